"""`amulett tune-law`: search a law's parameters, the best constant or a loop's gains, for a device and a suite."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_json, add_options, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder, write_json

if TYPE_CHECKING:
    from amulett_gym.evaluation.search.laws import Recipe

HELP = "tune a law or a loop's gains for a device and a suite; the same command continues an interrupted search"
EXAMPLES = """  amulett tune-law eq6-tuned --profile configs/my_device.yaml --out runs/tuned
  amulett tune-law constant --suite reach --out runs/constant
  amulett tune-law parametric --suite mixed --budget 20000 --seeds 1 --out runs/short
  amulett tune-law gains --control co-rotation --profile configs/my_device.yaml --out runs/gains
"""

TUNING = "tuning.json"
"""File that marks a folder of this command, and names what is tuned there."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    laws = "constant (a tension), eq6-tuned (4 parameters), parametric (18), or gains: those of the loop in --control"
    parser.add_argument("law", metavar="LAW", help=laws)
    control = "loop that plays (default: decentralized, the paper's)"
    parser.add_argument("--control", default="decentralized", metavar="LOOP", help=control)
    track = (
        "cost that is minimised: schedule or full-control (default: schedule for a law in the paper's loop, else "
        "full-control)"
    )
    parser.add_argument("--track", metavar="TRACK", help=track)
    suite = "suite of scenarios, searched on its split train, chosen on validation (default: mixed)"
    add_options(parser, "--suite", default="mixed", help=suite)
    add_options(parser, "--profile")
    budget = "simulated training episodes of all starts (default: as for the shipped laws; equal for all loops)"
    parser.add_argument("--budget", type=int, metavar="N", help=budget)
    seeds = "seeds of the independent starts, of which the best is chosen (default: 1 2)"
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2], metavar="N", help=seeds)
    validation = "validation scenarios that choose among the starts (default: 200)"
    parser.add_argument("--validation", type=int, default=200, metavar="N", help=validation)
    parser.add_argument("--out", required=True, metavar="DIR", help="folder; an interrupted search in it is continued")
    write = "also replace the package's parameters of this law, for a shipped device"
    parser.add_argument("--write", action="store_true", help=write)
    add_json(parser, "the tuned law's file")


def run(arguments: argparse.Namespace) -> int:
    """Tune, print the result, and write it; return 130 if Ctrl-C ended it."""
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.evaluation.search.gains import GAINS, TENSION
    from amulett_gym.evaluation.search.laws import Recipe, at_ends, check_shippable, profile_path, result_path, ship

    law, suite, profile = arguments.law, arguments.suite, arguments.profile
    sizes = {"validation": arguments.validation, "control": arguments.control, "track": arguments.track}
    recipe = Recipe(law, suite, profile, tuple(arguments.seeds), **sizes)
    if arguments.budget is not None:
        recipe = recipe.within(arguments.budget)
    if arguments.write:
        check_shippable(recipe)
    show, words = printer(arguments), _command(arguments)
    print_remarks(device_remarks(recipe.device(), loops=(recipe.control,)))
    try:
        content = tune_in(arguments.out, recipe, words, show)
    except KeyboardInterrupt:
        print("interrupted; finished generations are kept. Continue with:", file=sys.stderr)
        print(f"       {shlex.join(words)}", file=sys.stderr)
        return 130
    result = str(result_path(arguments.out, recipe))
    written = [result]
    loop = "" if recipe.control == "decentralized" else f"{recipe.control}/"
    contender = f"{loop}{result}"
    if law == GAINS:
        profile = str(profile_path(arguments.out))
        written.append(profile)
        contender = f"{loop}constant:{content['parameters'][TENSION]['value']:.4g}"
    if arguments.write:
        written.append(str(ship(recipe, content)))
    if arguments.json:
        print_json(content)
    show(_in_words(content))
    if ends := at_ends(recipe, content):
        show(f"At an end of the range that was searched: {', '.join(ends)}.")
    show(f"Written: {', '.join(written)}")
    policies = [contender] if loop else ["eq6", contender]
    again = shlex.join(["amulett", "evaluate", "--policies", *policies])
    options = shlex.join(["--suite", suite, "--profile", profile])
    show(f"Compare:\n  {again} \\\n      {options}", wrap=False)
    return 0


def tune_in(out: str, recipe: Recipe, words: Sequence[str], show: Callable[..., None]) -> dict[str, Any]:
    """Tune in a command's output folder, and return the result.

    Raises
    ------
    AmulettError
        If the folder holds anything else than a tuning of the same law, suite and device.
    """
    from dataclasses import asdict

    from amulett_gym.evaluation.metrics import COST_OF, METRICS
    from amulett_gym.evaluation.search.laws import tune
    from amulett_gym.settings import to_plain
    from amulett_gym.storage.provenance import write_provenance

    config = to_plain(asdict(recipe))
    total = recipe.episodes + recipe.judging

    def begin(done: int) -> None:
        starts = ", ".join(map(str, recipe.seeds))
        show(
            f"{recipe.law} in {recipe.control} on {recipe.suite} of the {recipe.device().name}, by the "
            f"{METRICS[COST_OF[recipe.cost_track]].name}, starts {starts}: "
            f"{total:,} simulated episodes, {recipe.episodes:,} on train with {recipe.population} candidates in a "
            f"generation, and {recipe.judging:,} to judge what was found" + (f"; {done:,} are done" if done else "")
        )

    def report(seed: int, start: Mapping[str, Any]) -> None:
        show(f"start {seed}: cost {start['train']:.4f} on train, {start['validation']:.4f} on validation")

    with output_folder(out, "tuned law", [[TUNING]]), locked_folder(out):
        subject = {key: config[key] for key in ("law", "control", "suite", "profile")}
        _refuse_other(Path(out), subject | ({"track": recipe.track} if recipe.track else {}))
        write_provenance(out, "tune-law", config, recipe.seeds, words)
        content = tune(out, recipe, report, begin, progress=True)
    show(f"{total:,} episodes were simulated.")
    return content


def _refuse_other(folder: Path, subject: Mapping[str, Any]) -> None:
    """Write what is tuned in a folder; refuse a folder in which something else was."""
    from amulett_gym.storage.reading import read_json

    path = folder / TUNING
    if path.is_file() and (found := read_json(path, "tuned law's folder")) != subject:
        there = found if isinstance(found, dict) else {}
        other = "another device" if there.get("profile") != subject["profile"] else ""
        named = "{law} on {suite} in {control}".format(**there) if {*subject} <= {*there} else "something else"
        raise AmulettError(
            f"'{folder}' holds a tuning of {named}{f', for {other}' if other else ''}; choose another folder"
        )
    write_json(path, dict(subject))


def _in_words(content: Mapping[str, Any]) -> str:
    """Return the table of the parameters."""
    from amulett_gym.reporting.table import Table

    rows = [
        (name, f"{entry['value']:.4g}", entry["unit"].replace("1", ""), entry["meaning"])
        for name, entry in content["parameters"].items()
    ]
    start = content["starts"][str(content["chosen_seed"])]
    note = f"from start {content['chosen_seed']}; cost {start['validation']:.4f} on validation"
    return Table("", ("parameter", "value", "unit", "meaning"), rows, note, left=(0, 2, 3)).text()


def _command(arguments: argparse.Namespace) -> list[str]:
    options = ("control", "track", "suite", "profile", "budget", "seeds", "validation", "out")
    return ["amulett", "tune-law", arguments.law, *command_words(arguments, *options)]
