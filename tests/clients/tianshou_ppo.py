"""Tianshou's PPO on single environments."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from judging import ENV_ID, Trained, mean_return, run
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic

NUM_ENVS, ROLLOUT = 8, 4096


def train(steps: int) -> Trained:
    """Train with a small exploration noise: noise in the tension costs motor effort."""
    torch.manual_seed(0)
    envs = DummyVectorEnv([lambda: gym.make(ENV_ID) for _ in range(NUM_ENVS)])
    envs.seed(0)
    observed, acted = envs.observation_space[0], envs.action_space[0]
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(state_shape=observed.shape, hidden_sizes=[64, 64], activation=torch.nn.Tanh),
        action_shape=acted.shape,
        unbounded=True,
    )
    critic = ContinuousCritic(
        preprocess_net=Net(state_shape=observed.shape, hidden_sizes=[64, 64], activation=torch.nn.Tanh)
    )
    with torch.no_grad():
        actor.sigma_param.fill_(-1.0)
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda mean_and_deviation: torch.distributions.Independent(
            torch.distributions.Normal(*mean_and_deviation), 1
        ),
        action_space=acted,
        deterministic_eval=True,
    )
    algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=1e-3), gamma=0.95, ent_coef=0.0)

    def act(observations):
        with torch.no_grad():
            return np.clip(actor(observations)[0][0].numpy(), -1.0, 1.0)

    before = mean_return(act)
    rollouts = max(round(steps / ROLLOUT), 1)
    algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=Collector(algorithm, envs, VectorReplayBuffer(ROLLOUT, NUM_ENVS)),
            max_epochs=1,
            epoch_num_steps=rollouts * ROLLOUT,
            collection_step_num_env_steps=ROLLOUT,
            update_step_num_repetitions=10,
            batch_size=512,
            test_in_training=False,
            show_progress=False,
            verbose=False,
        )
    )
    return Trained(before, mean_return(act), rollouts * ROLLOUT)


if __name__ == "__main__":
    run(train, 100_000)
