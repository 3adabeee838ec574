"""Stable-Baselines3's PPO on the native vector environment, and what is the same for its relatives."""

from __future__ import annotations

from functools import partial

from judging import ENV_ID, Trained, mean_return, run
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm

from amulett_agents import make_sb3_env


def train(learner: type[BaseAlgorithm], steps: int) -> Trained:
    """Train with a small exploration noise: noise in the tension costs motor effort."""
    envs = make_sb3_env(ENV_ID, num_envs=16)
    about = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3, "gamma": 0.95}
    policy = {"log_std_init": -1.0, "net_arch": [64, 64]}
    model = learner("MlpPolicy", envs, **about, policy_kwargs=policy, seed=0, device="cpu")

    def act(observations):
        return model.predict(observations, deterministic=True)[0]

    before = mean_return(act)
    model.learn(steps)
    return Trained(before, mean_return(act), model.num_timesteps)


if __name__ == "__main__":
    run(partial(train, PPO), 100_000)
