"""Gymnasium alone: a random search over linear policies, each environment of a vector playing another one."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from judging import ENV_ID, Trained, mean_return, run

POPULATION, BEST, EPISODE = 64, 16, 500


def train(steps: int) -> Trained:
    """Move the mean of a population of policies to that of its best ones, again and again."""
    generator = np.random.default_rng(0)
    envs = gym.make_vec(ENV_ID, num_envs=POPULATION)
    mean, deviation = np.zeros(14), np.full(14, 0.3)  # weights of 13 observations, and a constant
    before = mean_return(lambda observations: act(mean, observations))
    taken = 0
    while taken < steps:
        policies = mean + deviation * generator.standard_normal((POPULATION, mean.size))
        observations, _ = envs.reset(seed=[taken] * POPULATION)  # the same scenario for all
        returns = np.zeros(POPULATION)
        for _ in range(EPISODE):
            observations, rewards, *_ = envs.step(act(policies, observations))
            returns += rewards
        best = policies[np.argsort(returns)[-BEST:]]
        mean = mean + 0.5 * (best.mean(axis=0) - mean)
        deviation = deviation + 0.5 * (best.std(axis=0) - deviation)
        taken += POPULATION * EPISODE
    return Trained(before, mean_return(lambda observations: act(mean, observations)), taken)


def act(policies, observations):
    """Return the actions of one policy, or of one for each row of the observations."""
    return np.tanh((policies[..., :-1] * observations).sum(axis=1, keepdims=True) + policies[..., -1:]).astype("f4")


if __name__ == "__main__":
    run(train, 300_000)
