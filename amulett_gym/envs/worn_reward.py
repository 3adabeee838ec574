"""The reward of worn devices: minus the cost of an agent step, in units of the same wearers' cost without the device.

The divisors are the mean costs of an episode of 10 s, over 400 training episodes of the suite in which the arm is
outside the exoskeleton: a relaxed one, which no device guides, does not move. They are versioned data, fixed before any
training; ``python -m amulett_gym.evaluation.doffed`` measures them again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.reward import check_weights
from amulett_gym.profile import Profile

WORN_WEIGHTS = {"muscle": 0.5, "tracking": 0.3, "cuff": 0.2, "drives": 0.001}
"""Default weights of the reward's terms."""

WORN_TERMS = (*WORN_WEIGHTS, "failure")

DOFFED_SECONDS = 10.0
"""Length of the episodes of which the divisors are costs [s]."""

DOFFED = "doffed.json"
"""File with the frozen costs without the device."""


def check_worn_weights(weights: dict[str, float]) -> dict[str, float]:
    """Return the weights; errors as of `reward.check_weights`."""
    return check_weights(weights, WORN_WEIGHTS)


def doffed_costs(suite: str) -> dict[str, float]:
    """Return the mean costs of an episode without the device.

    Returns
    -------
    dict
        muscle [s], tracking [deg2 s], cuff [N2 m2 s], intention [deg2/s]: the square of the intention's rate.
    """
    return dict(_frozen()[suite])


def worn_divisors(profile: Profile, suite: str) -> dict[str, float]:
    """Return the divisors of the costs: muscle [s], tracking [deg2 s], cuff [N2 m2 s], drives [deg2/s].

    All but the last are the same for all devices. `drives` is the cost of drives that follow the intention in the suite
    assembly exactly, since in a suite of slow movements the sensors' noise is all that drives turn by: both turn by
    R_2 / R_1 of it.
    """
    found = doffed_costs(suite)
    ratio = profile.plant.joint_pulley_radius / profile.plant.drive_pulley_radius
    drives = 2.0 * ratio**2 * doffed_costs("assembly")["intention"]
    return {**{name: cost for name, cost in found.items() if name != "intention"}, "drives": drives}


def worn_prices(profile: Profile, suite: str, weights: Mapping[str, float] | None = None) -> NDArray[np.float64]:
    """Return weight / divisor of each term of `WORN_WEIGHTS`, shape (4,); `weights` replace the default ones."""
    divisors = worn_divisors(profile, suite)
    weighed = {**WORN_WEIGHTS, **(weights or {})}
    return np.array([weighed[term] / divisors[term] for term in WORN_WEIGHTS])


def doffed_cost(weights: Mapping[str, float] | None = None) -> float:
    """Return the mean cost of an episode of `DOFFED_SECONDS` without the device, 0.8 with the default weights.

    `weights` replace the default ones, as in `worn_prices`. Muscles and tracking cost 1 in units of their divisors;
    without the device there are neither cuff nor drives.
    """
    weighed = {**WORN_WEIGHTS, **(weights or {})}
    return weighed["muscle"] + weighed["tracking"]


@cache
def _frozen() -> dict[str, dict[str, float]]:
    content = json.loads((resources.files("amulett_gym") / "envs" / DOFFED).read_text("utf-8"))
    return dict(content["suites"])
