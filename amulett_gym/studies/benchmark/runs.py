"""The training runs of a benchmark: which there have to be, which are there, and what they say of themselves."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.learning import advice, load_learning, not_installed
from amulett_gym.storage.provenance import differences
from amulett_gym.storage.reading import read_json, read_text
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.studies.benchmark.description import Benchmark, training_recipe

_CONFIG, _FINISHED, _EVALUATIONS = "config.yaml", "finished.json", "evaluations.csv"


@dataclass(frozen=True)
class TrainingRun:
    """One training run of a benchmark.

    Attributes
    ----------
    entry : str
        The learned entry, or ``<entry>-without-<term>`` of an ablation.
    seed : int
    config : amulett_agents.TrainConfig
        Its resolved recipe.
    folder : Path
    """

    entry: str
    seed: int
    config: Any
    folder: Path

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{self.entry}, seed {self.seed}"

    def is_finished(self) -> bool:
        """Tell whether it has come to its end."""
        return (self.folder / _FINISHED).is_file()


def ablation_name(entry: str, term: str) -> str:
    """Return what an entry is called that was trained without a reward term."""
    return f"{entry}-without-{term}"


def required_runs(description: Benchmark, recipes: Path, folder: Path) -> list[TrainingRun]:
    """Return the runs that a description asks for, each with its checked recipe and its place in `folder`.

    Raises AmulettError if a recipe cannot be read or is wrong.
    """
    runs = []
    for name, entry in description.learned.items():
        for seed in entry.seeds:
            config = training_recipe(entry, seed, recipes)
            _check_period(description, name, config)
            runs.append(TrainingRun(name, seed, config, folder / name / f"seed-{seed}"))
    if description.learned:
        best = description.learned[description.best_learned]
        for term in description.ablations:
            name, seed = ablation_name(description.best_learned, term), best.seeds[0]
            config = training_recipe(best, seed, recipes, [f"env.reward_weights.{term}=0.0"])
            runs.append(TrainingRun(name, seed, config, folder / name / f"seed-{seed}"))
    return runs


def _check_period(description: Benchmark, name: str, config: Any) -> None:
    """Refuse, before it is trained, a policy that could not be judged."""
    steps = description.duration / config.env.agent_period
    if abs(steps - round(steps)) > 1e-9 * steps:
        raise AmulettError(
            f"learned entry '{name}' acts every {config.env.agent_period} s; an episode of {description.duration} s is "
            "no whole number of such steps"
        )


def check_runs(runs: Sequence[TrainingRun]) -> list[TrainingRun]:
    """Return the runs that are not finished, after checking that those that are there have the recipes asked for.

    Raises AmulettError if a run was trained by another recipe, or runs are missing and what learns is not installed.
    """
    for run in runs:
        if (run.folder / _CONFIG).is_file():
            _check_recipe(run)
    missing = [run for run in runs if not run.is_finished()]
    if missing and (absent := not_installed()):
        names = ", ".join(run.name for run in missing[:5]) + (", ..." if len(missing) > 5 else "")
        raise AmulettError(
            f"{len(missing)} of {len(runs)} training runs are missing ({names}); give the folder of runs, or "
            f"install what trains them. {advice(absent)}"
        )
    return missing


def train_run(run: TrainingRun, progress: bool = False) -> None:
    """Train a run, or go on with it where it was stopped.

    Raises KeyboardInterrupt if Ctrl-C or SIGTERM ended it; what was learned is kept.
    """
    training = load_learning("training")
    if (run.folder / _CONFIG).is_file():
        result = training.resume(run.folder, progress=progress)
    else:
        result = training.train(run.config, run.folder, progress=progress, command=["amulett", "benchmark"])
    if result.interrupted:
        raise KeyboardInterrupt


def train_missing(runs: Sequence[TrainingRun], advance: Callable[[TrainingRun], Any], progress: bool = False) -> None:
    """Train what is missing, one run after the other; `advance` is called with each that is finished."""
    for run in runs:
        if not run.is_finished():
            train_run(run, progress)
        advance(run)


def outcome(run: TrainingRun) -> dict[str, Any]:
    """Return ``steps``, ``seconds``, ``best_steps`` and ``best_cost`` (capped, on validation) of a finished run.

    Raises AmulettError if the file that says so is damaged.
    """
    path = run.folder / _FINISHED
    content = read_json(path, "a run's result")
    try:
        return {key: content[key] for key in ("steps", "seconds", "best_steps", "best_cost")}
    except (KeyError, TypeError) as error:
        raise AmulettError(f"'{path}' is damaged: {error!r}") from error


def learning_curve(run: TrainingRun) -> NDArray[np.float64]:
    """Return a run's validations, shape (n, 3): agent steps, wall clock [s], and cost.

    Raises AmulettError if the file cannot be read.
    """
    path = run.folder / _EVALUATIONS
    rows = list(csv.DictReader(io.StringIO(read_text(path, "a run's validations"))))
    try:
        return np.array([[float(row[key]) for key in ("steps", "seconds", "cost")] for row in rows]).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise AmulettError(f"'{path}' is damaged: {error!r}") from error


def _check_recipe(run: TrainingRun) -> None:
    """Refuse a stored run whose recipe is another one; how often it keeps itself does not matter.

    The file is compared as it is: a key that was not there when the run was trained had no value of today's.
    """
    stored, wanted = read_yaml(run.folder / _CONFIG, "recipe"), run.config.model_dump(mode="json")
    unread = "sac" if wanted["algorithm"] == "ppo" else "ppo"
    for aside in ("checkpoint_seconds", "checkpoint", "threads", unread):
        stored.pop(aside, None), wanted.pop(aside, None)
    for tree in (stored, wanted):
        if isinstance(tree.get("env"), dict):
            tree["env"].pop("threads", None)
    changed = differences(stored, wanted)
    if changed:
        raise AmulettError(
            f"the run in '{run.folder}' was trained by another recipe than {run.name} of this benchmark: "
            f"{'; '.join(changed)}; choose another folder for the runs, or mend the description"
        )
