"""The motors: a first-order lag of the commanded position, with limited speed."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def drive_rate(command: float, angle: float, inverse_lag: float, rate_limit: float) -> float:
    """Return the motor's speed [rad/s], at most `rate_limit`, from commanded and present position [rad].

    `inverse_lag` is one over the lag's time constant [1/s]; 0 for an ideal drive, which is already at its command.
    """
    return min(max((command - angle) * inverse_lag, -rate_limit), rate_limit)
