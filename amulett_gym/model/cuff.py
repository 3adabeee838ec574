"""The cuff between the exoskeleton's joint and the wearer's forearm: a spring and a damper, loose ones with slack."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def cuff_torque(apart: float, apart_rate: float, stiffness: float, damping: float, slack: float) -> float:
    """Return the torque on the wearer's elbow [N m]; that on the exoskeleton's joint is its negative.

    Parameters
    ----------
    apart, apart_rate : float
        Angle of the exoskeleton's joint minus that of the elbow [rad], and its rate [rad/s].
    stiffness, damping : float
        [N m/rad], [N m s/rad].
    slack : float
        Play between the cuff's two sides [rad]. Beyond half of it the padding is pressed; it pushes, and does not pull.
    """
    side = 1.0 if apart >= 0.0 else -1.0
    pressed = side * apart - 0.5 * slack
    if slack == 0.0:
        return stiffness * apart + damping * apart_rate
    return side * max(stiffness * pressed + damping * side * apart_rate, 0.0) if pressed > 0.0 else 0.0
