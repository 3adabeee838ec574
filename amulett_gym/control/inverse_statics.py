"""Inverse statics: the drive angles that give a torque at a co-contraction, or at a joint stiffness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.spring import find_position, find_positions, look_up_curve

STEPS = 3
"""Newton steps of `stiff_pair`: to 1e-3 N for the shipped springs, to 0.03 N for springs with another geometry."""


@compiled
def string_forces(torque: float, tension: float, joint_radius: float, max_force: float) -> tuple[float, float]:
    """Return the forces of biceps and triceps [N] that give a joint torque, the antagonist with a tension.

    The tension is limited to what the springs give, and the torque to what is left of it: M_max = (f_max - F_a) R_2.

    Parameters
    ----------
    torque : float
        tau [N m].
    tension : float
        F_a, co-contraction: force of the antagonist [N].
    joint_radius : float
        R_2 [m].
    max_force : float
        f_max, force at which the springs saturate [N].
    """
    antagonist = min(max(tension, 0.0), max_force)
    agonist = min(antagonist + abs(torque) / joint_radius, max_force)
    return (agonist, antagonist) if torque >= 0.0 else (antagonist, agonist)


@compiled
def affordable_tension(torque: float, tension: float, joint_radius: float, max_force: float) -> float:
    """Return the tension [N], lowered as far as the torque needs it: F_a <= f_max - |tau|/R_2, and at least 0.

    The parameters are those of `string_forces`.
    """
    return max(min(tension, max_force - abs(torque) / joint_radius), 0.0)


@compiled
def drive_angles(
    angle: float, biceps: float, triceps: float, drive_radius: float, joint_radius: float
) -> tuple[float, float]:
    """Return both drive angles [rad] at which the strings have given deflections (eqs. 4 and 5, solved for e).

    Parameters
    ----------
    angle : float
        Of the joint, x [rad].
    biceps, triceps : float
        String deflections [m].
    drive_radius, joint_radius : float
        R_1, R_2 [m].
    """
    wound = angle * joint_radius
    return (wound + biceps) / drive_radius, (wound - triceps) / drive_radius


@compiled
def stiff_pair(
    force_table: NDArray[np.float64],
    position_table: NDArray[np.float64],
    difference: float,
    tension: float,
    max_force: float,
) -> tuple[float, float, float, float]:
    """Return the string deflections that give a difference of forces at a stiffness, and the sums of slopes.

    They solve f(y_g) - f(y_a) = |dF| and f'(y_a) + f'(y_g) = 2 f'(y_0) for agonist and antagonist: with a torque, the
    stiffness K = R_2^2 (f'_a + f'_g) that both strings have at y_0, where their force is the tension, without. Newton's
    method has the determinant f''_a f'_g + f''_g f'_a, which is positive where the spring stiffens: there K rises with
    the antagonist's tension. Its result is limited to what can be had: a slack antagonist if the agonist alone is
    stiffer, and an agonist at the largest force.

    Parameters
    ----------
    force_table, position_table : ndarray
        f and its inverse (`model.spring.find_position`).
    difference : float
        dF, force of the biceps minus that of the triceps [N]; limited to `max_force`.
    tension : float
        f(y_0) [N].
    max_force : float
        f_max, force at which the springs saturate [N].

    Returns
    -------
    biceps, triceps : float
        Deflections as shares of the table's range.
    slopes, wanted : float
        f'_a + f'_g and 2 f'_0 by such a share [N].
    """
    apart = min(abs(difference), max_force)
    start, highest = find_positions(force_table, position_table, tension, max_force - apart)
    _, slope, _ = look_up_curve(force_table, start)
    wanted = 2.0 * slope
    # As if the spring's slope were linear in its deflection.
    shift = min(0.5 * apart / slope, 0.5 * start) if slope > 0.0 else 0.5 * start
    antagonist, agonist = min(start - shift, highest), min(start + shift, 1.0)
    for k in range(STEPS):
        force_a, slope_a, curvature_a = look_up_curve(force_table, antagonist)
        force_g, slope_g, curvature_g = look_up_curve(force_table, agonist)
        lacking = apart - (force_g - force_a)
        too_soft = wanted - (slope_a + slope_g)
        determinant = curvature_a * slope_g + curvature_g * slope_a
        step = (slope_g * too_soft - curvature_g * lacking) / determinant if determinant > 0.0 else 0.0
        # To zero only at last: there a spring without slope has no determinant.
        lowest = 0.25 * antagonist if k < STEPS - 1 else 0.0
        found = min(max(antagonist + step, lowest), highest)
        turn = slope_a * (found - antagonist) + lacking
        agonist = min(max(agonist + (turn / slope_g if slope_g > 0.0 else 0.0), found), 1.0)
        antagonist = found
    force_a, slope_a, _ = look_up_curve(force_table, antagonist)
    agonist = find_position(force_table, position_table, force_a + apart)  # the torque without Newton's remainder
    _, slope_g, _ = look_up_curve(force_table, agonist)
    biceps, triceps = (agonist, antagonist) if difference >= 0.0 else (antagonist, agonist)
    return biceps, triceps, slope_a + slope_g, wanted
