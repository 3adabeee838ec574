"""Computed torque on two levels ([7] Li et al.).

The high level computes the joint torque that gives the error of the position linear dynamics, and the drive angles
``e_d`` at which the strings give it with the co-contraction asked for (`control.inverse_statics` at the measured
angle)::

    tau_d = J (r_x'' + k_v (r_x' - v) + k_p e + k_i int e) + 2 delta J r_x' + M_m sin(x)

The damping torque compensates friction, with delta of Figure 3 at the co-contraction asked for. Where the springs'
largest force leaves too little for the torque, the co-contraction is lowered, but not below `least_tension`; delta
stays. The integral stops where the springs give no more torque.

The low level brings each drive there by the inverse of its model (`control.drive_model`), since the device does not
measure its drives::

    u = e^ + lambda (e_d - e^) + T_l r_x' / r,  r = R_1 / R_2

The feed-forward lets the drives follow the joint, with which ``e_d`` moves. With the measured rate instead of the
reference's it repeats the noise of that rate, and the step of the paper takes 0.24 s instead of 0.16 s. But where the
position error alone asks for more torque than the springs give, as after an obstacle, the joint is far from its
reference, and the measured rate is taken. Of the low level's PID in [7] only the proportional term is left: the model
has no error at rest, and the feed-forward is the derivative.

The drives lag by T / lambda, so the joint oscillates unless ``k_p J`` is less than its stiffness. Slack strings give
none, therefore the co-contraction is at least `least_tension`.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def wanted_acceleration(
    acceleration: float, error_rate: float, error: float, integral: float, kd: float, kp: float
) -> float:
    """Return the acceleration of the joint [rad/s2] that makes the error of the position decay.

    Parameters
    ----------
    acceleration : float
        r_x'', of the reference [rad/s2].
    error_rate, error : float
        Reference minus measured rate [rad/s] and angle [rad].
    integral : float
        Integral term [rad/s2].
    kd, kp : float
        k_v [1/s], k_p [1/s2].
    """
    return acceleration + kd * error_rate + kp * error + integral


@compiled
def followed_rate(reference_rate: float, velocity: float, torque: float, most: float) -> float:
    """Return the rate [rad/s] at which the drives follow the joint: the reference's, and the measured one far from it.

    Parameters
    ----------
    reference_rate, velocity : float
        Of the reference, and measured [rad/s].
    torque : float
        Torque that the position error asks for [N m].
    most : float
        Largest torque that the springs give [N m]; up to it the reference's rate counts, from twice that the measured.
    """
    share = min(max(abs(torque) / most - 1.0, 0.0), 1.0) if most > 0.0 else 1.0
    return reference_rate + share * (velocity - reference_rate)
