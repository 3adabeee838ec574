"""The preload-dependent decay rate of Figure 3."""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled


@compiled
def decay_rate(preload: float, a: float, b: float, c: float, d: float) -> float:
    """Return delta [1/s] at a preload force [N]: ``a exp(b preload + c) + d``, clipped at zero.

    This is the printed form. The form that agrees with Figure 3, ``a exp(b (preload + c)) + d``, is the same with
    ``b c`` instead of ``c``.
    """
    return max(a * math.exp(b * preload + c) + d, 0.0)


@compiled
def preload_force(force_biceps: float, force_triceps: float, mean: bool) -> float:
    """Return the preload that the decay rate depends on [N]: the mean of both true string forces, or the smaller.

    Figure 3 was measured with the same preload of both strings; in motion they differ. "Friction in the system also
    being preload dependent" (section 2.1) is that of both strings, hence the mean; the smaller is the antagonist's.
    """
    return 0.5 * (force_biceps + force_triceps) if mean else min(force_biceps, force_triceps)
