"""What a picture shows of one device at one moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from amulett_gym import FAILURES
from amulett_gym.envs.episodes import Episodes
from amulett_gym.simulation.batch import max_force, max_stiffness
from amulett_gym.simulation.dynamics import joint_stiffness, stretch_biceps, stretch_triceps
from amulett_gym.simulation.layout import LANES
from amulett_gym.simulation.worn_batch import WornSimulation

STRIP_SECONDS = 5.0
"""Length of the curves below the arm [s]."""


@dataclass(frozen=True)
class WearerFrame:
    """The true state of the arm that wears the device."""

    elbow_angle: float  # flexion is positive [rad]
    intention: float | None  # what the wearer wants the elbow's angle to be [rad]; None if the device guides the arm
    flexor: float  # activations, 0 to 1
    extensor: float
    cuff_torque: float | None  # of the device on the elbow [N m]; None if the arm is outside the device
    assistance: float  # how much the device follows the wearer, 0 to 1


@dataclass(frozen=True)
class Frame:
    """What a picture shows of one device at one moment: the true state, not the sensors' readings."""

    time: float  # since the start of the episode [s]
    joint_angle: float  # x_a, flexion is positive [rad]
    setpoint: float  # of x_a [rad]
    force_biceps: float  # true string force [N]
    force_triceps: float
    tension_setpoint: float | None  # of the antagonist [N]; None without a tension controller
    agonist: float | None  # +1 biceps, -1 triceps; None without a tension controller
    drive_biceps: float  # x_e1 [rad]
    drive_triceps: float  # x_e2 [rad]
    deflection_biceps: float  # Delta l_1 [m], negative if the string is slack
    deflection_triceps: float  # Delta l_2 [m]
    joint_radius: float  # R_2 [m]
    drive_radius: float  # R_1 [m]
    max_force: float  # where the springs saturate [N]
    joint_stiffness: float  # of the strings about the joint [N m/rad]
    max_stiffness: float  # the largest that the springs can give [N m/rad]
    obstacle_angle: float | None  # where an obstacle begins [rad]; None without one
    obstacle_side: float  # +1 if it blocks flexion, -1 if it blocks extension
    push_torque: float  # external torques, positive in flexion [N m]
    contact_torque: float
    payload_mass: float  # carried by the forearm, or by the wearer's hand once it is there [kg]
    failure: str  # why the device left its limits; empty while it runs
    wearer: WearerFrame | None = None  # None: the device is not worn


_COPIED = (
    "setpoint",
    "force_biceps",
    "force_triceps",
    "drive_biceps",
    "drive_triceps",
    "push_torque",
    "contact_torque",
)


def frame_of(episodes: Episodes, device: int) -> Frame:
    """Return the frame of one device's present state."""
    simulation, scenario = episodes.simulation, episodes.scenario(device)
    parameters = simulation.parameters_of(device)
    block, lane = divmod(int(device), LANES)
    own = parameters, simulation.scenarios[block], lane

    def state(name: str) -> float:
        return float(simulation.states[name][block, lane])

    copied = {name: state(name) for name in _COPIED}
    angle, biceps, triceps = state("angle"), copied["drive_biceps"], copied["drive_triceps"]
    reach = 1.0 / float(parameters["inverse_max_deflection"])
    controls_tension = bool(parameters["tension_loop"])
    payload, wearer = float(scenario["payload_mass"]), None
    if isinstance(simulation, WornSimulation):
        wearer, held = _wearer_of(simulation, device)
        payload *= held
    return Frame(
        **copied,
        time=state("tick") * float(parameters["control_period"]),
        joint_angle=angle,
        tension_setpoint=state("tension_setpoint") if controls_tension else None,
        agonist=state("agonist") if controls_tension else None,
        deflection_biceps=reach * stretch_biceps(*own, biceps, angle),
        deflection_triceps=reach * stretch_triceps(*own, triceps, angle),
        joint_radius=float(parameters["joint_radius"]),
        drive_radius=float(parameters["drive_radius"]),
        max_force=max_force(parameters),
        joint_stiffness=joint_stiffness(*own, angle, biceps, triceps),
        max_stiffness=max_stiffness(parameters),
        obstacle_angle=float(scenario["obstacle_angle"]) if scenario["obstacle_stiffness"] > 0 else None,
        obstacle_side=float(scenario["obstacle_side"]),
        payload_mass=payload,
        failure=FAILURES[int(state("failure"))],
        wearer=wearer,
    )


def _wearer_of(simulation: WornSimulation, device: int) -> tuple[WearerFrame, bool]:
    """Return the wearer's part of a frame, and whether the payload is in the hand."""
    person, live = simulation.read_wearers(np.array([device]))[0], simulation.live(device)
    guided, worn = bool(person["guided"]), bool(person["worn"])
    frame = WearerFrame(
        elbow_angle=float(live["elbow"]),
        intention=None if guided else float(live["intention"]),
        flexor=float(live["flexor"]),
        extensor=float(live["extensor"]),
        cuff_torque=float(live["cuff_torque"]) if worn else None,
        assistance=float(live["assistance"]),
    )
    return frame, bool(live["tick"] >= person["load_tick"])
