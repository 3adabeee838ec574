"""Model of a drive within a loop, and its inverse: the device measures no drive angle."""

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


@compiled
def drive_command(angle: float, wanted: float, factor: float, rate: float, lead: float) -> float:
    """Return the command of a drive [rad] that brings it to a moving angle faster than its lag does.

    With u = e + lambda (w - e) + T v, the lag T e' = u - e becomes e' = (w - e) lambda/T + v.

    Parameters
    ----------
    angle, wanted : float
        e, the drive's angle by its model, and w [rad].
    factor : float
        lambda [1]; 1: with the drive's own lag.
    rate : float
        v, rate of the wanted angle [rad/s].
    lead : float
        T, the drive's lag [s].
    """
    return angle + factor * (wanted - angle) + lead * rate
