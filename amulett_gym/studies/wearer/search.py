"""Cross-entropy search in the unit cube."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

SPREAD = 0.3
"""Standard deviation of the first candidates."""

_ELITE = 4  # one in so many
_KEPT = 0.3  # share of the last mean and spread
_LEAST = 0.01  # spread that is always left


class Budget(NamedTuple):
    """Candidates in each iteration, and iterations."""

    population: int
    iterations: int


def cross_entropy(
    costs_of: Callable[[Values], Values], start: Values, budget: Budget, seed: int
) -> tuple[Values, Values]:
    """Search for the least cost of many independent problems at once.

    Parameters
    ----------
    costs_of : callable
        Points, shape (problems, population, dimensions), in [0, 1] -> costs, shape (problems, population).
    start : ndarray, shape (problems, dimensions)
        Mean of the first candidates, and the first of them.
    budget : Budget
    seed : int

    Returns
    -------
    points : ndarray, shape (problems, dimensions)
        The best candidate of each problem.
    costs : ndarray, shape (problems,)
        Theirs.
    """
    random = np.random.default_rng(seed)
    problems = np.arange(len(start))
    centre, spread = start.copy(), np.full_like(start, SPREAD)
    best, least = start.copy(), np.full(len(start), np.inf)
    for iteration in range(budget.iterations):
        noise = random.normal(size=(len(start), budget.population, start.shape[1]))
        points = np.clip(centre[:, None] + spread[:, None] * noise, 0.0, 1.0)
        if iteration == 0:
            points[:, 0] = start
        costs = costs_of(points)
        order = np.argsort(costs, axis=1, kind="stable")
        first = order[:, 0]
        better = costs[problems, first] < least
        best[better], least[better] = points[problems, first][better], costs[problems, first][better]
        elite = np.take_along_axis(points, order[:, : max(budget.population // _ELITE, 2), None], axis=1)
        centre = _KEPT * centre + (1.0 - _KEPT) * elite.mean(axis=1)
        spread = _KEPT * spread + (1.0 - _KEPT) * elite.std(axis=1) + _LEAST
    return best, least
