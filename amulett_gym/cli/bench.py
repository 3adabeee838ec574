"""`amulett bench`: how fast kernel, environments and learning are, beside others in the same run."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from amulett_gym.cli.train import add_overrides
from amulett_gym.errors import AmulettError
from amulett_gym.learning import check_installed, load_learning
from amulett_gym.storage.writing import check_writable, write_json

HELP = "measure speed: kernel, environments, learning, scale, beside C, Gymnasium's environments and peers"
EXAMPLES = """  amulett bench
  amulett bench --c --ppo --peers --json bench.json
  amulett bench --time-to-beat --seeds 3 --out runs/bench
  amulett bench --scale --out runs/bench --doc docs/performance.md
"""

_READ_BY = {
    "config": ("ppo", "time-to-beat"),
    "set": ("ppo", "time-to-beat"),
    "seeds": ("time-to-beat",),
    "limit": ("time-to-beat",),
    "simulated": ("scale",),
    "out": ("scale", "time-to-beat"),
}
"""The sections that read an option; all of them read those that are not here."""

Data = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    sections = parser.add_argument_group("measured on request, besides kernel and environments")
    sections.add_argument("--c", action="store_true", help="the kernel beside the same tick in C (from a checkout)")
    sections.add_argument("--ppo", action="store_true", help="PPO beside the same PPO on a null environment")
    sections.add_argument(
        "--time-to-beat", action="store_true", help="training time until PPO beats eq. 6, and the best constant, too"
    )
    sections.add_argument("--scale", action="store_true", help="from 1 to 65,536 devices; memory; an hour simulated")
    sections.add_argument("--peers", action="store_true", help="MuJoCo, MyoSuite, gym-electric-motor, if installed")
    parser.add_argument("--devices", type=int, default=1024, help="devices in the vector environments (default: 1024)")
    parser.add_argument("--turns", type=int, default=7, help="interleaved turns that each one takes (default: 7)")
    parser.add_argument("--seed", type=int, default=0, help="of scenarios and actions (default: 0)")
    parser.add_argument(
        "--config", metavar="FILE", help="recipe of --ppo (default: that of amulett train) and --time-to-beat (its own)"
    )
    add_overrides(parser, "change keys of that recipe, for example num_envs=1024")
    parser.add_argument("--seeds", type=int, default=10, help="training runs of --time-to-beat (default: 10)")
    parser.add_argument("--limit", type=float, default=120.0, help="longest of these runs [s] (default: 120)")
    parser.add_argument(
        "--simulated", type=float, default=3600.0, help="time that --scale's long run simulates [s] (default: 3600)"
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the numbers as JSON; - for standard output, and no tables"
    )
    parser.add_argument("--doc", metavar="FILE.md", help="renew what the document says of the measured sections")
    parser.add_argument("--out", metavar="DIR", help="folder for figures (--scale, --time-to-beat)")


def run(arguments: argparse.Namespace) -> int:
    """Measure, section by section; Ctrl-C ends it with what was measured until then (exit code 130)."""
    _check(arguments)
    from amulett_gym.reporting.document import check_document, update_document
    from amulett_gym.storage.provenance import machine
    from amulett_gym.studies.speed import document as performance

    asked = [name for name in performance.SECTIONS if _asked(arguments, name)]
    recipes = {section: _recipe(arguments, section) for section in asked if section in ("ppo", "time-to-beat")}
    if "c" in asked:
        yardstick()  # refused before anything is measured
    if arguments.doc is not None:
        check_document(arguments.doc, map(performance.section_marks, asked))
    data: Data = {}
    done: list[str] = []
    interrupted = False
    quiet = arguments.json == "-"
    try:
        for section in asked:
            try:
                _MEASURE[section](arguments, data, recipes.get(section))
                done.append(section)
            finally:
                for table in performance.tables(section, data):
                    _say(quiet, table.text() + "\n")
    except KeyboardInterrupt:
        interrupted = True
        print("amulett: interrupted; what was measured until then is kept", file=sys.stderr)
    finally:  # an error in a late section must not lose the early ones
        if quiet:
            print(json.dumps(data, indent=2, allow_nan=False))
        elif arguments.json is not None and data:
            write_json(arguments.json, data)
    if arguments.out is not None:
        from amulett_gym.studies.speed.figures import draw

        for path in draw(data, arguments.out):
            _say(quiet, f"Written: {path}")
    if arguments.doc is not None:
        found = {section: performance.tables(section, data) for section in done}
        texts = {
            performance.section_marks(section): "\n\n".join(
                [f"`{_command(arguments, section)}` on {machine()}", *(table.markdown() for table in made)]
            )
            for section, made in found.items()
            if made
        }
        update_document(arguments.doc, texts)
        _say(quiet, f"Renewed: {arguments.doc}")
    return 130 if interrupted else 0


def yardstick() -> Any:
    """Return the module that races the kernel against C.

    Raises
    ------
    AmulettError
        If there is no C compiler.
    """
    from amulett_gym.c.build import NO_COMPILER, find_compiler
    from amulett_gym.studies.speed import yardstick

    if find_compiler() is None:
        raise AmulettError(f"--c: {NO_COMPILER}")
    return yardstick


def _check(arguments: argparse.Namespace) -> None:
    for option, smallest in (("devices", 1), ("turns", 1), ("seed", 0), ("seeds", 1)):
        if getattr(arguments, option) < smallest:
            raise AmulettError(f"--{option} is {getattr(arguments, option)}; it has to be at least {smallest}")
    for option in ("limit", "simulated"):
        if not 0 < getattr(arguments, option) < math.inf:
            raise AmulettError(f"--{option} is {getattr(arguments, option)}; it has to be a positive number of seconds")
    for option in ("json", "out", "doc"):
        if getattr(arguments, option) == "":
            raise AmulettError(f"--{option} is empty; it has to name a file or folder")
    for option, sections in _READ_BY.items():
        if _given(arguments, option) and not any(_asked(arguments, section) for section in sections):
            asking = " or ".join(f"--{section}" for section in sections)
            raise AmulettError(f"--{option} changes nothing here: it is read by {asking}, which was not asked for")
    if arguments.json not in (None, "-"):
        check_writable(arguments.json)


def _asked(arguments: argparse.Namespace, section: str) -> bool:
    return section == "speed" or bool(getattr(arguments, section.replace("-", "_")))


def _given(arguments: argparse.Namespace, option: str) -> bool:
    name = "overrides" if option == "set" else option
    return bool(getattr(arguments, name) != arguments.parser.get_default(name))


def _recipe(arguments: argparse.Namespace, section: str) -> Any:
    """Return a section's checked recipe; torch is not imported yet."""
    check_installed()
    recipes = load_learning("recipes")
    own = recipes.SPRINT if section == "time-to-beat" and arguments.config is None else ()
    return recipes.load_train_config(arguments.config, [*own, *arguments.overrides])


def _speed(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    from amulett_gym.studies.speed.rates import PROFILES, contestants, race

    entrants = contestants(arguments.devices, arguments.seed)
    with _bar(arguments.turns * len(entrants), "turns") as bar:
        speeds = {speed.name: speed for speed in race(entrants, arguments.turns, watch=bar.update)}
    references = {
        "single": speeds["Pendulum-v1, single"],
        "vector": speeds[f"CartPole-v1, vector of {arguments.devices}"],
    }
    rows = {}
    for name, speed in speeds.items():
        kind = next((kind for kind in references if kind in name), None)
        ratio = None if kind is None else speed.steps_per_second / references[kind].steps_per_second
        rows[name] = {**speed.numbers(), "ratio": ratio}
    data["devices"] = arguments.devices
    data["kernel_ticks_per_s"] = {
        profile: speeds[f"kernel of {arguments.devices}, {profile}"].ticks_per_second for profile in reversed(PROFILES)
    }
    data["vector_steps_per_s"] = speeds[f"vector of {arguments.devices}, testbed"].steps_per_second
    data["single_step_us"] = 1e6 / speeds["single, testbed"].steps_per_second
    data["environments"] = rows


def _c(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    import tempfile

    from amulett_gym.simulation.kernel import advance

    module = yardstick()
    names = {
        "scalar": "c_ticks_per_s",
        "simd_strict": "c_strict_simd_ticks_per_s",
        "simd": "c_limit_ticks_per_s",
    }
    with tempfile.TemporaryDirectory(prefix="amulett-yardstick-") as folder, _bar(len(module.PROFILES), "C") as bar:
        builds = {name: module.build(name, Path(folder)) for name in names}
        module.agree(builds)
        found: Data = {key: {} for key in ("kernel_ticks_per_s", *names.values(), "ratio_to_c", "ratio_to_c_spread")}
        for profile in module.PROFILES:
            speeds = module.race({module.KERNEL: advance, **builds}, profile, arguments.devices, arguments.turns)
            found["kernel_ticks_per_s"][profile] = 1e6 * speeds[module.KERNEL].rate[0]
            for name, key in names.items():
                found[key][profile] = 1e6 * speeds[name].rate[0]
            median, least, most = speeds[module.KERNEL].ratio
            found["ratio_to_c"][profile], found["ratio_to_c_spread"][profile] = median, [least, most]
            bar.update()
    data.update(found, c_devices=arguments.devices)


def _ppo(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    speed = load_learning("speed")
    with _bar(arguments.turns, "PPO") as bar:
        data["ppo"] = speed.ppo_throughput(config, arguments.turns, watch=bar.update)


def _time_to_beat(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    speed = load_learning("speed")
    config = speed.from_the_middle(config)
    referee = speed.Referee(config)
    runs: list[Any] = []
    for seed in range(arguments.seed, arguments.seed + arguments.seeds):
        with _bar(None, f"seed {seed}") as bar:
            runs.append(
                speed.time_to_beat(config.model_copy(update={"seed": seed}), referee, arguments.limit, watch=bar.update)
            )
        data.update(speed.describe_beats(config, referee, runs, arguments.limit))


def _scale(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    from amulett_gym.studies.speed import scale

    found: Data = data.setdefault("scale", {})
    turns = min(arguments.turns, 3)
    found["memory_per_device"] = scale.memory_per_device(seed=arguments.seed)
    with _bar(turns * len(scale.SIZES), "sizes") as bar:
        found["device_step_ns"] = scale.cost_by_size(
            sizes=scale.SIZES, seed=arguments.seed, turns=turns, watch=bar.update
        )
    with _bar(2 * arguments.turns * len(scale.THREADED_SIZES), "threads") as bar:
        found["two_threads"] = scale.two_threads(seed=arguments.seed, turns=arguments.turns, watch=bar.update)
    with _bar(scale.SLICES, "long run") as bar:
        found["long_run"] = scale.long_run(
            devices=arguments.devices, seconds=arguments.simulated, seed=arguments.seed, watch=bar.update
        )


def _peers(arguments: argparse.Namespace, data: Data, config: Any) -> None:
    from amulett_gym.studies.speed import peers
    from amulett_gym.studies.speed.rates import PROFILES, race, single

    ours = [single(profile, arguments.seed) for profile in PROFILES]
    theirs, absent = peers.enter(seed=arguments.seed)
    with _bar(arguments.turns * (len(ours) + len(theirs)), "peers") as bar:
        speeds = race([*ours, *theirs], arguments.turns, watch=bar.update)
    data["peers"] = peers.compare(speeds[: len(ours)], speeds[len(ours) :], absent)


_MEASURE: dict[str, Callable[[argparse.Namespace, Data, Any], None]] = {
    "speed": _speed,
    "c": _c,
    "ppo": _ppo,
    "time-to-beat": _time_to_beat,
    "scale": _scale,
    "peers": _peers,
}


def _bar(total: int | None, what: str) -> Any:
    from tqdm import tqdm

    return tqdm(total=total, desc=what, leave=False, disable=not sys.stderr.isatty())


def _say(quiet: bool, message: str) -> None:
    if not quiet:
        print(message, flush=True)


def _command(arguments: argparse.Namespace, section: str) -> str:
    """Return the command that measures a section again; where it writes to is nobody else's business."""
    import shlex

    words = ["amulett", "bench", *([] if section == "speed" else [f"--{section}"])]
    for option in ("devices", "turns", "seed", "seeds", "limit", "simulated", "config"):
        if _given(arguments, option) and section in _READ_BY.get(option, (section,)):
            words += [f"--{option}", str(getattr(arguments, option))]
    if arguments.overrides and section in _READ_BY["set"]:
        words += ["--set", *arguments.overrides]
    return shlex.join(words)
