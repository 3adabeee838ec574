"""Piecewise cubics through given points: monotone ones (PCHIP), and ones with given slopes.

The same numbers as `scipy.interpolate` gives, to the last bit. Its import would take a third of the time up to a
process's first step, and the tables of a spring need little of it.

Coefficients have the shape (cells, 4), constant term first, over the distance from a cell's left knot.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def monotone_slopes(x: Values, y: Values) -> Values:
    """Return the slopes at all knots with which a cubic is monotone wherever its values are.

    Inside, the weighted harmonic mean of both neighbouring cells' slopes, 0 at an extremum (Fritsch and Butland,
    SIAM J. Sci. Stat. Comput. 5(2), 1984). At both ends, that of a parabola through three points, limited to keep the
    shape (Moler, Numerical Computing with MATLAB, 2004, section 3.6).

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Knots, rising, and values; n is at least 2.

    Returns
    -------
    ndarray, shape (n,)
    """
    width = np.diff(x)
    secant = np.diff(y) / width
    if secant.size == 1:
        return np.repeat(secant, 2)
    left, right = secant[:-1], secant[1:]
    rising = np.sign(left) * np.sign(right) > 0.0
    weight, other = 2.0 * width[1:] + width[:-1], width[1:] + 2.0 * width[:-1]
    slopes = np.zeros_like(y)
    with np.errstate(all="ignore"):  # where a secant is 0
        mean = (weight / left + other / right) / (weight + other)
        slopes[1:-1][rising] = 1.0 / mean[rising]
    slopes[0] = _end_slope(width[0], width[1], secant[0], secant[1])
    slopes[-1] = _end_slope(width[-1], width[-2], secant[-1], secant[-2])
    return slopes


def through(x: Values, y: Values, slopes: Values) -> Values:
    """Return the coefficients of the cubics with values y and these slopes at the knots x, shape (n - 1, 4)."""
    width = np.diff(x)
    secant = np.diff(y) / width
    bend = (slopes[:-1] + slopes[1:] - 2.0 * secant) / width
    return np.column_stack((y[:-1], slopes[:-1], (secant - slopes[:-1]) / width - bend, bend / width))


def monotone(x: Values, y: Values) -> Values:
    """Return the coefficients of the cubics through (x, y) that rise and fall only where the values y do."""
    return through(x, y, monotone_slopes(x, y))


def value(x: Values, coefficients: Values, at: Values) -> Values:
    """Return the cubics' values; beyond both ends, those of the outermost cells' cubics."""
    cell = _cells(x, at)
    a, b, c, d = coefficients[cell].T
    s = at - x[cell]
    return a + b * s + c * (s * s) + d * (s * s * s)


def slope(x: Values, coefficients: Values, at: Values) -> Values:
    """Return the cubics' slopes; beyond both ends, those of the outermost cells' cubics."""
    cell = _cells(x, at)
    _, b, c, d = coefficients[cell].T
    s = at - x[cell]
    return b + 2.0 * c * s + 3.0 * d * (s * s)


def _cells(x: Values, at: Values) -> NDArray[np.intp]:
    return np.clip(np.searchsorted(x, at, side="right") - 1, 0, x.size - 2)


def _end_slope(width: float, next_width: float, secant: float, next_secant: float) -> float:
    parabola = ((2.0 * width + next_width) * secant - width * next_secant) / (width + next_width)
    if np.sign(parabola) != np.sign(secant):
        return 0.0
    if np.sign(secant) != np.sign(next_secant) and abs(parabola) > 3.0 * abs(secant):
        return 3.0 * secant
    return parabola
