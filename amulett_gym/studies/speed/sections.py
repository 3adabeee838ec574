"""Measurements of `amulett bench`, one for each section of ``bench.json``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amulett_gym.c.build import NO_COMPILER, build, find_compiler
from amulett_gym.errors import AmulettError
from amulett_gym.learning import check_installed, load_learning
from amulett_gym.reporting.progress import Progress
from amulett_gym.simulation.kernel import advance
from amulett_gym.simulation.layout import CONTROLS, LOOPS
from amulett_gym.studies.speed import peers, rates, scale, yardstick

Data = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """Settings of the measurements."""

    devices: int = 1024  # in the vector environments
    turns: int = 7  # of each contestant
    seed: int = 0  # of scenarios and actions
    seeds: int = 10  # training runs of time-to-beat
    limit: float = 120.0  # longest of these runs [s]
    simulated: float = 3600.0  # simulated time of the long run of `scale` [s]
    config: str | None = None  # recipe of ppo and time-to-beat; None: each one's own
    overrides: Sequence[str] = ()  # changes of that recipe


def prepare(section: str, settings: Settings) -> Any:
    """Check a section's requirements, and return its recipe, None if it needs none.

    Raises AmulettError if the recipe is wrong, or something is not installed.
    """
    if section == "c" and find_compiler() is None:
        raise AmulettError(f"--c: {NO_COMPILER}")
    if section not in ("ppo", "time-to-beat"):
        return None
    check_installed()
    recipes = load_learning("recipes")
    own = recipes.SPRINT if section == "time-to-beat" and settings.config is None else ()
    return recipes.load_train_config(settings.config, [*own, *settings.overrides])


def _speed(settings: Settings, data: Data, recipe: Any) -> None:
    entrants = rates.contestants(settings.devices, settings.seed)
    with Progress(settings.turns * len(entrants), "speed", "turns") as bar:
        speeds = {speed.name: speed for speed in rates.race(entrants, settings.turns, watch=bar.update)}
    references = {
        "single": speeds["Pendulum-v1, single"],
        "vector": speeds[f"CartPole-v1, vector of {settings.devices}"],
    }
    rows = {}
    for name, speed in speeds.items():
        kind = next((kind for kind in references if kind in name), None)
        ratio = None if kind is None else speed.steps_per_second / references[kind].steps_per_second
        rows[name] = {**speed.numbers(), "ratio": ratio}
    data["devices"] = settings.devices
    data["kernel_ticks_per_s"] = {
        profile: speeds[f"kernel of {settings.devices}, {profile}"].ticks_per_second
        for profile in reversed(rates.PROFILES)
    }
    data["vector_steps_per_s"] = speeds[f"vector of {settings.devices}, testbed"].steps_per_second
    data["single_step_us"] = 1e6 / speeds["single, testbed"].steps_per_second
    data["environments"] = rows


def _loops(settings: Settings, data: Data, recipe: Any) -> None:
    entrants = [rates.kernel("testbed", settings.devices, settings.seed, control) for control in CONTROLS]
    with Progress(settings.turns * len(entrants), "loops", "turns") as bar:
        speeds = dict(zip(CONTROLS, rates.race(entrants, settings.turns, watch=bar.update), strict=True))
    data["loops_devices"] = settings.devices
    data["loops"] = {
        control: {**speed.numbers(), "ratio": rates.spread(rates.ratios(speed, speeds["decentralized"]))}
        for control, speed in speeds.items()
    }


def _worn(settings: Settings, data: Data, recipe: Any) -> None:
    pairs = [rates.worn_kernels(control, settings.devices, settings.seed) for control in LOOPS]
    with Progress(2 * settings.turns * len(pairs), "worn", "turns") as bar:
        speeds = rates.race([each for pair in pairs for each in pair], settings.turns, watch=bar.update)
    data["worn_devices"] = settings.devices
    data["worn"] = {
        control: {
            "worn_ticks_per_s": worn.ticks_per_second,
            "bare_ticks_per_s": bare.ticks_per_second,
            "worn_tick_over_bare": rates.spread(rates.ratios(bare, worn)),
        }
        for control, worn, bare in zip(LOOPS, speeds[::2], speeds[1::2], strict=True)
    }


def _c(settings: Settings, data: Data, recipe: Any) -> None:
    names = {"scalar": "c_ticks_per_s", "simd_strict": "c_strict_simd_ticks_per_s", "simd": "c_limit_ticks_per_s"}
    steps = 1 + len(names) + len(yardstick.PROFILES)
    with tempfile.TemporaryDirectory(prefix="amulett-yardstick-") as folder, Progress(steps, "C", "steps") as bar:
        builds = {}
        for name in names:
            builds[name] = build(name, Path(folder))
            bar.update(note=f"built {name}")
        yardstick.agree(builds)
        bar.update(note="compared with the kernel")
        found: Data = {key: {} for key in ("kernel_ticks_per_s", *names.values(), "ratio_to_c", "ratio_to_c_spread")}
        for profile in yardstick.PROFILES:
            speeds = yardstick.race({yardstick.KERNEL: advance, **builds}, profile, settings.devices, settings.turns)
            found["kernel_ticks_per_s"][profile] = 1e6 * speeds[yardstick.KERNEL].rate[0]
            for name, key in names.items():
                found[key][profile] = 1e6 * speeds[name].rate[0]
            median, least, most = speeds[yardstick.KERNEL].ratio
            found["ratio_to_c"][profile], found["ratio_to_c_spread"][profile] = median, [least, most]
            bar.update(note=f"raced on {profile}")
    data.update(found, c_devices=settings.devices)


def _ppo(settings: Settings, data: Data, recipe: Any) -> None:
    speed = load_learning("speed")
    with Progress(settings.turns, "PPO", "turns") as bar:
        data["ppo"] = speed.ppo_throughput(recipe, settings.turns, watch=bar.update)


def _time_to_beat(settings: Settings, data: Data, recipe: Any) -> None:
    speed = load_learning("speed")
    recipe = speed.with_neutral_start(recipe)
    evaluator = speed.Evaluator(recipe)
    runs: list[Any] = []
    for seed in range(settings.seed, settings.seed + settings.seeds):
        with Progress(None, f"time to beat, seed {seed}", "validations") as bar:
            seeded = recipe.model_copy(update={"seed": seed})
            runs.append(speed.time_to_beat(seeded, evaluator, settings.limit, watch=bar.update))
        data.update(speed.describe_beats(recipe, evaluator, runs, settings.limit))


def _scale(settings: Settings, data: Data, recipe: Any) -> None:
    found: Data = data.setdefault("scale", {})
    turns = min(settings.turns, 3)
    found["memory_per_device"] = scale.memory_per_device(seed=settings.seed)
    with Progress(turns * len(scale.SIZES), "sizes", "turns") as bar:
        found["device_step_ns"] = scale.cost_by_size(
            sizes=scale.SIZES, seed=settings.seed, turns=turns, watch=bar.update
        )
    with Progress(4 * settings.turns * len(scale.THREADED_SIZES), "threads", "turns") as bar:
        found["two_threads"] = scale.two_threads(seed=settings.seed, turns=settings.turns, watch=bar.update)
    with Progress(scale.SLICES, "long run", "slices") as bar:
        found["long_run"] = scale.long_run(
            devices=settings.devices, seconds=settings.simulated, seed=settings.seed, watch=bar.update
        )


def _peers(settings: Settings, data: Data, recipe: Any) -> None:
    ours = [rates.single(profile, settings.seed) for profile in rates.PROFILES]
    theirs, absent = peers.enter(seed=settings.seed)
    with Progress(settings.turns * (len(ours) + len(theirs)), "peers", "turns") as bar:
        speeds = rates.race([*ours, *theirs], settings.turns, watch=bar.update)
    data["peers"] = peers.compare(speeds[: len(ours)], speeds[len(ours) :], absent)


MEASURE: dict[str, Callable[[Settings, Data, Any], None]] = {
    "speed": _speed,
    "loops": _loops,
    "worn": _worn,
    "c": _c,
    "ppo": _ppo,
    "time-to-beat": _time_to_beat,
    "scale": _scale,
    "peers": _peers,
}
"""Section -> function that measures by settings and recipe, and adds its numbers to the data."""
