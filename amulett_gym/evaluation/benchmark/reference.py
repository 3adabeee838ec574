"""The clairvoyant reference of a benchmark: searched once, kept, judged as contenders are, and doubted once more."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import ENV_IDS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.benchmark.description import Benchmark
from amulett_gym.evaluation.clairvoyant import Effort, Reference, clairvoyant
from amulett_gym.evaluation.rollout import Trials
from amulett_gym.evaluation.runner import Own, Protocol, Run, play_alone
from amulett_gym.laws.contenders import parse_contender

FOLDER, CHECK = "clairvoyant", "clairvoyant-check"
MOST_THREADS = 4

BLOCK = 10
"""Scenarios that are searched at once: what a kill can lose."""


@dataclass(frozen=True)
class Searched:
    """What the search found on a suite.

    Attributes
    ----------
    run : Run
        What the best schedules do, by physical metrics as contenders are judged.
    evidence : dict
        Plain data: how the mean cost fell with the episodes tried, what each start alone came to, and what a search of
        twice as many rounds from another seed still found.
    """

    run: Run
    evidence: dict[str, Any]


def protocols(description: Benchmark, protocol: Protocol) -> dict[str, Protocol]:
    """Return by suite under which protocol its first held-out scenarios are searched."""
    counts = description.clairvoyant.scenarios
    return {
        suite: replace(protocol, suite=suite, split="held-out", episodes=count, env_id=ENV_IDS[1])
        for suite, count in counts.items()
    }


def check_starts(description: Benchmark) -> None:
    """Refuse starts that have no schedule, before anything is done.

    Raises
    ------
    AmulettError
        If one is unknown, or acts inside the loop.
    """
    for name in description.clairvoyant.starts:
        if parse_contender(name).policy_name is None:
            raise AmulettError(f"clairvoyant.starts names '{name}', which acts inside the loop and has no schedule")


def blocks(description: Benchmark) -> int:
    """Return how many blocks of scenarios are searched, the second search's among them."""
    settings = description.clairvoyant
    blocks = sum(-(-count // BLOCK) for count in settings.scenarios.values())
    return blocks + bool(settings.check and description.headline in settings.scenarios)


def search(
    description: Benchmark, protocol: Protocol, folder: Path, advance: Callable[[str], Any] = lambda what: None
) -> Searched:
    """Search for the best schedules of a suite's first held-out scenarios, or read what was found.

    Parameters
    ----------
    description : Benchmark
    protocol : Protocol
        From `protocols`.
    folder : Path
        Of the benchmark.
    advance : callable
        Called with the suite's name after every block of scenarios.

    Raises
    ------
    AmulettError
        If a file is damaged.
    """
    settings = description.clairvoyant
    effort = _effort(settings.effort)
    threads = min(os.cpu_count() or 1, MOST_THREADS)
    trials = Trials(protocol, threads=threads)

    def find() -> tuple[Reference, Run]:
        found = clairvoyant(
            trials, effort, settings.starts, folder / FOLDER, BLOCK, lambda done, count: advance(protocol.suite)
        )
        return found, play_alone(protocol, Own("clairvoyant", act=_Schedules(found.actions)))

    found, run = find()
    if not np.allclose(-run.values["return"], found.costs, rtol=1e-9):
        # They no longer cost what they did: another version of the simulation found them.
        for stale in (FOLDER, CHECK):
            for path in (folder / stale / protocol.profile.name).glob(f"{protocol.suite}-{protocol.split}-*.npz"):
                path.unlink()
        found, run = find()
    evidence = _evidence(found)
    count = min(settings.check, protocol.episodes)
    if count and protocol.suite == description.headline:
        deeper = replace(effort, seed=effort.seed + 1, stages=tuple(_longer(stage, 2.0) for stage in effort.stages))
        again = clairvoyant(
            Trials(replace(protocol, episodes=count), threads=threads),
            deeper,
            settings.starts,
            folder / CHECK,
            count,
        )
        advance(protocol.suite)
        first = found.costs[:count].mean()
        evidence["second_search"] = {
            "scenarios": count,
            "ratio": float(again.costs.mean() / first),
            "either": float(np.minimum(again.costs, found.costs[:count]).mean() / first),
        }
    return Searched(run, evidence)


class _Schedules:
    """Plays a schedule of its own with each scenario."""

    def __init__(self, actions: NDArray[np.float32]) -> None:
        self._actions, self._step = actions, 0

    def reset(self, count: int) -> None:
        self._step = 0

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        self._step += 1
        return self._actions[:, self._step - 1, None]


def _effort(factor: float) -> Effort:
    effort = Effort()
    return replace(effort, stages=tuple(_longer(stage, factor) for stage in effort.stages))


def _longer(stage: Any, factor: float) -> Any:
    return replace(stage, rounds=max(round(factor * stage.rounds), 1))


def _evidence(found: Reference) -> dict[str, Any]:
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
    }
