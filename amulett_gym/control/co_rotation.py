"""Co-/counter-rotation ([10] Tonietti et al.): drives turn together for the position, apart for the stiffness.

The common turn is that of equilibrium-point control with a PID of the joint position.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def correction(error: float, error_rate: float, integral: float, kp: float, kd: float) -> float:
    """Return the turn of both drives [rad] that the PID adds.

    Parameters
    ----------
    error, error_rate : float
        Reference minus measured joint angle [rad], and its rate [rad/s].
    integral : float
        Integral term [rad].
    kp, kd : float
        Gains [1], [s].
    """
    return kp * error + integral + kd * error_rate
