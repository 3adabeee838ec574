"""The ensemble of parameter sets that fit as well as the best one; its spread shows what the data determines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from amulett_gym.identification.parameters import PARAMETERS, Free, Values, of, pack, unpack
from amulett_gym.identification.search import Cost

DETERMINED = 0.2
"""Largest part of its search range that equally good sets may cover for a parameter to count as determined."""

AT_BOUND = 0.01
"""Distance from a bound, as a part of the search range, below which sets count as limited by it."""


def ensemble(
    cost: Cost,
    seed: int,
    candidates: Values,
    *,
    limit: float,
    walkers: int,
    steps: int,
    parameters: tuple[Free, ...] = PARAMETERS,
    last: bool = False,
) -> list[dict[str, float]]:
    """Return equally good parameter sets: the places of a random walk of many walkers below a limit of the cost.

    Each walker moves along the line through another one (the affine-invariant "stretch move" of Goodman and Weare,
    2010); a move is accepted if the cost stays within the limit. The list is empty if no candidate is within it.

    Parameters
    ----------
    candidates : ndarray, shape (candidates, parameters)
        Search vectors; the walkers start from some of those within the limit.
    limit : float
        Largest cost.
    walkers, steps : int
        Largest number of walkers; moves that each tries.
    parameters : tuple of Free
        What is searched.
    last : bool
        Whether only the last place of each walker is returned: draws that are uniform below the limit if enough
        moves are accepted. Else all places that they reached.
    """
    rng = np.random.default_rng(seed)
    within = [vector for vector in candidates[rng.permutation(len(candidates))] if cost(vector) <= limit]
    places = np.array(within[:walkers]).reshape(-1, len(parameters))
    members = list(places)
    count, size = places.shape
    for _ in range(steps if count > 1 else 0):
        for k in range(count):
            other = places[(k + rng.integers(1, count)) % count]
            stretch = (1.0 + rng.uniform()) ** 2 / 2.0  # density proportional to 1/sqrt(stretch), 0.5 to 2
            accept = rng.uniform() < stretch ** (size - 1)
            moved = other + stretch * (places[k] - other)
            if accept and ((moved >= 0.0) & (moved <= 1.0)).all() and cost(moved) <= limit:
                places[k] = moved
                members.append(moved)
    return [unpack(vector, parameters) for vector in (places if last else members)]


def spread(members: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float, bool]]:
    """Return the smallest and largest value of each parameter in equally good sets, and whether it is determined.

    Values have three digits. A parameter is determined if its values cover at most `DETERMINED` of the search range,
    and none is at a bound.
    """
    places = np.array([pack(member) for member in members])
    begin, end = places.min(axis=0), places.max(axis=0)
    free = of(members[0])
    low, high = unpack(begin, free), unpack(end, free)
    determined = (end - begin <= DETERMINED) & (begin > AT_BOUND) & (end < 1.0 - AT_BOUND)
    return {
        item.name: (float(f"{low[item.name]:.3g}"), float(f"{high[item.name]:.3g}"), bool(known))
        for item, known in zip(free, determined, strict=True)
    }
