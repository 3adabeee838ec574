"""The reward: minus what an agent step cost, in units of what eq. 6 pays for a whole episode of the same family.

What families cost differs by a factor of 100 and more: holding against pushes is cheap beside stepping. So each
scenario of a mix, too, is charged by its own family, and all of them count alike.

The divisors are versioned data, frozen before any training: the mean cost of eq. 6 (`text`, inside the loop) over 400
training scenarios of 10 s, or about 400 a family. ``python -m amulett_gym.evaluation.divisors`` measures them again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.tasks.suites import CONTACT_SUITES

DEFAULT_WEIGHTS = {"position": 0.5, "effort": 0.45, "tension": 0.05, "contact": 0.0}
"""Weights of the reward's terms where nothing is touched."""

CONTACT_WEIGHTS = {"position": 0.35, "effort": 0.3, "tension": 0.05, "contact": 0.3}
"""Weights where there are obstacles: a bump counts as much as the effort, and all of them sum to 1 as well."""

MOST_WEIGHT = 1e6

COST_TERMS = tuple(DEFAULT_WEIGHTS)
TERMS = (*COST_TERMS, "failure")

COST_CAP = 1.0
"""Most that one agent step can cost: a whole episode of eq. 6. It bounds what a failure has to cost."""


@cache
def _frozen() -> dict[str, Any]:
    content: dict[str, Any] = json.loads((resources.files("amulett_gym") / "envs" / "divisors.json").read_text())
    return content


def divisors(profile: Profile, suite: str, family: str | None = None) -> dict[str, float]:
    """Return what eq. 6 pays per episode: position [deg2 s], effort [deg2/s], tension [N2 s], contact [N2 m2 s].

    An own profile is charged by the shipped profile that it is based on; one without a base by the testbed.

    Parameters
    ----------
    profile : Profile
    suite : str
    family : str, optional
        For a scenario of that family: as the mixed suite draws it, or else as the family's own suite does. None: for
        any scenario of the suite.
    """
    by_suite, owner = _frozen()["divisors"], divisors_owner(profile)
    in_mixed: dict[str, dict[str, float]] = _frozen()["divisors_in_mixed"][owner]
    if suite == "mixed" and family in in_mixed:
        return in_mixed[family]
    found: dict[str, float] = by_suite[owner][family or suite]
    return found


def divisors_owner(profile: Profile) -> str:
    """Return the name of the shipped profile whose divisors charge a profile."""
    return profile.root if profile.root in _frozen()["divisors"] else "testbed"


def default_weights(suite: str) -> dict[str, float]:
    """Return the weights that the reward of a suite or family has unless others are asked for."""
    return dict(CONTACT_WEIGHTS if suite in CONTACT_SUITES else DEFAULT_WEIGHTS)


def prices(profile: Profile, suite: str, weights: Mapping[str, float] | None = None) -> NDArray[np.float64]:
    """Return what a unit of each cost term takes off the reward in an environment of a suite: weight / divisor.

    Parameters
    ----------
    profile : Profile
    suite : str
    weights : mapping of str to float, optional
        In the place of the families' default weights.

    Returns
    -------
    ndarray, shape (len(FAMILIES), len(COST_TERMS))
        One row for each of `simulation.layout.FAMILIES`; per deg2 s, deg2/s, N2 s and N2 m2 s.

    Raises
    ------
    AmulettError
        If a weight is wrong.
    """
    check_weights(weights)
    table = np.empty((len(FAMILIES), len(COST_TERMS)))
    for row, family in zip(table, FAMILIES, strict=True):
        weighed, paid = {**default_weights(family or suite), **(weights or {})}, divisors(profile, suite, family)
        row[:] = [weighed[term] / paid[term] for term in COST_TERMS]
    return table


def check_weights(weights: Mapping[str, float] | None) -> None:
    """Refuse weights that no reward can have.

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
