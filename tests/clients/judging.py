"""What the scripts of this folder share: a policy's mean return on held-out scenarios, and the line that they print.

Every script trains with one program of others: ``python NAME.py [STEPS]``. `.ci/clients` runs them all.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import amulett_gym

ENV_ID = amulett_gym.ENV_IDS[0]
EPISODES = 64

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class Trained(NamedTuple):
    """Mean returns before and after a training, and its agent steps."""

    before: float
    after: float
    steps: int


def mean_return(act: Act, **keywords: Any) -> float:
    """Return the mean return of deterministic actions, shape (N, 1), for observations, shape (N, 13).

    The scenarios are the same in every call; `keywords` are those of the environment.
    """
    envs = gym.make_vec(ENV_ID, num_envs=EPISODES, split="held-out", **keywords)
    observations, _ = envs.reset(seed=0)
    returns, running = np.zeros(EPISODES), np.ones(EPISODES, dtype=bool)
    while running.any():
        actions = np.asarray(act(observations), dtype=np.float32).reshape(EPISODES, 1)
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        returns += rewards * running
        running &= ~(terminated | truncated)
    envs.close()
    return float(returns.mean())


def run(train: Callable[[int], Trained], steps: int) -> None:
    """Train for the number of steps on the command line, or for `steps`, and print the result as JSON."""
    print(json.dumps(train(int(sys.argv[1]) if len(sys.argv) > 1 else steps)._asdict()))
