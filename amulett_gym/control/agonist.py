"""Which drive is the agonist: the one that contributes more force to the motion."""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled

BICEPS = 1.0
TRICEPS = -1.0


@compiled
def select_agonist(
    agonist: float, difference: float, error: float, hysteresis: float, tie_width: float, tie_error: float
) -> float:
    """Return the agonist for this tick: +1 biceps, -1 triceps (section 2.2).

    The drive whose spring is deflected more, by over `hysteresis`, is the agonist. Deflections within `tie_width` are
    equal: then the direction of the desired motion decides, if the position error is at least `tie_error`. In all other
    cases the agonist stays the one it was, so that noise does not make it chatter.

    At rest, and without a load, both springs are deflected alike, and the agonist stays the last one. So a step the
    other way switches in the very tick in which eq. 6 drops its setpoint, and the tension controller, restarting on the
    other string, never sees that drop: flexion and extension are mirrored under a constant tension, not quite under
    eq. 6.

    Parameters
    ----------
    agonist : float
        The present agonist.
    difference : float
        Measured deflection of the biceps' linear springs minus that of the triceps' [m].
    error : float
        Position setpoint minus measured angle [rad].
    hysteresis, tie_width : float
        [m].
    tie_error : float
        [rad].
    """
    if difference > hysteresis:
        return BICEPS
    if difference < -hysteresis:
        return TRICEPS
    if abs(difference) <= tie_width and abs(error) >= tie_error and error != 0.0:
        return BICEPS if error > 0.0 else TRICEPS
    return agonist
