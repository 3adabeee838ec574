"""The table that a log is in memory: SI units, radians, one array per column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, unknown


class Kind(NamedTuple):
    """What a column holds: a quantity of `storage.units.UNITS`, its unit in a file, and its meaning."""

    quantity: str
    unit: str
    meaning: str


COLUMNS: Mapping[str, Kind] = {
    "time": Kind("time", "s", "when the sensors were read"),
    "setpoint": Kind("angle", "deg", "position setpoint of the joint"),
    "angle": Kind("angle", "deg", "measured joint angle, positive in flexion"),
    "slider_biceps": Kind("length", "mm", "reading of the biceps' potentiometer: deflection of the linear spring"),
    "slider_triceps": Kind("length", "mm", "reading of the triceps' potentiometer: deflection of the linear spring"),
    "force_biceps": Kind("force", "N", "estimated force of the biceps' string"),
    "force_triceps": Kind("force", "N", "estimated force of the triceps' string"),
    "command_biceps": Kind("angle", "deg", "command of the biceps' drive"),
    "command_triceps": Kind("angle", "deg", "command of the triceps' drive"),
    "tension_setpoint": Kind("force", "N", "setpoint of the antagonist's string tension"),
}
"""Every column that a log may have, in the order of a written file.

The sensors of a row are those at its `time`, its setpoints are those that the controller then had, and its commands
those that it then sent: they act until the next row.
"""

REQUIRED = ("time", "setpoint", "angle")
"""The columns that every log has."""

GAP = 1.5
"""A step of time is a gap if it is longer than this multiple of the log's usual longest step (its 90th percentile)."""


@dataclass(frozen=True)
class Log:
    """A recorded table of one device.

    Attributes
    ----------
    columns : mapping of str to ndarray, shape (rows,)
        By the names of `COLUMNS`, `REQUIRED` among them, in SI units and radians. A missing cell is NaN; `time` has
        none, and rises from row to row.
    source : str
        Where it is from: a file, or a description.
    notes : tuple of str
        What was taken for what, what was left out and what is conspicuous.
    """

    columns: Mapping[str, NDArray[np.float64]]
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_columns(self.columns, "log")

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return one column, shape (rows,); one that the log does not have raises AmulettError."""
        if name not in self.columns:
            raise unknown("column", name, self.columns)
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.columns["time"])

    @property
    def gaps(self) -> NDArray[np.int64]:
        """Indices of the rows before which rows are missing (see `GAP`)."""
        return find_gaps(self.columns["time"])

    @property
    def period(self) -> float:
        """Mean time between two rows without a gap between them [s]; NaN if there are none."""
        steps = np.delete(np.diff(self.columns["time"]), self.gaps - 1)
        return float(steps.mean()) if steps.size else float("nan")


def find_gaps(time: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices of the rows before which rows are missing (see `GAP`); `time` rises."""
    steps = np.diff(time)
    if not steps.size:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(steps > GAP * np.percentile(steps, 90, method="lower")) + 1


def check_columns(columns: Mapping[str, NDArray[np.float64]], what: str) -> None:
    """Refuse columns that are no log.

    Raises
    ------
    AmulettError
        If a name is unknown, a required column is missing, the columns are not equally long, a number is infinite, or
        the time is not finite or does not rise.
    """
    for name in columns:
        if name not in COLUMNS:
            raise unknown(f"column of a {what}", name, COLUMNS)
    for name in REQUIRED:
        if name not in columns:
            raise AmulettError(f"a {what} needs the column '{name}'; there are: {', '.join(columns) or 'none'}")
    time = columns["time"]
    for name, values in columns.items():
        if values.shape != (time.size,):
            raise AmulettError(f"column '{name}' of the {what} has the shape {values.shape}, 'time' has {time.shape}")
        wrong = ~np.isfinite(values) if name == "time" else np.isinf(values)
        if wrong.any():
            raise AmulettError(f"column '{name}' of the {what}: {values[wrong][0]} in row {int(np.argmax(wrong))}")
    if (falls := np.diff(time) <= 0.0).any():
        row = int(np.argmax(falls)) + 1
        raise AmulettError(f"time of the {what} does not rise: {time[row]} s in row {row} follows {time[row - 1]} s")
