"""Measure the kernel's speed against the same tick in C, with the machine's limits (roofline).

::

    python -m amulett_gym.studies.speed.yardstick
    python -m amulett_gym.studies.speed.yardstick --devices 1024 --turns 3 --json yardstick.json

Every build is first checked against the kernel: a second of a mixed suite from exactly the same states.
"""

from __future__ import annotations

import ctypes
import platform
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.c.build import BUILDS, NO_COMPILER, Advance, aligned, build, compile_library, find_compiler
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation import kernel
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import RUNNING, STATE_NAMES
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.speed.command import command
from amulett_gym.studies.speed.work import FUNCTION_COST, count_work, flops
from amulett_gym.tasks.suites import sample

PROFILES = ("simulation", "testbed")
SUITES = ("steps", "reach", "hold-push")
"""Suites whose speed is measured."""
CHECKED_SUITES = (*SUITES, "mixed")
"""Suites whose states are compared; together they have everything that a scenario can have."""
DEVICES = (1024, 8192, 65536)
TURNS = 5
TURN_SECONDS = 0.15
AGENT_PERIOD = 0.02
"""Simulated time of a call [s], as an environment makes it."""
START = 1.0
"""Simulated time at which measurements begin [s]: every scenario is in motion then."""
CHECKED_DEVICES = 203
"""Not a multiple of the lanes: the last block is padded."""
CONSTANT_TENSION = 7.0  # [N]
KERNEL = "kernel"


def mixed_simulation(
    profile: str | Profile, num_devices: int, tension_law: str = "eq6", suites: Sequence[str] = SUITES
) -> Simulation:
    """Return devices at the start of the suites in turn; under ``"agent"`` the tension is a constant."""
    device = load_profile(profile)
    simulation = Simulation(device, num_devices, tension_law=tension_law)
    keys = np.arange(1, num_devices + 1, dtype=np.uint64)
    rows = sample(suites[0], keys, device)
    for k, suite in enumerate(suites[1:], start=1):
        rows[k :: len(suites)] = sample(suite, keys[k :: len(suites)], device)
    simulation.reset(rows)
    if tension_law == "agent":
        simulation.command_tension(CONSTANT_TENSION)
    return simulation


def deviations(expected: NDArray[np.void], states: NDArray[np.void]) -> dict[str, float]:
    """Return each field's largest deviation, relative where the expected value is above 1; NaN equals only NaN."""
    largest = {}
    for name in STATE_NAMES:
        should, is_ = expected[name].astype(float), states[name].astype(float)
        scale = np.maximum(1.0, np.abs(np.nan_to_num(should)))
        difference = np.where(np.isnan(should) & np.isnan(is_), 0.0, np.abs(should - is_) / scale)
        largest[name] = float(np.nan_to_num(difference, nan=np.inf).max())
    return largest


def check(
    advance: Advance, profile: str | Profile, tension_law: str, num_devices: int = CHECKED_DEVICES
) -> tuple[float, str]:
    """Return the largest deviation from the kernel after `START` seconds, and the field in which it is."""
    simulation = mixed_simulation(profile, num_devices, tension_law, CHECKED_SUITES)
    scenarios, states = aligned(simulation.scenarios), aligned(simulation.states)
    ticks = round(START / simulation.control_period)
    devices = simulation.parameters, simulation.which
    advance(*devices, scenarios, states, simulation.paths, simulation.loop, simulation.extended, num_devices, ticks)
    simulation.advance(ticks)
    largest = deviations(simulation.states, states)
    field = max(largest, key=lambda name: largest[name])
    return largest[field], field


@dataclass(frozen=True)
class Speed:
    """Million ticks a second on one core, and the ratio to strict scalar C, turn by turn: median, least, most."""

    rate: tuple[float, float, float]
    ratio: tuple[float, float, float]


def agree(builds: Mapping[str, Advance], write: Callable[[str], object] = lambda line: None) -> dict[str, float]:
    """Return the largest deviation of each build's states from the kernel's, over both profiles and two laws.

    Raises AmulettError if one exceeds its tolerance.
    """
    found, wrong = {}, []
    for name, advance in builds.items():
        cases = {(p, law): check(advance, p, law) for p in PROFILES for law in ("eq6", "agent")}
        worst, field = max(cases.values())
        found[name] = worst
        ok = worst <= BUILDS[name].tolerance
        write(f"  {BUILDS[name].label:40}{worst:10.1e}  {'ok' if ok else 'TOO MUCH'}")
        if not ok:
            wrong.append(f"'{BUILDS[name].label}' by {worst:.1e} in {field}, allowed is {BUILDS[name].tolerance:g}")
    if wrong:
        raise AmulettError(f"the tick in C deviates from the kernel: {'; '.join(wrong)}")
    return found


def race(
    contestants: Mapping[str, Advance],
    profile: str,
    num_devices: int,
    turns: int = TURNS,
    seconds: float = TURN_SECONDS,
    reference: str = "scalar",
) -> dict[str, Speed]:
    """Return the speeds of all contestants, which advance the same devices in turns of `seconds`, a period a call.

    A ratio is to the rate of `reference` in the same turn.
    """
    simulation = mixed_simulation(profile, num_devices)
    simulation.advance(round(START / simulation.control_period))
    if (simulation.read("failure") != RUNNING).any():
        raise AssertionError("a device has failed, which makes its ticks too fast")
    ticks = round(AGENT_PERIOD / simulation.control_period)
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(turns):
        for name, advance in contestants.items():
            scenarios, states = aligned(simulation.scenarios), aligned(simulation.states)
            devices = simulation.parameters, simulation.which
            arrays = *devices, scenarios, states, simulation.paths, simulation.loop, simulation.extended, num_devices
            rates[name].append(_rate(advance, arrays, ticks, seconds))
    ratios = {name: [r / c for r, c in zip(found, rates[reference], strict=True)] for name, found in rates.items()}
    return {name: Speed(_spread(rates[name]), _spread(ratios[name])) for name in contestants}


def _rate(advance: Advance, arrays: tuple[Any, Any, Any, Any, Any, Any, Any, int], ticks: int, seconds: float) -> float:
    advance(*arrays, 1)  # warm the caches
    done, start = 0, time.perf_counter()
    while True:
        advance(*arrays, ticks)
        done += arrays[-1] * ticks
        passed = time.perf_counter() - start
        if passed >= seconds:
            return done / passed / 1e6


def _spread(numbers: Sequence[float]) -> tuple[float, float, float]:
    return statistics.median(numbers), min(numbers), max(numbers)


LIMITS = ("scalar_pairs", "vector_pairs", "scalar_divisions", "vector_divisions", "bandwidth")


def measure_limits(folder: Path, turns: int = 3) -> dict[str, float]:
    """Return the limits of a core per second: pairs of a multiplication and an addition, divisions, bytes."""
    scalar = compile_library("limits.c", BUILDS["scalar"].flags, folder, "limits_scalar")
    simd = compile_library("limits.c", BUILDS["simd"].flags, folder, "limits_simd")
    limits = {}
    for name in LIMITS:
        function = getattr(scalar if name.startswith("scalar") else simd, name)
        function.restype = ctypes.c_double
        limits[name] = max(function() for _ in range(turns))
    return limits


def roofline(work: Mapping[str, float], limits: Mapping[str, float], ticks: int, rates: Mapping[str, float]) -> str:
    """Return the limits of a tick [ns] in words, and the one that binds.

    `work` is from `count_work`, `limits` from `measure_limits`; `rates` has the million ticks a second of ``"scalar"``
    and ``"simd"``. A block is loaded from memory once a call of `ticks` ticks, and then stays in the first cache.
    """
    traffic = (work["bytes read"] + work["bytes written"]) / ticks
    operations = flops(dict(work))
    bounds = {
        "scalar": operations / 2 / limits["scalar_pairs"] + work["divide"] / limits["scalar_divisions"],
        "simd": operations / 2 / limits["vector_pairs"] + work["divide"] / limits["vector_divisions"],
    }
    memory = traffic / limits["bandwidth"]
    lines = [
        f"  a tick: {work['add']:.0f} additions, {work['multiply']:.0f} multiplications, "
        f"{work['divide']:.0f} divisions, {work['exp']:.0f} exp, {work['sin']:.0f} sin, {work['sqrt']:.0f} sqrt, "
        f"{work['floor']:.0f} floor, {work['compare']:.0f} comparisons, "
        f"{work['table row']:.0f} table rows of 32 bytes;",
        f"  {operations:.0f} flop (an exp or sin as {FUNCTION_COST}). It reads {work['bytes read']:.0f} and writes "
        f"{work['bytes written']:.0f} different bytes of scenario and state in the first cache "
        f"({work['loads']:.0f} reads, {work['stores']:.0f} writes in the text);",
        f"  from memory comes a device's share of a block once a call of {ticks} ticks: {traffic:.0f} bytes a tick, "
        f"{operations / traffic:.0f} flop/byte. Machine: {2 * limits['scalar_pairs'] / limits['bandwidth']:.1f} "
        f"(scalar), {2 * limits['vector_pairs'] / limits['bandwidth']:.1f} (SIMD).",
        f"  memory bound {1e9 * memory:.2f} ns; arithmetic bound {1e9 * bounds['scalar']:.0f} ns scalar, "
        f"{1e9 * bounds['simd']:.1f} ns SIMD; "
        f"measured {1e3 / rates['scalar']:.0f} ns and {1e3 / rates['simd']:.0f} ns.",
    ]
    for name in ("scalar", "simd"):
        binding = "arithmetic" if bounds[name] > memory else "memory bandwidth"
        share = max(bounds[name], memory) * rates[name] * 1e6
        lines.append(f"  {name}: {binding} binds; the build reaches {100 * share:.0f} % of it.")
    return "\n".join(lines)


def report(sizes: Sequence[int], turns: int, write: Callable[[str], object] = print) -> dict[str, Any]:
    """Build, check and measure everything; write it as text and return it as plain data.

    Raises AmulettError if there is no compiler, it fails, or a build deviates from the kernel.
    """
    with tempfile.TemporaryDirectory(prefix="amulett-yardstick-") as folder:
        builds = {name: build(name, Path(folder)) for name in BUILDS}
        limits = measure_limits(Path(folder))
        found: dict[str, Any] = {"limits_per_s": limits, "work": {}}
        write(f"{find_compiler()} on {platform.machine()}; largest deviation from the kernel after {START:g} s, scaled")
        found["deviation"] = agree(builds, write)
        found.update({"kernel_ticks_per_s": {}, "c_ticks_per_s": {}, "ratio_to_c": {}})
        contestants: dict[str, Advance] = {KERNEL: kernel.advance, **builds}
        for profile in PROFILES:
            by_size = {size: race(contestants, profile, size, turns) for size in sizes}
            for size, speeds in by_size.items():
                head = "million ticks/s on one core (least-most), ratio to strict scalar C"
                write(f"\n{profile}, {size} devices: {head}")
                for name, speed in speeds.items():
                    label = BUILDS[name].label if name in BUILDS else "kernel (numba)"
                    write(f"  {label:40}{_line(speed.rate, 2)}   {_line(speed.ratio, 2)}")
            found["kernel_ticks_per_s"][profile] = {n: 1e6 * s[KERNEL].rate[0] for n, s in by_size.items()}
            found["c_ticks_per_s"][profile] = {
                name: {n: 1e6 * s[name].rate[0] for n, s in by_size.items()} for name in builds
            }
            found["ratio_to_c"][profile] = {
                n: dict(zip(_RATIO, s[KERNEL].ratio, strict=True)) for n, s in by_size.items()
            }
            found["work"][profile] = work = _work(profile)
            ticks = round(AGENT_PERIOD / load_profile(profile).loop.control_period)
            rates = {name: by_size[sizes[-1]][name].rate[0] for name in ("scalar", "simd")}
            write(f"\n{profile}, roofline at {sizes[-1]} devices:\n{roofline(work, limits, ticks, rates)}")
    return found


_RATIO = ("median", "least", "most")


def _line(spread: tuple[float, float, float], digits: int) -> str:
    median, least, most = (f"{number:.{digits}f}" for number in spread)
    return f"{median:>7} ({least}-{most})".ljust(24)


def _work(profile: str) -> dict[str, float]:
    simulation = mixed_simulation(profile, 24)
    simulation.advance(round(START / simulation.control_period))
    return count_work(simulation)


def main() -> int:
    """Run the command."""
    arguments = command(__doc__, "yardstick", TURNS, DEVICES).parse_args()
    if find_compiler() is None:
        print(NO_COMPILER)
        return 0
    found = report(arguments.devices, arguments.turns)
    if arguments.json:
        write_json(arguments.json, found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
