"""Measure the overhead of the environments over the kernel: time of a step, memory of a device.

::

    python -m amulett_gym.studies.speed.overhead
    python -m amulett_gym.studies.speed.overhead --devices 1024 --turns 21 --json overhead.json

Environment and kernel simulate the same seconds of the same episodes in turns, from the same state.
"""

from __future__ import annotations

import gc
import statistics
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np

import amulett_gym  # registers the environments
from amulett_gym.simulation import kernel
from amulett_gym.simulation.layout import RUNNING
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.speed.command import command

PROFILES = ("simulation", "testbed")
DEVICES = (1024, 16384)
TURNS = 15
CALLS = 300
"""Agent steps in a turn of the single environment, fewer than its scenario has."""
DEVICE_STEPS = 100_000
"""Steps of all devices in a turn of the vector environment, in at most `CALLS` calls."""
SETTLED = 50
"""Agent steps before measurements begin: every scenario is in motion then."""
ENV_ID = amulett_gym.ENV_IDS[0]

Turn = Callable[[], float]
"""A function that runs a turn and returns the mean time of a call [s]."""


@dataclass(frozen=True)
class Overhead:
    """Times of a call of the kernel alone and of `step` [us], their difference and their ratio: medians of turns."""

    kernel_us: float
    step_us: float
    difference_us: float
    ratio: float


@dataclass(frozen=True)
class Memory:
    """Bytes of a device: those that the environment holds, and those that one `step` returns to its caller."""

    held: float
    returned: float


def race(contestants: dict[str, Turn], turns: int) -> dict[str, list[float]]:
    """Run all contestants in turns; return the mean time of a call in each turn [us]."""
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for play in contestants.values():
        play()  # compile
    for _ in range(turns):
        for name, play in contestants.items():
            times[name].append(1e6 * play())
    return times


def step_overhead(profile: str, num_envs: int | None, turns: int = TURNS) -> Overhead:
    """Measure `step`, without Gymnasium's wrappers, against the kernel's ticks in it.

    Parameters
    ----------
    num_envs : int or None
        Devices of the vector environment; None: the single environment.
    """
    env: Any
    if num_envs is None:
        env, action, calls = gym.make(ENV_ID, profile=profile).unwrapped, np.zeros(1, dtype=np.float32), CALLS
    else:
        env = gym.make_vec(ENV_ID, num_envs=num_envs, profile=profile)
        action = np.zeros((num_envs, 1), dtype=np.float32)
        calls = min(max(DEVICE_STEPS // num_envs, 1), CALLS)
    env.reset(seed=0)
    for _ in range(SETTLED):
        env.step(action)
    state, simulation = env.get_state(), env.episodes.simulation
    ticks = round(env.episodes.agent_period / simulation.control_period)
    advance: Callable[..., None] = kernel.advance
    blocks = simulation.parameters, simulation.which, simulation.scenarios, simulation.states
    arrays = *blocks, simulation.paths, simulation.loop, simulation.extended, simulation.num_devices

    def turn(call: Callable[[], object]) -> Turn:
        def play() -> float:
            env.set_state(state)
            start = time.perf_counter()
            for _ in range(calls):
                call()
            return (time.perf_counter() - start) / calls

        return play

    times = race({"kernel": turn(lambda: advance(*arrays, ticks)), "step": turn(lambda: env.step(action))}, turns)
    if (simulation.read("failure") != RUNNING).any():
        raise AssertionError("a device has failed, which makes its ticks too fast")
    pairs = list(zip(times["kernel"], times["step"], strict=True))
    return Overhead(
        statistics.median(times["kernel"]),
        statistics.median(times["step"]),
        statistics.median(step - alone for alone, step in pairs),
        statistics.median(step / alone for alone, step in pairs),
    )


def reset_us(num_envs: int | None, seed: int | None, turns: int = TURNS) -> float:
    """Return the median time of `reset` of all devices [us], to the next episode or to that of a seed."""
    env: Any = gym.make(ENV_ID).unwrapped if num_envs is None else gym.make_vec(ENV_ID, num_envs=num_envs)
    calls = CALLS if num_envs is None else 1

    def play() -> float:
        start = time.perf_counter()
        for _ in range(calls):
            env.reset(seed=seed)
        return (time.perf_counter() - start) / calls

    return statistics.median(race({"reset": play}, turns)["reset"])


def memory(few: int = 1024, many: int = 16384) -> Memory:
    """Measure a device's memory, all that Python and numpy allocate, by vector environments of two sizes."""
    few_held, few_returned = _traced(few)
    many_held, many_returned = _traced(many)
    return Memory((many_held - few_held) / (many - few), (many_returned - few_returned) / (many - few))


def _traced(num_envs: int) -> tuple[int, int]:
    def play(num_envs: int) -> tuple[Any, ...]:
        env = gym.make_vec(ENV_ID, num_envs=num_envs)
        env.reset(seed=0)
        return env, env.step(np.zeros((num_envs, 1), dtype=np.float32))

    play(1)  # what is made once
    gc.collect()
    tracemalloc.start()
    kept = list(play(num_envs))
    both, _ = tracemalloc.get_traced_memory()
    kept.pop()  # what the step returned
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return held, both - held


def report(sizes: Sequence[int], turns: int, write: Callable[[str], object] = print) -> dict[str, Any]:
    """Measure everything; write it as text and return it as plain data."""
    batches = {"single": None, **{f"{size} devices": size for size in sizes}}
    found: dict[str, Any] = {"step": {}, "reset_us": {}}
    write(f"{f'medians of {turns} turns':28}{'kernel [us]':>12}{'step [us]':>12}{'beyond [us]':>13}{'ratio':>8}")
    for profile in PROFILES:
        overheads = {name: step_overhead(profile, size, turns) for name, size in batches.items()}
        for name, o in overheads.items():
            write(f"{f'{profile}, {name}':28}{o.kernel_us:12.1f}{o.step_us:12.1f}{o.difference_us:13.1f}{o.ratio:8.3f}")
        found["step"][profile] = {name: asdict(overhead) for name, overhead in overheads.items()}
    write(f"{'':28}{'reset [us]':>12}{'with a seed [us]':>19}")
    for name, size in batches.items():
        times = {"next": reset_us(size, None, turns), "seeded": reset_us(size, 0, turns)}
        write(f"{name:28}{times['next']:12.1f}{times['seeded']:19.1f}")
        found["reset_us"][name] = times
    found["bytes_per_device"] = asdict(memory())
    write(
        "a device takes {held:.0f} bytes, and {returned:.0f} in what a step returns".format(**found["bytes_per_device"])
    )
    return found


def main() -> int:
    """Run the command."""
    arguments = command(__doc__, "overhead", TURNS, DEVICES).parse_args()
    found = report(arguments.devices, arguments.turns)
    if arguments.json:
        write_json(arguments.json, found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
