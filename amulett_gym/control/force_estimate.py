"""Estimate of a string's force: predicted by the drive model and the joint angle, corrected slowly by the slider.

The device measures no drive angle, and its sliders are noisy: a reading alone scatters by 1.7 N at 10 N. The drive
model with the measured joint angle gives the force without delay and with little noise, but off by what the device
differs from its profile. The difference of both is filtered and added (a complementary filter) ::

    F^ = f(y^) + b,   b' = (F_slider - F^) / T_b

The slider's force is read without the floor of the paper's loop (5 N, Figure 5b): at the floor, a torque
R_2 (F_1 - F_2) would be blind for a slack string. Below 5 N the slider is less certain, and the prediction carries the
estimate.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def next_bias(bias: float, reading: float, predicted: float, time_constant: float, period: float) -> float:
    """Return the next difference [N] of the slider's force to the predicted one, behind a first-order filter.

    Parameters
    ----------
    bias : float
        The last difference, b [N].
    reading, predicted : float
        Force by the slider, and by drive model and joint angle [N].
    time_constant : float
        T_b [s].
    period : float
        Since the last difference [s].
    """
    return bias + (reading - predicted - bias) * period / (time_constant + period)
