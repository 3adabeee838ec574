"""Equation 6: the hand-tuned law that scales the desired string tension by the position error."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def scaling_factor(error: float, nominal: float, minimum: float, error_offset: float) -> float:
    """Return f_sigma of eq. 6 as the paper's text describes it: 1 at no error, minimum/nominal at `error_offset`.

    The printed equation lost the shift by d_offset; with it the factor is smallest *at* d_offset, and beyond it the
    factor stays there.

    Parameters
    ----------
    error : float
        phi_Setpoint - phi; unit as `error_offset`.
    nominal, minimum : float
        sigma and sigma_min [N].
    error_offset : float
        d_offset.
    """
    lowest = minimum / nominal
    distance = max(1.0 - abs(error) / error_offset, 0.0)
    return (1.0 - lowest) * distance**4 + lowest


@compiled
def scaling_factor_printed(error: float, nominal: float, minimum: float, error_offset: float) -> float:
    """Return f_sigma exactly as eq. 6 is printed, clipped to 1: minimum/nominal at no error, 1 at `error_offset`."""
    lowest = minimum / nominal
    return min((1.0 - lowest) * (abs(error) / error_offset) ** 4 + lowest, 1.0)
