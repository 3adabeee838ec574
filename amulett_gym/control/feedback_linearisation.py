"""Feedback linearisation of joint position and mean tension (Palli et al., 2008; De Luca et al., 2009).

The inputs are the drives' rates, w_i = e_i'. Position and mean tension s = (F_1 + F_2)/2 depend on them by ::

    x''' = (R_2/J) (F_1' - F_2') - 2 delta x'' - (M_m/J) cos(x) x',   s' = (F_1' + F_2')/2
    F_1' = f_1' (R_1 w_1 - R_2 x'),   F_2' = f_2' (R_2 x' - R_1 w_2)

which is linear in them. Solved for w_1 and w_2, jerk and tension's rate can be chosen independently: the jerk as that
of the reference plus a feedback with poles at -bandwidth, the tension's rate proportional to its error. The matrix has
the determinant -(R_1^2 R_2/J) f_1' f_2': both strings have to be taut. Slopes are therefore limited from below, the
drives' rates from above, and where a string comes near slack, feed-forward takes over (`tautness`).

The tension's setpoint is that of the antagonist; the mean one is higher by half of what the reference motion needs.
"""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled


@compiled
def desired_jerk(error: float, rate: float, acceleration: float, jerk: float, bandwidth: float) -> float:
    """Return the jerk of the joint [rad/s3] at which its error has three poles at -bandwidth.

    Parameters
    ----------
    error, rate, acceleration : float
        Reference minus actual joint angle [rad], and its first two derivatives [rad/s], [rad/s2].
    jerk : float
        Of the reference [rad/s3].
    bandwidth : float
        [rad/s].
    """
    w = bandwidth
    return jerk + w * (w * (w * error + 3.0 * rate) + 3.0 * acceleration)


@compiled
def drive_rates(
    jerk: float,
    tension_rate: float,
    velocity: float,
    slopes: tuple[float, float],
    inertia: float,
    drive_radius: float,
    joint_radius: float,
) -> tuple[float, float]:
    """Return the rates of both drives, w_1 and w_2 [rad/s], that give a jerk and a rate of the mean tension.

    Parameters
    ----------
    jerk : float
        x''' + 2 delta x'' + (M_m/J) cos(x) x' [rad/s3]: what the strings have to give.
    tension_rate : float
        s' [N/s].
    velocity : float
        Of the joint, x' [rad/s].
    slopes : tuple of float
        f_1', f_2' [N/m], positive.
    inertia : float
        J [kg m2].
    drive_radius, joint_radius : float
        R_1, R_2 [m].
    """
    half = 0.5 * jerk * inertia / joint_radius
    wound = joint_radius * velocity
    biceps = wound + (tension_rate + half) / slopes[0]
    triceps = wound - (tension_rate - half) / slopes[1]
    return biceps / drive_radius, triceps / drive_radius


@compiled
def tautness(biceps: float, triceps: float, taut_force: float) -> float:
    """Return the share [1] of feedback linearisation in the command: 1 if both strings have `taut_force` [N] or more.

    It falls to 0 with the smaller of both forces; the rest of the command is feed-forward.
    """
    return min(max(min(biceps, triceps) / taut_force, 0.0), 1.0)


def decoupling_determinant(
    slopes: tuple[float, float], inertia: float, drive_radius: float, joint_radius: float
) -> float:
    """Return the determinant of (x''', s') by (w_1, w_2): -(R_1^2 R_2/J) f_1' f_2' [rad N/s2]; 0: not decoupled."""
    return -(math.pow(drive_radius, 2) * joint_radius / inertia) * slopes[0] * slopes[1]
