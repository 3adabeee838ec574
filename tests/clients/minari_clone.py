"""Minari: a data set of a good constant's episodes, and a policy fitted to what it reads back."""

from __future__ import annotations

import os
import tempfile

import gymnasium as gym
import minari
import numpy as np
from judging import ENV_ID, Trained, mean_return, run

from amulett_gym import load_policy

TEACHER = "eq6-tuned"


def train(steps: int) -> Trained:
    """Record the teacher, and fit the next tension to the observations by least squares, with and without squares."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        collector = minari.DataCollector(gym.make(ENV_ID))
        teacher = load_policy(TEACHER, collector)
        for episode in range(-(-steps // 500)):
            observation, _ = collector.reset(seed=episode)
            ended = False
            while not ended:
                observation, _, terminated, truncated, _ = collector.step(teacher(observation))
                ended = terminated or truncated
        collector.create_dataset("amulett/teacher-v0", algorithm_name=TEACHER, author="amulett-gym")
        episodes = list(minari.load_dataset("amulett/teacher-v0").iterate_episodes())
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    weights, *_ = np.linalg.lstsq(inputs(observations), actions, rcond=None)
    before = mean_return(lambda seen: np.zeros((len(seen), 1)))
    after = mean_return(lambda seen: np.clip(inputs(seen) @ weights, -1.0, 1.0))
    return Trained(before, after, len(actions))


def inputs(observations):
    """Return observations, their squares and a constant."""
    return np.concatenate([observations, observations**2, np.ones((len(observations), 1))], axis=1)


if __name__ == "__main__":
    run(train, 20_000)
