"""What the microcontroller reads: quantised, noisy angles and spring deflections."""

from __future__ import annotations

import numpy as np

from amulett_gym.jit.compiled import compiled


@compiled
def quantise(value: float, resolution: float) -> float:
    """Round `value` to a multiple of `resolution`; a resolution of 0 leaves it as it is."""
    return np.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value  # math.floor: by an integer


@compiled
def read_slider(deflection: float, noise: float, resolution: float, travel: float) -> float:
    """Return the potentiometer's reading [m] of a spring's deflection [m]: noise, then the travel's ends, then bits."""
    return quantise(min(max(deflection + noise, 0.0), travel), resolution)
