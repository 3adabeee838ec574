"""How fast the environments are, beside Gymnasium's own in the same run.

The machine is noisy, so contestants take turns and the median of their turns counts; a ratio under 1.3 is a tie.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

TURNS = 7
TURN_SECONDS = 0.25

Step = Callable[[], object]


@dataclass(frozen=True)
class Contestant:
    """Something that steps: `devices` agent steps a call, each of `ticks` control ticks."""

    name: str
    step: Step
    devices: int = 1
    ticks: int = 1


@dataclass(frozen=True)
class Speed:
    """A contestant's median speed and the spread of its turns."""

    name: str
    steps_per_second: float
    slowest: float
    fastest: float
    ticks_per_second: float


def contestants(devices: int = 1024, seed: int = 0) -> list[Contestant]:
    """Return the environments on both profiles, single and vector, and Gymnasium's Pendulum and CartPole.

    Each holds an action that is drawn once, with `seed`; its episodes are drawn with `seed`, too.
    """
    ours = []
    for profile in ("testbed", "simulation"):
        keywords: dict[str, Any] = {"profile": profile, "suite": "steps"}
        single = gym.make("Amulett/Scaling-v0", **keywords)
        unwrapped: Any = single.unwrapped
        ticks = round(unwrapped.episodes.agent_period / unwrapped.profile.loop.control_period)
        vector = gym.make_vec("Amulett/Scaling-v0", num_envs=devices, **keywords)
        ours += [
            Contestant(f"single, {profile}", _single(single, seed), 1, ticks),
            Contestant(f"vector of {devices}, {profile}", _vector(vector, seed), devices, ticks),
        ]
    return [
        *ours,
        Contestant("Pendulum-v1, single", _single(gym.make("Pendulum-v1"), seed)),
        Contestant("CartPole-v1, single", _single(gym.make("CartPole-v1"), seed)),
        Contestant(
            f"CartPole-v1, vector of {devices}",
            _vector(gym.make_vec("CartPole-v1", num_envs=devices, vectorization_mode="vector_entry_point"), seed),
            devices,
        ),
    ]


def race(
    entrants: list[Contestant], turns: int = TURNS, seconds: float = TURN_SECONDS, watch: Callable[[], object] = int
) -> list[Speed]:
    """Let all step in turns and return their speeds.

    Parameters
    ----------
    entrants : list of Contestant
    turns : int
        Turns each of them takes.
    seconds : float
        Length of a turn [s].
    watch : callable
        Called after each turn, for a progress bar.
    """
    for entrant in entrants:
        entrant.step()  # compile
    rates: dict[str, list[float]] = {entrant.name: [] for entrant in entrants}
    for _ in range(turns):
        for entrant in entrants:
            rates[entrant.name].append(_rate(entrant.step, seconds) * entrant.devices)
            watch()
    return [
        Speed(name, statistics.median(found), min(found), max(found), statistics.median(found) * entrant.ticks)
        for entrant, (name, found) in zip(entrants, rates.items(), strict=True)
    ]


def _rate(step: Step, seconds: float) -> float:
    calls, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < seconds:
        for _ in range(10):
            step()
        calls += 10
    return calls / passed


def _single(env: gym.Env[Any, Any], seed: int) -> Step:
    """Return a function that steps an environment and resets it when its episode ends, as any user's loop does."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    action = env.action_space.sample()

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return step


def _vector(env: gym.vector.VectorEnv[Any, Any, Any], seed: int) -> Step:
    env.reset(seed=seed)
    env.action_space.seed(seed)
    actions = env.action_space.sample()
    return lambda: env.step(actions)
