"""The log that the device of a simulation would write."""

from __future__ import annotations

import numpy as np

from amulett_gym.logs.log import COLUMNS, Log
from amulett_gym.simulation.trajectory import Trajectory

_OF_SENSORS = {
    "time": "time",
    "setpoint": "setpoint",
    "angle": "measured_angle",
    "slider_biceps": "measured_biceps",
    "slider_triceps": "measured_triceps",
}
_OF_CONTROLLER = ("command_biceps", "command_triceps", "tension_setpoint")


def log_of(trajectory: Trajectory) -> Log:
    """Return what the device of a simulation would log: sensor readings, setpoints and commands, row by control tick.

    The state after the last tick has no row, since no command follows it.
    """
    columns = {name: np.array(trajectory[signal][:-1], dtype=float) for name, signal in _OF_SENSORS.items()}
    columns |= {name: np.array(trajectory[name][1:], dtype=float) for name in _OF_CONTROLLER}
    return Log({name: columns[name] for name in COLUMNS if name in columns}, f"simulated, profile {trajectory.profile}")
