"""`amulett bench`: how fast kernel, environments and learning are, compared with others in the same run."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from amulett_gym.cli.output import print_json, printer
from amulett_gym.cli.train import add_overrides
from amulett_gym.errors import AmulettError
from amulett_gym.storage.writing import check_writable, write_json

HELP = "measure speed: kernel, environments, learning, scale; compare with C and with other environments"
EXAMPLES = """  amulett bench
  amulett bench --c --ppo --peers --out runs/bench
  amulett bench --time-to-beat --seeds 3 --out runs/bench
  amulett bench --scale --out runs/bench --doc docs/performance.md
"""

_READ_BY = {
    "config": ("ppo", "time-to-beat"),
    "set": ("ppo", "time-to-beat"),
    "seeds": ("time-to-beat",),
    "limit": ("time-to-beat",),
    "simulated": ("scale",),
    "turns": ("speed", "c", "ppo", "scale", "peers"),
    "devices": ("speed", "c", "scale"),
}
"""The sections that read an option; all of them read those that are not here."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    sections = parser.add_argument_group("measured on request, besides kernel and environments")
    sections.add_argument("--c", action="store_true", help="the same tick in C (needs a C compiler)")
    sections.add_argument("--ppo", action="store_true", help="PPO, compared with PPO on a null environment")
    sections.add_argument(
        "--time-to-beat", action="store_true", help="training time until PPO beats eq. 6, and the best constant, too"
    )
    sections.add_argument("--scale", action="store_true", help="from 1 to 65,536 devices; memory; an hour simulated")
    sections.add_argument("--peers", action="store_true", help="MuJoCo, MyoSuite, gym-electric-motor, if installed")
    parser.add_argument("--devices", type=int, default=1024, help="devices in the vector environments (default: 1024)")
    parser.add_argument("--turns", type=int, default=7, help="alternating turns of each (default: 7)")
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
    parser.add_argument("--doc", metavar="FILE.md", help="renew what the document says of the measured sections")
    parser.add_argument("--out", metavar="DIR", help="folder for bench.json and figures")
    parser.add_argument(
        "--json",
        nargs="?",
        const=True,
        default=False,
        metavar="FILE",
        help="print the content of bench.json as JSON, and nothing else (with FILE, deprecated: write it there)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, section by section; Ctrl-C ends it with what was measured until then (exit code 130)."""
    _check(arguments)
    targets = _targets(arguments)
    from amulett_gym.reporting.document import check_document, update_document
    from amulett_gym.storage.provenance import machine
    from amulett_gym.studies.speed import document as performance
    from amulett_gym.studies.speed.sections import MEASURE, Settings, prepare

    asked = [name for name in performance.SECTIONS if _asked(arguments, name)]
    settings = Settings(**{field.name: getattr(arguments, field.name) for field in fields(Settings)})
    recipes = {section: prepare(section, settings) for section in asked}
    if arguments.doc is not None:
        check_document(arguments.doc, map(performance.section_marks, asked))
    data: dict[str, Any] = {}
    done: list[str] = []
    interrupted = False
    show = printer(arguments)
    try:
        for section in asked:
            try:
                MEASURE[section](settings, data, recipes[section])
                done.append(section)
            finally:
                for table in performance.tables(section, data):
                    show(table.text() + "\n")
    except KeyboardInterrupt:
        interrupted = True
        print("amulett: interrupted; what was measured until then is kept", file=sys.stderr)
    finally:  # an error in a late section must not lose the early ones
        for target in targets if data else ():
            write_json(target, data)
            show(f"Written: {target}")
        if arguments.json:
            print_json(data)
    if arguments.out is not None:
        from amulett_gym.studies.speed.figures import draw

        for path in draw(data, arguments.out):
            show(f"Written: {path}")
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
        show(f"Renewed: {arguments.doc}")
    return 130 if interrupted else 0


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


def _targets(arguments: argparse.Namespace) -> list[Path]:
    """Return the files that the numbers are written to; `--json` is true afterwards where they are printed."""
    targets: list[Path] = []
    if isinstance(arguments.json, str):
        note = "--json FILE is deprecated; --json prints the numbers, --out DIR writes them to DIR/bench.json"
        print(f"amulett: note: {note}", file=sys.stderr)
        if arguments.json != "-":
            targets.append(Path(arguments.json))
        arguments.json = arguments.json == "-"
    if arguments.out is not None:
        targets.append(Path(arguments.out) / "bench.json")
    for target in targets:
        check_writable(target)
    return targets


def _asked(arguments: argparse.Namespace, section: str) -> bool:
    return section == "speed" or bool(getattr(arguments, section.replace("-", "_")))


def _given(arguments: argparse.Namespace, option: str) -> bool:
    name = "overrides" if option == "set" else option
    return bool(getattr(arguments, name) != arguments.parser.get_default(name))


def _command(arguments: argparse.Namespace, section: str) -> str:
    """Return the command that measures a section again; where it writes to is left out."""
    words = ["amulett", "bench", *([] if section == "speed" else [f"--{section}"])]
    for option in ("devices", "turns", "seed", "seeds", "limit", "simulated", "config"):
        if _given(arguments, option) and section in _READ_BY.get(option, (section,)):
            words += [f"--{option}", str(getattr(arguments, option))]
    if arguments.overrides and section in _READ_BY["set"]:
        words += ["--set", *arguments.overrides]
    return shlex.join(words)
