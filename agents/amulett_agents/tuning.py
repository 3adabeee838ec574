"""Tuning a recipe: trials that Optuna proposes, each a training run of its own.

A study is a folder:

====================  =================================================================================
``study.json``        the recipe, the space, the seeds: what makes the trials what they are
``trials/<n>/<s>/``   the run of trial n with seed s; what a run left in it is all that there is to know
``trials.json``       what came of each trial: parameters, costs
``best.yaml``         the best trial's recipe
====================  =================================================================================

The runs are the study's memory: one that is finished is never done again, one that was killed is resumed. What trial n
tries depends on the study's seed, on n and on the costs of the trials before it alone, so that a study that was killed
comes to the same trials as one that was not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import Field, ValidationError, model_validator

from amulett_agents.config import RecipeError, TrainConfig
from amulett_agents.run_folder import CONFIG, TrainResult
from amulett_agents.training import resume, train
from amulett_gym.errors import AmulettError
from amulett_gym.settings import Group, describe, find_config
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.safe_yaml import read_yaml, to_yaml
from amulett_gym.storage.writing import output_folder, write_json, write_text

STUDY, TRIALS, BEST = "study.json", "trials.json", "best.yaml"
RUNS = "trials"
_RANDOM_TRIALS = 8
"""Trials at random before the sampler has something to learn from."""


class Range(Group):
    """Numbers from `low` to `high`; whole ones if both are written without a point."""

    low: int | float
    high: int | float
    log: bool = Field(default=False, description="try orders of magnitude alike")

    @model_validator(mode="after")
    def _check_order(self) -> Range:
        if not self.low < self.high:
            raise ValueError(f"low is {self.low} and high {self.high}; it has to be low < high")
        if self.log and self.low <= 0:
            raise ValueError(f"low is {self.low}; with log it has to be above 0")
        return self

    def distribution(self) -> BaseDistribution:
        """Return it as Optuna knows it."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return IntDistribution(self.low, self.high, log=self.log)
        return FloatDistribution(self.low, self.high, log=self.log)

    def ends(self) -> list[Any]:
        """Return what has to be a valid value."""
        return [self.low, self.high]


class Choice(Group):
    """One of some values, lists and null among them."""

    choices: list[Any] = Field(min_length=2, max_length=100)

    def distribution(self) -> BaseDistribution:
        """Return it as Optuna knows it: by number, for it takes no lists."""
        return CategoricalDistribution(list(range(len(self.choices))))

    def ends(self) -> list[Any]:
        """Return what has to be a valid value."""
        return self.choices


Space = dict[str, Range | Choice]


@dataclass(frozen=True)
class Trial:
    """What came of a trial.

    Attributes
    ----------
    number : int
    changes : dict
        Dotted key of the recipe -> value.
    costs : list of float
        Lowest validation cost of the run with each seed; none if it failed.
    error : str
        Why it failed: the recipe was refused, or a run diverged; else an empty string.
    """

    number: int
    changes: dict[str, Any]
    costs: list[float]
    error: str = ""

    @property
    def cost(self) -> float | None:
        """Mean over the seeds; None if it failed."""
        return float(np.mean(self.costs)) if self.costs else None


def load_space(path: str | Path, config: TrainConfig) -> Space:
    """Read what may be changed in a recipe: dotted keys with ``{low, high, log}`` or ``{choices}``.

    Raises
    ------
    AmulettError
        If the file cannot be read, a key is none of the recipe's, or an end of a range or a choice is not allowed.
    """
    content = read_yaml(find_config(path, "space"), "space")
    if not content:
        raise AmulettError(f"space '{path}' names no key of the recipe")
    space: Space = {}
    for key, entry in content.items():
        kind: type[Range | Choice] = Choice if isinstance(entry, Mapping) and "choices" in entry else Range
        try:
            space[str(key)] = kind.model_validate(entry)
        except ValidationError as error:
            raise describe(error, kind, f"space '{path}', key '{key}'") from error
        found = space[str(key)]
        ends = [_valid(config, str(key), value, path) for value in found.ends()]
        if isinstance(found, Range) and all(isinstance(end, int) for end in ends):  # 1e3 of a key that takes integers
            space[str(key)] = Range(low=ends[0], high=ends[1], log=found.log)
    return space


def _valid(config: TrainConfig, key: str, value: Any, path: str | Path) -> Any:
    """Return a value of a space as the recipe reads it; refuse one that is not allowed."""
    try:
        content: Any = _changed(config, {key: value}).model_dump()
    except ValidationError as error:
        if any(one["loc"] for one in error.errors()):  # others may be right in company
            raise describe(error, TrainConfig, f"space '{path}'") from error
        return value
    for part in key.split("."):
        content = content[part]
    return content


def tune(
    config: TrainConfig,
    space: Space,
    trials: int,
    out: str | Path,
    seed: int = 0,
    seeds: int = 1,
    command: Sequence[str] | None = None,
    progress: bool = False,
    tell: Callable[[Trial, Trial | None], None] | None = None,
) -> list[Trial] | None:
    """Try changes of a recipe, or go on with it.

    Parameters
    ----------
    config : TrainConfig
        What is not changed.
    space : dict
        From `load_space`.
    trials : int
        How many there shall be, those of an earlier call included.
    out : str or Path
        Folder of the study; made if it does not exist, gone on with if it does.
    seed : int
        Of what is tried.
    seeds : int
        Runs of each trial, with the recipe's seed and the following ones; their mean counts.
    command : sequence of str, optional
        The words of the command, to be kept with it.
    progress : bool
        Draw the runs' progress bars.
    tell : callable, optional
        Called with each trial that comes to its end, and the best one so far.

    Returns
    -------
    list of Trial or None
        All trials; None if Ctrl-C or SIGTERM ended it before.

    Raises
    ------
    AmulettError
        If `out` holds something else or another study, another process works in it, or `max_seconds` would let the
        machine's speed decide.
    """
    if config.max_seconds is not None:
        raise AmulettError("max_seconds lets the machine's speed decide what a trial costs; use total_steps for tuning")
    for name, value in (("trials", trials), ("seeds", seeds)):
        if value < 1:
            raise AmulettError(f"{name} is {value}; it has to be at least 1")
    if seed < 0:
        raise AmulettError(f"seed is {seed}; it has to be at least 0")
    out = user_path(out)
    with output_folder(out, "study", [[STUDY]]), locked_folder(out):
        _begin(out, config, space, seed, seeds, command)
        done: list[Trial] = []
        for number in range(trials):
            changes = _propose(space, done, seed, number)
            trial = _run(config, changes, out / RUNS / f"{number:04d}", number, seeds, progress)
            if trial is None:
                return None
            done.append(trial)
            write_json(out / TRIALS, [asdict(one) | {"cost": one.cost} for one in done])
            best = best_of(done)
            if best is not None:
                recipe = _changed(config, best.changes).model_dump()
                write_text(out / BEST, to_yaml(recipe))
            if tell is not None:
                tell(trial, best)
    return done


def best_of(trials: Sequence[Trial]) -> Trial | None:
    """Return the trial of the lowest cost, the first of equal ones; None if all failed."""
    judged = [trial for trial in trials if trial.costs]
    return min(judged, key=lambda trial: (trial.cost, trial.number)) if judged else None


def _begin(out: Path, config: TrainConfig, space: Space, seed: int, seeds: int, command: Sequence[str] | None) -> None:
    """Write down what the study is, or compare it with what was written down."""
    study = {
        "config": config.model_dump(),
        "space": {key: entry.model_dump() for key, entry in space.items()},
        "seed": seed,
        "seeds": seeds,
    }
    if (out / STUDY).is_file():
        changed = differences(read_json(out / STUDY, "study", limit=1_000_000), json.loads(json.dumps(study)))
        if changed:
            raise AmulettError(
                f"'{out}' holds another study: {'; '.join(changed)}; go on with that one, or choose another folder"
            )
    else:
        write_json(out / STUDY, study)
    write_provenance(out, "tune", study, [seed, *(config.seed + k for k in range(seeds))], command)


def _propose(space: Space, done: Sequence[Trial], seed: int, number: int) -> dict[str, Any]:
    """Return what a trial changes, from the seed, its number and the trials before it."""
    distributions = {key: entry.distribution() for key, entry in space.items()}
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    entropy = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    sampler = optuna.samplers.TPESampler(seed=entropy, n_startup_trials=_RANDOM_TRIALS, constant_liar=False)
    study = optuna.create_study(sampler=sampler)
    for trial in done:
        if trial.costs:
            drawn = {
                key: entry.choices.index(trial.changes[key]) if isinstance(entry, Choice) else trial.changes[key]
                for key, entry in space.items()
            }
            study.add_trial(optuna.trial.create_trial(params=drawn, distributions=distributions, value=trial.cost))
    drawn = study.ask(distributions).params
    return {key: entry.choices[drawn[key]] if isinstance(entry, Choice) else drawn[key] for key, entry in space.items()}


def _run(
    config: TrainConfig, changes: Mapping[str, Any], folder: Path, number: int, seeds: int, progress: bool
) -> Trial | None:
    """Train with each seed, or go on with it, or read what was done; None if that was interrupted."""
    costs = []
    for k in range(seeds):
        try:
            recipe = _changed(config, {**changes, "seed": config.seed + k})
        except ValidationError as error:
            return Trial(number, dict(changes), [], str(describe(error, TrainConfig, "recipe")))
        run = folder / str(recipe.seed)
        result: TrainResult
        if (run / CONFIG).is_file():
            result = resume(run, progress=progress)
        else:  # nothing, or a folder that a process was killed in before it had said what it is
            try:
                result = train(recipe, run, progress=progress)
            except RecipeError as error:
                return Trial(number, dict(changes), [], str(error))
        if result.interrupted:
            return None
        if result.diverged is not None:
            return Trial(number, dict(changes), [], f"diverged after {result.diverged:,} steps, seed {recipe.seed}")
        costs.append(result.best_cost)
    return Trial(number, dict(changes), costs)


def _changed(config: TrainConfig, changes: Mapping[str, Any]) -> TrainConfig:
    content = config.model_dump()
    for dotted, value in changes.items():
        *groups, key = dotted.split(".")
        place: Any = content
        for group in groups:
            place = place.setdefault(group, {})
            if not isinstance(place, dict):
                raise AmulettError(f"'{dotted}' is no key of the recipe: '{group}' is a value")
        place[key] = value
    return TrainConfig.model_validate(content)
