"""Feed-forward above, closed loops below ([11] Lenzi et al.): an inverse model, and PIDs of position and stiffness.

High level: from the reference motion and the stiffness asked for, the inverse model gives drive angles: the torque of
eq. 1 (`control.inverse_dynamics`), the string deflections that give it at the stiffness (`control.inverse_statics`),
and, at the low level, the commands that bring the drives there in spite of their lag (`control.drive_model`).

Low level: the PID of the position (`control.co_rotation`) turns both drives together, a PID of the stiffness apart, by

    theta_c = k_p e_K + k_i int e_K + k_d e_K',  e_K = K_ref - K^,  K^ = R_2^2 (f'(y_1^) + f'(y_2^))

with deflections by the sliders. K_ref is the stiffness of the high level's deflections, as late as the drives are.
Where the high level wants a string below the force floor, under which the sliders are not trusted (Figure 5b), e_K is 0
and the integral stays. A spring that is weaker than the model's is not noticed: the sliders measure its deflection.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def opening(error: float, error_rate: float, integral: float, kp: float, kd: float) -> float:
    """Return by how much the PID of the stiffness turns each drive against the other [rad].

    Parameters
    ----------
    error, error_rate : float
        Reference minus estimated stiffness [N m/rad], and its rate [N m/(rad s)].
    integral : float
        Integral term [rad].
    kp, kd : float
        Gains [rad2/(N m)], [rad2 s/(N m)].
    """
    return kp * error + integral + kd * error_rate
