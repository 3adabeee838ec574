"""The benchmark's searched references: the best schedules with the future known, kept once found."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import ENV_IDS
from amulett_gym.envs.reward import Track
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol, Run, play_alone
from amulett_gym.evaluation.search.clairvoyant import Effort, Reference, clairvoyant, replay
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.laws.contenders import Own, parse_contender
from amulett_gym.simulation.layout import Control
from amulett_gym.studies.benchmark.description import Benchmark, loop_of, named
from amulett_gym.workers.call import ALONE, Workers

CLAIRVOYANT, CHECK, FORESIGHT = "clairvoyant", "clairvoyant-check", "foresight"
MOST_THREADS = 4

BLOCK = 10
"""Scenarios that are searched at once; an interruption loses at most these."""

REDRAWS, FIRST_REDRAW = 40, 1000
"""Number and first key of the noise draws by which schedules are judged again; no search uses them."""


@dataclass(frozen=True)
class Searched:
    """The result of the search on a suite.

    `run` has the metrics of the best schedules, as contenders have. `evidence` is plain data: the mean cost by episodes
    tried, the cost of each start alone, the cost of the schedules with other noise, and the gain of a second search
    with twice as many rounds and another seed. `foresight` is the same for schedules found without the scenarios' own
    noise.
    """

    run: Run
    evidence: dict[str, Any]
    foresight: Searched | None = None


@dataclass(frozen=True)
class Place:
    """The control loop and the track of a search, and the laws from which it starts."""

    loop: Control
    track: Track
    starts: tuple[str, ...]


def protocols(description: Benchmark, protocol: Protocol) -> dict[str, Protocol]:
    """Return by suite the protocol under which its first held-out scenarios are searched."""
    there = replace(protocol, split="held-out", env_id=ENV_IDS[1])
    counts = description.clairvoyant.scenarios
    return {suite: replace(there, suite=suite, episodes=count) for suite, count in counts.items()}


def check_starts(description: Benchmark) -> None:
    """Refuse starts that have no schedule.

    Raises AmulettError if one is unknown, or acts inside the loop.
    """
    for name in description.clairvoyant.starts:
        if parse_contender(name).policy_name is None:
            raise AmulettError(f"clairvoyant.starts names '{name}', which acts inside the loop and has no schedule")


def place(evidence: Any) -> Place:
    """Return where schedules are searched: in the loop of the best constant, from its laws of the named starts.

    Parameters
    ----------
    evidence : stages.Evidence
    """
    description, loop = evidence.description, loop_of(evidence.best_constant())
    starts = []
    for name in description.clairvoyant.starts:
        entry = evidence.entries.get(named(loop, name))
        starts.append(name if entry is None else entry.members[0].policy_name)
    return Place(loop, description.track, tuple(starts))


def rounds(description: Benchmark) -> int:
    """Return the number of rounds of all searches together."""
    settings, effort = description.clairvoyant, _effort(description)
    headline = settings.scenarios.get(description.headline, 0)
    searches = [(count, effort) for count in settings.scenarios.values()]
    searches += [(min(settings.check, headline), _longer(effort, 2.0)), (headline if settings.draws else 0, effort)]
    return sum(-(-count // BLOCK) * effort.rounds for count, effort in searches)


def search(
    description: Benchmark,
    protocol: Protocol,
    folder: Path,
    report: Callable[[int, str], object],
    place: Place,
    workers: Workers = ALONE,
) -> Searched:
    """Search for the best schedules of a suite's first held-out scenarios, or read those found before.

    Parameters
    ----------
    protocol : Protocol
        From `protocols`.
    folder : Path
        Of the benchmark.
    report : callable
        Called with a number of finished rounds, and the label of the search.
    place : Place
    workers : Workers

    Raises
    ------
    AmulettError
        If a file is damaged.
    """
    settings, effort = description.clairvoyant, _effort(description)
    threads = min(os.cpu_count() or 1, MOST_THREADS)
    there = partial(Trials, control=place.loop, track=place.track, threads=threads)
    trials = there(protocol)
    others = trials.redrawn(REDRAWS, FIRST_REDRAW)

    def find(what: str, trials: Trials, effort: Effort) -> Reference:
        label = f"{what} on {protocol.suite}"
        starts, kept = place.starts, folder / what
        return clairvoyant(trials, effort, starts, kept, BLOCK, lambda rounds: report(rounds, label), workers)

    def judged(actions: NDArray[np.float32]) -> Run:
        return play_alone(
            protocol, Own("schedules", {"control": place.loop, "track": place.track}, act=_Schedules(actions))
        )

    found = find(CLAIRVOYANT, trials, effort)
    evidence = _evidence(found, others)
    if protocol.suite != description.headline:
        return Searched(judged(found.actions), evidence)
    count = min(settings.check, protocol.episodes)
    if count:
        first = found.costs[:count]
        few = there(replace(protocol, episodes=count))
        again = find(CHECK, few, replace(_longer(effort, 2.0), seed=effort.seed + 1))
        evidence["second_search"] = {
            "scenarios": count,
            "ratio": float(again.costs.mean() / first.mean()),
            "either": float(np.minimum(again.costs, first).mean() / first.mean()),
        }
    foresight = None
    if settings.draws:
        foreseen = find(FORESIGHT, trials.redrawn(settings.draws), effort)
        foresight = Searched(judged(foreseen.actions), _evidence(foreseen, others))
    return Searched(judged(found.actions), evidence, foresight)


class _Schedules:
    """Plays a schedule of its own with each scenario."""

    def __init__(self, actions: NDArray[np.float32]) -> None:
        self._actions, self._step = actions, 0

    def reset(self, count: int) -> None:
        self._step = 0

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        self._step += 1
        return self._actions[:, self._step - 1, None]


def _effort(description: Benchmark) -> Effort:
    return _longer(Effort(), description.clairvoyant.effort)


def _longer(effort: Effort, factor: float) -> Effort:
    stages = tuple(replace(stage, rounds=max(round(factor * stage.rounds), 1)) for stage in effort.stages)
    return replace(effort, stages=stages)


def _evidence(found: Reference, others: Trials) -> dict[str, Any]:
    curve = found.curve
    rows = curve[np.unique(np.linspace(0, len(curve) - 1, 25).astype(int))]
    late = float(np.interp(0.75 * curve[-1, 0], curve[:, 0], curve[:, 1]))
    return {
        "scenarios": int(found.costs.size),
        "curve": [[round(float(episodes)), float(cost)] for episodes, cost in rows],
        "last_quarter": float(1.0 - curve[-1, 1] / late),
        "best_start": float(np.min(list(found.starts.values()), axis=0).mean()),
        "searches_alone": [float(costs.mean()) for costs in found.restarts],
        "mean_cost": float(found.costs.mean()),
        "with_other_noise": float(replay(others, found.actions).mean()),
    }
