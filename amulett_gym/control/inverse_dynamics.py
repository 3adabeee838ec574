"""Inverse dynamics: the torque of the strings that moves the joint (eq. 1, solved for it)."""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled


@compiled
def joint_torque(acceleration: float, rate: float, angle: float, inertia: float, decay: float, weight: float) -> float:
    """Return the torque of the strings [N m] at which the joint has an acceleration.

    Parameters
    ----------
    acceleration, rate, angle : float
        Of the joint: x'' [rad/s2], x' [rad/s], x [rad].
    inertia, decay, weight : float
        J [kg m2], delta [1/s], M_m [N m].
    """
    return inertia * (acceleration + 2.0 * decay * rate) + weight_torque(weight, angle)


@compiled
def weight_torque(weight: float, angle: float) -> float:
    """Return the torque [N m] that holds a weight, M_m [N m] at the horizontal, at a joint angle [rad]."""
    return weight * math.sin(angle) if weight != 0.0 else 0.0  # a sine takes long
