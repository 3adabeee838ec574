"""The preload-dependent decay rate of Figure 3."""

from __future__ import annotations

import math

from amulett_gym.compiled import compiled


@compiled
def decay_rate(preload: float, a: float, b: float, c: float, d: float) -> float:
    """Return delta [1/s] at a preload force [N]: ``a exp(b preload + c) + d``, clipped at zero.

    The preload is the smaller of the two true string forces. This is the printed form. The form that agrees with
    Figure 3, ``a exp(b (preload + c)) + d``, is the same with ``b c`` in the place of ``c``.
    """
    return max(a * math.exp(b * preload + c) + d, 0.0)
