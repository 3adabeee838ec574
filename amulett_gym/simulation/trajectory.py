"""The trajectory of one device: its state at every control tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.dynamics import recorded_stiffness
from amulett_gym.simulation.layout import LANES
from amulett_gym.storage.writing import atomic_path

_TO_DEGREES = float(np.degrees(1.0))

CSV_COLUMNS = {
    "time_s": ("time", 1.0),
    "setpoint_deg": ("setpoint", _TO_DEGREES),
    "joint_angle_deg": ("angle", _TO_DEGREES),
    "joint_velocity_deg_per_s": ("velocity", _TO_DEGREES),
    "measured_angle_deg": ("measured_angle", _TO_DEGREES),
    "measured_velocity_deg_per_s": ("measured_velocity", _TO_DEGREES),
    "agonist": ("agonist", 1.0),
    "tension_setpoint_N": ("tension_setpoint", 1.0),
    "force_biceps_N": ("force_biceps", 1.0),
    "force_triceps_N": ("force_triceps", 1.0),
    "estimated_force_biceps_N": ("estimate_biceps", 1.0),
    "estimated_force_triceps_N": ("estimate_triceps", 1.0),
    "measured_deflection_biceps_mm": ("measured_biceps", 1000.0),
    "measured_deflection_triceps_mm": ("measured_triceps", 1000.0),
    "position_output_deg": ("position_output", _TO_DEGREES),
    "tension_output_deg": ("tension_output", _TO_DEGREES),
    "command_biceps_deg": ("command_biceps", _TO_DEGREES),
    "command_triceps_deg": ("command_triceps", _TO_DEGREES),
    "drive_biceps_deg": ("drive_biceps", _TO_DEGREES),
    "drive_triceps_deg": ("drive_triceps", _TO_DEGREES),
    "push_torque_Nm": ("push_torque", 1.0),
    "contact_torque_Nm": ("contact_torque", 1.0),
    "joint_stiffness_Nm_per_rad": ("joint_stiffness", 1.0),
    "stiffness_setpoint_Nm_per_rad": ("stiffness_setpoint", 1.0),
}
"""Column of the CSV file -> signal and the factor that turns its SI unit into the column's. Where a control loop takes
no stiffness, its setpoint is nan."""


@dataclass(frozen=True)
class Trajectory:
    """The recorded state of one device at every control tick, the initial one included.

    Row k holds the state at ``k control_period``. True values, sensor readings and setpoint are those of that time: the
    next tick acts on them. Agonist, tension setpoint, controller outputs, commands and push are those of the tick that
    ended then.

    Attributes
    ----------
    profile : str
        The profile's name.
    control_period : float
        Time between two rows [s].
    signals : mapping of str to ndarray, shape (ticks + 1,)
        By the names of `layout.STATE_NAMES`, with a wearer also of `worn_layout.WORN_NAMES`, in SI units and radians,
        and ``joint_stiffness`` [N m/rad], that of the strings about the joint. Agonist: +1 biceps, -1 triceps.
    """

    profile: str
    control_period: float
    signals: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one signal or ``"time"`` [s], shape (ticks + 1,); an unknown name raises AmulettError."""
        if name == "time":
            return self.signals["tick"] * self.control_period
        if name not in self.signals:
            raise unknown("signal", name, ["time", *self.signals])
        return self.signals[name]

    def __len__(self) -> int:
        return len(self.signals["tick"])


def record(
    simulation: Simulation,
    ticks: int,
    device: int = 0,
    before_tick: Callable[[int], None] | None = None,
    tick: Callable[[], object] | None = None,
) -> Trajectory:
    """Return the trajectory of one device over a number of control ticks, ``ticks + 1`` rows.

    Parameters
    ----------
    simulation : Simulation
        Reset by the caller; all its devices advance.
    ticks, device : int
    before_tick : callable, optional
        Called with 0, 1, ... before each tick, e.g. to command a tension at the caller's own rate.
    tick : callable, optional
        Called for each tick instead of ``simulation.advance(1)``, if the control loop is elsewhere.

    Raises
    ------
    AmulettError
        If there is no such device.
    """
    if not 0 <= device < simulation.num_devices:
        raise AmulettError(f"device is {device}; it has to be 0 to {simulation.num_devices - 1}")
    block, lane = divmod(device, LANES)
    live = simulation.live(device)
    signals = {name: np.empty(ticks + 1, dtype=view.dtype) for name, view in live.items()}
    for row in range(ticks + 1):
        if row > 0:
            if before_tick is not None:
                before_tick(row - 1)
            if tick is None:
                simulation.advance(1)
            else:
                tick()
        for name, view in live.items():
            signals[name][row] = view
    signals["joint_stiffness"] = recorded_stiffness(
        simulation.parameters_of(device),
        simulation.scenarios[block],
        lane,
        *(signals[name] for name in ("angle", "drive_biceps", "drive_triceps")),
    )
    period = float(simulation.parameters_of(device)["control_period"])
    return Trajectory(simulation.profile_of(device).name, period, signals)


def write_csv(trajectory: Trajectory | Mapping[str, Trajectory], path: str | Path) -> None:
    """Write a trajectory as CSV, one row per tick and the units in the header (see `CSV_COLUMNS`).

    A mapping of laws' names to trajectories is written one below the other, with the name in a first column ``law``.

    Raises
    ------
    AmulettError
        If the file cannot be written.
    """
    several = isinstance(trajectory, Mapping)
    named = trajectory if isinstance(trajectory, Mapping) else {"": trajectory}
    with atomic_path(path) as temporary, temporary.open("w") as file:
        file.write(",".join(["law"] * several + list(CSV_COLUMNS)) + "\n")
        for name, each in named.items():
            law = [f'"{name}"'.replace("%", "%%")] * several
            columns = [each[signal] * factor for signal, factor in CSV_COLUMNS.values()]
            np.savetxt(file, np.column_stack(columns), fmt=",".join(law + ["%.10g"] * len(columns)))
