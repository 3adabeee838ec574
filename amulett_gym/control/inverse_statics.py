"""Inverse statics: the drive angles that give a torque at a co-contraction."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


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
