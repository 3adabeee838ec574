"""The PID controller."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def filtered_derivative(derivative: float, change: float, gain: float, time_constant: float, period: float) -> float:
    """Return the next value of ``gain d/dt`` behind a first-order filter (backward Euler).

    Parameters
    ----------
    derivative : float
        The previous value.
    change : float
        Change of the signal since the previous tick.
    gain : float
        K_d [s].
    time_constant : float
        Of the filter [s]; 0 gives the plain difference quotient.
    period : float
        Time between ticks [s].
    """
    return (time_constant * derivative + gain * change) / (time_constant + period)


@compiled
def integrate(
    integral: float, error: float, gain: float, period: float, headroom_up: bool, headroom_down: bool
) -> float:
    """Return the next integral term; it stays where it is when the output it drives has no room that way (anti-windup).

    Parameters
    ----------
    integral : float
        The previous value, in the output's unit.
    error : float
        Setpoint minus actual value.
    gain : float
        K_i [1/s].
    period : float
        Time between ticks [s].
    headroom_up, headroom_down : bool
        Whether the output may still rise, fall.
    """
    if (error > 0.0 and not headroom_up) or (error < 0.0 and not headroom_down):
        return integral
    return integral + gain * error * period
