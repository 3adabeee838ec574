"""`amulett bench`: speed, compared with that of other programs in the same run."""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from amulett_gym.cli.options import add_figures, add_options, check_least, check_seconds, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.writing import check_writable, write_json

HELP = "measure speed: kernel, environments, learning, scale; compare with C and with other environments"
EXAMPLES = """  amulett bench
  amulett bench --loops --worn --c --ppo --peers --out runs/bench
  amulett bench --time-to-beat --seeds 3 --out runs/bench
  amulett bench --scale --out runs/bench --doc docs/performance.md
"""

_READ_BY = {
    "config": ("ppo", "time-to-beat"),
    "set": ("ppo", "time-to-beat"),
    "seeds": ("time-to-beat",),
    "limit": ("time-to-beat",),
    "simulated": ("scale",),
    "turns": ("speed", "loops", "worn", "c", "ppo", "scale", "peers"),
    "devices": ("speed", "loops", "worn", "c", "scale"),
}
"""Option -> the sections that read it; all sections read the other options."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    sections = parser.add_argument_group("measured on request, besides kernel and environments")
    sections.add_argument("--loops", action="store_true", help="every control loop, compared with the paper's")
    sections.add_argument("--worn", action="store_true", help="devices with a wearer, compared with the same ones bare")
    sections.add_argument("--c", action="store_true", help="the same tick in C (needs a C compiler)")
    sections.add_argument("--ppo", action="store_true", help="PPO, compared with PPO on a null environment")
    sections.add_argument(
        "--time-to-beat", action="store_true", help="training time until PPO beats eq. 6 and constants"
    )
    sections.add_argument("--scale", action="store_true", help="from 1 to 65,536 devices; memory; a simulated hour")
    sections.add_argument("--peers", action="store_true", help="MuJoCo, MyoSuite, gym-electric-motor, if installed")
    parser.add_argument("--devices", type=int, default=1024, help="devices in the vector environments (default: 1024)")
    parser.add_argument("--turns", type=int, default=7, help="measurements of each, in alternation (default: 7)")
    parser.add_argument("--seed", type=int, default=0, help="seed of scenarios and actions (default: 0)")
    parser.add_argument(
        "--config", metavar="FILE", help="recipe of --ppo (default: that of amulett train) and --time-to-beat (its own)"
    )
    add_options(parser, "--set", help="change keys of that recipe, for example num_envs=1024")
    parser.add_argument("--seeds", type=int, default=10, help="training runs of --time-to-beat (default: 10)")
    parser.add_argument("--limit", type=float, default=120.0, help="time limit of such a run [s] (default: 120)")
    parser.add_argument(
        "--simulated", type=float, default=3600.0, help="simulated time of --scale's long run [s] (default: 3600)"
    )
    add_options(parser, "--doc", help="renew the measured sections in a document")
    parser.add_argument("--out", metavar="DIR", help="folder for bench.json and figures")
    add_figures(parser)
    parser.add_argument(
        "--json",
        nargs="?",
        const=True,
        default=False,
        metavar="FILE",
        help="print the content of bench.json as JSON, and nothing else (FILE, deprecated: write it there)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, section by section; Ctrl-C keeps the results until then (exit code 130)."""
    _check(arguments)
    targets = _targets(arguments)
    from amulett_gym.reporting.document import check_document, update_document
    from amulett_gym.storage.provenance import machine, write_provenance
    from amulett_gym.studies.speed import document as performance
    from amulett_gym.studies.speed.instructions import compiler_target
    from amulett_gym.studies.speed.sections import MEASURE, Settings, prepare

    chosen = [name for name in performance.SECTIONS if _is_chosen(arguments, name)]
    settings = Settings(**{field.name: getattr(arguments, field.name) for field in fields(Settings)})
    recipes = {section: prepare(section, settings) for section in chosen}
    if arguments.doc is not None:
        check_document(arguments.doc, map(performance.section_marks, chosen))
    if arguments.out is not None:
        config = {"sections": chosen, **asdict(settings)}
        write_provenance(
            arguments.out, "bench", config, [arguments.seed], [*_words(arguments, *chosen), "--out", str(arguments.out)]
        )
    data: dict[str, Any] = {}
    done: list[str] = []
    interrupted = False
    show = printer(arguments)
    compiled = compiler_target()
    here = f"{machine()[:-1]}, compiled for {compiled['target']}"
    here += "." if compiled["vector_bits"] is None else f", registers of {compiled['vector_bits']} bits."
    show(f"On {here}\n")
    try:
        for section in chosen:
            try:
                MEASURE[section](settings, data, recipes[section])
                done.append(section)
            finally:
                for table in performance.tables(section, data):
                    show(table.text() + "\n")
    except KeyboardInterrupt:
        interrupted = True
        print("amulett: interrupted; the results until then are kept", file=sys.stderr)
    finally:  # an error in a late section must not lose the early ones
        content = {"machine": here, **compiled, **data}
        for target in targets if data else ():
            write_json(target, content)
            show(f"Written: {target}")
        if arguments.json:
            print_json(content)
    if arguments.out is not None:
        from amulett_gym.studies.speed.figures import draw

        for path in draw(data, arguments.out):
            show(f"Written: {path}")
    if arguments.doc is not None:
        texts = {}
        for section in done:
            if tables := [table.markdown() for table in performance.tables(section, data)]:
                head = f"`{shlex.join(_words(arguments, section))}` on {here}"
                texts[performance.section_marks(section)] = "\n\n".join([head, *tables])
        update_document(arguments.doc, texts)
        show(f"Renewed: {arguments.doc}")
    return 130 if interrupted else 0


def _check(arguments: argparse.Namespace) -> None:
    check_least(arguments, devices=1, turns=1, seed=0, seeds=1)
    check_seconds(arguments, "limit", "simulated")
    for option in ("json", "out", "doc"):
        if getattr(arguments, option) == "":
            raise AmulettError(f"--{option} is empty; it has to name a file or folder")
    for option, sections in _READ_BY.items():
        if _is_given(arguments, option) and not any(_is_chosen(arguments, section) for section in sections):
            readers = " or ".join(f"--{section}" for section in sections)
            raise AmulettError(f"--{option} changes nothing here: it is read by {readers}, which was not given")


def _targets(arguments: argparse.Namespace) -> list[Path]:
    """Return the files for the numbers; afterwards `--json` is whether they are printed."""
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


def _is_chosen(arguments: argparse.Namespace, section: str) -> bool:
    return section == "speed" or bool(getattr(arguments, section.replace("-", "_")))


def _is_given(arguments: argparse.Namespace, option: str) -> bool:
    name = "overrides" if option == "set" else option
    return bool(getattr(arguments, name) != arguments.parser.get_default(name))


def _words(arguments: argparse.Namespace, *sections: str) -> list[str]:
    """Return the words of the command that measures some sections again, without its outputs."""
    options = ("devices", "turns", "seed", "seeds", "limit", "simulated", "config")
    read = {name for name in (*options, "set") if set(sections) & set(_READ_BY.get(name, sections))}
    given = [name for name in options if name in read and _is_given(arguments, name)]
    asked = [f"--{section}" for section in sections if section != "speed"]
    overrides = ["--set", *arguments.overrides] if arguments.overrides and "set" in read else []
    return ["amulett", "bench", *asked, *command_words(arguments, *given), *overrides]
