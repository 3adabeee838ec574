"""Tune laws and gains by differential evolution: searched on `train`, chosen on `validation`, never on `held-out`.

On the track *schedule* the cost of an episode is minus its return, on *full control* the full-control cost
(`metrics.control_prices`). Gains are tuned with a constant co-contraction.

A law can be tuned over a fleet of devices. Then the scenarios are dealt to its devices in turn, and all candidates of a
generation play the same pairs of device and scenario. The best start is chosen on the same fleet or another one.

`tune` searches from several independent starts, each with random candidates. What is finished in the folder is not
repeated: starts, and generations of a start. ``amulett tune-law`` is the command.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from amulett_gym import __version__
from amulett_gym.errors import AmulettError, warn_deprecated
from amulett_gym.evaluation.metrics import COST_OF
from amulett_gym.evaluation.search.gains import GAINS, SHAPE, gains_of, profile_text, shapes_of, shipped_text
from amulett_gym.evaluation.search.law_recipe import Recipe, file_name
from amulett_gym.evaluation.search.law_search import Start, described_recipe
from amulett_gym.fleet import in_words
from amulett_gym.gains import Following
from amulett_gym.laws.parametric import BEST_CONSTANT, DEFAULT_SUITE, FORMAT, LAWS, TUNED
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import merge
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.writing import write_json, write_text
from amulett_gym.workers.call import ALONE, Call, Workers
from amulett_gym.workers.report import advance
from amulett_gym.workers.run import results

Report = Callable[[int, Mapping[str, Any]], None]


def result_path(folder: str | Path, recipe: Recipe) -> Path:
    """Return the file of the result in a folder."""
    return Path(folder) / f"{file_name(recipe)}.json"


def tune(
    folder: str | Path,
    recipe: Recipe,
    report: Report = lambda seed, start: None,
    begin: Callable[[int], object] = lambda done: None,
    progress: bool = False,
) -> dict[str, Any]:
    """Tune a law or gains, write `result_path` and ``stages/``, and return the file's content.

    The file of a law is a contender; for gains there is `profile_path`, too. The parameters are those of the start with
    the lowest cost on `validation`.

    Parameters
    ----------
    folder : str or Path
    recipe : Recipe
    report : callable
        Called with the seed and result of each finished start.
    begin : callable
        Called first, with the number of episodes that an earlier run in the folder has simulated.
    progress : bool
        Whether to show progress on stderr.

    Raises
    ------
    AmulettError
        If a file cannot be read or written.
    """
    (content,) = tune_all(folder, [recipe], lambda recipe, seed, start: report(seed, start), begin, progress)
    return content


def tune_all(
    folder: str | Path,
    recipes: Sequence[Recipe],
    report: Callable[[Recipe, int, Mapping[str, Any]], None] = lambda recipe, seed, start: None,
    begin: Callable[[int], object] = lambda done: None,
    progress: bool = False,
    workers: Workers = ALONE,
) -> list[dict[str, Any]]:
    """Tune by several recipes of different loops, as in `tune`; `profile_path` then holds the gains of all loops.

    `report` is also called with the recipe. The workers each search from a start; they change no result.
    """
    starts = [start for recipe in recipes for start in starts_of(folder, recipe)]
    done = sum(start.done for start in starts)
    total = sum(recipe.episodes + recipe.judging for recipe in recipes)
    begin(done)
    with Progress(total, "tune-law", "episodes", progress, done) as bar:
        for start in starts:
            if start.result:
                report(start.recipe, start.seed, start.result)
        finish_all([start for start in starts if not start.result], workers, bar.update, report)
    contents, changes = [], dict[str, Any]()
    for recipe in recipes:
        content = _content(recipe, [start for start in starts if start.recipe is recipe])
        write_json(result_path(folder, recipe), content)
        contents.append(content)
        if recipe.law == GAINS:
            changes = merge(changes, _changes(recipe, content))
            write_text(profile_path(folder), profile_text(recipe.device(), changes))
    return contents


def finish_all(
    starts: Sequence[Start],
    workers: Workers,
    advance: Callable[[int], object],
    report: Callable[[Recipe, int, Mapping[str, Any]], object] = lambda recipe, seed, start: None,
) -> None:
    """Finish starts, and give each its result; `advance` is called with simulated episodes."""
    named = {
        f"{start.recipe.law} on {start.recipe.suite} in {start.recipe.control}, start {start.seed}": start
        for start in starts
    }
    calls = {
        name: Call(_finish, (start.recipe, start.seed), Path(start.folder), (start.file,))
        for name, start in named.items()
    }
    with closing(results(calls, workers, advance)) as finished:
        for name, result in finished:
            start = named[name]
            start.result = result
            report(start.recipe, start.seed, result)


def starts_of(folder: str | Path, recipe: Recipe) -> list[Start]:
    """Return the starts of a recipe, as far as they are kept in a folder."""
    trials = recipe.trials()
    return [Start(folder, recipe, seed, *trials) for seed in recipe.seeds]


def _finish(folder: Path, recipe: Recipe, seed: int) -> dict[str, Any]:
    return Start(folder, recipe, seed, *recipe.trials()).finish(advance)


def profile_path(folder: str | Path) -> Path:
    """Return the file of the profile with tuned gains in a folder."""
    return Path(folder) / "profile.yaml"


def _changes(recipe: Recipe, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a profile's groups with tuned gains and their source."""
    found, profile = content["parameters"], recipe.device()
    space = gains_of(recipe.control, profile, found[SHAPE]["value"] if shapes_of(recipe.control) else "")
    vector = np.array([float(f"{found[gain.name]['value']:.6g}") for gain in space.parameters])
    source = (
        f"identified: tuned on train of {recipe.suite}, {recipe.episodes} simulated episodes, with a constant of "
        f"{vector[-1]:.3g} N: amulett tune-law {GAINS} --control {recipe.control} --suite {recipe.suite}"
        + (f" --track {recipe.track}" if recipe.track else "")
    )
    return space.changes(profile, vector, source)


def at_ends(recipe: Recipe, content: Mapping[str, Any]) -> list[str]:
    """Return the parameters of a result that are within 2 % of an end of their range in the search."""
    space = recipe.space()
    vector = np.array([content["parameters"][parameter.name]["value"] for parameter in space.parameters])
    near = np.abs(space.to_unit(vector) - 0.5) > 0.48
    return [parameter.name for parameter, end in zip(space.parameters, near, strict=True) if end]


def check_shippable(recipe: Recipe) -> None:
    """Refuse a recipe whose result cannot be one of the package's tuned laws."""
    if not isinstance(recipe.profile or recipe.fleet, str):
        other = f"on {recipe.device().name}" if recipe.fleet is None else f"over {in_words(recipe.fleet)} of your own"
        raise AmulettError(f"only laws tuned on a shipped device or fleet can be put into the package, not {other}")
    if recipe.fleet is not None and recipe.suite != DEFAULT_SUITE:
        raise AmulettError(f"laws tuned over a fleet can be put into the package for the suite {DEFAULT_SUITE} only")
    if recipe.law == BEST_CONSTANT.name:
        raise AmulettError("the package has no tuned constant: name it, for example constant:6")
    if recipe.law == GAINS and recipe.control not in LOOPS:
        raise AmulettError("the gains of the paper's loop stay as they are in the package")
    if recipe.track:
        raise AmulettError(f"the package has nothing that is tuned for the track '{recipe.track}' in this way")
    if recipe.law != GAINS and recipe.control in LOOPS:
        raise AmulettError(f"the package has tuned laws of the paper's loop only, not of '{recipe.control}'")


def ship(recipe: Recipe, content: Mapping[str, Any]) -> Path:
    """Put a law, or gains into their profile, into the package instead of the present ones; return the file."""
    check_shippable(recipe)
    with resources.as_file(resources.files("amulett_gym")) as package:
        if recipe.law == GAINS:
            path = package / "profiles" / f"{recipe.profile}.yaml"
            text = shipped_text(path.read_text("utf-8"), _changes(recipe, content)["loops"])
            write_text(path, text)
        else:
            path = result_path(package.joinpath(*TUNED, recipe.profile or recipe.fleet), recipe)
            write_json(path, content)
    return path


def _content(recipe: Recipe, searched: Sequence[Start]) -> dict[str, Any]:
    starts = {start.seed: start.result for start in searched}
    train = searched[0].train
    validation = searched[0].validation
    law, loop = recipe.space(), recipe.control in LOOPS or recipe.law == GAINS
    chosen = min(starts, key=lambda seed: starts[seed]["validation"])
    described = {}
    for parameter, value in zip(law.parameters, starts[chosen]["parameters"], strict=True):
        described[parameter.name] = {"value": value, "unit": parameter.unit, "meaning": parameter.meaning}
    if shape := starts[chosen].get(SHAPE):
        meaning = Following.model_fields[SHAPE].description
        described = {SHAPE: {"value": shape, "unit": "1", "meaning": meaning}, **described}
    shown = ("train", "validation", SHAPE, "reached")
    return {
        "format": FORMAT,
        "version": 1,
        "parameters": described,
        "recipe": {key: value for key, value in described_recipe(recipe).items() if loop or key != "control"},
        **({"cost": COST_OF[recipe.cost_track]} if loop or recipe.track else {}),
        "chosen_seed": chosen,
        "training_episodes": recipe.episodes,
        "starts": {str(seed): {key: start[key] for key in shown if key in start} for seed, start in starts.items()},
        "sha256": {"train": train.digest(), "validation": validation.digest()},
        "versions": {"amulett-gym": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Run the deprecated command."""
    parser = argparse.ArgumentParser(description="Deprecated: use amulett tune-law.")
    parser.add_argument("--law", nargs="+", default=["eq6-tuned", "parametric"], choices=list(LAWS))
    parser.add_argument("--suite", nargs="+", default=["steps"])
    parser.add_argument("--profile", default="testbed")
    parser.add_argument("--out", required=True, metavar="DIR")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(Recipe.seeds))
    arguments = parser.parse_args(argv)
    warn_deprecated("python -m amulett_gym.evaluation.search.laws is deprecated: use amulett tune-law")
    for suite in arguments.suite:
        for law in arguments.law:
            recipe = Recipe(law, suite, arguments.profile, tuple(arguments.seeds))
            folder = Path(arguments.out) / recipe.device().name
            tune(folder, recipe, progress=True)
            print(f"Written: {result_path(folder, recipe)}")


if __name__ == "__main__":
    main()
