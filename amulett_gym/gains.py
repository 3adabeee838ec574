"""Gains of the control loops of the literature: one group for each loop of `amulett_gym.control`.

A loop that is left out of a profile has the defaults, which hold for the testbed.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from amulett_gym.settings import Group, Sourced

Lead = Annotated[float, Field(ge=0, le=1)]
Factor = Annotated[float, Field(ge=1, le=1000)]
Filter = Annotated[float, Field(ge=0, le=1)]


class Following(Sourced):
    """How a loop's reference follows a jump of the setpoint (`control.reference_motion`)."""

    reference: Literal["minimum-jerk", "critically-damped", "first-order"] = Field(
        default="minimum-jerk", description="shape of the answer to a jump of the setpoint"
    )
    reference_time: float = Field(
        default=0.21,
        ge=0.01,
        le=10,
        description="duration of a minimum-jerk answer, or time until 2 % are left of a filter's [s]",
    )


class EquilibriumPoint(Following):
    """Gains of `control.equilibrium_point`."""

    lead: Lead = Field(default=0.135, description="time by which the drives lead the reference, against their lag [s]")


class CoRotation(EquilibriumPoint):
    """Gains of `control.co_rotation`."""

    kp: float = Field(default=0.405, ge=0, le=100, description="drive angle by position error [1]")
    ki: float = Field(default=0.59, ge=0, le=1000, description="rate of the drive angle by position error [1/s]")
    kd: float = Field(default=0.0205, ge=0, le=10, description="drive angle by rate of the position error [s]")
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class TorqueStiffness(Following):
    """Gains of `control.torque_stiffness`."""

    integral_weight: float = Field(
        default=100.0, ge=0, le=1e9, description="q_0, weight of the position error's integral [1/(rad s)2]"
    )
    angle_weight: float = Field(default=50.0, gt=0, le=1e9, description="q_1, weight of the position error [1/rad2]")
    rate_weight: float = Field(default=0.0, ge=0, le=1e9, description="q_2, weight of the error's rate [s2/rad2]")
    torque_weight: float = Field(default=1.0, gt=0, le=1e9, description="r, weight of the torque [1/(N m)2]")
    factor: Factor = Field(default=3.0, description="lambda, by which a drive is faster than its lag [1]")
    lead: Lead = Field(default=0.141, description="lag of the drives, by which they lead the reference [s]")
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class FeedforwardFeedback(CoRotation):
    """Gains of `control.feedforward_feedback`."""

    lead: Lead = Field(default=0.141, description="lag of the drives, by which they lead the reference [s]")
    factor: Factor = Field(default=4.0, description="lambda, by which a drive is faster than its lag [1]")
    stiffness_kp: float = Field(default=0.004, ge=0, le=100, description="drive angle by stiffness error [rad2/(N m)]")
    stiffness_ki: float = Field(default=0.02, ge=0, le=1000, description="rate of it by stiffness error [rad2/(N m s)]")
    stiffness_kd: float = Field(
        default=0.0, ge=0, le=10, description="drive angle by rate of the stiffness error [rad2 s/(N m)]"
    )
    stiffness_filter: Filter = Field(default=0.1, description="time constant of the estimated stiffness [s]; 0: none")


class Loops(Group):
    """Gains of all loops but the paper's, which are in `loop`."""

    equilibrium_point: EquilibriumPoint = Field(default=EquilibriumPoint(), description="feed-forward alone")
    co_rotation: CoRotation = Field(default=CoRotation(), description="feed-forward with a PID of the joint position")
    torque_stiffness: TorqueStiffness = Field(
        default=TorqueStiffness(), description="regulator of the joint torque, at a joint stiffness"
    )
    feedforward_feedback: FeedforwardFeedback = Field(
        default=FeedforwardFeedback(), description="inverse model, with PIDs of position and stiffness"
    )
