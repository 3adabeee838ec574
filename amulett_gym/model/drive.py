"""The motors: a first-order lag behind the commanded position, with limited speed."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def drive_rate(command: float, angle: float, inverse_lag: float, rate_limit: float) -> float:
    """Return the motor's speed [rad/s].

    Parameters
    ----------
    command, angle : float
        Commanded and present motor position [rad].
    inverse_lag : float
        One over the lag's time constant [1/s]; 0 for an ideal drive, which is already where it was told to be.
    rate_limit : float
        Largest speed [rad/s].
    """
    return min(max((command - angle) * inverse_lag, -rate_limit), rate_limit)
