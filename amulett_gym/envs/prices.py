"""Divisors of the costs, and prices: weight over divisor.

The divisors are the mean costs of eq. 6 (`text`, in the paper's loop) on the device over 400 training scenarios of
10 s, or about 400 per family. Those of the shipped profiles are versioned data, fixed before any training; ``python -m
amulett_gym.evaluation.divisors`` measures them again. Those of other devices are measured when they are first needed
(see `envs.eq6_costs`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.envs.eq6_costs import Eq6Costs, eq6_costs, shipped_costs
from amulett_gym.envs.reward import COST_TERMS, SCHEDULE, Track, default_weights
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.tasks.suites import families_of


def divisors(profile: Profile, suite: str, family: str | None = None, track: Track = SCHEDULE) -> dict[str, float]:
    """Return eq. 6's mean costs of an episode: position [deg2 s], effort [deg2/s], tension [N2 s], contact [N2 m2 s].

    On the track *full control* the effort is that of the drives' own motion.

    Parameters
    ----------
    profile : Profile
        The device with the gains of the paper's loop. One that is not shipped is measured, once.
    suite : str
    family : str, optional
        Family of a scenario: as the mixed suite draws it, or else as the family's own suite does. None: any scenario of
        the suite.
    """
    costs = _costs(profile, suite, family)
    found = {term: costs[term] for term in COST_TERMS}
    return found if track == SCHEDULE else {**found, "effort": costs["drive_effort"]}


def _costs(profile: Profile, suite: str, family: str | None) -> dict[str, float]:
    in_mixed = suite == "mixed" and family in families_of("mixed")
    drawn = suite if in_mixed else family or suite
    measured = _measured(profile, drawn)
    if measured is not None:
        return (measured.families[str(family)] if in_mixed else measured.mean).model_dump()
    frozen, owner = _frozen(), _frozen_owner(profile)
    return dict(frozen["divisors_in_mixed"][owner][family] if in_mixed else frozen["divisors"][owner][drawn])


def divisors_owner(profile: Profile, suite: str) -> str:
    """Return the name of the device whose divisors a profile has in a suite.

    It is a shipped profile's if the profile describes the same device, else its own. Where eq. 6 cannot play on the
    device (`eq6_costs.measure`), it is that of the shipped profile that it is based on.
    """
    return _frozen_owner(profile) if _measured(profile, suite) is None else profile.name


def divisors_are(profile: Profile, suite: str) -> Literal["frozen", "measured"]:
    """Return whether the divisors of a profile in a suite are those frozen with a shipped profile, or measured.

    Those of the shipped fleets' devices are measured, too, though not again.
    """
    return "frozen" if _measured(profile, suite) is None else "measured"


def _measured(profile: Profile, suite: str) -> Eq6Costs | None:
    return eq6_costs(profile, suite) if shipped_costs(profile) is None else None


def _frozen_owner(profile: Profile) -> str:
    return shipped_costs(profile) or (profile.root if profile.root in _frozen()["divisors"] else "testbed")


def prices(
    profile: Profile,
    suite: str,
    weights: Mapping[str, float] | None = None,
    track: Track = SCHEDULE,
    families: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Return weight / divisor of each family and cost term in an environment of a suite.

    Parameters
    ----------
    profile, suite, track
        As of `divisors`.
    weights : mapping, optional
        They replace the families' default weights (`default_weights`).
    families : array of int, shape (N,), optional
        Indices into `simulation.layout.FAMILIES`, one for each row; by default all, in order. Only these need divisors.

    Returns
    -------
    ndarray, shape (N, len(COST_TERMS))
        Per deg2 s, deg2/s, N2 s and N2 m2 s.
    """
    rows = np.arange(len(FAMILIES)) if families is None else np.asarray(families)
    table = np.full((len(FAMILIES), len(COST_TERMS)), np.nan)
    for index in np.unique(rows):
        family = FAMILIES[index]
        weighed = {**default_weights(family or suite, track), **(weights or {})}
        divisor = divisors(profile, suite, family, track)
        table[index] = [weighed[term] / divisor[term] for term in COST_TERMS]
    return table[rows]


@cache
def _frozen() -> dict[str, Any]:
    return dict(json.loads((resources.files("amulett_gym") / "envs" / "divisors.json").read_text()))
