"""The speed of the environments in comparison with Gymnasium's own.

Timings are noisy, so contestants take turns and the median of their turns counts; a ratio under 1.3 is a tie.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import Control
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.tasks.suites import sample
from amulett_gym.tasks.worn_suites import sample_worn

PROFILES = ("testbed", "simulation")
TURNS = 7
TURN_SECONDS = 0.25
AGENT_PERIOD = 0.02
"""Simulated time of a kernel's call [s], as an environment makes it."""
EPISODE = 10.0
"""Simulated time after which the kernel alone restarts its scenarios [s]."""

Step = Callable[[], object]


@dataclass(frozen=True)
class Contestant:
    """A function to measure: a call of `step` makes `devices` agent steps, each of `ticks` control ticks."""

    name: str
    step: Step
    devices: int = 1
    ticks: int = 1


@dataclass(frozen=True)
class Speed:
    """A contestant's agent steps a second in each turn, and the control ticks of such a step."""

    name: str
    rates: tuple[float, ...]
    ticks: int = 1

    @property
    def steps_per_second(self) -> float:
        """Median of the turns."""
        return statistics.median(self.rates)

    @property
    def ticks_per_second(self) -> float:
        """Median of the turns."""
        return self.steps_per_second * self.ticks

    def numbers(self) -> dict[str, float]:
        """Return the median, the slowest and the fastest turn, and ticks a second, by name."""
        steps = {"steps_per_s": self.steps_per_second, "slowest": min(self.rates), "fastest": max(self.rates)}
        return {**steps, "ticks_per_s": self.ticks_per_second}


def contestants(devices: int = 1024, seed: int = 0) -> list[Contestant]:
    """Return kernel and environments on both profiles, and Gymnasium's Pendulum and CartPole.

    Each environment repeats one action, drawn with `seed`, as its episodes are.
    """
    return [
        *(kernel(profile, devices, seed) for profile in PROFILES),
        *(single(profile, seed) for profile in PROFILES),
        *(vector(profile, devices, seed) for profile in PROFILES),
        Contestant("Pendulum-v1, single", step_single(gym.make("Pendulum-v1"), seed)),
        Contestant("CartPole-v1, single", step_single(gym.make("CartPole-v1"), seed)),
        Contestant(
            f"CartPole-v1, vector of {devices}",
            _step_vector(gym.make_vec("CartPole-v1", num_envs=devices, vectorization_mode="vector_entry_point"), seed),
            devices,
        ),
    ]


def single(profile: str, seed: int = 0) -> Contestant:
    """Return our single environment, as `gym.make` makes it."""
    env = gym.make("Amulett/Scaling-v0", profile=profile, suite="steps", agent_period=AGENT_PERIOD)
    return Contestant(f"single, {profile}", step_single(env, seed), 1, _ticks(profile))


def vector(profile: str, devices: int, seed: int = 0, threads: int = 1) -> Contestant:
    """Return our vector environment."""
    env = gym.make_vec(
        "Amulett/Scaling-v0",
        num_envs=devices,
        profile=profile,
        suite="steps",
        agent_period=AGENT_PERIOD,
        threads=threads,
    )
    name = f"vector of {devices}, {profile}" + (f", {threads} threads" if threads > 1 else "")
    return Contestant(name, _step_vector(env, seed), devices, _ticks(profile))


def kernel(profile: str, devices: int, seed: int = 0, control: Control = "decentralized") -> Contestant:
    """Return the kernel alone with a control loop, an agent's period a call, eq. 6 inside the loop."""
    device = load_profile(profile)
    simulation = Simulation(device, devices, control, tension_law="eq6")
    simulation.reset(sample("steps", _keys(devices, seed), device))
    name = f"kernel of {devices}, {profile}" + (f", {control}" if control != "decentralized" else "")
    return _kernel(name, simulation)


def worn_kernels(control: Control, devices: int, seed: int = 0) -> tuple[Contestant, Contestant]:
    """Return the kernel with the same devices and scenarios worn and bare, a control loop and eq. 6 in both.

    Bare devices make the wearers' moves on their own. There are no pushes: those on a hand are too strong for a bare
    device, and one that failed takes no time.
    """
    device = load_profile("worn")
    rows, wearers = sample_worn("reaches", _keys(devices, seed), device)
    worn = WornSimulation(device, devices, control, tension_law="eq6")
    worn.reset(rows, wearers=wearers)
    worn.assist(1.0)
    bare = Simulation(device, devices, control, tension_law="eq6")
    bare.reset(rows)
    return _kernel(f"worn, {control}", worn), _kernel(f"bare, {control}", bare)


def _keys(devices: int, seed: int) -> NDArray[np.uint64]:
    return np.random.default_rng(seed).integers(2**63, size=devices, dtype=np.uint64)


def _kernel(name: str, simulation: Simulation) -> Contestant:
    """Return a simulation as a contestant, which starts its scenarios again after an episode."""
    start = simulation.get_state()
    ticks = round(AGENT_PERIOD / simulation.control_period)
    calls = 0

    def step() -> None:
        nonlocal calls
        simulation.advance(ticks)
        calls += 1
        if calls * AGENT_PERIOD >= EPISODE:
            simulation.set_state(start)
            calls = 0

    return Contestant(name, step, simulation.num_devices, ticks)


def race(
    entrants: Sequence[Contestant], turns: int = TURNS, seconds: float = TURN_SECONDS, watch: Callable[[], object] = int
) -> list[Speed]:
    """Return the speeds of all entrants, which step in turns of `seconds` [s]; `watch` is called after each turn."""
    for entrant in entrants:
        entrant.step()  # compile
    rates: list[list[float]] = [[] for _ in entrants]
    for _ in range(turns):
        for entrant, found in zip(entrants, rates, strict=True):
            found.append(_rate(entrant.step, seconds) * entrant.devices)
            watch()
    return [Speed(entrant.name, tuple(found), entrant.ticks) for entrant, found in zip(entrants, rates, strict=True)]


def spread(numbers: Sequence[float]) -> dict[str, float]:
    """Return the median, the least and the largest of some numbers, by name."""
    return {"median": statistics.median(numbers), "least": min(numbers), "most": max(numbers)}


def ratios(ours: Speed, theirs: Speed) -> list[float]:
    """Return the ratios of `ours` to `theirs` turn by turn: neighbouring turns run under similar load."""
    return [mine / other for mine, other in zip(ours.rates, theirs.rates, strict=True)]


def step_single(env: gym.Env[Any, Any], seed: int) -> Step:
    """Return a function that steps an environment and resets it when its episode ends."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    action = env.action_space.sample()

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return step


def _step_vector(env: gym.vector.VectorEnv[Any, Any, Any], seed: int) -> Step:
    env.reset(seed=seed)
    env.action_space.seed(seed)
    actions = env.action_space.sample()
    return lambda: env.step(actions)


def _rate(step: Step, seconds: float) -> float:
    calls, start = 0, time.perf_counter()
    while True:
        for _ in range(10):
            step()
        calls += 10
        passed = time.perf_counter() - start
        if passed >= seconds:
            return calls / passed


def _ticks(profile: str) -> int:
    return round(AGENT_PERIOD / load_profile(profile).loop.control_period)
