"""`amulett identify`: search for the parameters that the paper does not print."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import (
    add_figures,
    add_json,
    add_options,
    add_workers,
    check_least,
    chosen_workers,
    command_words,
)
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder

if TYPE_CHECKING:
    from amulett_gym.workers.call import Workers

HELP = "search for the parameters that the paper does not print, or draw devices that explain it (20 min on two cores)"
EXAMPLES = """  amulett identify --out runs/identify
  amulett identify --spring-end stall --out runs/identify-stall
  amulett identify --seeds 1 --population 30 --generations 10 --refinement 5 --steps 2 --out runs/short
  amulett identify --fleet --below-floor clamp --out runs/fleet
"""
SPRING_ENDS = ("held", "continued", "hard-stop", "stall")  # of `studies.paper.reproduction.Readings.spring_end`
_COUNTS = {
    "population": "candidates in a generation",
    "generations": "generations of each start",
    "refinement": "generations of the search that continues from all starts",
    "steps": "moves of each walker of the ensemble",
}
FLOORS = ("clamp", "hold", "ignore")  # of `studies.paper.reproduction.Readings.floor`
_OF_FLEET = ("below_floor", "spring_laws", "bound", "devices", "write", "doc")
"""Options for `--fleet` alone."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", required=True, metavar="DIR", help="folder; an interrupted study in it is continued")
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=int,
        metavar="N",
        help="seeds of the independent starts (default: 1 2 3, of a fleet 1 to 6)",
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
    parser.add_argument(
        "--fleet",
        action="store_true",
        help="instead draw a sample of devices whose physics explains the paper with the shipped testbed's loop, in "
        "three fleets: to train on, to choose by, held out",
    )
    parser.add_argument(
        "--below-floor", choices=FLOORS, help="of a fleet: treatment of forces below the floor (default: the testbed's)"
    )
    parser.add_argument(
        "--spring-laws",
        nargs="*",
        type=float,
        metavar="X",
        help="of a fleet: free lengths of a spring over its half width, each of them fixed in a further start; 0 is "
        "linear, 1 mounted unstretched (default: 0 0.7)",
    )
    parser.add_argument(
        "--bound",
        type=float,
        metavar="X",
        help="of a fleet: largest cost of a device above the least one (default: 2.5)",
    )
    counts = "of a fleet: number of devices to train on, to choose by, held out (default: 64 16 32)"
    parser.add_argument("--devices", nargs=3, type=int, metavar="N", help=counts)
    parser.add_argument("--write", action="store_true", help="also replace the package's fleets")
    add_options(parser, "--doc", help="of a fleet: renew the generated part of a document, and its figure")
    add_workers(parser, "searches", processes=True)
    parser.add_argument("--overwrite", action="store_true", help="replace a study with other sizes in the folder")
    add_figures(parser, into=("fleet",))
    add_json(parser, "the content of identification.json, or of fleet.json")


def run(arguments: argparse.Namespace) -> int:
    """Identify, print the result, and write the files."""
    check_least(arguments, **dict.fromkeys(_COUNTS, 1))
    workers = chosen_workers(arguments)
    if arguments.population is not None and arguments.population < 5:
        raise AmulettError(f"--population is {arguments.population}; differential evolution needs at least 5")
    if arguments.seeds and (min(arguments.seeds) < 0 or len(set(arguments.seeds)) < len(arguments.seeds)):
        raise AmulettError(f"--seeds are {arguments.seeds}; they have to differ and be at least 0")
    if arguments.fleet:
        return _sample(arguments, workers)
    if other := [name for name in _OF_FLEET if getattr(arguments, name) not in (None, False)]:
        raise AmulettError(f"--{other[0].replace('_', '-')} is for a sample of devices; add --fleet")
    from amulett_gym.studies.paper.reproduction import Readings
    from amulett_gym.studies.paper.study import STUDY_MARKS, Recipe, stage_count, study
    from amulett_gym.studies.paper.study_words import in_words

    recipe = Recipe(**_given(arguments, "seeds", *_COUNTS))
    total = stage_count(recipe)
    show = printer(arguments)
    show(f"{total} searches, {workers.words()}; a search may take minutes.")
    progress = Progress(total, "identify", "searches")
    with output_folder(arguments.out, "study", [STUDY_MARKS]), locked_folder(arguments.out), progress:
        words = _command(arguments.out, recipe, arguments.spring_end)
        readings = Readings(spring_end=arguments.spring_end)
        report = _reporter(show, progress, total)
        content = study(arguments.out, recipe, readings, workers, report, arguments.overwrite, words)
    if arguments.json:
        print_json(content)
    show(in_words(content))
    show(f"Written to {arguments.out}: identification.json, simulation.yaml and testbed.yaml.")
    return 0


def _sample(arguments: argparse.Namespace, workers: Workers) -> int:
    """Draw a sample of devices, print how they are, and write the files."""
    from amulett_gym.profile import load_profile
    from amulett_gym.reporting.document import check_document, update_document
    from amulett_gym.reporting.style import save_figures
    from amulett_gym.studies.paper.reproduction import Readings
    from amulett_gym.studies.paper.sample import CONTENT, FLEETS, RECIPE, Recipe, sample, ship, stage_count
    from amulett_gym.studies.paper.sample_page import MARKS, block, draw, in_words

    if arguments.refinement is not None:
        raise AmulettError("--refinement is not for --fleet, whose starts are not refined; leave it out")
    if arguments.bound is not None and not 0.0 < arguments.bound < 1e6:
        raise AmulettError(f"--bound is {arguments.bound:g}; it has to be above 0, and below 1e6")
    if outside := [ratio for ratio in arguments.spring_laws or () if not 0.0 <= ratio <= 1.0]:
        raise AmulettError(f"--spring-laws has {outside[0]:g}; a free length over the half width is from 0 to 1")
    if arguments.devices and min(arguments.devices) < 1:
        raise AmulettError(f"--devices are {arguments.devices}; each fleet needs at least 1")
    recipe = Recipe(
        **_given(arguments, "seeds", "spring_laws", "population", "generations", "steps", "bound", "devices")
    )
    floor = arguments.below_floor or load_profile("testbed").sensors.below_floor
    readings = Readings(spring_end=arguments.spring_end, floor=floor)
    if arguments.doc:
        check_document(arguments.doc, [MARKS], images=True)
    total, show = stage_count(recipe), printer(arguments)
    show(f"{total} steps, {workers.words()}; a search may take minutes.")
    sizes = command_words(argparse.Namespace(**_plain(recipe)), *(name.replace("_", "-") for name in _plain(recipe)))
    words = ["amulett", "identify", "--fleet", "--spring-end", arguments.spring_end, "--below-floor", floor, *sizes]
    progress = Progress(total, "identify", "steps")
    with output_folder(arguments.out, "sample of devices", [[RECIPE]]), locked_folder(arguments.out), progress:
        report, words = _reporter(show, progress, total), [*words, "--out", arguments.out]
        content = sample(arguments.out, recipe, readings, workers, report, arguments.overwrite, words)
        save_figures(draw(content), Path(arguments.out))
    if arguments.json:
        print_json(content)
    show(in_words(content))
    show(f"Written to {arguments.out}: {CONTENT}, {', '.join(f'{name}.yaml' for name in FLEETS)} and figures.")
    if arguments.write:
        show(f"Written: {ship(arguments.out)}")
    if arguments.doc:
        update_document(arguments.doc, {MARKS: block(content)}, draw(content))
        show(f"Written: {arguments.doc}")
    return 0


def _given(arguments: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Return the options that are given, lists as tuples."""
    values = {name: getattr(arguments, name) for name in names}
    return {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items() if value is not None
    }


def _plain(recipe: Any) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in vars(recipe).items()}


def _reporter(show: Callable[..., None], progress: Progress, total: int) -> Callable[[str, Mapping[str, Any]], None]:
    """Return a function that prints the name and result of a stage with its number."""
    numbers = count(1)

    def report(name: str, stage: Any) -> None:
        shown = "walked"
        if isinstance(stage, Mapping):
            cost = [f"cost {stage['cost']:.3f}"] if "cost" in stage else []
            shown = ", ".join([*cost, f"{stage['explained']} rows explained"]) if "explained" in stage else "drawn"
        show(f"{next(numbers):3d} of {total}  {name:32} {shown}")
        progress.update()

    return report


def _command(out: str, recipe: Any, spring_end: str) -> list[str]:
    sizes = [word for name in _COUNTS for word in (f"--{name}", str(getattr(recipe, name)))]
    end = [] if spring_end == SPRING_ENDS[0] else ["--spring-end", spring_end]
    return ["amulett", "identify", "--seeds", *map(str, recipe.seeds), *sizes, *end, "--out", out]
