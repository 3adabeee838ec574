"""Throughput of PPO, relative to a null environment."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.model import callbacks, make_model
from amulett_agents.validation import torch_threads

TURNS = 9


class ConstantVecEnv(VecEnv):
    """A null environment: constant observations and rewards, endless episodes."""

    def __init__(
        self, num_envs: int, observation_space: gym.Space[Any], action_space: gym.Space[Any], seed: int = 0
    ) -> None:
        super().__init__(num_envs, observation_space, action_space)
        shape = (num_envs, *(observation_space.shape or ()))
        # Not all zeros, with which arithmetic might be faster.
        self._observations = np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)
        self._rewards = np.full(num_envs, -0.002, dtype=np.float32)
        self._dones = np.zeros(num_envs, dtype=bool)
        self._infos: list[dict[str, Any]] = [{}] * num_envs

    def reset(self) -> NDArray[np.float32]:
        """Return the observations."""
        return self._observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Do nothing."""

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Return the constants."""
        return self._observations, self._rewards, self._dones, self._infos

    def close(self) -> None:
        """Do nothing."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return None for each device."""
        return [None for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Do nothing."""

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Return None for each device."""
        return [None for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each device."""
        return [False for _ in self._get_indices(indices)]


class RolloutClock(BaseCallback):
    """Adds up the duration of rollouts, without updates [s]."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds, self._started = 0.0, 0.0

    def _on_rollout_start(self) -> None:
        self._started = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self.seconds += time.perf_counter() - self._started

    def _on_step(self) -> bool:
        return True


def ppo_throughput(config: TrainConfig, turns: int = TURNS, watch: Callable[[], object] = int) -> dict[str, Any]:
    """Return the throughput of the same PPO on our environment and on a null environment, measured in turns.

    A turn has one episode's length of rollouts of each, so that every turn includes ends of episodes. Every update runs
    all its epochs: with `target_kl`, which ends updates early, the two would do different work.

    Parameters
    ----------
    config : TrainConfig
        The recipe of both.
    turns : int
    watch : callable
        Called after each turn, for a progress bar.

    Returns
    -------
    dict
        ``env`` and ``null``, medians of agent steps per second; ``ratio``, the median of env to null in the same turn;
        ``ratio_spread``, its minimum and maximum; ``step_ms``, of both, the duration of a step of all devices within
        a ``rollout`` and an ``update`` [ms].
    """
    config = config.model_copy(update={"ppo": config.ppo.model_copy(update={"target_kl": None})})
    with torch_threads(config.threads):
        models = {"env": make_model(config), "null": make_model(config)}
        like = models["null"].get_env()
        assert like is not None
        models["null"].env = ConstantVecEnv(config.num_envs, like.observation_space, like.action_space, config.seed)
        rollout = config.num_envs * config.ppo.n_steps
        for model in models.values():
            model.learn(rollout)  # compile, allocate
        rollouts = math.ceil(config.env.max_episode_steps / config.ppo.n_steps)
        rates: dict[str, list[float]] = {name: [] for name in models}
        clocks = {name: RolloutClock() for name in models}
        for _ in range(turns):
            seconds = dict.fromkeys(models, 0.0)
            for _ in range(rollouts):
                for name, model in models.items():
                    started = time.perf_counter()
                    model.learn(rollout, [*callbacks(config), clocks[name]], reset_num_timesteps=False)
                    seconds[name] += time.perf_counter() - started
            for name, passed in seconds.items():
                rates[name].append(rollouts * rollout / passed)
            watch()
    step_ms = {}
    for name, clock in clocks.items():
        rolling = 1e3 * clock.seconds / (turns * rollouts * config.ppo.n_steps)
        whole = 1e3 * config.num_envs * sum(1.0 / rate for rate in rates[name]) / turns
        step_ms[name] = {"rollout": rolling, "update": whole - rolling}
    ratios = [env / null for env, null in zip(rates["env"], rates["null"], strict=True)]
    return {
        "env": statistics.median(rates["env"]),
        "null": statistics.median(rates["null"]),
        "ratio": statistics.median(ratios),
        "ratio_spread": [min(ratios), max(ratios)],
        "num_envs": config.num_envs,
        "step_ms": step_ms,
    }
