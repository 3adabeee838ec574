"""Direct commands of both drives ([12] Stevens et al.: a network that drives everything).

The agent sets what the drives turn together and what they turn apart; there is no feedback but the agent's. Without a
load the joint rests at x = (R_1 / R_2) theta_s, and both strings have the tension sigma:
u_1 = theta_s + theta_c, u_2 = theta_s - theta_c, theta_c = f^-1(sigma) / R_1.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def drive_commands(mean: float, deflection: float, drive_radius: float) -> tuple[float, float]:
    """Return the commands of biceps and triceps [rad].

    Parameters
    ----------
    mean : float
        theta_s, mean angle of both drives [rad].
    deflection : float
        f^-1(sigma), string deflection at the co-contraction [m].
    drive_radius : float
        R_1 [m].
    """
    apart = deflection / drive_radius
    return mean + apart, mean - apart


@compiled
def co_contraction(biceps: float, triceps: float, drive_radius: float) -> float:
    """Return the string deflection [m] by which two commands [rad] co-contract: the inverse of `drive_commands`.

    Parameters
    ----------
    biceps, triceps : float
        Commands [rad].
    drive_radius : float
        R_1 [m].
    """
    return 0.5 * (biceps - triceps) * drive_radius
