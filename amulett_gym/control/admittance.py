"""Intent control: the setpoint follows the torque by which a wearer moves the exoskeleton (admittance).

The rate of the setpoint is proportional to the torque beyond a dead band; a share of the joint's own rate is carried
on, so that the wearer need not push during a whole motion. The assistance, 0 to 1, scales both: with 0 the device
yields slowly, and holds its place against a load.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def setpoint_rate(
    torque: float, velocity: float, assistance: float, gain: float, rest_gain: float, carry: float, dead_band: float
) -> float:
    """Return the rate of the position setpoint [rad/s].

    Parameters
    ----------
    torque : float
        Of the wearer on the exoskeleton, with its lead [N m].
    velocity : float
        Measured rate of the joint [rad/s].
    assistance : float
        In [0, 1].
    gain, rest_gain : float
        G at an assistance of 1 and of 0 [rad/(s N m)].
    carry : float
        Share of the joint's rate at an assistance of 1 [1].
    dead_band : float
        Torque that is ignored [N m].
    """
    beyond = torque - min(max(torque, -dead_band), dead_band)
    return (rest_gain + assistance * (gain - rest_gain)) * beyond + assistance * carry * velocity
