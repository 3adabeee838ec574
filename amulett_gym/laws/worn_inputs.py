"""What a network in `Amulett/Worn-v0` sees besides what it sees in the other environments: the wearer, by the cuff.

The wearer's intention is not measured. It shows in the cuff's torque, in its rate, and in whether the arm moves with
the torque or against it. Features are smooth steps of some widths, as in `laws.features`; means over the episode, as in
`laws.memory`, show who wears the device, and how much the person pushes at present.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import CUFF_RATE_SCALE, CUFF_SCALE
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS

Values = NDArray[np.floating[Any]]

WORN_SCALES = {**OBSERVATION_SCALES, "measured_cuff": CUFF_SCALE, "cuff_rate": CUFF_RATE_SCALE}
"""What an entry of 1 stands for, where that is not 1 [rad, rad/s, s, N, N m, N m/s]."""

WORN_ACTIONS = ("tension", "assistance")
"""Names of the action's entries, in order."""

CUFF, CUFF_RATE, ASSISTANCE = range(len(OBSERVATIONS), len(WORN_OBSERVATIONS))
"""Columns of the observation's entries on cuff and assistance."""

_VELOCITY = OBSERVATIONS.index("joint_velocity")
_SPEED = math.degrees(float(OBSERVATION_SCALES["joint_velocity"]))


def _seen(rows: Values) -> tuple[Values, Values, Values]:
    """Return torque on the cuff [N m], its rate [N m/s], and the joint's velocity [deg/s]."""
    return CUFF_SCALE * rows[:, CUFF], CUFF_RATE_SCALE * rows[:, CUFF_RATE], _SPEED * rows[:, _VELOCITY]


def cuff_features(rows: Values) -> dict[str, Values]:
    """Return the features of observations, shape (N, 16), by name, each of shape (N,) and in [-1, 1]."""
    torque, rate, velocity = _seen(rows)
    fine, coarse = np.tanh(torque / 0.1), np.tanh(torque / 0.4)
    return {
        "cuff_0.1Nm": fine,
        "cuff_0.4Nm": coarse,
        "cuff_rate_1Nm_s": np.tanh(rate / 1.0),
        "cuff_rate_5Nm_s": np.tanh(rate / 5.0),
        # whether the wearer moves the arm (positive) or brakes it
        "cuff_power_slow": fine * np.tanh(velocity / 8.0),
        "cuff_power_fast": coarse * np.tanh(velocity / 30.0),
        # whether the torque grows
        "cuff_growth": fine * np.tanh(rate / 1.0),
    }


def cuff_quantities(rows: Values) -> dict[str, Values]:
    """Return what is averaged over the episode, as `cuff_features`."""
    torque, rate, velocity = _seen(rows)
    return {
        "cuff": np.tanh(torque / 0.4),
        "cuff_size": np.tanh(np.abs(torque) / 0.4),
        "cuff_rate_size": np.tanh(np.abs(rate) / 5.0),
        "cuff_power": np.tanh(torque / 0.4) * np.tanh(velocity / 30.0),
        "assistance": rows[:, ASSISTANCE],
    }
