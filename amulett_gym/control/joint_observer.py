"""Observer of the joint's motion and of the disturbance that acts on it (extended state observer, Han, 2009).

It predicts the joint angle by the acceleration of eq. 1, whose string forces are estimated, plus a disturbance that is
taken as constant, and corrects all three by the measured angle: with gains of a critically damped filter, so that one
bandwidth sets them. A rate from the encoder alone has several times the noise at the same delay. The disturbance, as an
acceleration, holds pushes, contact, payload and errors of the model.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def observe(
    angle: float, velocity: float, acceleration: float, measured: float, bandwidth: float, period: float
) -> tuple[float, float, float]:
    """Return the joint's angle [rad], its rate [rad/s] and the change of the disturbance [rad/s2].

    Parameters
    ----------
    angle, velocity, acceleration : float
        The last estimates [rad], [rad/s], [rad/s2]; the acceleration includes the disturbance.
    measured : float
        Joint angle [rad].
    bandwidth : float
        Of the correction [rad/s].
    period : float
        Since the last estimates [s].
    """
    kept = 1.0 / (1.0 + bandwidth * period)
    lost = 1.0 - kept
    predicted = angle + period * (velocity + 0.5 * period * acceleration)
    missed = measured - predicted
    return (
        predicted + (1.0 - kept * kept * kept) * missed,
        velocity + period * acceleration + 1.5 * lost * lost * (1.0 + kept) * missed / period,
        lost * lost * lost * missed / (period * period),
    )
