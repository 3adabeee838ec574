"""Inverse dynamics: the torque of the strings that moves the joint (eq. 1, solved for it)."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def joint_torque(acceleration: float, rate: float, inertia: float, decay: float, weight: float) -> float:
    """Return the torque of the strings [N m] at which the joint has an acceleration.

    Parameters
    ----------
    acceleration, rate : float
        Of the joint: x'' [rad/s2], x' [rad/s].
    inertia, decay : float
        J [kg m2], delta [1/s].
    weight : float
        Torque of the weight [N m] at the joint's angle (`plant.weight_torque`).
    """
    return inertia * (acceleration + 2.0 * decay * rate) + weight
