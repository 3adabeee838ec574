"""The motors: a first-order lag of the commanded position, with limited speed.

A drive with a stall torque has the straight torque-speed line of a geared DC motor: the largest rate at which it winds
its string falls with the string's torque, from the rate limit without load to 0 at the stall torque. A load beyond
stall drives it back along the same line, up to the rate limit. The alternative, a drive that a load cannot turn, would
need a self-locking gear, and could hold a string at any force; then only the spring's end would limit the torque at the
joint.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def drive_rate(command: float, angle: float, inverse_lag: float, rate_limit: float) -> float:
    """Return the motor's speed [rad/s], at most `rate_limit`, from commanded and present position [rad].

    `inverse_lag` is one over the lag's time constant [1/s]; 0 for an ideal drive, which is already at its command.
    """
    return min(max((command - angle) * inverse_lag, -rate_limit), rate_limit)


@compiled
def loaded_drive_rate(
    command: float, angle: float, inverse_lag: float, rate_limit: float, sense: float, load: float
) -> float:
    """Return the speed [rad/s] of a motor under load.

    Parameters
    ----------
    command, angle, inverse_lag, rate_limit : float
        As of `drive_rate`; `rate_limit` is the speed without load.
    sense : float
        Direction in which the motor winds its string: 1, or -1.
    load : float
        Torque of the string as a share of the stall torque [1], 0 or greater.
    """
    if inverse_lag == 0.0:
        return 0.0
    winding = min(sense * (command - angle) * inverse_lag, rate_limit * (1.0 - load))
    return sense * max(winding, -rate_limit)
