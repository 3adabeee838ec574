"""The reward: minus what an agent step cost, in units of what eq. 6 pays for a whole episode.

The divisors are versioned data, frozen before any training: the mean cost of eq. 6 (`text`, inside the loop) over 400
training scenarios of 10 s. ``python -m amulett_gym.evaluation.divisors`` measures them again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

from amulett_gym.config import Profile
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.tasks.suites import CONTACT_SUITES

DEFAULT_WEIGHTS = {"position": 0.5, "effort": 0.45, "tension": 0.05, "contact": 0.0}
"""Weights of the reward's terms in suites in which nothing is touched."""

CONTACT_WEIGHTS = {"position": 0.35, "effort": 0.3, "tension": 0.05, "contact": 0.3}
"""Weights in suites with obstacles: a bump counts as much as the effort, and all of them sum to 1 as well."""

MOST_WEIGHT = 1e6

COST_TERMS = tuple(DEFAULT_WEIGHTS)
TERMS = (*COST_TERMS, "failure")

COST_CAP = 1.0
"""Most that one agent step can cost: a whole episode of eq. 6. It bounds what a failure has to cost."""


@cache
def _table() -> dict[str, dict[str, dict[str, float]]]:
    return json.loads((resources.files("amulett_gym") / "envs" / "divisors.json").read_text())["divisors"]


def divisors(profile: Profile, suite: str) -> dict[str, float]:
    """Return what eq. 6 pays per episode: position [deg2 s], effort [deg2/s], tension [N2 s], contact [N2 m2 s].

    An own profile is charged by the shipped profile that it is based on; one without a base by the testbed.
    """
    table = _table()
    return table[profile.root if profile.root in table else "testbed"][suite]


def default_weights(suite: str) -> dict[str, float]:
    """Return the weights that a suite's reward has unless others are asked for."""
    return dict(CONTACT_WEIGHTS if suite in CONTACT_SUITES else DEFAULT_WEIGHTS)


def check_weights(weights: Mapping[str, float] | None, suite: str = "steps") -> dict[str, float]:
    """Return all weights, the given ones in the place of the suite's defaults.

    Raises
    ------
    AmulettError
        If a name is unknown or a weight is no number from 0 to a million.
    """
    if weights is not None and not isinstance(weights, Mapping):
        raise AmulettError(f"reward_weights is {weights!r}; it has to be a mapping of term to weight")
    for name, weight in (weights or {}).items():
        if name not in DEFAULT_WEIGHTS:
            raise unknown("reward weight", str(name), DEFAULT_WEIGHTS)
        if not isinstance(weight, int | float) or isinstance(weight, bool) or not 0 <= weight <= MOST_WEIGHT:
            raise AmulettError(f"reward weight '{name}' is {weight!r}; it has to be a number from 0 to {MOST_WEIGHT:g}")
    return {**default_weights(suite), **(weights or {})}
