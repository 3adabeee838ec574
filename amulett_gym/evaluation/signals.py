"""Signals of the tension controller, from a recorded trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.agonist import BICEPS
from amulett_gym.simulation.trajectory import Trajectory

ANTAGONIST = {+1: "triceps", -1: "biceps"}
"""Agonist, +1 biceps or -1 triceps -> the string whose tension is controlled."""


def acting(trajectory: Trajectory, name: str) -> NDArray[Any]:
    """Return one of a tick's signals in the row in which that tick begins, shape (ticks + 1,).

    A trajectory has agonist, tension setpoint and commands in the row in which their tick ends, but the state that they
    act on in the row before. The last row, which no tick follows, repeats the last tick's.
    """
    values = trajectory[name]
    return np.append(values[1:], values[-1])


def force_feedback(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return the tension controller's feedback, the antagonist's estimated force [N], shape (ticks + 1,)."""
    biceps_is_agonist = acting(trajectory, "agonist") == BICEPS
    return np.where(biceps_is_agonist, trajectory["estimate_triceps"], trajectory["estimate_biceps"])


def switch_rows(trajectory: Trajectory) -> NDArray[np.int64]:
    """Return the rows at the beginning of the ticks that switch the agonist."""
    return np.flatnonzero(np.diff(trajectory["agonist"]))
