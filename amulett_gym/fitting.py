"""How an exoskeleton is fitted to a wearer: cuff, torque sensor, cables, and the admittance that follows the wearer.

The group `wearer` of a profile. No device of the paper was worn, so all values are assumed or of the literature.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from amulett_gym.settings import Group, Sourced

Positive = Annotated[float, Field(gt=0)]


class Cuff(Sourced):
    """The cuff on the forearm, about the elbow."""

    stiffness: float = Field(default=80.0, ge=0, le=10_000, description="[N m/rad]; 0: no contact")
    damping: float = Field(default=0.8, ge=0, le=100, description="[N m s/rad]")
    slack_deg: float = Field(default=0.0, ge=0, le=90, description="play between the cuff's two sides [deg]")


class TorqueSensor(Sourced):
    """The sensor of the cuff's torque on the exoskeleton."""

    noise: float = Field(default=0.01, ge=0, le=10, description="standard deviation [N m]")
    filter: float = Field(default=0.01, ge=0, le=1, description="time constant of its low-pass [s]; 0: none")
    resolution: float = Field(default=0.0, ge=0, le=10, description="least step [N m]; 0: exact")


class Cable(Sourced):
    """Bowden cables that lead both strings (`amulett_gym.model.cable`)."""

    friction: float = Field(default=0.0, ge=0, le=1, description="mu, string on sheath [1]; 0: no cable")
    bend_biceps_deg: float = Field(default=180.0, ge=0, le=1440, description="theta, total bend of the sheath [deg]")
    bend_triceps_deg: float = Field(default=180.0, ge=0, le=1440, description="theta, total bend of the sheath [deg]")
    presliding: float = Field(default=3e-4, ge=1e-6, le=0.1, description="way of the string before it slides [m]")
    side: Literal["joint", "drive"] = Field(
        default="joint",
        description="where the cables are: joint, between spring and joint, where the force estimate does not see "
        "their friction; drive, between drive and spring, where it only loads the drives: these need a "
        "drives.stall_torque and a drives.lag",
    )


class Admittance(Sourced):
    """The setpoint's rate: ``(rest_gain + a (gain - rest_gain)) db(tau + lead tau') + a carry v``, db a dead band.

    a is the assistance, tau the measured torque of the wearer on the exoskeleton, v the joint's measured rate.
    """

    gain: float = Field(default=0.7, ge=0, le=1000, description="G at full assistance [rad/(s N m)]")
    rest_gain: float = Field(default=0.0, ge=0, le=1000, description="G without assistance [rad/(s N m)]")
    carry: float = Field(default=0.92, ge=0, le=5, description="c at full assistance, share of the joint's rate [1]")
    lead: float = Field(default=0.2, ge=0, le=2, description="lead time of the torque [s]")
    rate_filter: float = Field(default=0.02, ge=1e-6, le=10, description="time constant of the torque's rate [s]")
    dead_band: float = Field(default=0.03, ge=0, le=10, description="torque that is ignored [N m]")


class Fitting(Group):
    """How the device is worn."""

    cuff: Cuff = Field(default=Cuff(), description="cuff on the forearm")
    torque_sensor: TorqueSensor = Field(default=TorqueSensor(), description="sensor of the cuff's torque")
    cable: Cable = Field(default=Cable(), description="Bowden cables of both strings")
    admittance: Admittance = Field(default=Admittance(), description="how the setpoint follows the cuff's torque")
