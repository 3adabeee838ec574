"""`amulett identify`: search for the parameters that the paper does not print."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from itertools import count
from typing import Any

from amulett_gym.cli.options import add_json, check_least
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder

HELP = "search for the parameters that the paper does not print (about 20 minutes on two cores)"
EXAMPLES = """  amulett identify --out runs/identify
  amulett identify --spring-end stall --out runs/identify-stall
  amulett identify --seeds 1 --population 30 --generations 10 --refinement 5 --steps 2 --out runs/short
"""
SPRING_ENDS = ("held", "continued", "hard-stop", "stall")  # of `studies.paper.reproduction.Readings.spring_end`
_COUNTS = {
    "population": "candidates in a generation",
    "generations": "generations of each start",
    "refinement": "generations of the search that continues from all starts",
    "steps": "moves of each walker of the ensemble",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", required=True, metavar="DIR", help="folder; an interrupted study in it is continued")
    parser.add_argument(
        "--seeds", nargs="+", type=int, metavar="N", help="seeds of the independent starts (default: 1 2 3)"
    )
    for name, text in _COUNTS.items():
        parser.add_argument(f"--{name}", type=int, metavar="N", help=f"{text} (default: as the shipped study)")
    parser.add_argument(
        "--spring-end",
        choices=SPRING_ENDS,
        default=SPRING_ENDS[0],
        help="what ends the spring's curve: the force is held at its end, the law goes on, a stop takes over, or "
        "the law goes on and drives stall (default: held)",
    )
    cores = os.cpu_count() or 1
    parser.add_argument("--processes", type=int, default=cores, metavar="N", help="parallel searches (default: cores)")
    parser.add_argument("--overwrite", action="store_true", help="replace a study with other sizes in the folder")
    add_json(parser, "the content of identification.json")


def run(arguments: argparse.Namespace) -> int:
    """Identify, print the result, and write the files."""
    from amulett_gym.studies.paper.reproduction import Readings
    from amulett_gym.studies.paper.study import STUDY_MARKS, Recipe, in_words, stage_count, study

    chosen: dict[str, Any] = {name: getattr(arguments, name) for name in ("seeds", *_COUNTS)}
    check_least(arguments, **dict.fromkeys((*_COUNTS, "processes"), 1))
    if arguments.population is not None and arguments.population < 5:
        raise AmulettError(f"--population is {arguments.population}; differential evolution needs at least 5")
    if arguments.seeds and (min(arguments.seeds) < 0 or len(set(arguments.seeds)) < len(arguments.seeds)):
        raise AmulettError(f"--seeds are {arguments.seeds}; they have to differ and be at least 0")
    given = {name: value for name, value in chosen.items() if value is not None}
    recipe = Recipe(**given | ({"seeds": tuple(arguments.seeds)} if arguments.seeds else {}))
    total, numbers = stage_count(recipe), count(1)
    progress = Progress(total, "identify", "searches")
    show = printer(arguments)
    show(f"{total} searches, {min(arguments.processes, total)} in parallel; a search may take minutes.")

    def report(name: str, stage: Mapping[str, Any]) -> None:
        shown = f"cost {stage['cost']:.3f}, {stage['explained']} rows explained" if "cost" in stage else "walked"
        show(f"{next(numbers):3d} of {total}  {name:32} {shown}")
        progress.update()

    with output_folder(arguments.out, "study", [STUDY_MARKS]), locked_folder(arguments.out), progress:
        words = _command(arguments.out, recipe, arguments.spring_end)
        readings = Readings(spring_end=arguments.spring_end)
        content = study(arguments.out, recipe, readings, arguments.processes, report, arguments.overwrite, words)
    if arguments.json:
        print_json(content)
    show(in_words(content))
    show(f"Written to {arguments.out}: identification.json, simulation.yaml and testbed.yaml.")
    return 0


def _command(out: str, recipe: Any, spring_end: str) -> list[str]:
    sizes = [word for name in _COUNTS for word in (f"--{name}", str(getattr(recipe, name)))]
    end = [] if spring_end == SPRING_ENDS[0] else ["--spring-end", spring_end]
    return ["amulett", "identify", "--seeds", *map(str, recipe.seeds), *sizes, *end, "--out", out]
