"""Gains of the control loops of the literature: one group for each loop of `amulett_gym.control`.

A loop that is left out of a profile has the defaults, which hold for the testbed. `lead` and `factor` are relative to
the drives' lag, so that they also hold for drives with another lag; without lag they have no effect.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from amulett_gym.settings import Group, Sourced

Lead = Annotated[
    float, Field(ge=0, le=5, description="time by which the drives lead the reference, as a share of drives.lag [1]")
]
Factor = Annotated[float, Field(ge=1, le=1000)]
Filter = Annotated[float, Field(ge=0, le=1)]
Bandwidth = Annotated[float, Field(gt=0, le=1000)]
SliderTime = Annotated[float, Field(gt=0, le=100)]
Rate = Annotated[float, Field(gt=0, le=1000)]
SlopeFloor = Annotated[float, Field(gt=0, le=1)]


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

    lead: Lead = 1.0


class CoRotation(EquilibriumPoint):
    """Gains of `control.co_rotation`."""

    kp: float = Field(default=0.405, ge=0, le=100, description="drive angle by position error [1]")
    ki: float = Field(default=0.59, ge=0, le=1000, description="rate of the drive angle by position error [1/s]")
    kd: float = Field(default=0.0205, ge=0, le=10, description="drive angle by rate of the position error [s]")
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class TorqueStiffness(Following):
    """Gains of `control.torque_stiffness`."""

    integral_weight: float = Field(
        default=20.0, ge=0, le=1e9, description="q_0, weight of the position error's integral [1/(rad s)2]"
    )
    angle_weight: float = Field(default=15.0, gt=0, le=1e9, description="q_1, weight of the position error [1/rad2]")
    rate_weight: float = Field(default=0.0, ge=0, le=1e9, description="q_2, weight of the error's rate [s2/rad2]")
    torque_weight: float = Field(default=1.0, gt=0, le=1e9, description="r, weight of the torque [1/(N m)2]")
    factor: Factor = Field(default=2.0, description="lambda, by which a drive is faster than its lag [1]")
    lead: Lead = 1.0
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class FeedforwardFeedback(CoRotation):
    """Gains of `control.feedforward_feedback`."""

    kp: float = Field(default=0.1, ge=0, le=100, description="drive angle by position error [1]")
    kd: float = Field(default=0.02, ge=0, le=10, description="drive angle by rate of the position error [s]")
    velocity_filter: Filter = Field(default=0.004, description="time constant of the measured joint rate [s]; 0: none")
    factor: Factor = Field(default=3.0, description="lambda, by which a drive is faster than its lag [1]")
    stiffness_kp: float = Field(default=0.004, ge=0, le=100, description="drive angle by stiffness error [rad2/(N m)]")
    stiffness_ki: float = Field(default=0.02, ge=0, le=1000, description="rate of it by stiffness error [rad2/(N m s)]")
    stiffness_kd: float = Field(
        default=0.0, ge=0, le=10, description="drive angle by rate of the stiffness error [rad2 s/(N m)]"
    )
    stiffness_filter: Filter = Field(default=0.1, description="time constant of the estimated stiffness [s]; 0: none")


class FeedbackLinearisation(EquilibriumPoint):
    """Gains of `control.feedback_linearisation`; only its feed-forward near slack strings has a lead."""

    bandwidth: Bandwidth = Field(default=25.0, description="triple pole of the position error [rad/s]")
    tension_bandwidth: float = Field(default=8.0, ge=0, le=1000, description="pole of the tension error [rad/s]")
    observer_bandwidth: Bandwidth = Field(default=80.0, description="of the joint's rate and its disturbance [rad/s]")
    slider_time: SliderTime = Field(default=0.15, description="time in which a slider corrects its string's force [s]")
    taut_force: float = Field(
        default=4.0, gt=0, le=1000, description="string force below which feed-forward takes over [N]"
    )
    slope_floor: SlopeFloor = Field(
        default=0.6, description="least slope of a spring, as a share of its largest force by largest deflection [1]"
    )
    most_rate: Rate = Field(default=18.0, description="largest rate that the loop asks of a drive [rad/s]")


class Torque(Following):
    """Gains of `control.torque`."""

    virtual_stiffness: float = Field(
        default=5.0, ge=0, le=1000, description="of the virtual spring [N m/rad]; 0, with no damping: transparency"
    )
    virtual_damping: float = Field(default=0.5, ge=0, le=100, description="of the virtual damper [N m s/rad]")
    torque_time: float = Field(default=0.03, gt=0, le=10, description="time constant of the torque [s]")
    observer_bandwidth: Bandwidth = Field(default=100.0, description="of the joint's rate and its disturbance [rad/s]")
    slider_time: SliderTime = Field(default=1.0, description="time in which a slider corrects its string's force [s]")
    slope_floor: SlopeFloor = Field(
        default=0.3, description="least slope of a spring, as a share of its largest force by largest deflection [1]"
    )
    most_rate: Rate = Field(default=20.0, description="largest rate that the loop asks of the drives [rad/s]")


class Cascade(EquilibriumPoint):
    """Gains of `control.cascade`."""

    kp: float = Field(default=7.39, ge=0, le=1e4, description="K_o, string force by position error [N/rad]")
    kd: float = Field(default=2.0, ge=0, le=1e3, description="K_v, string force by joint rate [N s/rad]")
    kf: float = Field(default=0.01, ge=0, le=10, description="k_f, turn of a drive by error of its force [rad/N]")
    ki: float = Field(default=2.82, ge=0, le=1000, description="rate of the drive angle by position error [1/s]")
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class ComputedTorque(EquilibriumPoint):
    """Gains of `control.computed_torque`."""

    kp: float = Field(default=1000.0, ge=0, le=1e6, description="k_p, acceleration by position error [1/s2]")
    kd: float = Field(default=5.0, ge=0, le=1e4, description="k_v, acceleration by rate of the position error [1/s]")
    ki: float = Field(default=4000.0, ge=0, le=1e8, description="k_i, jerk by position error [1/s3]")
    factor: float = Field(default=1.4, gt=0, le=100, description="lambda, by which a drive is faster than its lag [1]")
    least_tension: float = Field(default=0.5, ge=0, le=1000, description="smallest co-contraction of the strings [N]")
    velocity_filter: Filter = Field(default=0.01, description="time constant of the measured joint rate [s]; 0: none")


class MinimalMotion(ComputedTorque):
    """Gains of `control.minimal_motion`, which differs from computed torque in the drive angles that it chooses."""


def group_name(control: str) -> str:
    """Return the name of a loop's group in `Loops`."""
    return control.replace("-", "_")


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
    feedback_linearisation: FeedbackLinearisation = Field(
        default=FeedbackLinearisation(), description="jerk and mean tension decoupled"
    )
    torque: Torque = Field(default=Torque(), description="joint torque of a virtual spring and damper")
    cascade: Cascade = Field(default=Cascade(), description="position, then string forces, on a feed-forward")
    computed_torque: ComputedTorque = Field(default=ComputedTorque(), description="computed torque on two levels")
    minimal_motion: MinimalMotion = Field(default=MinimalMotion(), description="computed torque with the least motion")
