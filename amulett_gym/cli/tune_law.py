"""`amulett tune-law`: search a law's parameters, the best constant or a loop's gains, for devices and a suite."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_device, add_json, add_options, add_workers, chosen_workers, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder, write_json, write_text

if TYPE_CHECKING:
    from amulett_gym.evaluation.search.law_recipe import Recipe
    from amulett_gym.reporting.table import Table
    from amulett_gym.simulation.layout import Control
    from amulett_gym.workers.call import Workers

HELP = "tune a law or a loop's gains for a device or a fleet; the same command continues an interrupted search"
EXAMPLES = """  amulett tune-law eq6-tuned --profile configs/my_device.yaml --out runs/tuned
  amulett tune-law constant --suite reach --out runs/constant
  amulett tune-law parametric --suite mixed --budget 20000 --seeds 1 --out runs/short
  amulett tune-law parametric --fleet plausible --choose-fleet plausible-choose --out runs/over-a-fleet
  amulett tune-law gains --control co-rotation --profile configs/my_device.yaml --out runs/gains
  amulett tune-law gains --control all --budget 100000 --out runs/gains-of-all-loops
"""

COSTS = "costs.csv"
"""File with the costs in each of several loops."""

TUNING = "tuning.json"
"""File that marks a folder of this command, and names what is tuned there."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    laws = "constant (a tension), eq6-tuned (4 parameters), parametric (18), or gains: those of the loop in --control"
    parser.add_argument("law", metavar="LAW", help=laws)
    control = (
        "loops that play, or all that fit the device: tuned one by one, alike (default: decentralized, the paper's)"
    )
    parser.add_argument("--control", nargs="+", default=["decentralized"], metavar="LOOP", help=control)
    track = (
        "cost that is minimised: schedule or full-control (default: schedule for a law in the paper's loop, else "
        "full-control)"
    )
    parser.add_argument("--track", metavar="TRACK", help=track)
    suite = "suite of scenarios, searched on its split train, chosen on validation (default: mixed)"
    add_options(parser, "--suite", default="mixed", help=suite)
    add_device(parser, one=False)
    choose = "devices on which the best of the starts is chosen, of a law tuned over a fleet (default: that fleet)"
    parser.add_argument("--choose-fleet", metavar="FLEET", help=choose)
    budget = "simulated training episodes of all starts, for each loop (default: as for the shipped laws)"
    parser.add_argument("--budget", type=int, metavar="N", help=budget)
    seeds = "seeds of the independent starts, of which the best is chosen (default: 1 2)"
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2], metavar="N", help=seeds)
    validation = "validation scenarios that choose among the starts (default: 200)"
    parser.add_argument("--validation", type=int, default=200, metavar="N", help=validation)
    add_workers(parser, "searches", processes=True)
    parser.add_argument("--out", required=True, metavar="DIR", help="folder; an interrupted search in it is continued")
    write = "also replace the package's parameters of this law, for a shipped device"
    parser.add_argument("--write", action="store_true", help=write)
    add_json(parser, "the tuned law's file; of several loops each by its name, and those skipped")


def run(arguments: argparse.Namespace) -> int:
    """Tune, print the result, and write it; return 130 if Ctrl-C ended it."""
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.evaluation.search.gains import GAINS
    from amulett_gym.evaluation.search.laws import at_ends, check_shippable, profile_path, result_path, ship
    from amulett_gym.laws.contenders import split_loop
    from amulett_gym.simulation.layout import LOOPS

    workers = chosen_workers(arguments)
    loop, law = split_loop(arguments.law)
    if loop:
        raise AmulettError(f"'{arguments.law}' names a loop; write {law} --control {loop}")
    (recipes, skipped), profile = _recipes(arguments), arguments.profile
    if arguments.write:
        for recipe in recipes:
            check_shippable(recipe)
    show, words = printer(arguments), _command(arguments)
    for each, reason in skipped.items():
        whom = "this device" if recipes[0].fleet is None else "all devices"
        show(f"Without {each}, which does not fit {whom}: {reason}.")
    loops = tuple(recipe.control for recipe in recipes)
    if recipes[0].fleet is None:  # the devices of a fleet are taken as they are
        print_remarks(device_remarks(recipes[0].device(), loops=loops, suite=recipes[0].suite))
    try:
        contents = tune_in(arguments.out, recipes, words, show, workers)
    except KeyboardInterrupt:
        print("interrupted; finished generations are kept. Continue with:", file=sys.stderr)
        print(f"       {shlex.join(words)}", file=sys.stderr)
        return 130
    tuned, several = list(zip(recipes, contents, strict=True)), len(recipes) > 1
    written = [str(result_path(arguments.out, recipe)) for recipe in recipes]
    if arguments.law == GAINS:
        profile = str(profile_path(arguments.out))
        written.append(profile)
    if several:
        written.append(str(Path(arguments.out) / COSTS))
    if arguments.write:
        written += [str(ship(recipe, content)) for recipe, content in tuned]
    if arguments.json:
        every = {recipe.control: content for recipe, content in tuned} | ({"skipped": skipped} if skipped else {})
        print_json(every if several else contents[0])
    show((_costs(tuned) if several else _in_words(contents[0])).text(), wrap=False)
    for recipe, content in tuned:
        if ends := at_ends(recipe, content):
            loop = f" for {recipe.control}" if several else ""
            show(f"At an end of the range that was searched{loop}: {', '.join(ends)}.")
    show(f"Written: {', '.join(written)}")
    policies = [_contender(arguments.out, recipe, content) for recipe, content in tuned]
    policies = policies if recipes[0].control in LOOPS else ["eq6", *policies]
    again = shlex.join(["amulett", "evaluate", "--policies", *policies])
    devices = ["--profile", profile] if arguments.fleet is None else ["--fleet", arguments.fleet]
    options = shlex.join(["--suite", arguments.suite, *devices])
    show(f"Compare:\n  {again} \\\n      {options}", wrap=False)
    return 0


def _recipes(arguments: argparse.Namespace) -> tuple[list[Recipe], dict[Control, str]]:
    """Return the recipe of each loop, and the loops that `all` skips with the reasons."""
    from amulett_gym.fleet import load_fleet
    from amulett_gym.profile import load_profile
    from amulett_gym.simulation.layout import CONTROLS, unfit_loops

    skipped: dict[Control, str] = {}
    controls = arguments.control
    if controls == ["all"]:
        if arguments.fleet is None:
            skipped = unfit_loops(load_profile(arguments.profile))
        for device in load_fleet(arguments.fleet) if arguments.fleet is not None else ():
            found = unfit_loops(device).items()
            skipped = {loop: f"'{device.name}': {reason}" for loop, reason in found} | skipped
        controls = [control for control in CONTROLS if control != "position-only" and control not in skipped]
    elif "all" in controls:
        loops = " ".join(control for control in controls if control != "all")
        raise AmulettError(f"--control all stands alone; write --control all, or the loops without it: {loops}")
    if len(set(controls)) < len(controls):
        raise AmulettError(f"--control names a loop twice: {' '.join(controls)}")
    names = ("law", "suite", _devices(arguments), "choose_fleet", "seeds", "validation", "track")
    recipes = read_recipes({**{name: getattr(arguments, name) for name in names}, "control": controls})
    if arguments.budget is not None:
        recipes = [recipe.within(arguments.budget) for recipe in recipes]
    return recipes, skipped


def read_recipes(config: Mapping[str, Any]) -> list[Recipe]:
    """Return the recipes of a folder's configuration, in which `control` is a loop or a list of them."""
    from amulett_gym.evaluation.search.law_recipe import Recipe

    controls = config.get("control", "decentralized")
    return [Recipe(**{**config, "control": loop}) for loop in ([controls] if isinstance(controls, str) else controls)]


def tune_in(
    out: str, recipes: Sequence[Recipe], words: Sequence[str], show: Callable[..., None], workers: Workers
) -> list[dict[str, Any]]:
    """Tune in each loop in a command's output folder, and return the results.

    Raises
    ------
    AmulettError
        If the folder holds anything else than a tuning of the same law, loops, suite and device.
    """
    from dataclasses import asdict

    from amulett_gym.evaluation.metrics import COST_OF, METRICS
    from amulett_gym.evaluation.search.laws import tune_all
    from amulett_gym.fleet import in_words
    from amulett_gym.settings import to_plain
    from amulett_gym.storage.provenance import write_provenance

    first, loops = recipes[0], [recipe.control for recipe in recipes]
    config = to_plain(asdict(first)) | {"control": loops if len(loops) > 1 else loops[0]}
    each = first.episodes + first.judging
    total = sum(recipe.episodes + recipe.judging for recipe in recipes)
    where = f"of the {first.device().name}" if first.fleet is None else f"over {in_words(first.fleet)}"

    def begin(done: int) -> None:
        starts = ", ".join(map(str, first.seeds))
        show(
            f"{first.law} in {', '.join(loops)} on {first.suite} {where}, by the "
            f"{METRICS[COST_OF[first.cost_track]].name}, starts {starts}: "
            f"{total:,} simulated episodes, "
            + (f"{each:,} in each of {len(loops)} loops: " if len(loops) > 1 else "")
            + f"{first.episodes:,} on train with {first.population} candidates in a "
            f"generation, and {first.judging:,} to judge what was found" + (f"; {done:,} are done" if done else "")
        )

    def report(recipe: Recipe, seed: int, start: Mapping[str, Any]) -> None:
        loop = f"{recipe.control}, " if len(loops) > 1 else ""
        show(f"{loop}start {seed}: cost {start['train']:.4f} on train, {start['validation']:.4f} on validation")
        if "reached" in start:
            reached = ", ".join(f"{shape} {cost:.4f}" for shape, cost in start["reached"].items())
            show(f"  reference motion: {start['reference']}; costs when it was chosen: {reached}")

    with output_folder(out, "tuned law", [[TUNING]]), locked_folder(out):
        always, others = ("law", "control", "suite", "profile"), ("track", "fleet", "choose_fleet")
        given = {key: config[key] for key in others if config[key] is not None}
        _refuse_other(Path(out), {key: config[key] for key in always} | given)
        write_provenance(out, "tune-law", config, first.seeds, words)
        contents = tune_all(out, recipes, report, begin, True, workers)
        if len(recipes) > 1:
            write_text(Path(out) / COSTS, _costs(list(zip(recipes, contents, strict=True))).csv())
    show(f"{total:,} episodes were simulated.")
    return contents


def _refuse_other(folder: Path, subject: Mapping[str, Any]) -> None:
    """Write what is tuned in a folder; refuse a folder in which something else was."""
    from amulett_gym.storage.reading import read_json

    path = folder / TUNING
    if path.is_file() and (found := read_json(path, "tuned law's folder")) != subject:
        there = found if isinstance(found, dict) else {}
        devices = {"fleet": "another fleet", "choose_fleet": "another choose-fleet", "profile": "another device"}
        other = next((words for key, words in devices.items() if there.get(key) != subject.get(key)), "")
        loops = there.get("control")
        there = {**there, "control": ", ".join(loops) if isinstance(loops, list) else loops}
        named = "{law} on {suite} in {control}".format(**there) if {*subject} <= {*there} else "something else"
        raise AmulettError(
            f"'{folder}' holds a tuning of {named}{f', for {other}' if other else ''}; choose another folder"
        )
    write_json(path, dict(subject))


def _in_words(content: Mapping[str, Any]) -> Table:
    """Return the table of the parameters."""
    from amulett_gym.reporting.table import Table

    rows = [
        (name, _shown(entry["value"]), entry["unit"].replace("1", ""), entry["meaning"])
        for name, entry in content["parameters"].items()
    ]
    start = content["starts"][str(content["chosen_seed"])]
    note = f"from start {content['chosen_seed']}; cost {start['validation']:.4f} on validation"
    return Table("", ("parameter", "value", "unit", "meaning"), rows, note, left=(0, 2, 3))


def _costs(tuned: Sequence[tuple[Recipe, Mapping[str, Any]]]) -> Table:
    """Return the table of the costs in each loop."""
    from amulett_gym.evaluation.search.gains import SHAPE, TENSION
    from amulett_gym.reporting.table import Table

    rows = []
    for recipe, content in tuned:
        chosen, found = content["chosen_seed"], content["parameters"]
        start = content["starts"][str(chosen)]
        own = [_shown(found[name]["value"]) if name in found else "" for name in (SHAPE, TENSION)]
        costs = [f"{start[split]:.4f}" for split in ("train", "validation")]
        rows.append((recipe.control, *own, *costs, str(chosen), f"{content['training_episodes']}"))
    head = ("loop", SHAPE, f"{TENSION} [N]", "cost on train", "cost on validation", "start", "training episodes")
    return Table("", head, rows, left=(0, 1))


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def _contender(out: str, recipe: Recipe, content: Mapping[str, Any]) -> str:
    """Return the name by which other commands play what was tuned."""
    from amulett_gym.evaluation.search.gains import GAINS, TENSION
    from amulett_gym.evaluation.search.laws import result_path
    from amulett_gym.laws.contenders import CONSTANT
    from amulett_gym.simulation.layout import LOOPS

    loop = f"{recipe.control}/" if recipe.control in LOOPS else ""
    if recipe.law == GAINS:
        return f"{loop}{CONSTANT}{_shown(content['parameters'][TENSION]['value'])}"
    return f"{loop}{result_path(out, recipe)}"


def _command(arguments: argparse.Namespace) -> list[str]:
    subject = ("control", "track", "suite", _devices(arguments), "choose-fleet")
    options = (*subject, "budget", "seeds", "validation", "workers", "ray", "out")
    return ["amulett", "tune-law", arguments.law, *command_words(arguments, *options)]


def _devices(arguments: argparse.Namespace) -> str:
    """Return the name of the option that chooses the devices."""
    return "profile" if arguments.fleet is None else "fleet"
