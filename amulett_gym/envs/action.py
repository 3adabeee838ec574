"""Actions: the linear map from one in [-1, 1] to a tension setpoint [N] within a range, and what is no action.

The two formulas are written only here. They keep the type of arrays and numbers; compiled code uses the same source, so
that the bits are the same everywhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.jit.compiled import compiled

TENSION_RANGE = (4.0, 15.0)
"""Default tension setpoints at action -1 and +1 [N]."""

FEED_FORWARD_RANGE = (0.0, 15.0)
"""The same in loops that feed the co-contraction forward: they can let the strings go slack."""

ALL_NUMBERS = -1
"""Instead of a device: no action is NaN."""


def tension_of(action: Any, low: float, high: float) -> Any:
    """Return the tension [N] that an action, a number or an array, means in the range from `low` to `high` [N]."""
    return low + 0.5 * (action + 1.0) * (high - low)


def action_of(tension: Any, low: float, high: float) -> Any:
    """Return the action that means a tension [N], a number or an array, in the range from `low` to `high` [N]."""
    return 2.0 * (tension - low) / (high - low) - 1.0


compiled_tension_of, compiled_action_of = compiled(tension_of), compiled(action_of)
"""Both formulas for compiled code."""


def action_to_tension(action: ArrayLike, tension_range: tuple[float, float]) -> NDArray[np.float64]:
    """Return the tensions [N] that actions mean, in float64."""
    return np.asarray(tension_of(np.asarray(action, dtype=np.float64), *tension_range))


def tension_to_action(tension: ArrayLike, tension_range: tuple[float, float]) -> NDArray[np.float64]:
    """Return the actions that mean tensions [N], in float64."""
    return np.asarray(action_of(np.asarray(tension, dtype=np.float64), *tension_range))


@compiled
def first_nan(others: NDArray[np.float64] | None, actions: NDArray[np.float64]) -> int:
    """Return the first device that has a NaN among its actions, or `ALL_NUMBERS`; `others` are second ones, or None."""
    for device in range(actions.size):
        if math.isnan(actions[device]):
            return device
        if others is not None:  # noqa: SIM102, numba drops a branch only if it asks for nothing else
            if math.isnan(others[device]):
                return device
    return ALL_NUMBERS
