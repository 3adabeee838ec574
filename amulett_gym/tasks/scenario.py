"""One episode as plain data: setpoint moves, pushes, an obstacle, a payload, the posture at the start.

A scenario can be written as JSON, read back and replayed bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from amulett_gym.config import Group, Profile, describe
from amulett_gym.errors import AmulettError
from amulett_gym.files import read_text
from amulett_gym.simulation.layout import MAX_MOVES, MAX_PUSHES, SCENARIO, arm_torques

_DIGITS = 9  # of angles in degrees: suites sample far coarser, so that packing and unpacking loses nothing


class Move(Group):
    """A move of the position setpoint: a step, or a minimum-jerk reach."""

    time: float = Field(ge=0, description="when it begins [s]; acts from the first control tick at or after it")
    angle_deg: float = Field(ge=-180, le=180, description="where it goes [deg]")
    duration: float = Field(default=0.0, ge=0, description="[s]; 0: a step")


class Push(Group):
    """A constant external torque for a while."""

    time: float = Field(ge=0, description="when it begins [s]; acts from the first control tick at or after it")
    duration: float = Field(gt=0, description="[s]")
    torque: float = Field(ge=-100, le=100, description="positive in flexion [N m]")


class Obstacle(Group):
    """Something compliant in the way of the forearm."""

    angle_deg: float = Field(ge=-180, le=180, description="where it begins [deg]")
    blocks: Literal["flexion", "extension"] = "flexion"
    stiffness: float = Field(gt=0, le=10_000, description="[N m/rad]")
    damping: float = Field(default=0.0, ge=0, le=100, description="[N m s/rad]")


class Payload(Group):
    """A point mass carried by the forearm."""

    mass: float = Field(ge=0, le=20, description="[kg]")
    arm: float = Field(ge=0, le=1, description="lever arm about the joint [m]")


class Scenario(Group):
    """Everything about an episode that is not the device."""

    initial_angle_deg: float = Field(default=0.0, ge=-180, le=180, description="at rest there at the start [deg]")
    initial_tension: float | None = Field(
        default=None, gt=0, description="of the antagonist at the start [N]; null: the profile's nominal tension"
    )
    moves: list[Move] = Field(default=[], max_length=MAX_MOVES)
    pushes: list[Push] = Field(default=[], max_length=MAX_PUSHES)
    obstacle: Obstacle | None = None
    payload: Payload | None = None
    measure_from: float = Field(
        default=0.0,
        ge=0,
        description="metrics, rewards and setpoint steps count from here [s]; before, the arm settles",
    )
    noise_seed: int | None = Field(
        default=None, ge=0, lt=2**64, description="key of the sensor noise; null: drawn by the environment"
    )

    @model_validator(mode="after")
    def _check_order(self) -> Scenario:
        for before, after in zip(self.moves, self.moves[1:], strict=False):
            if after.time < before.time + before.duration - 1e-9:  # a sum of decimals may end a bit late
                raise ValueError(
                    f"the move at {after.time} s begins before the one at {before.time} s has ended, "
                    f"{before.time + before.duration} s"
                )
        return self


def load_scenario(scenario: str | Path | Mapping[str, Any] | Scenario) -> Scenario:
    """Read and validate a scenario from a JSON file, a mapping, or as it is.

    Raises
    ------
    AmulettError
        If the file cannot be read or a key or value is wrong.
    """
    if isinstance(scenario, Scenario):
        return scenario
    what = "scenario"
    if isinstance(scenario, str | Path):
        what = f"scenario '{scenario}'"
        try:
            content = read_text(scenario, "scenario")
            scenario = json.loads(content)
        except (ValueError, RecursionError) as error:
            raise AmulettError(f"{what} is not valid JSON: {error}") from error
    try:
        return Scenario.model_validate(scenario)
    except ValidationError as error:
        raise describe(error, Scenario, what) from error


def pack(scenario: Scenario, profile: Profile) -> NDArray[np.void]:
    """Turn a scenario into the record that the simulation reads, in SI units and radians.

    Returns
    -------
    ndarray of `simulation.layout.SCENARIO`, shape (1,)

    Raises
    ------
    AmulettError
        If the initial angle is beyond the profile's limit, or the obstacle is too stiff for the integration step.
    """
    limit = profile.plant.angle_limit_deg
    if abs(scenario.initial_angle_deg) >= limit:
        raise AmulettError(
            f"scenario: 'initial_angle_deg' is {scenario.initial_angle_deg}; the device's limit is +-{limit} deg"
        )
    row = empty_rows(1, profile)
    row["initial_angle"] = np.radians(scenario.initial_angle_deg)
    if scenario.initial_tension is not None:
        row["initial_tension"] = scenario.initial_tension
    if scenario.payload is not None:
        row["payload_mass"], row["payload_arm"] = scenario.payload.mass, scenario.payload.arm
        row["inertia"], row["static_torque"] = arm_torques(profile, scenario.payload.mass, scenario.payload.arm)
    row["move_count"] = len(scenario.moves)
    for k, move in enumerate(scenario.moves):
        row["move_time"][0, k] = move.time
        row["move_angle"][0, k] = np.radians(move.angle_deg)
        row["move_duration"][0, k] = move.duration
    row["push_count"] = len(scenario.pushes)
    for k, push in enumerate(scenario.pushes):
        row["push_time"][0, k] = push.time
        row["push_duration"][0, k] = push.duration
        row["push_torque"][0, k] = push.torque
    if scenario.obstacle is not None:
        row["obstacle_angle"] = np.radians(scenario.obstacle.angle_deg)
        row["obstacle_side"] = 1.0 if scenario.obstacle.blocks == "flexion" else -1.0
        row["obstacle_stiffness"] = scenario.obstacle.stiffness
        row["obstacle_damping"] = scenario.obstacle.damping
    row["measure_from"] = scenario.measure_from
    if scenario.noise_seed is not None:
        row["noise_key"] = scenario.noise_seed
    if scenario.obstacle is not None:
        _check_stiffness(scenario.obstacle, float(row["inertia"][0]), profile)
    return row


def unpack(row: NDArray[np.void] | np.void) -> Scenario:
    """Turn a packed record back into a scenario; packing it again gives the same record."""

    def degrees(angle: Any) -> float:
        return round(float(np.degrees(angle)), _DIGITS)

    obstacle = payload = None
    if row["obstacle_stiffness"] > 0:
        obstacle = Obstacle(
            angle_deg=degrees(row["obstacle_angle"]),
            blocks="flexion" if row["obstacle_side"] > 0 else "extension",
            stiffness=float(row["obstacle_stiffness"]),
            damping=float(row["obstacle_damping"]),
        )
    if row["payload_mass"] > 0:
        payload = Payload(mass=float(row["payload_mass"]), arm=float(row["payload_arm"]))
    return Scenario(
        initial_angle_deg=degrees(row["initial_angle"]),
        initial_tension=float(row["initial_tension"]),
        moves=[
            Move(
                time=float(row["move_time"][k]),
                angle_deg=degrees(row["move_angle"][k]),
                duration=float(row["move_duration"][k]),
            )
            for k in range(int(row["move_count"]))
        ],
        pushes=[
            Push(
                time=float(row["push_time"][k]),
                duration=float(row["push_duration"][k]),
                torque=float(row["push_torque"][k]),
            )
            for k in range(int(row["push_count"]))
        ],
        obstacle=obstacle,
        payload=payload,
        measure_from=float(row["measure_from"]),
        noise_seed=int(row["noise_key"]),
    )


def _check_stiffness(obstacle: Obstacle, inertia: float, profile: Profile) -> None:
    """Refuse an obstacle that the integration step cannot resolve.

    A step may cover half a radian of the swing on the obstacle, and a tenth of the damping's time constant: damping
    makes the torque jump at contact, in the middle of a step.
    """
    step = profile.loop.control_period / profile.loop.substeps
    for key, value, most in (
        ("stiffness", obstacle.stiffness, 0.25 * inertia / step**2),
        ("damping", obstacle.damping, 0.1 * inertia / step),
    ):
        if value > most:
            raise AmulettError(
                f"scenario: 'obstacle.{key}' is {value}; with an inertia of {inertia:.4g} kg m2 and {step:g} s steps "
                f"at most {most:.4g} is possible (more loop.substeps allow more)"
            )


def empty_rows(count: int, profile: Profile) -> NDArray[np.void]:
    """Return `count` packed scenarios in which nothing happens: the bare arm at rest at 0 deg."""
    rows = np.zeros(count, dtype=SCENARIO)
    rows["initial_tension"] = profile.variable_stiffness.nominal_tension
    rows["inertia"], rows["static_torque"] = arm_torques(profile)
    return rows
