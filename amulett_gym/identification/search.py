"""Search for the parameters of least cost, by differential evolution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution

from amulett_gym.identification.parameters import PARAMETERS, Free, Values, pack, unpack

Cost = Callable[[Values], float]
"""Search vector -> cost, the smaller the better."""


@dataclass(frozen=True)
class Fit:
    """The outcome of one search."""

    cost: float
    parameters: dict[str, float]  # by the names of `PARAMETERS`
    population: Values  # last generation, shape (candidates, parameters): the start of a further search


def search(
    cost: Cost,
    seed: int,
    *,
    generations: int,
    population: int | Values,
    fixed: Mapping[str, float] | None = None,
    parameters: tuple[Free, ...] = PARAMETERS,
) -> Fit:
    """Return the parameters of least cost that differential evolution finds.

    Parameters
    ----------
    seed : int
        Of the first generation and of the search.
    population : int or ndarray, shape (candidates, parameters)
        Number of candidates, drawn between the bounds; or the search vectors of the first generation.
    fixed : mapping of str to float, optional
        Parameters that are not varied.
    parameters : tuple of Free
        What is searched.
    """
    rng = np.random.default_rng(seed)
    if isinstance(population, int):
        population = rng.uniform(size=(population, len(parameters)))
    free = np.array([item.name not in (fixed or {}) for item in parameters])
    template = pack({**unpack(np.full(len(parameters), 0.5), parameters), **(fixed or {})})

    def whole(part: Values) -> Values:
        vector = template.copy()
        vector[free] = part
        return vector

    found = differential_evolution(
        lambda part: cost(whole(part)),
        [(0.0, 1.0)] * int(free.sum()),
        init=population[:, free],
        seed=rng,
        maxiter=generations,
        tol=0.0,
        atol=1e-4,
        polish=False,
    )
    return Fit(
        float(found.fun), unpack(whole(found.x), parameters), np.array([whole(part) for part in found.population])
    )
