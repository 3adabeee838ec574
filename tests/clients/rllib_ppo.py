"""RLlib's PPO on the native vector environment."""

from __future__ import annotations

import gymnasium as gym
import ray
import torch
from judging import ENV_ID, Trained, mean_return, run
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

ROLLOUT = 4096


def train(steps: int) -> Trained:
    """Train with one environment runner in this process, and judge the mean of its Gaussian policy."""
    ray.init("local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    config = (
        PPOConfig()
        .environment(f"amulett_gym:{ENV_ID}", env_config={"suite": "steps"})
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=16,
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
            rollout_fragment_length=ROLLOUT // 16,
        )
        .training(gamma=0.95, lr=1e-3, train_batch_size=ROLLOUT, minibatch_size=512, num_epochs=10, vf_clip_param=10.0)
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], vf_share_layers=False))
        .debugging(seed=0, log_level="ERROR")
    )
    algorithm = config.build_algo()

    def act(observations):
        with torch.no_grad():
            found = algorithm.get_module().forward_inference({Columns.OBS: torch.as_tensor(observations)})
        return found[Columns.ACTION_DIST_INPUTS][:, :1].clamp(-1, 1).numpy()  # the mean; the rest is the deviation

    before = mean_return(act)
    rollouts = max(round(steps / ROLLOUT), 1)
    for _ in range(rollouts):
        algorithm.train()
    after = mean_return(act)
    algorithm.stop()
    ray.shutdown()
    return Trained(before, after, rollouts * ROLLOUT)


if __name__ == "__main__":
    run(train, 100_000)
