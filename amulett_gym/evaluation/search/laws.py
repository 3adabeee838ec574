"""Tune a law's parameters by differential evolution: searched on `train`, chosen on `validation`, never on `held-out`.

``python -m amulett_gym.evaluation.search.laws --law parametric --suite steps --out DIR`` tunes; ``--write`` puts the
result into the package, too. Each independent start is a *stage*: those finished in the folder are not repeated.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from amulett_gym import __version__
from amulett_gym.envs.action import TENSION_RANGE, tension_to_action
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.trials import Choose, Trials
from amulett_gym.laws.parametric import FORMAT, LAWS, TUNED, Device, Law
from amulett_gym.profile import load_profile
from amulett_gym.storage.kept import digest, kept
from amulett_gym.storage.writing import write_json

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """The settings of a tuning; the defaults gave the shipped parameters.

    Attributes
    ----------
    law, suite, profile : str
    seeds : tuple of int
        One for each independent start.
    population : int
        Candidates in a generation; 0: four, and two for each of the law's parameters.
    generations : tuple of (int, int)
        Stages of a start: the number of training scenarios, and of generations on them. The first, with few scenarios,
        finds the region; the others refine it.
    validation : int
        Validation scenarios, which choose among the starts.
    """

    law: str = "parametric"
    suite: str = "steps"
    profile: str = "testbed"
    seeds: tuple[int, ...] = (1, 2)
    population: int = 0
    generations: tuple[tuple[int, int], ...] = ((14, 40), (42, 20))
    validation: int = 200

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise unknown("law", self.law, LAWS)
        if not self.population:
            object.__setattr__(self, "population", 4 + 2 * len(LAWS[self.law].parameters))
        if self.population < 5:
            raise AmulettError(f"population is {self.population}; differential evolution needs at least 5")
        if not self.seeds or min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise AmulettError(f"seeds are {self.seeds}; they have to differ and to be at least 0")
        counts = [self.validation, *(number for stage in self.generations for number in stage)]
        if not self.generations or min(counts) < 1:
            raise AmulettError("generations and validation have to be at least 1 each")

    @property
    def episodes(self) -> int:
        """Simulated training episodes of all starts."""
        of_one = sum(scenarios * (1 + generations) for scenarios, generations in self.generations)
        return len(self.seeds) * self.population * of_one


Report = Callable[[str, Mapping[str, Any]], None]


def tune(folder: str | Path, recipe: Recipe, report: Report = lambda name, stage: None) -> dict[str, Any]:
    """Tune a law, write ``<profile>/<law>-<suite>.json`` with its ``stages/``, and return the file's content.

    The file is a contender. Its parameters are those of the start with the lowest cost on `validation`. `report` is
    called with the name and result of each finished start.

    Raises
    ------
    AmulettError
        If a name is unknown, or a file cannot be read or written.
    """
    place, name = Path(folder) / load_profile(recipe.profile).name, f"{recipe.law}-{recipe.suite}"
    most = max(scenarios for scenarios, _ in recipe.generations)
    train = Trials(_protocol(recipe, "train", most))
    validation = Trials(_protocol(recipe, "validation", recipe.validation))
    starts = {}
    for seed in recipe.seeds:
        inputs = _inputs(recipe, seed, train, validation)
        path = place / "stages" / f"{name}-{seed}.json"
        starts[seed] = kept(path, inputs, partial(search, recipe, seed, train, validation))
        report(f"{name}-{seed}", starts[seed])
    content = _content(recipe, starts, train, validation)
    write_json(place / f"{name}.json", content)
    return content


def search(recipe: Recipe, seed: int, train: Trials, validation: Trials) -> dict[str, Any]:
    """Return the result of a search from one start.

    Returns
    -------
    dict
        ``parameters`` (a list), the mean cost on ``train`` (all its scenarios) and ``validation``, and ``history``:
        pairs of the number of simulated episodes and the least cost found so far on the stage's own scenarios.
    """
    law = LAWS[recipe.law]
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(recipe.population, len(law.parameters)))
    points[0] = law.to_unit(law.start())
    best = points[0]
    history: list[list[float]] = []
    episodes = 0
    for scenarios, generations in recipe.generations:
        least = np.inf

        def value(columns: Values, scenarios: int = scenarios) -> Values:
            nonlocal episodes, least
            costs = mean_costs(law, law.from_unit(columns.T), train, np.arange(scenarios))
            episodes += costs.size * scenarios
            least = min(least, float(costs.min()))
            history.append([episodes, least])
            return costs

        bounds, batch = [(0.0, 1.0)] * len(law.parameters), {"vectorized": True, "updating": "deferred"}
        evolution = {"mutation": (0.4, 0.9), "recombination": 0.9, "tol": 0.0, "atol": 0.0, "polish": False}
        found = differential_evolution(value, bounds, init=points, seed=rng, maxiter=generations, **batch, **evolution)
        points, best = found.population, found.x
    vector = law.from_unit(best)

    def cost(trials: Trials) -> float:
        return float(mean_costs(law, vector[None], trials, np.arange(len(trials.rows)))[0])

    return {"parameters": vector.tolist(), "train": cost(train), "validation": cost(validation), "history": history}


def mean_costs(law: Law, vectors: Values, trials: Trials, scenarios: NDArray[np.int64]) -> Values:
    """Return the mean cost of each parameter vector, shape (candidates, parameters), over the scenarios."""
    candidates = len(vectors)
    each = np.repeat(vectors, scenarios.size, axis=0)
    costs = trials.play(np.tile(scenarios, candidates), following(law, each, trials)).sum(axis=0)
    return costs.reshape(candidates, scenarios.size).mean(axis=1)


def following(law: Law, vectors: Values, trials: Trials) -> Choose:
    """Return a law with parameters for each device, shape (N, parameters); one row is for all."""
    device = Device.of(trials.protocol.profile, trials.protocol.agent_period)

    def choose(step: int, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        tensions = law.tensions(observations, vectors, device, TENSION_RANGE)
        return tension_to_action(tensions, TENSION_RANGE).astype(np.float32)

    return choose


def _protocol(recipe: Recipe, split: str, episodes: int) -> Protocol:
    return Protocol(load_profile(recipe.profile), recipe.suite, split, episodes=episodes)


def _content(
    recipe: Recipe, starts: Mapping[int, Mapping[str, Any]], train: Trials, validation: Trials
) -> dict[str, Any]:
    law = LAWS[recipe.law]
    chosen = min(starts, key=lambda seed: starts[seed]["validation"])
    described = {}
    for parameter, value in zip(law.parameters, starts[chosen]["parameters"], strict=True):
        described[parameter.name] = {"value": value, "unit": parameter.unit, "meaning": parameter.meaning}
    return {
        "format": FORMAT,
        "version": 1,
        "parameters": described,
        "recipe": json.loads(json.dumps(asdict(recipe))),
        "chosen_seed": chosen,
        "training_episodes": recipe.episodes,
        "starts": {str(seed): {key: start[key] for key in ("train", "validation")} for seed, start in starts.items()},
        "sha256": {"train": train.digest(), "validation": validation.digest()},
        "versions": {"amulett-gym": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
    }


def _inputs(recipe: Recipe, seed: int, train: Trials, validation: Trials) -> dict[str, Any]:
    """Return all that a start's result depends on."""
    this = asdict(replace(recipe, seeds=(seed,)))
    law = [asdict(parameter) for parameter in LAWS[recipe.law].parameters]
    scenarios = [train.digest(), validation.digest()]
    long = {"recipe": this, "law": law, "scenarios": scenarios, "scipy": scipy.__version__}
    return {"recipe": this, "sha256": digest(long)}


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--law", nargs="+", default=list(LAWS), choices=list(LAWS))
    parser.add_argument("--suite", nargs="+", default=["steps"])
    parser.add_argument("--profile", default="testbed")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of results; its finished starts are reused")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(Recipe.seeds))
    parser.add_argument("--write", action="store_true", help="put the result into the package, too")
    arguments = parser.parse_args(argv)

    def report(name: str, start: Mapping[str, Any]) -> None:
        print(f"{name:28} train {start['train']:.4f}, validation {start['validation']:.4f}", flush=True)

    for suite in arguments.suite:
        for law in arguments.law:
            recipe = Recipe(law, suite, arguments.profile, tuple(arguments.seeds))
            content = tune(arguments.out, recipe, report)
            if arguments.write:
                with resources.as_file(resources.files("amulett_gym").joinpath(*TUNED)) as folder:
                    write_json(folder / arguments.profile / f"{law}-{suite}.json", content)


if __name__ == "__main__":
    main()
