"""The reference motion: the setpoint, whose jumps become minimum-jerk motions (Flash and Hogan, 1985)."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def remaining_offset(
    offset: float, rate: float, acceleration: float, time: float, duration: float
) -> tuple[float, float, float]:
    """Return an offset on its minimum-jerk way to zero, its rate and its acceleration.

    Parameters
    ----------
    offset, rate, acceleration : float
        At the begin [rad], [rad/s], [rad/s2].
    time : float
        Since the begin [s].
    duration : float
        Time at which offset, rate and acceleration are zero [s]; they stay zero from then on.
    """
    if time >= duration:
        return 0.0, 0.0, 0.0
    t = time / duration
    a, b, c = offset, rate * duration, acceleration * duration * duration
    c3 = -10.0 * a - 6.0 * b - 1.5 * c
    c4 = 15.0 * a + 8.0 * b + 1.5 * c
    c5 = -6.0 * a - 3.0 * b - 0.5 * c
    value = a + t * (b + t * (0.5 * c + t * (c3 + t * (c4 + t * c5))))
    slope = b + t * (c + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    curvature = c + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    return value, slope / duration, curvature / (duration * duration)
