"""Tuning of a recipe with Optuna.

A study is a folder:

====================  ==============================================================
``study.json``        recipe, space and seeds, which determine the trials
``kept_policies/``    copies of the bundles that the recipe and the space name as `network.start`
``trials/<n>/<s>/``   the training run of trial n with seed s
``trials.json``       parameters and costs of each trial
``best.yaml``         the recipe of the best trial
====================  ==============================================================

The state of a study is in its runs: a finished one is not repeated, a killed one is resumed. Trial n depends only on
the study's seed, on n and on the costs of the trials before its batch, so that a killed study continues with the same
trials, and any number of workers makes the same ones.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import Field, ValidationError, model_validator

from amulett_agents.config import RecipeError, TrainConfig
from amulett_agents.run_folder import CONFIG, TrainResult, starting_from
from amulett_agents.training import begin, resume_all
from amulett_gym.errors import AmulettError
from amulett_gym.laws.copies import FOLDER, copy_policies, kept_policies
from amulett_gym.settings import Group, describe, find_config
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.safe_yaml import read_yaml, to_yaml
from amulett_gym.storage.writing import output_folder, write_json, write_text
from amulett_gym.workers.call import ALONE, Workers

STUDY, TRIALS, BEST = "study.json", "trials.json", "best.yaml"
RUNS = "trials"
RANDOM_TRIALS = 8
"""Random trials before the sampler uses their costs."""


class Range(Group):
    """Numbers from `low` to `high`; integers if both are integers."""

    low: int | float
    high: int | float
    log: bool = Field(False, description="draw on a logarithmic scale")

    @model_validator(mode="after")
    def _check_order(self) -> Range:
        if not self.low < self.high:
            raise ValueError(f"low is {self.low} and high {self.high}; it has to be low < high")
        if self.log and self.low <= 0:
            raise ValueError(f"low is {self.low}; with log it has to be above 0")
        return self

    def distribution(self) -> BaseDistribution:
        """Return Optuna's distribution."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return IntDistribution(self.low, self.high, log=self.log)
        return FloatDistribution(self.low, self.high, log=self.log)

    def ends(self) -> list[Any]:
        """Return the values that the recipe has to accept."""
        return [self.low, self.high]


class Choice(Group):
    """One of some values, which may be lists and null."""

    choices: list[Any] = Field(min_length=2, max_length=100)

    def distribution(self) -> BaseDistribution:
        """Return Optuna's distribution of the index: it takes no lists."""
        return CategoricalDistribution(list(range(len(self.choices))))

    def ends(self) -> list[Any]:
        """Return the values that the recipe has to accept."""
        return self.choices


Space = dict[str, Range | Choice]


@dataclass(frozen=True)
class Trial:
    """The result of a trial.

    `changes` maps dotted keys of the recipe to values. `costs` are the lowest validation costs of the runs, one a seed.
    If the recipe was refused or a run diverged, `costs` is empty and `error` is the reason.
    """

    number: int
    changes: dict[str, Any]
    costs: list[float]
    error: str = ""

    @property
    def cost(self) -> float | None:
        """Mean cost over the seeds; None if the trial failed."""
        return float(np.mean(self.costs)) if self.costs else None


def load_space(path: str | Path, config: TrainConfig) -> Space:
    """Read a search space: dotted keys of the recipe with ``{low, high, log}`` or ``{choices}``.

    Raises
    ------
    AmulettError
        If the file cannot be read, a key is not in the recipe, or a range's end or a choice is not allowed.
    """
    return parse_space(read_yaml(find_config(path, "space"), "space"), config, path)


def stored_study(content: Mapping[str, Any]) -> tuple[TrainConfig, Space]:
    """Return the recipe and the space of a study from the settings in its ``command.json``.

    Raises
    ------
    AmulettError
        If they are not of this version, or damaged.
    """
    try:
        config = TrainConfig.model_validate(content["config"])
        return config, parse_space(dict(content["space"]), config, STUDY)
    except ValidationError as error:
        raise describe(error, TrainConfig, "the study's recipe") from error
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, AmulettError):
            raise
        raise AmulettError(f"the study's settings are damaged: {error!r}") from error


def parse_space(content: Mapping[Any, Any], config: TrainConfig, path: str | Path) -> Space:
    """Return the search space that a file at `path` holds; errors as of `load_space`."""
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
        if isinstance(found, Range) and all(isinstance(end, int) for end in ends):  # 1e3 of an integer key
            space[str(key)] = Range(low=ends[0], high=ends[1], log=found.log)
    return space


def _valid(config: TrainConfig, key: str, value: Any, path: str | Path) -> Any:
    """Return a value of a space as the recipe reads it; refuse an invalid one."""
    try:
        content: Any = _changed(config, {key: value}).model_dump()
    except ValidationError as error:
        if any(one["loc"] for one in error.errors()):  # the value may be valid together with others
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
    report: Callable[[Trial, Trial | None], None] | None = None,
    places: Mapping[str, str] | None = None,
    workers: Workers = ALONE,
    batch: int = 1,
) -> list[Trial] | None:
    """Run the trials of a study, or continue it.

    Parameters
    ----------
    config : TrainConfig
        Recipe; the space's keys are changed in it.
    space : dict
        From `load_space`.
    trials : int
        Number of trials, including those of earlier calls.
    out : str or Path
        Folder of the study; made if it does not exist.
    seed : int
        Seed of the proposals.
    seeds : int
        Runs of each trial, with the recipe's seed and the following ones; the mean of their costs counts.
    command : sequence of str, optional
        Words of the command, which are stored with the study.
    progress : bool
        Show the runs' progress.
    report : callable, optional
        Called after each trial with it and the best one so far.
    places : mapping, optional
        The name of a bundle in the recipe or the space -> where it is now (`laws.copies.kept_policies`).
    workers : Workers
        They train the runs of the first `RANDOM_TRIALS` trials and of each batch; they change no result.
    batch : int
        Later trials that are proposed together, from the costs of those before the batch.

    Returns
    -------
    list of Trial or None
        All trials; None if Ctrl-C or SIGTERM ended the study.

    Raises
    ------
    AmulettError
        If `out` holds something else or another study, another process works in it, or the recipe has `max_seconds`,
        with which costs depend on the machine's speed.
    """
    if config.max_seconds is not None:
        raise AmulettError("max_seconds makes a trial's cost depend on the machine's speed; use total_steps for tuning")
    for name, value, least in (("trials", trials, 1), ("seeds", seeds, 1), ("seed", seed, 0), ("batch", batch, 1)):
        if value < least:
            raise AmulettError(f"{name} is {value}; it has to be at least {least}")
    out = user_path(out)
    with output_folder(out, "study", [[STUDY]]), locked_folder(out):
        kept = _begin(out, config, space, seed, seeds, batch, command, places)
        done: list[Trial] = []
        for numbers in _batches(trials, batch):
            proposed = [_Proposed(number, _propose(space, done, seed, number)) for number in numbers]
            try:
                for trial in _made(config, proposed, kept, out / RUNS, seeds, workers, progress):
                    done = sorted([*done, trial], key=lambda one: one.number)
                    write_json(out / TRIALS, [asdict(one) | {"cost": one.cost} for one in done])
                    best = best_of(done)
                    if best is not None:
                        write_text(out / BEST, to_yaml(_kept(_changed(config, best.changes), kept).model_dump()))
                    if report is not None:
                        report(trial, best)
            except KeyboardInterrupt:
                return None
    return done


def _batches(trials: int, batch: int) -> Iterator[range]:
    """Yield the numbers of the trials that know the same ones before them: first the random ones, which know none."""
    yield range(min(trials, RANDOM_TRIALS))
    for first in range(RANDOM_TRIALS, trials, batch):
        yield range(first, min(first + batch, trials))


def best_of(trials: Sequence[Trial]) -> Trial | None:
    """Return the trial with the lowest cost, the first of equal ones; None if all failed."""
    return min((trial for trial in trials if trial.costs), key=lambda trial: (trial.cost, trial.number), default=None)


def _begin(
    out: Path,
    config: TrainConfig,
    space: Space,
    seed: int,
    seeds: int,
    batch: int,
    command: Sequence[str] | None,
    places: Mapping[str, str] | None,
) -> dict[str, str]:
    """Write ``study.json``, or compare the study with the one that is there; return the places of its kept bundles."""
    earlier = read_json(out / STUDY, "study") if (out / STUDY).is_file() else {}
    if not isinstance(earlier, dict):
        raise AmulettError(f"'{out / STUDY}' is damaged: it holds no mapping")
    record, copies = earlier.get("kept", {}), None
    if not earlier or bool(record) != (out / FOLDER).is_dir():  # new, or killed before the bundles were written
        choices = space.get("network.start")
        starts = [config.network.start, *(choices.ends() if choices is not None else [])]
        copies = copy_policies([start for start in starts if start is not None], places)
        record = copies.record
    study = {
        "config": config.model_dump(),
        "space": {key: entry.model_dump() for key, entry in space.items()},
        "seed": seed,
        "seeds": seeds,
        "kept": record,
        "batch": batch,
    }
    if not earlier:
        write_json(out / STUDY, study)
    elif changed := differences({"kept": {}, "batch": 1} | earlier, json.loads(json.dumps(study))):
        raise AmulettError(
            f"'{out}' holds another study: {'; '.join(changed)}; continue that one, or choose another folder"
        )
    if copies is not None:
        copies.write(out)
    write_provenance(out, "tune", study, [seed, *(config.seed + k for k in range(seeds))], command)
    return kept_policies(out.resolve(), record)


def _propose(space: Space, done: Sequence[Trial], seed: int, number: int) -> dict[str, Any]:
    """Return the changes of a trial, from the seed, its number and the trials before it."""
    distributions = {key: entry.distribution() for key, entry in space.items()}
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    entropy = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    sampler = optuna.samplers.TPESampler(seed=entropy, n_startup_trials=RANDOM_TRIALS, constant_liar=False)
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


@dataclass
class _Proposed:
    """A trial before its runs are finished: their folders, each with the result as soon as it is there."""

    number: int
    changes: dict[str, Any]
    runs: dict[Path, TrainResult | None] = field(default_factory=dict)

    def trial(self) -> Trial | None:
        """Return the finished trial; None if a run is missing."""
        results = [result for result in self.runs.values() if result is not None]
        if len(results) < len(self.runs):
            return None
        for result in results:
            if result.diverged is not None:
                error = f"diverged after {result.diverged:,} steps, seed {result.seed}"
                return Trial(self.number, self.changes, [], error)
        return Trial(self.number, self.changes, [result.best_cost for result in results])


def _made(
    config: TrainConfig,
    proposed: Sequence[_Proposed],
    kept: Mapping[str, str],
    folder: Path,
    seeds: int,
    workers: Workers,
    progress: bool,
) -> Iterator[Trial]:
    """Yield each trial as it is finished; its runs are trained, resumed or read. Raises KeyboardInterrupt."""
    of: dict[Path, _Proposed] = {}
    for each in proposed:
        try:
            for k in range(seeds):
                recipe = _kept(_changed(config, {**each.changes, "seed": config.seed + k}), kept)
                run = folder / f"{each.number:04d}" / str(recipe.seed)
                if not (run / CONFIG).is_file():  # a process may have been killed in the folder before it wrote that
                    begin(recipe, run)
                each.runs[run] = None
        except ValidationError as error:
            yield Trial(each.number, each.changes, [], str(describe(error, TrainConfig, "recipe")))
        except RecipeError as error:
            yield Trial(each.number, each.changes, [], str(error))
        else:
            of |= dict.fromkeys(each.runs, each)
    numbers = [each.number for each in proposed]
    what = f"trial {numbers[0]}" if len(numbers) == 1 else f"trials {numbers[0]} to {numbers[-1]}"
    for run, result in resume_all([*of], workers, progress, what):
        of[run].runs[run] = result
        if (trial := of[run].trial()) is not None:
            yield trial


def _kept(config: TrainConfig, kept: Mapping[str, str]) -> TrainConfig:
    """Return a recipe that starts from the study's copy of its bundle."""
    start = kept.get(config.network.start or "")
    return config if start is None else starting_from(config, start)


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
