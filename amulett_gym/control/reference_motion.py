"""The reference motion: the setpoint, whose jumps become smooth motions.

A *minimum-jerk* motion (Flash and Hogan, 1985) is the smoothest for the joint. The answer of a *critically damped*
second-order filter, or of a *first-order* one, needs less motion of the drives for the same position ISE: the integrals
of (position error)^2 and rate^2 of an answer to a jump have a product of 0.560, 0.3125 and 0.25 times the jump's fourth
power; 0.25 is the least.
"""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled

MINIMUM_JERK, CRITICALLY_DAMPED, FIRST_ORDER = 0, 1, 2

_TIME_CONSTANTS = math.log(50.0)
"""Of a first-order answer until 2 % are left."""

_DOUBLE_TIME_CONSTANTS = 5.833921
"""Of a critically damped answer until 2 % are left: (1 + s) exp(-s) = 0.02."""


@compiled
def remaining_offset(
    shape: int, offset: float, rate: float, acceleration: float, time: float, duration: float
) -> tuple[float, float, float]:
    """Return an offset on its way to zero, its rate and its acceleration.

    Parameters
    ----------
    shape : int
        MINIMUM_JERK, CRITICALLY_DAMPED or FIRST_ORDER.
    offset, rate, acceleration : float
        At the begin [rad], [rad/s], [rad/s2]. A filter goes on as far as its order allows: the first-order one from the
        offset, the critically damped one from offset and rate.
    time : float
        Since the begin [s].
    duration : float
        Time at which a minimum-jerk motion ends, and at which 2 % of the offset are left in a filter that began at rest
        [s].
    """
    if shape == FIRST_ORDER:
        return first_order_offset(offset, time, duration)
    if shape == CRITICALLY_DAMPED:
        return critically_damped_offset(offset, rate, time, duration)
    return minimum_jerk_offset(offset, rate, acceleration, time, duration)


@compiled
def first_order_offset(offset: float, time: float, duration: float) -> tuple[float, float, float]:
    """Return what a first-order filter leaves of an offset; see `remaining_offset`."""
    pace = _TIME_CONSTANTS / duration
    left = offset * math.exp(-pace * time)
    return left, -pace * left, pace * pace * left


@compiled
def critically_damped_offset(offset: float, rate: float, time: float, duration: float) -> tuple[float, float, float]:
    """Return what a critically damped filter leaves of an offset; see `remaining_offset`."""
    pace = _DOUBLE_TIME_CONSTANTS / duration
    slope, decay = rate + pace * offset, math.exp(-pace * time)
    left = (offset + slope * time) * decay
    speed = slope * decay - pace * left
    return left, speed, -pace * (slope * decay + speed)


@compiled
def minimum_jerk_offset(
    offset: float, rate: float, acceleration: float, time: float, duration: float
) -> tuple[float, float, float]:
    """Return what is left of an offset on its minimum-jerk way to zero; see `remaining_offset`."""
    t = min(time / duration, 1.0)
    a, b, c = offset, rate * duration, acceleration * duration * duration
    c3 = -10.0 * a - 6.0 * b - 1.5 * c
    c4 = 15.0 * a + 8.0 * b + 1.5 * c
    c5 = -6.0 * a - 3.0 * b - 0.5 * c
    value = a + t * (b + t * (0.5 * c + t * (c3 + t * (c4 + t * c5))))
    slope = b + t * (c + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    curvature = c + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    left = 0.0 if t >= 1.0 else 1.0  # as a factor: a branch would prevent vectorisation
    return left * value, left * slope / duration, left * curvature / (duration * duration)


@compiled
def remaining_jerk(shape: int, offset: float, rate: float, acceleration: float, time: float, duration: float) -> float:
    """Return the jerk [rad/s3] of an offset on its way to zero; the parameters are those of `remaining_offset`."""
    if shape != MINIMUM_JERK:
        _, rate, acceleration = remaining_offset(shape, offset, rate, acceleration, time, duration)
        if shape == FIRST_ORDER:
            return -_TIME_CONSTANTS / duration * acceleration
        pace = _DOUBLE_TIME_CONSTANTS / duration
        return -pace * (2.0 * acceleration + pace * rate)
    if time >= duration:
        return 0.0
    t = time / duration
    a, b, c = offset, rate * duration, acceleration * duration * duration
    c3 = -10.0 * a - 6.0 * b - 1.5 * c
    c4 = 15.0 * a + 8.0 * b + 1.5 * c
    c5 = -6.0 * a - 3.0 * b - 0.5 * c
    return (6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)) / (duration * duration * duration)
