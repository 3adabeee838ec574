"""Optimal torque and stiffness ([8] Huang et al., first approach): as if both were commanded directly, independently.

Then the joint is a double integrator of its error, J e'' = -tau with e = r_x - x, and the linear quadratic regulator of

    int q_0 (int e)^2 + q_1 e^2 + q_2 e'^2 + r tau^2 dt

is tau = k_0 int e + k_1 e + k_2 e'; the integral is an addition, against errors of the model. The torque that the
reference motion needs by the model is added. Inverse statics at the measured angle turn torque and stiffness into drive
angles, and the inverse of the drives' model turns those into commands: u = e + lambda (e_d - e) + T r_x'/r. It is the
reference's rate that is led, not the measured one, whose noise T/r amplifies. Nor is the measured one taken where the
position error asks for more torque than the springs give (`control.computed_torque.followed_rate`): this would hardly
change the motion, and increase the effort of the commands on contact.

The strings' stiffness K resists fast pushes only: the torque does not depend on the angle but by the regulator, so a
lasting push meets k_1, then the integral. What is left of the drives' lag, T/lambda, limits the regulator: without
friction and integral, the closed loop is stable for k_1 < K + k_2 lambda/T. So soft strings take small gains only, and
where both are almost slack (below 2 N on the testbed) the joint oscillates about its setpoint by some degrees.
"""

from __future__ import annotations

import math


def regulator_gains(
    integral_weight: float, angle_weight: float, rate_weight: float, torque_weight: float, inertia: float
) -> tuple[float, float, float]:
    """Return the regulator's gains k_0 [N m/(rad s)], k_1 [N m/rad], k_2 [N m s/rad].

    The return difference |J s^3 + k_2 s^2 + k_1 s + k_0|^2 has to be the cost's -J^2 s^6 + (q_2 s^4 - q_1 s^2 + q_0)/r:

        k_0 = sqrt(q_0/r),  k_1 = sqrt(q_1/r + 2 k_0 k_2),  k_2 = sqrt(q_2/r + 2 J k_1)

    Without a weight of the integral that is the closed form of the double integrator's Riccati equation, k_1 =
    sqrt(q_1/r), k_2 = sqrt((q_2 + 2 J sqrt(q_1 r))/r). With one, each insertion of k_1 and k_2 into the other takes
    three quarters of the logarithm of the error away.

    Parameters
    ----------
    integral_weight, angle_weight, rate_weight, torque_weight : float
        q_0 [1/(rad s)2], q_1 [1/rad2], q_2 [s2/rad2], r [1/(N m)2].
    inertia : float
        J [kg m2].
    """
    of_integral, of_angle, of_rate = math.sqrt(integral_weight / torque_weight), 0.0, 0.0
    for _ in range(40):
        of_angle = math.sqrt(angle_weight / torque_weight + 2.0 * of_integral * of_rate)
        of_rate = math.sqrt(rate_weight / torque_weight + 2.0 * inertia * of_angle)
    return of_integral, of_angle, of_rate
