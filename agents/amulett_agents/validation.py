"""Validation of a model during training, on scenarios that are never trained on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO

from amulett_agents.bundles import describe_policy
from amulett_agents.config import TrainConfig
from amulett_agents.model import Model
from amulett_gym.envs.reward import TERM_KEY
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.laws.actor import Actor

_WATCHED = 50
"""Steps between two calls of `watch` in a validation."""


def make_validation_env(
    config: TrainConfig, split: str = "validation", tension_law: str = "agent"
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return the environment in which a run's policies are compared."""
    return gym.make_vec(config.env.id, split=split, tension_law=tension_law, **config.validation_keywords)


def evaluate(
    model: Model, env: gym.vector.VectorEnv[Any, Any, Any], seed: int, watch: Callable[[], object] = int
) -> dict[str, float]:
    """Return the mean cost per episode of a model's deterministic policy, by the arithmetic of its bundle.

    Each device of `env` plays one episode; device i is seeded with ``seed + i``. `watch` is called every 50 steps, to
    show progress. The result has ``cost``, minus the mean return; each reward term's share of it; the number of
    ``failures``; the present ``exploration_std`` (of SAC at the first observations).
    """
    act = Actor(*describe_policy(model), env)
    observations, info = env.reset(seed=seed)
    std = exploration_std(model, act.inputs(observations))
    playing = np.ones(env.num_envs, dtype=bool)
    step = failures = 0
    costs = dict.fromkeys(reward_terms(env), 0.0)
    while playing.any():
        if step % _WATCHED == 0:
            watch()
        step += 1
        observations, _, terminated, truncated, info = env.step(act(observations))
        for term in costs:
            costs[term] -= float(info[TERM_KEY.format(term)][playing].sum()) / env.num_envs
        failures += int((terminated & playing).sum())
        playing &= ~(terminated | truncated)
    return {"cost": sum(costs.values()), **costs, "failures": failures, "exploration_std": std}


def reward_terms(env: gym.vector.VectorEnv[Any, Any, Any]) -> tuple[str, ...]:
    """Return the names of the reward's terms in an environment of `make_validation_env`."""
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, TensionVectorEnv)
    return unwrapped.episodes.terms


def exploration_std(model: Model, observations: NDArray[np.floating[Any]]) -> float:
    """Return the mean standard deviation of a model's exploration noise, before SAC's tanh, at some observations."""
    with torch.no_grad():
        if isinstance(model, PPO):
            return float(model.policy.log_std.exp().mean())
        seen = torch.as_tensor(observations, dtype=torch.float32)
        return float(model.policy.actor.get_action_dist_params(seen)[1].exp().mean())


def warm_up(config: TrainConfig) -> None:
    """Compile the kernel of a recipe's environment, so that no measured time includes it."""
    env = gym.make_vec(config.env.id, num_envs=2, split="validation", max_episode_steps=1, **config.env.keywords())
    env.reset(seed=0)
    for _ in range(2):  # the second step starts the next episode
        env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
    env.close()


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch compute with `count` threads within the block."""
    threads = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
