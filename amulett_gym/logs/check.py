"""What a log's numbers show: stamps that repeat, gaps, jitter, and values that look like another unit or sign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.logs.log import COLUMNS, find_gaps

Columns = Mapping[str, NDArray[np.float64]]
_JITTER = 0.01  # of the usual step: smaller differences are rounding
_PERIODS = (1e-5, 0.5)  # [s]
_LARGEST = {"angle": 2.0 * np.pi, "length": 0.5, "force": 1e4}  # of a joint, a slider, a string; in SI units
_RELATED = 0.5  # correlation of setpoint and angle


def one_per_stamp(
    columns: Columns, rows: NDArray[np.int64], time_header: str, keep: Literal["first", "last", "mean", "refuse"]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64], list[str]]:
    """Return the log with one row per stamp, the rows' numbers in the file, and a note if rows were left out.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (rows,)
    rows : ndarray of int, shape (rows,)
        Their numbers in the file.
    time_header : str
        Name of the time's column, for the error message.
    keep : {"first", "last", "mean", "refuse"}
        Which of several rows with the same time remains.

    Raises
    ------
    AmulettError
        If a time is missing, or falls, or repeats and `keep` is ``"refuse"``.
    """
    time = columns["time"]
    where = f"column '{time_header}'"
    if (missing := ~np.isfinite(time)).any():
        raise AmulettError(f"row {rows[np.argmax(missing)]}, {where}: it has no time")
    steps = np.diff(time)
    if (falls := steps < 0.0).any():
        k = int(np.argmax(falls))
        after = "a counter that began again, or a second recording? Keep one part of the file"
        raise AmulettError(f"row {rows[k + 1]}, {where}: the time falls, {time[k + 1]} s follows {time[k]} s: {after}")
    first = np.concatenate([[True], steps > 0.0])
    if first.all():
        return dict(columns), rows, []
    again = rows[~first]
    if keep == "refuse":
        raise AmulettError(f"row {again[0]}, {where}: the time repeats, and repeated_stamps is 'refuse'")
    starts = np.flatnonzero(first)
    same = _are_equal(columns, first)
    count = f"{again.size} row{'s' * (again.size > 1)}, the first is {again[0]}"
    notes = [f"repeated stamps: {count}; {_remains(keep, same)}"]
    if keep == "mean":
        group = np.cumsum(first) - 1
        return {name: _means(values, group, starts) for name, values in columns.items()}, rows[starts], notes
    kept = starts if keep == "first" else np.append(starts[1:], time.size) - 1
    return {name: values[kept] for name, values in columns.items()}, rows[kept], notes


def conspicuous(columns: Columns, rows: NDArray[np.int64]) -> list[str]:
    """Return notes on a log with rising times: its rate, gaps, columns that never change, values that are unlikely."""
    notes = _on_time(columns["time"], rows)
    for name, values in columns.items():
        if name == "time":
            continue
        known, kind = values[np.isfinite(values)], COLUMNS[name]
        if known.size > 1 and np.ptp(known) == 0.0:
            notes.append(f"{name}: never changes")
        largest = _LARGEST[kind.quantity]
        if known.size and np.abs(known).max() > largest:
            unit = {"angle": "rad", "length": "m", "force": "N"}[kind.quantity]
            notes.append(f"{name}: reaches {np.abs(known).max():.4g} {unit}, more than {largest:.3g}: check its unit")
        if kind.quantity == "length" and known.size and known.min() < -0.001:
            notes.append(
                f"{name}: falls to {1e3 * known.min():.4g} mm, though a slider reads 0 or more: check its sign"
            )
    setpoint, angle = columns["setpoint"], columns["angle"]
    both = np.isfinite(setpoint) & np.isfinite(angle)
    if both.sum() > 2 and np.ptp(setpoint[both]) > 0.0 and np.ptp(angle[both]) > 0.0:
        related = np.corrcoef(setpoint[both], angle[both])[0, 1]
        if related < -_RELATED:
            notes.append(f"angle: falls where the setpoint rises (correlation {related:.2f}): check the signs of both")
    return notes


def _on_time(time: NDArray[np.float64], rows: NDArray[np.int64]) -> list[str]:
    """Return notes on rate, jitter and gaps."""
    steps, gaps = np.diff(time), find_gaps(time)
    if not steps.size:
        return ["time: a single row"]
    usual = np.delete(steps, gaps - 1)
    period, least, most = usual.mean(), usual.min(), usual.max()
    notes = [f"time: {time.size} rows in {time[-1] - time[0]:.6g} s, {1.0 / period:.5g} per second"]
    if most - least > _JITTER * period:
        notes.append(f"jitter: steps of {1e3 * least:.4g} to {1e3 * most:.4g} ms, mean {1e3 * period:.4g} ms")
    if gaps.size:
        longest = int(gaps[np.argmax(steps[gaps - 1])])
        many = "1 gap" if gaps.size == 1 else f"{gaps.size} gaps, the longest"
        notes.append(f"gaps: {many} of {steps[longest - 1]:.4g} s before row {rows[longest]}")
    if not _PERIODS[0] <= period <= _PERIODS[1]:
        notes.append(f"time: {period:.4g} s between two rows: check its unit")
    return notes


def _are_equal(columns: Columns, first: NDArray[np.bool_]) -> bool:
    """Return whether all rows with the same stamp are equal."""
    again = np.flatnonzero(~first)
    return all(np.array_equal(values[again], values[again - 1], equal_nan=True) for values in columns.values())


def _remains(keep: str, same: bool) -> str:
    if same:
        return "equal to the row before and left out"
    return {"first": "the first of each remains", "last": "the last of each remains", "mean": "their mean remains"}[
        keep
    ]


def _means(values: NDArray[np.float64], group: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the mean of the known values of each group; a group of one keeps its value to the last bit."""
    known = np.isfinite(values)
    count = np.bincount(group, weights=known)
    total = np.bincount(group, weights=np.where(known, values, 0.0))
    with np.errstate(invalid="ignore"):
        means = total / count
    return np.where(np.bincount(group) == 1, values[starts], means)
