"""Model of a drive within a loop: the device measures no drive angle."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def next_angle(angle: float, command: float, share: float, most: float) -> float:
    """Return a drive's angle [rad] after a control period: a first-order lag with a limited rate.

    Parameters
    ----------
    angle, command : float
        At the begin of the period [rad].
    share : float
        1 - exp(-period / lag) [1]; 1 for an ideal drive.
    most : float
        Largest rate times the period [rad].
    """
    return angle + min(max((command - angle) * share, -most), most)
