"""What the readings' noise is: its size without a model, its size after one, and whether residuals are white."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Values = NDArray[np.float64]

LAGS = 20
"""Rows over which residuals are tested for whiteness."""

_LONGEST = 400  # rows over which correlated residuals are summed


def rough_noise(values: Values) -> float:
    """Return the standard deviation of a signal's noise by its third differences, which a slow motion hardly has.

    The median of their squares is taken, so that short fast motions do not count; at least the rounding of readings.
    """
    rough = np.diff(values, n=3) / np.sqrt(20.0)
    median = float(np.median(np.abs(rough))) / 0.6745 if rough.size else 0.0
    return max(median, resolution(values) / np.sqrt(12.0), 1e-9)


def resolution(values: Values) -> float:
    """Return the step of which all readings are multiples, but for an offset; 0 if there is none.

    That is the smallest difference of readings, if the others are multiples of it: a converter's bit.
    """
    distinct = np.unique(values[np.isfinite(values)])
    steps = np.diff(distinct)
    steps = steps[steps > 1e-9 * max(float(np.ptp(distinct)), 1e-12)] if distinct.size else steps
    if steps.size < 3:
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    whole = steps / least
    if np.abs(whole - np.round(whole)).max() > 0.1:
        return 0.0
    return float(np.ptp(distinct) / np.round(np.ptp(distinct) / least))


@dataclass(frozen=True)
class Whiteness:
    """A test of residuals: white ones carry no information that the model has not used.

    Attributes
    ----------
    p : float
        Of the Ljung-Box test over `LAGS` rows: small if the residuals are correlated.
    largest : float
        Largest autocorrelation within these rows, with its sign.
    time : float
        Factor by which correlation raises the variance of a mean, 1 or more: so many rows count as one.
    """

    p: float
    largest: float
    time: float


def whiteness(residuals: list[Values]) -> Whiteness:
    """Return the test of residuals in pieces of consecutive rows."""
    pieces = [each for each in residuals if each.size > LAGS + 1]
    count = sum(each.size for each in pieces)
    if not count:
        return Whiteness(1.0, 0.0, 1.0)
    mean = float(np.concatenate(pieces).mean())
    most = min(_LONGEST, max(each.size for each in pieces) // 4)
    sums = np.zeros(max(most, LAGS) + 1)
    for piece in pieces:
        centred = piece - mean
        size = 1 << (2 * centred.size - 1).bit_length()
        spectrum = np.fft.rfft(centred, size)
        found = np.fft.irfft(spectrum * spectrum.conj(), size)[: min(sums.size, centred.size)]
        sums[: found.size] += found
    if sums[0] <= 0.0:
        return Whiteness(1.0, 0.0, 1.0)
    correlation = sums[1:] / sums[0]
    near = correlation[:LAGS]
    statistic = count * (count + 2.0) * float(np.sum(near**2 / (count - np.arange(1, LAGS + 1))))
    time = 1.0
    for pair in range(0, correlation.size - 1, 2):  # Geyer: pairs of a reversible process are positive
        both = float(correlation[pair] + correlation[pair + 1])
        if both <= 0.0:
            break
        time += 2.0 * both
    return Whiteness(float(chi2.sf(statistic, LAGS)), float(near[np.argmax(np.abs(near))]), time)
