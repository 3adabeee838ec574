"""What a network in `Amulett/Worn-v0` sees besides what it sees in the other environments: the wearer, by the cuff.

The wearer's intention is not measured. It shows in the cuff's torque, in its rate, and in whether the arm moves with
the torque or against it. Features are smooth steps of some widths, as in `laws.features`; means over the episode, as in
`laws.memory`, show who wears the device, and how much the person pushes at present. Traces hold what means lose: since
when the arm rests, how far it is from where it began, and how it was pushed there. A push has the same torque as the
begin of a movement; where work repeats, it differs in place and time.
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

_ANGLE, _VELOCITY = OBSERVATIONS.index("joint_angle"), OBSERVATIONS.index("joint_velocity")
_DEG = math.degrees(float(OBSERVATION_SCALES["joint_angle"]))
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


TRACES = (
    "first_angle",  # where the episode began, as lowest and highest over 150 deg
    "lowest_angle",
    "highest_angle",
    "place",  # from the lowest (-1) to the highest angle (1)
    "displacement",  # from where it began: tanh(angle / 10 deg)
    "away",  # its size
    "motion_0.3s",  # how recently the arm moved: exp(-time / width)
    "motion_1s",
    "rest",  # time since it moved, over 5 s
    "direction_1s",  # which way it moved, averaged
    "direction_3s",
    "push_away",  # torque on the cuff while the arm rested away from where it began, averaged
)
"""Names of the traces, in order; all are in [-1, 1]. Their times are those at an agent period of 20 ms."""

_WIDTHS = {"motion_0.3s": 15, "motion_1s": 50, "direction_1s": 50, "direction_3s": 150}  # [agent steps]
_REST, _PUSH = 250, 50  # [agent steps]
_MOVING, _EDGE = 8.0, 1.5  # joint rate that counts as a motion, and the width of this step [deg/s]
_ROOM = 10.0  # least range of angles that a place is measured by [deg]


def next_traces(rows: Values, before: Values, begins: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the traces of some devices after an observation, shape (K, len(TRACES)).

    Parameters
    ----------
    rows : ndarray, shape (K, 16)
        Observations.
    before : ndarray, shape (K, len(TRACES))
        Traces of the last step.
    begins : ndarray of bool, shape (K,)
        Devices whose episode begins.
    """
    last = dict(zip(TRACES, np.where(begins[:, None], 0.0, before).T, strict=True))
    torque, _, velocity = _seen(rows)
    angle = rows[:, _ANGLE]
    first, lowest, highest = (np.where(begins, angle, last[name]) for name in TRACES[:3])
    lowest, highest = np.minimum(lowest, angle), np.maximum(highest, angle)
    place = (2.0 * angle - lowest - highest) / np.maximum(highest - lowest, _ROOM / _DEG)
    displacement = np.tanh(_DEG * (angle - first) / 10.0)
    away = np.abs(displacement)
    moves = 1.0 / (1.0 + np.exp(-np.clip((np.abs(velocity) - _MOVING) / _EDGE, -30.0, 30.0)))
    found = {"first_angle": first, "lowest_angle": lowest, "highest_angle": highest, "place": place}
    found |= {"displacement": displacement, "away": away}
    for name in ("motion_0.3s", "motion_1s"):
        found[name] = np.maximum(moves, last[name] * math.exp(-1.0 / _WIDTHS[name]))
    found["rest"] = np.minimum(last["rest"] + 1.0 / _REST, 1.0) * (1.0 - moves)
    for name in ("direction_1s", "direction_3s"):
        found[name] = last[name] + (np.tanh(velocity / 20.0) - last[name]) / _WIDTHS[name]
    share = away * (1.0 - found["motion_0.3s"]) / _PUSH
    found["push_away"] = last["push_away"] + share * (np.tanh(torque / 0.4) - last["push_away"])
    return np.stack([found[name] for name in TRACES], axis=1)
