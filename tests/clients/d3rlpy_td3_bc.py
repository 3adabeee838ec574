"""d3rlpy's TD3+BC, which learns from recorded steps alone: those of eq. 6 with tuned parameters."""

from __future__ import annotations

import d3rlpy
import gymnasium as gym
import numpy as np
from judging import ENV_ID, Trained, mean_return, run

from amulett_gym import load_policy

EPISODES, EPISODE = 32, 500


def train(steps: int) -> Trained:
    """Record 32 episodes of a native vector environment, and take `steps` gradient steps on them."""
    d3rlpy.seed(0)
    # A small alpha: cloning dominates, since a critic learns little from the actions of one law.
    model = d3rlpy.algos.TD3PlusBCConfig(gamma=0.95, batch_size=256, alpha=0.1).create(device="cpu:0")
    dataset = d3rlpy.dataset.MDPDataset(*record())
    model.build_with_dataset(dataset)
    before = mean_return(model.predict)
    steps = max(steps, 100)
    model.fit(
        dataset,
        n_steps=steps,
        n_steps_per_epoch=steps,
        show_progress=False,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )
    return Trained(before, mean_return(model.predict), steps)


def record():
    """Return observations, actions, rewards, and the ends of episodes by failure and by time, one step a row."""
    envs = gym.make_vec(ENV_ID, num_envs=EPISODES, max_episode_steps=EPISODE + 1)
    policy = load_policy("eq6-tuned", envs)
    observations, _ = envs.reset(seed=0)
    rows = []
    for step in range(EPISODE):
        actions = policy(observations)
        following, rewards, terminated, _, _ = envs.step(actions)
        rows.append((observations, actions, rewards, terminated, np.full(EPISODES, step == EPISODE - 1)))
        observations = following
    return tuple(np.stack(column, axis=1).reshape(EPISODES * EPISODE, -1) for column in zip(*rows, strict=True))


if __name__ == "__main__":
    run(train, 3_000)
