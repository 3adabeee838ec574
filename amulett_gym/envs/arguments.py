"""What a caller may give to an environment's reset and step, checked: options, seeds, actions."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, unknown

Seeds = NDArray[np.object_]
NO_SEED = np.array(None)


def as_numbers(actions: NDArray[Any]) -> NDArray[np.float64]:
    """Return a contiguous copy of actions, which the compiled step takes.

    Raises
    ------
    AmulettError
        If they are no numbers.
    """
    try:
        return actions.astype(np.float64)
    except (TypeError, ValueError):
        raise AmulettError(f"an action is no number: {actions.tolist()!r:.80}; allowed is [-1, 1]") from None


def checked_options(options: dict[str, Any] | None, allowed: Sequence[str]) -> dict[str, Any]:
    """Return the options of a reset; raise an AmulettError if one is unknown."""
    for option in options or {}:
        if option not in allowed:
            raise unknown("reset option", str(option), allowed)
    return options or {}


def device_seeds(seed: int | Sequence[int | None] | NDArray[Any] | None, count: int) -> Seeds:
    """Return each device's seed or None: ``seed + i`` or ``seed[i]`` for device i.

    Raises
    ------
    AmulettError
        If the number of seeds is not that of the devices.
    gymnasium.error.Error
        If a seed is no whole number of at least 0; Gymnasium's message.
    """
    if seed is None:
        return np.full(count, None)
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    listed = seed if isinstance(seed, Sequence) else [seed]
    for kind in set(map(type, listed)):
        if kind is bool or not issubclass(kind, int | np.integer | None):
            raise gym.error.Error(f"Seed must be a python integer, actual type: {kind}")
    seeds = np.array([None if one is None else operator.index(one) for one in listed], dtype=object)
    given = seeds[seeds != NO_SEED]
    if (given < 0).any():
        raise gym.error.Error(f"Seed must be greater or equal to zero, actual value: {given.min()}")
    if not isinstance(seed, Sequence):
        return seeds + np.arange(count, dtype=object)
    if len(seeds) != count:
        raise AmulettError(f"{len(seeds)} seeds were given for {count} devices")
    return seeds
