"""Means and ratios over scenarios, with bootstrap intervals.

A *resample* draws as many scenarios as there are, with replacement. All metrics of all policies are resampled with the
same draws: a scenario is drawn for every policy or for none, so that what a scenario does to all of them cancels in a
ratio. The draws depend on the number of scenarios and on `SEED` only.

NaN stands for a value that does not exist, such as the rise time of a step whose target was not reached.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 4000
SEED = 0
LEVEL = 0.95
"""Probability that an interval is to contain the true value."""

Weights = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A number and its interval; NaN where undefined, an infinite bound where the data give none."""

    mean: float
    low: float
    high: float


UNDEFINED = Estimate(np.nan, np.nan, np.nan)


def draw_weights(count: int, resamples: int = RESAMPLES, seed: int = SEED) -> Weights:
    """Draw how often each scenario occurs in each resample.

    Parameters
    ----------
    count : int
        Number of scenarios, at least 1.
    resamples : int
        Number of resamples.
    seed : int
        Seed of the draws.

    Returns
    -------
    ndarray, shape (resamples, count)
        Whole numbers; each row sums to `count`.
    """
    return np.random.default_rng(seed).multinomial(count, np.full(count, 1.0 / count), size=resamples).astype(float)


def mean(values: ArrayLike, weights: Weights) -> Estimate:
    """Return the mean of the values that exist, with its percentile bootstrap interval.

    Parameters
    ----------
    values : array_like, shape (count,)
        One value for each scenario; NaN where there is none.
    weights : ndarray, shape (resamples, count)
        From :func:`draw_weights`.

    Returns
    -------
    Estimate
        Without an interval (NaN) if fewer than two values exist: one scenario says nothing about its spread.
    """
    values = np.asarray(values, dtype=float)
    return _ratio(values, np.where(np.isnan(values), np.nan, 1.0), weights)


def ratio_of_sums(values: ArrayLike, reference: ArrayLike, weights: Weights) -> Estimate:
    """Return the sum of a policy's values over the sum of the reference's, scenarios resampled in pairs.

    A ratio of sums and not a mean of ratios: a scenario counts by what it costs, and one that costs the reference next
    to nothing does not decide the comparison.

    Parameters
    ----------
    values, reference : array_like, shape (count,)
        What the policy and the reference have in the same scenarios. Only scenarios in which both exist count.
    weights : ndarray, shape (resamples, count)
        From :func:`draw_weights`.

    Returns
    -------
    Estimate
        Undefined (NaN) if the reference's sum is zero; an infinite bound if it is zero in too many resamples.
    """
    return _ratio(np.asarray(values, dtype=float), np.asarray(reference, dtype=float), weights)


def _ratio(numerator: NDArray[np.float64], denominator: NDArray[np.float64], weights: Weights) -> Estimate:
    if numerator.shape != denominator.shape or numerator.shape != weights.shape[1:]:
        shapes = numerator.shape, denominator.shape, weights.shape[1:]
        raise ValueError(f"values, references and weights are for {shapes} scenarios; they have to be for the same")
    both = ~(np.isnan(numerator) | np.isnan(denominator))
    numerator, denominator = np.where(both, numerator, 0.0), np.where(both, denominator, 0.0)
    if denominator.sum() == 0.0:
        return UNDEFINED
    point = float(numerator.sum() / denominator.sum())
    if both.sum() < 2:
        return Estimate(point, np.nan, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (weights @ numerator) / (weights @ denominator)
    # A resample may hold none of the scenarios that count: 0/0. What is left are numbers and infinities, among which
    # the nearest rank is a value that occurred; interpolating could give NaN.
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(ratios, [tail, 100.0 - tail], method="nearest")
    return Estimate(point, float(low), float(high))
