"""Equations 1-5: the elbow joint between two strings.

Flexion is positive. Equal turns of both drives move the joint; opposite turns co-contract it.
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
    """Return J of eq. 3 [kg m2] from m_i [kg] and lever arms l_i [m].

    Point masses by Huygens-Steiner, plus a thin rod with the length of the longest arm.
    """
    rod = sum(masses) * reduce(np.maximum, arms) ** 2 / 12
    return rod + sum(mass * arm**2 for mass, arm in zip(masses, arms, strict=True))


def static_torque(masses: Sequence[Numbers], arms: Sequence[Numbers]) -> Any:
    """Return M_m of eq. 2 [N m]: the weight's torque about the joint when the forearm is horizontal."""
    return GRAVITY * sum(mass * arm for mass, arm in zip(masses, arms, strict=True))


@compiled
def weight_torque(static_torque: float, joint: float) -> float:
    """Return the weight's torque about the joint [N m] of eq. 1, from M_m [N m] and x_a [rad].

    A loop over lanes that the compiler vectorises computes this sine in any case, even if nothing weighs: call it in a
    loop of its own, behind a branch.
    """
    return static_torque * math.sin(joint)


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
    velocity: float,
    force_biceps: float,
    force_triceps: float,
    decay: float,
    weight: float,
    external: float,
    inertia: float,
    joint_radius: float,
) -> float:
    """Return the second derivative of x_a by eq. 1 [rad/s2], with an external torque added.

    From the rate of x_a [rad/s], f(Delta l_1) and f(Delta l_2) [N], delta [1/s], the weight's torque
    (`weight_torque`), that of pushes and obstacles, positive in flexion [N m], J [kg m2] and R_2 [m].
    """
    torque = (force_biceps - force_triceps) * joint_radius - weight + external
    return torque / inertia - 2.0 * decay * velocity


@compiled
def contact_torque(joint: float, velocity: float, angle: float, side: float, stiffness: float, damping: float) -> float:
    """Return the torque of a compliant obstacle [N m], which pushes and never pulls.

    From x_a [rad] and its rate [rad/s], the obstacle's angle [rad], its side (+1 if it blocks flexion, -1 extension),
    stiffness [N m/rad] (0: no obstacle) and damping [N m s/rad].
    """
    depth = side * (joint - angle)
    if depth <= 0.0 or stiffness <= 0.0:
        return 0.0
    return -side * max(stiffness * depth + damping * side * velocity, 0.0)
