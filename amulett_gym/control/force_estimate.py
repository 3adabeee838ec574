"""Estimate of a string's force: predicted by the drive model and the joint angle, corrected slowly by the slider.

The device measures no drive angle, and its sliders are noisy: a reading alone scatters by 1.7 N at 10 N. The drive
model with the measured joint angle gives the string's deflection without delay and with little noise, but off by what
the device differs from its profile, mostly by its pulleys. A correction of the deflection follows the slider ::

    F^ = f(y^ + b),   b' = (F_slider - F^) / (T_b f'(y^ + b))

The slider's force is read without the floor of the paper's loop (5 N, Figure 5b): at the floor, a torque
R_2 (F_1 - F_2) would be blind for a slack string. Below 5 N the slider is less certain, and the prediction carries the
estimate.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def next_correction(
    correction: float, reading: float, estimate: float, slope: float, time_constant: float, period: float
) -> float:
    """Return the next correction of a deflection, b, in the unit of the slope's deflection.

    Parameters
    ----------
    correction : float
        The last one.
    reading, estimate : float
        Force by the slider, and the estimate with the last correction [N].
    slope : float
        f' at the estimate, positive.
    time_constant : float
        T_b [s].
    period : float
        Since the last correction [s].
    """
    return correction + (reading - estimate) / slope * period / (time_constant + period)
