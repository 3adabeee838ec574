"""Estimates with bootstrap intervals.

A *resample* draws as many scenarios as there are, with replacement. All metrics of all policies use the same draws: a
scenario is drawn for every policy or for none, so that differences between scenarios cancel in a ratio. The draws
depend on the number of scenarios and on `SEED` only.

NaN is an undefined value, such as the rise time of a step whose target was not reached.

Learned policies also vary with the training seed. The values of several seeds have the shape (seeds, scenarios), and
their resamples draw seeds and scenarios independently, as whole rows and columns: :func:`draw_nested`. The intervals of
few seeds are still too narrow: if mainly the seeds differ, those of 10 contain the true value about 92 times in 100,
those of 3 about 82 times.

Over a fleet, values also vary with the device. They have the shape (seeds, devices, scenarios), one seed for a law;
scenario k is the same on each device, so that seeds, devices and scenarios are drawn independently of each other.

Interquartile mean, performance profile and probability of improvement are those of Agarwal et al., "Deep reinforcement
learning at the edge of the statistical precipice" (2021); here low values are good, since they are costs.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import beta

RESAMPLES = 4000
SEED = 0
LEVEL = 0.95
"""Nominal probability that an interval contains the true value."""

Weights = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A number with its interval; NaN if undefined, an infinite bound if the data have none."""

    mean: float
    low: float
    high: float

    def plain(self) -> dict[str, float | None]:
        """Return ``{"mean", "low", "high"}``, with None for numbers that are not finite."""
        return {key: float(value) if math.isfinite(value) else None for key, value in asdict(self).items()}


UNDEFINED = Estimate(np.nan, np.nan, np.nan)


def draw_weights(count: int, resamples: int = RESAMPLES, seed: int = SEED) -> Weights:
    """Return how often each of `count` (at least 1) scenarios occurs in each resample, shape (resamples, count)."""
    return np.random.default_rng(seed).multinomial(count, np.full(count, 1.0 / count), size=resamples).astype(float)


def mean(values: ArrayLike, weights: Weights) -> Estimate:
    """Return the mean of the defined values, shape (count,), with its percentile bootstrap interval.

    `weights` are from :func:`draw_weights`. With fewer than two values the interval is NaN.
    """
    values = np.asarray(values, dtype=float)
    return _ratio(values, np.where(np.isnan(values), np.nan, 1.0), weights)


def ratio_of_sums(values: ArrayLike, reference: ArrayLike, weights: Weights) -> Estimate:
    """Return the sum of a policy's values over the sum of the reference's, scenarios resampled in pairs.

    It is a ratio of sums, not a mean of ratios: a scenario with a very low cost of the reference has little influence.

    Parameters
    ----------
    values, reference : array_like, shape (count,)
        Of the same scenarios. Only scenarios in which both are defined count.
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
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (weights @ numerator) / (weights @ denominator)
    return _interval(point, ratios, int(both.sum()))


@dataclass(frozen=True)
class Draws:
    """How often each training seed, shape (resamples, seeds), each scenario and each device occurs in each resample.

    `devices` is None without a fleet.
    """

    seeds: Weights
    scenarios: Weights
    devices: Weights | None = None


@dataclass(frozen=True)
class Count:
    """A number of cases among all cases, with the exact interval of the probability."""

    count: int
    total: int
    low: float
    high: float


def draw_nested(
    seeds: int, scenarios: int, resamples: int = RESAMPLES, seed: int = SEED, devices: int | None = None
) -> Draws:
    """Return how often each training seed, each scenario and each device occurs in each resample, drawn independently.

    Scenarios are drawn as by :func:`draw_weights`, so that all contenders of a comparison share them. Of n seeds n - 1
    are drawn: then the resamples vary as much as means of n seeds do; with n draws they would vary less (Rao and Wu,
    "Resampling inference with complex survey data", 1988). So are n - 1 of n `devices`, None without a fleet; all
    contenders share these, too. With one seed or device, it is not resampled.
    """
    some = _draw_fewer(seeds, resamples, seed + 1)
    of_devices = None if devices is None else _draw_fewer(devices, resamples, seed + 2)
    return Draws(some, draw_weights(scenarios, resamples, seed), of_devices)


def _draw_fewer(count: int, resamples: int, seed: int) -> Weights:
    shares = np.full(count, 1.0 / count)
    return np.random.default_rng(seed).multinomial(max(count - 1, 1), shares, size=resamples).astype(float)


def nested_ratio(values: ArrayLike, reference: ArrayLike, draws: Draws) -> Estimate:
    """Return the sum of a learner's values over the sum of the reference's, seeds and scenarios resampled.

    Parameters
    ----------
    values : array_like, shape (seeds, scenarios), or (seeds, devices, scenarios) with a fleet
    reference : array_like, of this shape or without the seeds
        Of the same seeds, or of a law that was not learned: resampled with the same draws, in pairs.
    draws : Draws
        From :func:`draw_nested`.

    Returns
    -------
    Estimate
        Only cells in which both are defined count. Undefined (NaN) if the reference's sum is zero.
    """
    cells = _cells(values, draws)
    other = np.broadcast_to(np.asarray(reference, dtype=float), cells.shape)
    both = ~(np.isnan(cells) | np.isnan(other))
    cells, other = np.where(both, cells, 0.0), np.where(both, other, 0.0)
    if other.sum() == 0.0:
        return UNDEFINED
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = _nested_sum(cells, draws) / _nested_sum(other, draws)
    return _interval(float(cells.sum() / other.sum()), ratios, int(both.sum()))


def nested_mean(values: ArrayLike, draws: Draws) -> Estimate:
    """Return the mean of the defined values, as of :func:`nested_ratio`, seeds, devices and scenarios resampled."""
    cells = _cells(values, draws)
    return nested_ratio(cells, np.where(np.isnan(cells), np.nan, 1.0), draws)


def interquartile_mean(values: ArrayLike, draws: Draws) -> Estimate:
    """Return the mean of the middle half of all values, shape (seeds, scenarios), seeds and scenarios resampled.

    A few very bad or very good episodes do not change it.
    """
    return _mean_of_ranks(values, draws, 0.25, 0.75)


def worst_mean(values: ArrayLike, draws: Draws, share: float = 0.1) -> Estimate:
    """Return the mean of the largest values, shape (seeds, scenarios): the CVaR of costs, by default of a tenth.

    `share` is the share of all values, above 0 and at most 1.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"share is {share}; it has to be above 0 and at most 1")
    return _mean_of_ranks(values, draws, 1.0 - share, 1.0)


def performance_profile(values: ArrayLike, thresholds: ArrayLike, draws: Draws) -> list[Estimate]:
    """Return for each threshold the share of all values, shape (seeds, scenarios), that do not exceed it.

    The intervals are pointwise. An undefined value exceeds every threshold.
    """
    cells = _cells(values, draws)
    return [nested_mean(np.where(cells <= threshold, 1.0, 0.0), draws) for threshold in np.asarray(thresholds)]


def probability_of_improvement(values: ArrayLike, reference: ArrayLike, draws: Draws) -> Estimate:
    """Return the probability that a learner costs less than the reference in the same scenario; a tie counts half.

    Parameters
    ----------
    values : array_like, shape (seeds, scenarios)
    reference : array_like, shape (scenarios,) or (other seeds, scenarios)
        Each of its seeds is compared with each of the learner's; only the seeds of `values` are resampled.
    draws : Draws

    Raises
    ------
    ValueError
        If a value is undefined.
    """
    cells, other = _cells(values, draws), np.atleast_2d(np.asarray(reference, dtype=float))
    if np.isnan(cells).any() or np.isnan(other).any():
        raise ValueError("some values are NaN; all have to be numbers for a probability of improvement")
    wins = [np.where(cells == row, 0.5, np.where(cells < row, 1.0, 0.0)) for row in other]
    return nested_mean(np.mean(wins, axis=0), draws)


def count_failures(failed: ArrayLike) -> Count:
    """Return the number of failed episodes, with the exact (Clopper-Pearson) interval of the probability.

    All episodes are assumed to be independent, which those of one seed or scenario need not be.
    """
    cases = np.asarray(failed, dtype=bool)
    count, total, tail = int(cases.sum()), int(cases.size), 0.5 * (1.0 - LEVEL)
    low = float(beta.ppf(tail, count, total - count + 1)) if count else 0.0
    high = float(beta.ppf(1.0 - tail, count + 1, total - count)) if count < total else 1.0
    return Count(count, total, low, high)


def _cells(values: ArrayLike, draws: Draws) -> NDArray[np.float64]:
    cells = np.asarray(values, dtype=float)
    levels = [draws.seeds, *([] if draws.devices is None else [draws.devices]), draws.scenarios]
    shape = tuple(weights.shape[1] for weights in levels)
    if cells.ndim == len(shape) - 1:
        cells = cells[None]
    if cells.shape != shape:
        levels_are = "seeds and scenarios" if draws.devices is None else "seeds, devices and scenarios"
        raise ValueError(f"the values have the shape {cells.shape}; the draws are for {shape} {levels_are}")
    return cells


def _nested_sum(cells: NDArray[np.float64], draws: Draws) -> NDArray[np.float64]:
    """Return the sum over each resample's seeds, devices and scenarios, shape (resamples,)."""
    if draws.devices is None:
        return np.einsum("rs,rs->r", draws.seeds @ cells, draws.scenarios)
    seeds, devices, scenarios = cells.shape
    of_scenarios = draws.scenarios @ cells.reshape(seeds * devices, scenarios).T
    both = (draws.seeds[:, :, None] * draws.devices[:, None, :]).reshape(-1, seeds * devices)
    return np.asarray(np.einsum("rc,rc->r", of_scenarios, both))


def _mean_of_ranks(values: ArrayLike, draws: Draws, low: float, high: float) -> Estimate:
    """Return the mean of the values whose rank, as a share of all, is between `low` and `high`.

    This is the mean of the quantile function over that range: a value at its border counts in part.
    """
    cells = _cells(values, draws)
    if np.isnan(cells).all():
        return UNDEFINED
    order = np.argsort(cells, axis=None, kind="stable")  # NaN are last, with weight 0
    row, column = np.unravel_index(order, cells.shape)
    ranked = cells.reshape(-1)[order]
    exists = ~np.isnan(ranked)
    ranked = np.where(exists, ranked, 0.0)

    def of(weights: Weights) -> NDArray[np.float64]:
        reached = np.cumsum(weights * exists, axis=1)
        total = reached[:, -1:]
        inside = np.clip(reached, low * total, high * total)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.diff(inside, axis=1, prepend=low * total) @ ranked / ((high - low) * total[:, 0])

    point = float(of(np.ones((1, ranked.size)))[0])
    few = max(1_000_000 // ranked.size, 1)  # resamples at a time: the weights of all need gigabytes
    starts = range(0, len(draws.seeds), few)
    means = [of(draws.seeds[k : k + few, row] * draws.scenarios[k : k + few, column]) for k in starts]
    return _interval(point, np.concatenate(means), int(exists.sum()))


def _interval(point: float, resampled: NDArray[np.float64], count: int) -> Estimate:
    """Return a number with its percentile interval, without one if there are fewer than two values."""
    if count < 2:
        return Estimate(point, np.nan, np.nan)
    # A resample may have no defined value: 0/0. The others are numbers and infinities, whose nearest rank is defined,
    # while interpolation could give NaN.
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(resampled, [tail, 100.0 - tail], method="nearest")
    return Estimate(point, float(low), float(high))
