"""The training runs of a benchmark."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE
from amulett_gym.errors import AmulettError, refuse_worn
from amulett_gym.laws.contenders import bundle_folder, split_loop
from amulett_gym.laws.copies import policy_digest
from amulett_gym.learning import advice, load_learning, not_installed
from amulett_gym.simulation.layout import DRIVES
from amulett_gym.storage.provenance import differences
from amulett_gym.storage.reading import read_json, read_text
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.studies.benchmark.description import Benchmark, loop_of, named, profile_of, training_recipe

_CONFIG, _FINISHED, _EVALUATIONS, _START = "config.yaml", "finished.json", "evaluations.csv", "start"


@dataclass(frozen=True)
class TrainingRun:
    """One training run of a benchmark."""

    entry: str  # the learned entry, or ``<entry>-without-<term>`` of an ablation
    seed: int
    config: Any  # its resolved recipe, `amulett_agents.TrainConfig`
    folder: Path

    @property
    def name(self) -> str:
        """Entry and seed."""
        return f"{self.entry}, seed {self.seed}"

    def is_finished(self) -> bool:
        """Return whether the run is complete."""
        return (self.folder / _FINISHED).is_file()


def ablation_name(entry: str, term: str) -> str:
    """Return the name of an entry trained without a reward term."""
    return f"{entry}-without-{term}"


def required_runs(description: Benchmark, recipes: Path, folder: Path) -> list[TrainingRun]:
    """Return the runs of a description, each with its checked recipe and its place in `folder`.

    Raises AmulettError if a recipe cannot be read or is wrong.
    """
    runs, device = [], [] if description.track == SCHEDULE else [f"env.profile={profile_of(description, recipes)}"]
    for name, entry in description.learned.items():
        for seed in entry.seeds:
            config = training_recipe(entry, seed, recipes, device)
            _check_period(description, name, config)
            _check_loop(description, name, config)
            runs.append(TrainingRun(name, seed, config, folder / name / f"seed-{seed}"))
    if description.ablations and description.learned and description.best_learned is not None:
        best = description.learned[description.best_learned]
        for term in description.ablations:
            name, seed = ablation_name(description.best_learned, term), best.seeds[0]
            config = training_recipe(best, seed, recipes, [*device, f"env.reward_weights.{term}=0.0"])
            runs.append(TrainingRun(name, seed, config, folder / name / f"seed-{seed}"))
    return runs


def trained_loops(runs: Sequence[TrainingRun]) -> dict[str, str]:
    """Return the loop in which each entry is trained; `DRIVES` of those in `Amulett/Drives-v0`, which has none."""
    return {run.entry: DRIVES if run.config.env.id == DRIVES_ID else run.config.env.control for run in runs}


def _check_period(description: Benchmark, name: str, config: Any) -> None:
    """Refuse a recipe whose policy could not be evaluated because of its agent period."""
    steps = description.duration / config.env.agent_period
    if abs(steps - round(steps)) > 1e-9 * steps:
        raise AmulettError(
            f"learned entry '{name}' acts every {config.env.agent_period} s; an episode of {description.duration} s is "
            "no whole number of such steps"
        )


def _check_loop(description: Benchmark, name: str, config: Any) -> None:
    """Refuse a recipe whose policy would act in another loop than it was trained in, or by another track's cost."""
    control = config.env.control
    if config.env.id == WORN_ID:
        raise refuse_worn(f"learned entry '{name}'")
    own = named(control, split_loop(name)[1])
    if description.track == FULL_CONTROL and config.env.track != FULL_CONTROL:
        raise AmulettError(
            f"learned entry '{name}' is trained on the track {config.env.track}; set env.track={FULL_CONTROL}"
        )
    if config.env.id == DRIVES_ID and description.learned[name].best_loop_seeds:
        raise AmulettError(
            f"learned entry '{name}' is trained in {DRIVES_ID}, which has no loop; best_loop_seeds has to be empty"
        )
    if config.env.id in ENV_IDS[:2] and control != loop_of(name):
        raise AmulettError(f"learned entry '{name}' is trained in the loop {control}; call it '{own}'")


def check_runs(runs: Sequence[TrainingRun]) -> list[TrainingRun]:
    """Return the runs that are not finished, after checking the recipes of the stored ones.

    Raises AmulettError if a run was trained by another recipe, or runs are missing and the training extra is.
    """
    for run in runs:
        if (run.folder / _CONFIG).is_file():
            _check_recipe(run)
    missing = [run for run in runs if not run.is_finished()]
    if missing and (absent := not_installed()):
        names = ", ".join(run.name for run in missing[:5]) + (", ..." if len(missing) > 5 else "")
        raise AmulettError(
            f"{len(missing)} of {len(runs)} training runs are missing ({names}); give the folder of runs, or "
            f"install the training extra. {advice(absent)}"
        )
    return missing


def begin_run(run: TrainingRun) -> None:
    """Write what is needed to train a run from its beginning, unless it is there."""
    if not (run.folder / _CONFIG).is_file():
        load_learning("training").begin(run.config, run.folder, ["amulett", "benchmark"])


def train_run(run: TrainingRun, progress: bool = False) -> None:
    """Train a run, or resume it. Raises KeyboardInterrupt if Ctrl-C or SIGTERM ended it; its checkpoint is kept."""
    training = load_learning("training")
    if (run.folder / _CONFIG).is_file():
        result = training.resume(run.folder, progress=progress)
    else:
        result = training.train(run.config, run.folder, progress=progress, command=["amulett", "benchmark"])
    if result.interrupted:
        raise KeyboardInterrupt


def train_missing(runs: Sequence[TrainingRun], advance: Callable[[TrainingRun], Any], progress: bool = False) -> None:
    """Train missing runs one after the other; `advance` is called with each finished run."""
    for run in runs:
        if not run.is_finished():
            train_run(run, progress)
        advance(run)


def outcome(run: TrainingRun) -> dict[str, Any]:
    """Return ``steps``, ``seconds``, ``best_steps`` and ``best_cost`` (capped, on validation) of a finished run.

    Raises AmulettError if its file is damaged.
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
    """Refuse a stored run of another recipe; neither the interval of checkpoints nor the place of its start matters.

    The file is compared as it is: a key that did not exist when the run was trained does not get today's default.
    """
    stored, wanted = read_yaml(run.folder / _CONFIG, "recipe"), run.config.model_dump(mode="json")
    unread = "sac" if wanted["algorithm"] == "ppo" else "ppo"
    for aside in ("checkpoint_seconds", "checkpoint", "threads", unread):
        stored.pop(aside, None), wanted.pop(aside, None)
    for tree in (stored, wanted):
        if isinstance(tree.get("env"), dict):
            tree["env"].pop("threads", None)
    start, copied = wanted["network"]["start"], str(run.folder / _START)
    if start is not None and policy_digest(copied) == policy_digest(str(bundle_folder(start))) is not None:
        stored["network"]["start"] = start  # the same policy, even if it was elsewhere
    changed = differences(stored, wanted)
    if changed:
        raise AmulettError(
            f"the run in '{run.folder}' was trained by another recipe than {run.name} of this benchmark: "
            f"{'; '.join(changed)}; choose another folder for the runs, or correct the description"
        )
