"""Cascade ([9] Fasel et al.): an outer loop of the joint position asks the string forces, an inner loop winds for them.

The outer loop asks the agonist for a force beyond the co-contraction ``sigma``::

    dF = K_o (r_x - x) - K_v v
    F_1d = sigma + max(dF + M_m sin(r_x) / R_2, 0),  F_2d = sigma + max(-dF - M_m sin(r_x) / R_2, 0)

with sigma lowered where the springs' largest force leaves too little for the difference. The inner loop winds each
drive by the error of its estimated force, ``k_f (F_d - F^)``, on top of the feed-forward of equilibrium-point control.
An integral of the position error turns both drives. The inner loop of [9] has a derivative as well; here the noise of
the sliders and the low-pass of the force estimate leave it nothing to improve.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def force_difference(error: float, velocity: float, kp: float, kd: float) -> float:
    """Return dF, the force of the biceps minus that of the triceps [N] that the outer loop asks for.

    Parameters
    ----------
    error : float
        Reference minus measured joint angle [rad].
    velocity : float
        Rate of the joint [rad/s].
    kp, kd : float
        K_o [N/rad], K_v [N s/rad].
    """
    return kp * error - kd * velocity


@compiled
def winding(wanted: float, estimate: float, untrusted: bool, kf: float) -> float:
    """Return the turn [rad] by which a drive winds its string for the error of the force.

    An estimate below the floor of the sensors (`untrusted`) says only that the force is not more than it.

    Parameters
    ----------
    wanted, estimate : float
        String forces F_d, F^ [N].
    untrusted : bool
        Whether the estimate is below the floor.
    kf : float
        Gain [rad/N].
    """
    error = wanted - estimate
    return 0.0 if untrusted and error < 0.0 else kf * error
