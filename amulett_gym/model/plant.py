"""Equations 1-5: the elbow joint between two strings.

Signs: flexion is positive. Both drives turning by the same angle move the joint; turning apart they co-contract it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled

GRAVITY = 9.81  # g [m/s2]

Numbers = float | NDArray[np.float64]
"""A number, or one for each of many arms."""


def inertia(masses: Sequence[Numbers], arms: Sequence[Numbers]) -> Any:
    """Return J of eq. 3 [kg m2]: point masses by Huygens-Steiner, plus a thin rod as long as the longest arm.

    Parameters
    ----------
    masses : sequence of float or ndarray
        m_i [kg].
    arms : sequence of float or ndarray
        l_i, lever arms about the joint [m].
    """
    rod = sum(masses) * reduce(np.maximum, arms) ** 2 / 12
    return rod + sum(mass * arm**2 for mass, arm in zip(masses, arms, strict=True))


def static_torque(masses: Sequence[Numbers], arms: Sequence[Numbers]) -> Any:
    """Return M_m of eq. 2 [N m]: the weight's torque about the joint when the forearm is horizontal."""
    return GRAVITY * sum(mass * arm for mass, arm in zip(masses, arms, strict=True))


@compiled
def deflection_biceps(drive: float, joint: float, drive_radius: float, joint_radius: float) -> float:
    """Return Delta l_1 of eq. 4 [m] from the angles x_e1, x_a [rad] and the radii R_1, R_2 [m]."""
    return drive * drive_radius - joint * joint_radius


@compiled
def deflection_triceps(drive: float, joint: float, drive_radius: float, joint_radius: float) -> float:
    """Return Delta l_2 of eq. 5 [m] from the angles x_e2, x_a [rad] and the radii R_1, R_2 [m]."""
    return joint * joint_radius - drive * drive_radius


@compiled
def joint_acceleration(
    joint: float,
    velocity: float,
    force_biceps: float,
    force_triceps: float,
    decay: float,
    external: float,
    inertia: float,
    static_torque: float,
    joint_radius: float,
) -> float:
    """Return the second derivative of x_a by eq. 1 [rad/s2], with an external torque added.

    Parameters
    ----------
    joint, velocity : float
        x_a [rad] and its rate [rad/s].
    force_biceps, force_triceps : float
        f(Delta l_1), f(Delta l_2) [N].
    decay : float
        delta [1/s].
    external : float
        Torque of pushes and obstacles, positive in flexion [N m].
    inertia, static_torque : float
        J [kg m2] and M_m [N m].
    joint_radius : float
        R_2 [m].
    """
    weight = static_torque * math.sin(joint) if static_torque != 0.0 else 0.0  # a sine is dear
    torque = (force_biceps - force_triceps) * joint_radius - weight + external
    return torque / inertia - 2.0 * decay * velocity


@compiled
def contact_torque(joint: float, velocity: float, angle: float, side: float, stiffness: float, damping: float) -> float:
    """Return the torque of a compliant obstacle [N m]; it pushes the arm back and never pulls.

    Parameters
    ----------
    joint, velocity : float
        x_a [rad] and its rate [rad/s].
    angle : float
        Where the obstacle begins [rad].
    side : float
        +1 if it blocks flexion beyond `angle`, -1 if it blocks extension.
    stiffness, damping : float
        [N m/rad] and [N m s/rad]; a stiffness of 0 is no obstacle.
    """
    depth = side * (joint - angle)
    if depth <= 0.0 or stiffness <= 0.0:
        return 0.0
    return -side * max(stiffness * depth + damping * side * velocity, 0.0)
