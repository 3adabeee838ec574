"""Loops of a measured force-deflection curve: the mean of its branches up and down, and the work that is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MEAN = "mean of"
"""Begin of the words of `Mean.in_words`."""

_LEAST_COVER = 0.8
"""Share of the deflections' range that each branch has to cover."""

_MOST_GAIN = 0.05
"""Share of the work of loading by which that of unloading may be larger: measurement errors."""


@dataclass(frozen=True)
class Mean:
    """The mean of a curve's branches, at the deflections of its first branch up, where all branches are known.

    Attributes
    ----------
    columns : list of ndarray, shape (points,)
        Deflection [m], force [N] and the others, means of both directions.
    rows : list of int
        For each point, the row of the first branch up at or after it.
    up, down : int
        Number of branches.
    work, loss : float
        Work of loading the string between the ends of the curve, and how much of it unloading does not return [J].
    """

    columns: list[NDArray[np.float64]]
    rows: list[int]
    up: int
    down: int
    work: float
    loss: float

    def in_words(self) -> str:
        """Return what was done, and the loss."""
        branches = f"{self.up} branch{'es' * (self.up > 1)} up and {self.down} down"
        low, high = 1e3 * self.columns[0][[0, -1]]
        taken = f"{self.loss:.3g} J of {self.work:.3g} J, {100.0 * self.loss / self.work:.3g} %"
        found = f"hysteresis takes {taken}, which is not simulated" if self.loss > 0.0 else "no hysteresis is measured"
        return f"{MEAN} {branches}, {low:.4g} to {high:.4g} mm; {found}"


def mean_of_branches(columns: list[list[float]], rows: list[int], name: str) -> Mean | None:
    """Return the mean of the branches of a curve that is recorded in loops; None if its deflection never falls.

    Parameters
    ----------
    columns : list of list of float
        Deflection [m], force [N] and any others, in the order in which they were recorded.
    rows : list of int
        The rows' numbers, for an error message.
    name : str
        Of the deflection's column.

    Raises
    ------
    ValueError
        If the deflection stands still or turns on its way, so that a branch covers less than 80 % of the range, or
        unloading returns more work than loading takes.
    """
    deflection = np.array(columns[0])
    steps = np.sign(np.diff(deflection))
    if not (steps < 0).any():
        return None
    branches = _branches(steps)
    span = np.ptp(deflection)
    for first, last in branches:
        cover = abs(deflection[last] - deflection[first]) / span
        if cover < _LEAST_COVER:
            turn = first if first > 0 else last
            k = turn + 1
            if last < steps.size and steps[last] == 0.0:  # it stands still
                k = last + 1
            raise ValueError(
                f"row {rows[k]}, column '{name}': it has to rise from row to row; {deflection[k]} follows "
                f"{deflection[k - 1]}. Of a loop, each branch has to cover {100 * _LEAST_COVER:g} % of the range, the "
                f"one from row {rows[first]} to {rows[last]} covers {100 * cover:.3g} %"
            )
    rising = [_sorted(columns, first, last) for first, last in branches if steps[first] > 0]
    falling = [_sorted(columns, first, last) for first, last in branches if steps[first] < 0]
    if not rising:
        raise ValueError(f"row {rows[1]}, column '{name}': it has to rise from row to row; it only falls")
    low = max(branch[0][0] for branch in (*rising, *falling))
    high = min(branch[0][-1] for branch in (*rising, *falling))
    inner = rising[0][0][(rising[0][0] > low) & (rising[0][0] < high)]
    grid = np.array([low, *inner, high])
    up, down = (_average(direction, grid) for direction in (rising, falling))
    work, returned = (float(np.trapezoid(direction[0], grid)) for direction in (up, down))
    if not work > 0.0:
        raise ValueError(f"loading takes no work: {work:g} J between {1e3 * low:g} and {1e3 * high:g} mm")
    if returned > (1.0 + _MOST_GAIN) * work:
        raise ValueError(
            f"unloading returns {returned:.3g} J, more than the {work:.3g} J that loading takes; are the rows in the "
            "order in which they were recorded?"
        )
    means = [grid, *(0.5 * (rise + fall) for rise, fall in zip(up, down, strict=True))]
    first, last = next(branch for branch in branches if steps[branch[0]] > 0)
    places = first + np.minimum(np.searchsorted(deflection[first : last + 1], grid), last - first)
    return Mean(means, [rows[k] for k in places], len(rising), len(falling), work, work - returned)


def _branches(steps: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return the first and last index of each run of rows in which the deflection goes one way.

    Rows with the deflection of the row before are left out at a turn; elsewhere they end a branch.
    """
    found = []
    first = 0
    while first < steps.size:
        if steps[first] == 0.0:
            first += 1
            continue
        last = first
        while last < steps.size and steps[last] == steps[first]:
            last += 1
        found.append((first, last))
        first = last
    return found


def _sorted(columns: list[list[float]], first: int, last: int) -> list[NDArray[np.float64]]:
    """Return a branch by rising deflection."""
    part = [np.array(column[first : last + 1]) for column in columns]
    return part if part[0][0] < part[0][-1] else [column[::-1] for column in part]


def _average(branches: list[list[NDArray[np.float64]]], grid: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the mean over branches of each column but the first, at the deflections of `grid`."""
    return [
        np.mean([np.interp(grid, branch[0], branch[k]) for branch in branches], axis=0)
        for k in range(1, len(branches[0]))
    ]
