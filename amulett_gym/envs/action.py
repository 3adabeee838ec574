"""The linear map from an action in [-1, 1] to a tension setpoint [N] within a range.

The two formulas are written only here. They keep the type of arrays and numbers; compiled code uses the same source, so
that the bits are the same everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.jit.compiled import compiled

TENSION_RANGE = (4.0, 15.0)
"""Default tension setpoints at action -1 and +1 [N]."""

FEED_FORWARD_RANGE = (0.0, 15.0)
"""The same in loops that feed the co-contraction forward: they can let the strings go slack."""


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
