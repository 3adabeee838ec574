"""What a comparison reports about an episode: names, units, and the cost that ranks contenders."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.reward import COST_CAP, COST_TERMS

UNITS = {
    "cost": "1",
    "cost_position": "1",
    "cost_effort": "1",
    "cost_tension": "1",
    "cost_contact": "1",
    "cost_failure": "1",
    "return": "1",
    "failed": "1",
    "effort": "deg2/s",
    "position_ise": "deg2 s",
    "tension_ise": "N2 s",
    "isav_biceps": "deg2/s",
    "isav_triceps": "deg2/s",
    "iav_biceps": "deg",
    "iav_triceps": "deg",
    "rise_time": "s",
    "settling_time": "s",
    "overshoot": "deg",
    "tension_ise_estimated": "N2 s",
    "isav_kick": "deg2/s",
    "effort_biceps": "deg2/s",
    "effort_triceps": "deg2/s",
    "contact_ise": "N2 m2 s",
    "contact_peak": "N m",
    "push_deflection": "deg",
    "resting_stiffness": "N m/rad",
    "setpoint_steps": "1",
    "steps_risen": "1",
    "steps_settled": "1",
    "agonist_switches": "1",
}
"""Unit of each reported metric, in the order of reports; "1" is dimensionless. `effort` is that of both drives."""

COSTS = ("position", "effort", "tension", "contact", "failure")
"""Terms of the cost; ``"cost_" + term`` is reported for each."""

Values = NDArray[np.float64]


def derive(raw: Mapping[str, Values], charge: Values, prices: Values) -> dict[str, Values]:
    """Add what follows from raw metrics: the cost with its terms, whether the device failed, both drives' effort.

    The cost is the sum of each raw metric times its price: its weight over what eq. 6 pays for it, both of the
    scenario's family. Neither shaped nor capped, unlike the reward: a contender is ranked by what it did.

    Parameters
    ----------
    raw : mapping of str to ndarray
        Final values of ``info["metrics"]``.
    charge : ndarray
        `failure_cost` of the devices that failed, 0 for the others.
    prices : ndarray, shape (N, len(COST_TERMS))
        Of each scenario: `envs.reward.prices` of its family.

    Returns
    -------
    dict of str to ndarray
        `raw` and the derived metrics: all of `UNITS` but ``return``.
    """
    effort = raw["effort_biceps"] + raw["effort_triceps"]
    terms = {
        "position": raw["position_ise"],
        "effort": effort,
        "tension": raw["tension_ise"],
        "contact": raw["contact_ise"],
    }
    costs = {f"cost_{term}": prices[:, k] * terms[term] for k, term in enumerate(COST_TERMS)}
    costs["cost_failure"] = charge
    failed = np.asarray(charge > 0.0, dtype=np.float64)
    return {"cost": np.sum(list(costs.values()), axis=0), **costs, "failed": failed, "effort": effort, **raw}


def failure_cost(time: float, duration: float, agent_period: float) -> float:
    """Return what a device that failed at `time` [s] is charged, as by the reward: `COST_CAP` for each step left.

    Its other metrics stay what they were when it failed, and would flatter it.

    Parameters
    ----------
    time, duration, agent_period : float
        When it failed, how long the episode would have been, and the length of a step [s]. The step is that of the
        comparison, not of the contender, so that all contenders are charged alike.
    """
    steps_done = math.floor(time / agent_period + 1e-9)
    return COST_CAP * max(round(duration / agent_period) - steps_done, 1)
