"""The sensors' quantised, noisy readings."""

from __future__ import annotations

import numpy as np

from amulett_gym.jit.compiled import compiled


@compiled
def quantise(value: float, resolution: float) -> float:
    """Return `value` rounded to a multiple of `resolution`, or unchanged if that is 0."""
    # math.floor would convert to an integer.
    return np.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@compiled
def read_slider(deflection: float, noise: float, resolution: float, travel: float) -> float:
    """Return the potentiometer's reading [m] of a spring's deflection [m]: with noise, then clipped, then quantised."""
    return quantise(min(max(deflection + noise, 0.0), travel), resolution)
