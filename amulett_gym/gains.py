"""Gains of the control loops of the literature: one group for each loop of `amulett_gym.control`.

A loop that is left out of a profile has the defaults, which hold for the testbed.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from amulett_gym.settings import Group, Sourced

Lead = Annotated[float, Field(ge=0, le=1)]
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


class Loops(Group):
    """Gains of all loops but the paper's, which are in `loop`."""

    equilibrium_point: EquilibriumPoint = Field(default=EquilibriumPoint(), description="feed-forward alone")
    co_rotation: CoRotation = Field(default=CoRotation(), description="feed-forward with a PID of the joint position")
