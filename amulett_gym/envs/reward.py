"""The reward: minus the cost of an agent step, in units of eq. 6's cost of a whole episode of the same family.

Costs of families differ by a factor of 100 and more: holding against pushes costs far less than stepping. So each
scenario of a mix uses its own family's divisors (`envs.prices`), and all families have the same weight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.tasks.suites import CONTACT_SUITES

DEFAULT_WEIGHTS = {"position": 0.5, "effort": 0.45, "tension": 0.05, "contact": 0.0}
"""Weights of the reward's terms in families without obstacles."""

CONTACT_WEIGHTS = {"position": 0.35, "effort": 0.3, "tension": 0.05, "contact": 0.3}
"""Weights in families with obstacles; they sum to 1, too."""

MOST_WEIGHT = 1e6

Track = Literal["schedule", "full-control"]
SCHEDULE, FULL_CONTROL = TRACKS = get_args(Track)
"""What is compared, by which cost.

*Schedule*: tension laws in one control loop; the effort is that of the commands without the setpoint's jump. *Full
control*: any loops with any laws; the effort is that of the drives' own motion, alike for all loops, and there is no
term for the tension, which not every loop controls.
"""

COST_TERMS = tuple(DEFAULT_WEIGHTS)
TERMS = (*COST_TERMS, "failure")
TERM_KEY = "reward_{}"
"""Key in ``info`` of a term."""

Terms = dict[str, NDArray[np.float64]]
RewardFunction = Callable[[Terms, Terms], ArrayLike]
"""Type of `reward_fn`, see `own_reward`."""

COST_CAP = 1.0
"""Largest cost of one agent step: a whole episode of eq. 6. It bounds the cost of a failure."""


def default_weights(suite: str, track: Track = SCHEDULE) -> dict[str, float]:
    """Return the default weights of the reward in a suite or family; on *full control* those without the tension."""
    weights = CONTACT_WEIGHTS if suite in CONTACT_SUITES else DEFAULT_WEIGHTS
    if track == SCHEDULE:
        return dict(weights)
    total = sum(weights.values()) - weights["tension"]
    return {term: 0.0 if term == "tension" else weight / total for term, weight in weights.items()}


def check_weights(weights: dict[str, float], allowed: Iterable[str] = COST_TERMS) -> dict[str, float]:
    """Return the weights; raise an AmulettError if a name is not allowed or a weight is not from 0 to a million."""
    for name, weight in weights.items():
        if name not in allowed:
            raise unknown("reward weight", name, allowed)
        if not 0 <= weight <= MOST_WEIGHT:
            raise AmulettError(f"reward weight '{name}' is {weight}; it has to be from 0 to {MOST_WEIGHT:g}")
    return weights


def own_reward(function: RewardFunction, costs: Terms, terms: Terms) -> NDArray[np.float64]:
    """Return the rewards of a user's function, shape (N,).

    Parameters
    ----------
    function : callable
        Maps `costs` and `terms` to rewards, shape (N,). Each reward may depend only on the entries of its device.
    costs : dict of ndarray, shape (N,)
        Raw costs of the step: position [deg2 s], effort [deg2/s], tension [N2 s], contact [N2 m2 s], and failure, 1 if
        the device left its limits.
    terms : dict of ndarray, shape (N,)
        Terms of the default reward, weighted, divided and capped; their sum is the default reward.

    Raises
    ------
    AmulettError
        If the function does not return one finite number for each device.
    """
    found = function(costs, terms)
    try:
        rewards = np.array(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise AmulettError(f"reward_fn returned {found!r}; it has to return an array of numbers") from error
    shape = costs["failure"].shape
    if rewards.shape != shape or not np.isfinite(rewards).all():
        wrong = f"the shape {rewards.shape}" if rewards.shape != shape else f"{rewards[~np.isfinite(rewards)][0]}"
        raise AmulettError(f"reward_fn returned {wrong}; it has to return finite numbers in the shape {shape}")
    return rewards
