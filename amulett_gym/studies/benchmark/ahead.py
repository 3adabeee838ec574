"""What workers do ahead of a benchmark's stages: each stage then finds its results in the files in which they are kept.

With one worker on this machine nothing is done ahead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.laws import finish_all, starts_of
from amulett_gym.evaluation.search.optimal import optimal_costs, result_file
from amulett_gym.laws.contenders import Contender, Own
from amulett_gym.laws.copies import Copies, copy_policies, kept_policies
from amulett_gym.learning import load_learning
from amulett_gym.profile import Profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.kept import read_kept, write_kept
from amulett_gym.storage.temporary import call_folder
from amulett_gym.studies.benchmark.episodes import Play, arrays_of
from amulett_gym.studies.benchmark.runs import TrainingRun, begin_run
from amulett_gym.workers.call import Call, Workers
from amulett_gym.workers.run import results


def tune_ahead(recipes: Mapping[Path, Sequence[Recipe]], workers: Workers, progress: bool = False) -> None:
    """Search from all starts of the recipes, which are given by folder."""
    if workers.alone:
        return
    starts = [start for folder, own in recipes.items() for recipe in own for start in starts_of(folder, recipe)]
    total = sum((start.recipe.episodes + start.recipe.judging) // len(start.recipe.seeds) for start in starts)
    with _progress(total, "tuning", "episodes", workers, progress, sum(start.done for start in starts)) as bar:
        finish_all([start for start in starts if not start.result], workers, bar.update)


def play_ahead(plays: Sequence[Play], workers: Workers, what: str, progress: bool = False) -> None:
    """Play the episodes that are not kept, except those of a user's callable, which may not be sent to a worker."""
    if workers.alone:
        return
    ours = {f"{play.label} on {play.path}": play for play in plays if not isinstance(play.contender, Own)}
    missing = {name: play for name, play in ours.items() if read_kept(play.path, play.digest) is None}
    calls = {}
    for name, play in missing.items():
        policy = play.contender.policy_name
        sent = copy_policies([] if policy is None else [policy])
        calls[name] = Call(_play, (play.protocol, play.contender, sent, play.keeps_schedule))
    with (
        _progress(len(ours), what, "runs", workers, progress, len(ours) - len(missing)) as bar,
        closing(results(calls, workers)) as finished,
    ):
        for name, arrays in finished:
            write_kept(missing[name].path, missing[name].digest, arrays)
            bar.update(note=missing[name].label)


def train_ahead(runs: Sequence[TrainingRun], workers: Workers, progress: bool = False) -> None:
    """Train the runs that are not finished. Raises KeyboardInterrupt if Ctrl-C ended them."""
    if workers.alone or all(run.is_finished() for run in runs):
        return
    missing = [run for run in runs if not run.is_finished()]
    for run in missing:
        begin_run(run)
    training = load_learning("training")
    for _ in training.resume_all([run.folder for run in missing], workers, progress, f"training, {workers.words()}"):
        pass


def solve_ahead(
    profile: Profile,
    suite: str,
    split: str,
    scenarios: Sequence[int],
    folder: Path,
    duration: float,
    workers: Workers,
    progress: bool = False,
) -> None:
    """Find the optimal commands of scenarios; parameters as of `optimal_costs`."""
    if workers.alone:
        return
    calls = {
        f"optimal control, scenario {number}": Call(
            _solve, (profile, suite, split, number, duration), folder, (result_file(profile, suite, split, number),)
        )
        for number in scenarios
    }
    with (
        _progress(len(calls), "optimal control", "scenarios", workers, progress) as bar,
        closing(results(calls, workers)) as finished,
    ):
        for _ in finished:
            bar.update()


def _progress(total: int, what: str, unit: str, workers: Workers, show: bool = True, done: int = 0) -> Progress:
    return Progress(total, f"{what}, {workers.words()}", unit, show, done)


def _play(protocol: Protocol, contender: Contender, sent: Copies, keep_schedule: bool) -> dict[str, NDArray[Any]]:
    """Play a contender whose policy was sent along, and return what is kept of its run."""
    with call_folder() as folder:
        sent.write(folder)
        name, places = contender.policy_name, kept_policies(folder, sent.record)
        here = replace(contender, policy_name=None if name is None else places.get(name, name))
        return arrays_of(protocol, here, keep_schedule)


def _solve(folder: Path, profile: Profile, suite: str, split: str, number: int, duration: float) -> None:
    optimal_costs(profile, suite, split, [number], folder, duration)
