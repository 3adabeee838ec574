"""One search for a law's parameters or for gains, by differential evolution, kept generation by generation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, differential_evolution

from amulett_gym.envs.action import tension_to_action
from amulett_gym.envs.reward import SCHEDULE, Track
from amulett_gym.evaluation.search.gains import SHAPE, Gains
from amulett_gym.evaluation.search.law_recipe import Recipe, file_name
from amulett_gym.evaluation.search.trials import Choose, Trials, held
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.parametric import Device, Law
from amulett_gym.settings import to_plain
from amulett_gym.storage.kept import digest, read_kept, write_kept
from amulett_gym.workers import report

Values = NDArray[np.float64]


@dataclass
class Start:
    """One independent search, kept in a file: its result, or the costs of its generations until then."""

    folder: str | Path
    recipe: Recipe
    seed: int
    train: Trials
    validation: Trials
    known: list[list[float]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.path = Path(self.folder) / self.file
        self.inputs = _inputs(self.recipe, self.seed, self.train, self.validation)
        found = read_kept(self.path, self.inputs)
        if isinstance(found, dict) and "parameters" in found:
            self.result = found
        elif isinstance(found, dict) and _fits(found.get("costs"), self.recipe):
            self.known = found["costs"]

    @property
    def file(self) -> str:
        """Name of the start's file in the folder."""
        return f"stages/{file_name(self.recipe)}-{self.seed}.json"

    @property
    def done(self) -> int:
        """Episodes that were simulated until now."""
        if self.result:
            return (self.recipe.episodes + self.recipe.judging) // len(self.recipe.seeds)
        return sum(self.recipe.calls()[: len(self.known)])

    def finish(self, advance: Callable[[int], object]) -> dict[str, Any]:
        """Search on, keep every generation, and return the result; `advance` is called with simulated episodes."""

        def keep(costs: Values) -> None:
            advance(self.recipe.calls()[len(self.known)])
            self.known.append(costs.tolist())
            write_kept(self.path, self.inputs, {"costs": self.known})
            report.keep()

        self.result = search(self.recipe, self.seed, self.train, self.validation, tuple(self.known), keep)
        advance(self.recipe.judging // len(self.recipe.seeds))
        write_kept(self.path, self.inputs, self.result)
        report.keep()
        return self.result


def _fits(costs: Any, recipe: Recipe) -> bool:
    """Return whether kept costs are those of generations."""
    try:
        return np.shape(costs)[1:] == (recipe.population,) and bool(np.isfinite(costs).all())
    except (TypeError, ValueError):
        return False


def search(
    recipe: Recipe,
    seed: int,
    train: Trials,
    validation: Trials,
    known: Sequence[Sequence[float]] = (),
    keep: Callable[[Values], object] = lambda costs: None,
) -> dict[str, Any]:
    """Return the result of a search from one start.

    Parameters
    ----------
    known : sequence
        Costs of the first generations from an earlier run of the same search; they are not simulated again.
    keep : callable
        Called with the costs of each generation that was simulated.

    Returns
    -------
    dict
        ``parameters`` (a list), the mean cost on ``train`` (all its scenarios) and ``validation``, and ``history``:
        pairs of the number of simulated episodes and the least cost found so far on the stage's own scenarios. For
        gains with a reference motion also ``reference``, its shape, and ``reached``: the least cost in each shape when
        it was chosen, on the first stage's scenarios.
    """
    law = recipe.space()
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(recipe.population, len(law.parameters)))
    points[0] = law.to_unit(law.start())
    history: list[list[float]] = []
    episodes = 0

    def evolve(law: Law | Gains, points: Values, scenarios: int, generations: int) -> OptimizeResult:
        least = np.inf

        def value(columns: Values) -> Values:
            nonlocal episodes, least
            if len(history) < len(known):
                costs = np.array(known[len(history)])
            else:
                costs = mean_costs(law, law.from_unit(columns.T), train, np.arange(scenarios), recipe.cost_track)
                keep(costs)
            episodes += costs.size * scenarios
            least = min(least, float(costs.min()))
            history.append([episodes, least])
            return costs

        bounds, batch = [(0.0, 1.0)] * len(law.parameters), {"vectorized": True, "updating": "deferred"}
        evolution = {"mutation": (0.4, 0.9), "recombination": 0.9, "tol": 0.0, "atol": 0.0, "polish": False}
        how = {**batch, **evolution, "maxiter": generations}
        return differential_evolution(value, bounds, init=points, seed=rng, **how)

    shapes, tries, stages = recipe.stages()
    reached: dict[str, float] = {}
    if isinstance(law, Gains) and tries:
        spaces = [replace(law, reference=shape) for shape in shapes]
        found = [evolve(space, points, *tries) for space in spaces]
        reached = {shape: float(one.fun) for shape, one in zip(shapes, found, strict=True)}
        chosen = int(np.argmin(list(reached.values())))
        law, points, best = spaces[chosen], found[chosen].population, found[chosen].x
    for scenarios, generations in stages:
        last = evolve(law, points, scenarios, generations)
        points, best = last.population, last.x
    vector = law.from_unit(best)

    def cost(trials: Trials) -> float:
        return float(mean_costs(law, vector[None], trials, np.arange(len(trials.rows)), recipe.cost_track)[0])

    result = {"parameters": vector.tolist(), "train": cost(train), "validation": cost(validation), "history": history}
    return {**result, **({SHAPE: law.reference, "reached": reached} if isinstance(law, Gains) and reached else {})}


def mean_costs(
    space: Law | Gains, vectors: Values, trials: Trials, scenarios: NDArray[np.int64], track: Track = SCHEDULE
) -> Values:
    """Return the mean cost on a track of each parameter vector, shape (candidates, parameters), over the scenarios."""
    if isinstance(space, Gains):  # all devices of a batch share their gains
        tensions = [held(np.full(scenarios.size, vector[-1]), trials.tension_range) for vector in vectors]
        devices = [space.profile(trials.protocol.profile, vector) for vector in vectors]
        pairs = zip(tensions, devices, strict=True)
        return np.array([trials.costs(scenarios, *each, track).mean() for each in pairs])
    candidates = len(vectors)
    each, rows = np.repeat(vectors, scenarios.size, axis=0), np.tile(scenarios, candidates)
    found = trials.costs(rows, following(space, each, trials, rows), track=track)
    return found.reshape(candidates, scenarios.size).mean(axis=1)


def following(law: Law, vectors: Values, trials: Trials, scenarios: NDArray[np.int64] | None = None) -> Choose:
    """Return a law with parameters for each episode, shape (N, parameters); one row is for all.

    `scenarios` are those that are played, shape (N,); only a fleet needs them.
    """
    which = np.zeros(1, dtype=np.int64) if scenarios is None else trials.which[scenarios]
    device = Device.of_each(trials.profiles, which, trials.protocol.agent_period)

    def choose(step: int, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        tensions = law.tensions(observations, vectors, device, trials.tension_range)
        return tension_to_action(tensions, trials.tension_range).astype(np.float32)

    return choose


def described_recipe(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as plain data without what is None, as in older files."""
    return {key: value for key, value in to_plain(asdict(recipe)).items() if value is not None}


def _inputs(recipe: Recipe, seed: int, train: Trials, validation: Trials) -> dict[str, Any]:
    """Return all that a start's result depends on."""
    this = described_recipe(replace(recipe, seeds=(seed,)))
    for key in {"profile", "fleet", "choose_fleet"} & this.keys():  # their content is part of the scenarios' digests
        this[key] = recipe.device().name if key == "profile" else _fleet_name(this[key])
    law = [asdict(parameter) for parameter in recipe.space().parameters]
    scenarios = [train.digest(), validation.digest()]
    long = {"recipe": this, "law": law, "scenarios": scenarios, "scipy": scipy.__version__}
    if shapes := recipe.stages()[0]:
        long["shapes"] = shapes
    return {"recipe": this, "sha256": digest(long)}


def _fleet_name(fleet: str | list[Any]) -> str | list[str]:
    return fleet if isinstance(fleet, str) else [profile.name for profile in load_fleet(fleet)]
