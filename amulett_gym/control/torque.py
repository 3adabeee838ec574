"""Joint torque control (the paper's outlook, section 5.2): the setpoint is a torque, zero torque is transparency.

The springs make the strings' forces a measured torque, tau^ = R_2 (F_1^ - F_2^). Both drives turn together to change it
and with the joint, so that its motion does not; they turn apart for the co-contraction, which is fed forward ::

    e_s' = (tau_d - tau^) / (T_t r K^) + v / r,   r = R_1 / R_2

where r K^ is the torque by the drives' common turn, K^ the joint's stiffness. The setpoint comes from a virtual spring
and damper about the reference motion (impedance control), and compensates the bare arm's weight ::

    tau_d = K_v (x_r - x) + D_v (x_r' - x') + M_m sin(x) + tau_0

tau_0 is the torque at rest at the start, such as a payload's or the estimate's error: like a force sensor, the estimate
is tared there. With K_v = D_v = 0 the arm follows whatever pushes it. What the push still feels is the arm's inertia,
the strings' friction, and what the drives' delay leaves. Without a spring nothing holds the arm either: an error of the
estimate moves it like a push. The sliders' noise alone moves the testbed's arm by up to 9 deg in 3 s.

The loop estimates string forces itself, without the floor of 5 N (`control.force_estimate`): with it, a string below
5 N reads as 5 N, and the torque estimate is off by up to R_2 5 N = 0.2 N m on the testbed, half of what the strings can
give. Any co-contraction, down to slack strings, can therefore be chosen; 8 N keeps both strings taut up to a torque of
0.3 N m.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def desired_torque(
    error: float, error_rate: float, stiffness: float, damping: float, load: float, most: float
) -> float:
    """Return the torque setpoint [N m] of the virtual spring and damper, limited to what the strings can give.

    Parameters
    ----------
    error, error_rate : float
        Reference minus measured joint angle [rad], and its rate [rad/s].
    stiffness, damping : float
        K_v [N m/rad], D_v [N m s/rad].
    load : float
        Torque that is compensated, M_m sin(x) + tau_0 [N m].
    most : float
        Largest torque, f_max R_2 [N m].
    """
    return min(max(stiffness * error + damping * error_rate + load, -most), most)


@compiled
def common_rate(
    missing: float, velocity: float, stiffness: float, time_constant: float, drive_radius: float, joint_radius: float
) -> float:
    """Return the rate of both drives [rad/s] at which the torque approaches its setpoint.

    Parameters
    ----------
    missing : float
        tau_d - tau^ [N m].
    velocity : float
        Of the joint [rad/s].
    stiffness : float
        K^, of the joint [N m/rad], positive.
    time_constant : float
        T_t [s].
    drive_radius, joint_radius : float
        R_1, R_2 [m].
    """
    return (missing / (time_constant * stiffness) + velocity) * joint_radius / drive_radius
