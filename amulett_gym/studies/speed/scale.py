"""Scaling of the vector environment: cost of a device's step, memory of a device, long runs."""

from __future__ import annotations

import gc
import os
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym import ENV_IDS
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.studies.speed.rates import AGENT_PERIOD, Contestant, kernel, race, ratios, spread, vector

SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
THREADED_SIZES = (1024, 8192, 65536)
PARTS = 8
"""Parts of the devices that threads take in turn: small ones would ask for the GIL too often."""
UNDISTURBED = 2**16
"""Agent steps of all devices before two threads that wait as little as possible wait for each other."""
HOUR = 3600.0  # [s]
EPISODE_STEPS = 500
SLICES = 60
"""Parts of the long run in which speed and memory are measured."""
LONE_DEVICES = 8
"""Devices whose one episode lasts as long as the whole long run: a block of the kernel."""

Watch = Callable[[], object]
Floats = NDArray[np.float32]


def cost_by_size(
    profile: str = "testbed", sizes: Sequence[int] = SIZES, seed: int = 0, turns: int = 3, watch: Watch = int
) -> dict[int, dict[str, float]]:
    """Return the time of one device's step in a vector environment of each size [ns]: median, least, most."""
    entrants = [vector(profile, size, seed) for size in sizes]
    speeds = race(entrants, turns, watch=watch)
    return {size: spread([1e9 / rate for rate in speed.rates]) for size, speed in zip(sizes, speeds, strict=True)}


def two_threads(
    profile: str = "testbed", sizes: Sequence[int] = THREADED_SIZES, seed: int = 0, turns: int = 7, watch: Watch = int
) -> dict[int, dict[str, dict[str, float]]]:
    """Return speed-ups by a second thread at each size, turn by turn: median, least, most.

    ``"threads"`` is that of an environment. ``"cores"`` is that of the kernel alone, the devices in `PARTS`, which two
    threads take in turn; they wait for each other only after `UNDISTURBED` agent steps: what the machine has to give.
    """
    speeds = race([one for size in sizes for one in _threaded(profile, size, seed)], turns, watch=watch)
    found = {}
    for k, size in enumerate(sizes):
        one, two, alone, together = speeds[4 * k : 4 * (k + 1)]
        found[size] = {"threads": spread(ratios(two, one)), "cores": spread(ratios(together, alone))}
    return found


def _threaded(profile: str, devices: int, seed: int) -> list[Contestant]:
    """Return an environment with one thread and with two, and the kernel with one and two that hardly wait."""
    parts = [kernel(profile, devices // PARTS, seed + part) for part in range(PARTS)]
    calls = max(UNDISTURBED // devices, 1)

    def advance(waiting: Iterable[Contestant]) -> None:
        for part in waiting:
            for _ in range(calls):
                part.step()

    def advance_together() -> None:
        waiting = iter(parts)  # of both threads; with the GIL, none is taken twice
        other = pool.submit(advance, waiting)
        advance(waiting)
        other.result()

    pool = ThreadPoolExecutor(1)
    steps = lambda: advance(parts), advance_together
    environments = [vector(profile, devices, seed, threads) for threads in (1, 2)]
    return [*environments, *(Contestant("kernel", step, calls * PARTS * parts[0].devices) for step in steps)]


def memory_per_device(profile: str = "testbed", devices: int = 65536, seed: int = 0) -> dict[str, float | None]:
    """Return the bytes of a device in a vector environment.

    ``"simulation"`` are those of the simulated devices' arrays, ``"arrays"`` those of all arrays that the environment
    holds, Gymnasium's batched spaces included. ``"resident"`` is the growth of the process's resident memory while the
    environment was made, reset and stepped twice, room for the results of a step included; None without ``/proc``.
    """
    small = _made(profile, 1)
    small.reset(seed=seed)
    small.step(np.zeros((1, 1), dtype=np.float32))  # loads and compiles: memory of no device
    before = resident_bytes()
    env = _made(profile, devices)
    env.reset(seed=seed)
    for _ in range(2):
        env.step(np.zeros((devices, 1), dtype=np.float32))
    after = resident_bytes()
    return {
        "devices": devices,
        "simulation": held_bytes(env.episodes) / devices,
        "arrays": held_bytes(env) / devices,
        "resident": None if before is None or after is None else (after - before) / devices,
    }


def held_bytes(thing: Any) -> int:
    """Return the bytes of all different arrays that an object holds, directly or indirectly."""
    arrays: dict[int, int] = {}
    seen: set[int] = set()

    def look(item: Any) -> None:
        if id(item) in seen:
            return
        seen.add(id(item))
        if isinstance(item, np.ndarray):
            while isinstance(item.base, np.ndarray):
                item = item.base
            arrays[id(item)] = item.nbytes
        elif isinstance(item, dict):
            for value in item.values():
                look(value)
        elif isinstance(item, list | tuple):
            for value in item:
                look(value)
        elif type(item).__module__.startswith(("amulett_gym", "gymnasium.spaces")):
            look(vars(item))

    look(thing)
    return sum(arrays.values())


def resident_bytes() -> int | None:
    """Return the process's resident memory now, or None where there is no ``/proc``."""
    gc.collect()
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def long_run(
    profile: str = "testbed", devices: int = 1024, seconds: float = HOUR, seed: int = 0, watch: Watch = int
) -> dict[str, Any]:
    """Return the drift, the growth of memory and the slow-down in a long run of about `seconds` of simulated time.

    In one environment each device plays episode after episode; the last one must be, bit for bit, that of a new
    environment. In another one `LONE_DEVICES` devices play one single episode. `watch` is called `SLICES` times.

    Returns
    -------
    dict
        ``steps_per_s`` and ``resident_bytes`` of each slice, the ``speed_ratio`` of the last third to the first, the
        growth ``resident_growth_bytes_per_device`` from the end of the first slice, ``failures``,
        ``last_episode_is_exact``, and for the single episode ``lone_clock_error_s``, and the changes
        ``lone_angle_change_deg`` and ``lone_tension_change_n`` between its middle and its end.
    """
    rng = np.random.default_rng(seed)
    episodes = max(round(seconds / (EPISODE_STEPS * AGENT_PERIOD) / SLICES), 1)
    env = _made(profile, devices)
    env.reset(seed=seed)
    steps = SLICES * episodes * (EPISODE_STEPS + 1)  # with the step that starts the next episode
    lone = _made(profile, LONE_DEVICES, max_episode_steps=steps)
    lone.reset(seed=seed)
    held = np.zeros((LONE_DEVICES, 1), dtype=np.float32)
    speeds, memory, lone_means, failures = [], [], [], 0
    observations: Floats = np.empty(0, dtype=np.float32)
    for _ in range(SLICES):
        actions = rng.uniform(-1, 1, (devices, 1)).astype(np.float32)
        passed = 0.0
        readings = []
        for _ in range(episodes * (EPISODE_STEPS + 1)):
            start = time.perf_counter()
            observations, _, terminated, _, _ = env.step(actions)
            passed += time.perf_counter() - start
            failures += int(terminated.sum())
            info = lone.step(held)[4]
            readings.append((info["joint_angle"].mean(), info["force_biceps"].mean() + info["force_triceps"].mean()))
        failures += int(np.count_nonzero(info["failure"]))
        speeds.append(devices * episodes * (EPISODE_STEPS + 1) / passed)
        memory.append(resident_bytes())
        lone_means.append(np.mean(readings, axis=0))
        watch()
    half, third = SLICES // 2, SLICES // 3
    change = np.abs(lone_means[-1] - lone_means[half])
    grown = None if memory[0] is None or memory[-1] is None else (memory[-1] - memory[0]) / devices
    return {
        "devices": devices,
        "simulated_s": steps * AGENT_PERIOD,
        "steps_per_s": speeds,
        "resident_bytes": memory,
        "speed_ratio": statistics.median(speeds[-third:]) / statistics.median(speeds[:third]),
        "resident_growth_bytes_per_device": grown,
        "failures": failures,
        "last_episode_is_exact": _replays(env, profile, seed, SLICES * episodes, observations, actions),
        "lone_clock_error_s": float(np.abs(info["time"] - steps * AGENT_PERIOD).max()),
        "lone_angle_change_deg": float(change[0]),
        "lone_tension_change_n": float(change[1]) / 2,
    }


def _replays(
    env: TensionVectorEnv, profile: str, seed: int, episode: int, observations: Floats, actions: Floats
) -> bool:
    """Return whether the environment continues as a new one that was reset until the same episode."""
    new = _made(profile, env.num_envs)
    first, _ = new.reset(seed=seed)
    for _ in range(episode):
        first, _ = new.reset()
    if not np.array_equal(first, observations):
        return False
    return all(np.array_equal(env.step(actions)[0], new.step(actions)[0]) for _ in range(EPISODE_STEPS))


def _made(profile: str, devices: int, max_episode_steps: int = EPISODE_STEPS) -> TensionVectorEnv:
    env: Any = gym.make_vec(
        ENV_IDS[0],
        num_envs=devices,
        profile=profile,
        suite="steps",
        agent_period=AGENT_PERIOD,
        max_episode_steps=max_episode_steps,
    )
    made: TensionVectorEnv = env.unwrapped
    return made
