"""Which parameter sets fit as well as the best: what the data does not determine shows in how far they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from amulett_gym.identification.parameters import PARAMETERS, Values, pack, unpack
from amulett_gym.identification.search import Cost

DETERMINED = 0.2
"""A parameter is determined if the sets as good as the best cover at most this part of its search range, within it."""

AT_BOUND = 0.01
"""Sets that come this near to a bound, as a part of the search range, may go on beyond it."""


def ensemble(
    cost: Cost, seed: int, candidates: Values, *, limit: float, walkers: int, steps: int
) -> list[dict[str, float]]:
    """Return parameter sets that are as good as the best: a random walk of many walkers where the cost is low enough.

    Each walker moves along the line through another one (the affine-invariant "stretch move" of Goodman and Weare,
    2010); a move is accepted if the cost stays within the limit.

    Parameters
    ----------
    candidates : ndarray, shape (candidates, parameters)
        Search vectors; the walkers start from some of those within the limit.
    limit : float
        Largest cost.
    walkers : int
        At most so many.
    steps : int
        Moves that each walker tries.

    Returns
    -------
    list of dict of str to float
        Every place at which a walker was; empty if no candidate is within the limit.
    """
    rng = np.random.default_rng(seed)
    within = [vector for vector in candidates[rng.permutation(len(candidates))] if cost(vector) <= limit]
    places = np.array(within[:walkers]).reshape(-1, len(PARAMETERS))
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
    return [unpack(vector) for vector in members]


def spread(members: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float, bool]]:
    """Return what the data determines of each parameter, by its name.

    Parameters
    ----------
    members : sequence of mapping
        Parameter sets that are as good as the best.

    Returns
    -------
    dict of str to tuple
        Smallest and largest value, three digits, and whether that determines it: the values cover at most
        `DETERMINED` of the search range, and none is at a bound, beyond which they might go on.
    """
    places = np.array([pack(member) for member in members])
    begin, end = places.min(axis=0), places.max(axis=0)
    low, high = unpack(begin), unpack(end)
    determined = (end - begin <= DETERMINED) & (begin > AT_BOUND) & (end < 1.0 - AT_BOUND)
    return {
        free.name: (float(f"{low[free.name]:.3g}"), float(f"{high[free.name]:.3g}"), bool(known))
        for free, known in zip(PARAMETERS, determined, strict=True)
    }
