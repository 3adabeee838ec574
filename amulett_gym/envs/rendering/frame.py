"""What a picture shows of one device at one moment."""

from __future__ import annotations

from dataclasses import dataclass

from amulett_gym.envs.episodes import Episodes
from amulett_gym.simulation.kernel import joint_stiffness, stretch_biceps, stretch_triceps
from amulett_gym.simulation.layout import FAILURES, LANES

STRIP_SECONDS = 5.0
"""How much of the past the strip below the arm shows [s]."""


@dataclass(frozen=True)
class Frame:
    """What a picture shows of one device at one moment: the truth, not what the sensors say.

    Parameters
    ----------
    time : float
        Since the start of the episode [s].
    joint_angle, setpoint : float
        x_a and its setpoint, flexion is positive [rad].
    force_biceps, force_triceps : float
        True string forces [N].
    tension_setpoint : float or None
        Of the antagonist [N]; None if the loop has no tension controller.
    agonist : float or None
        +1 biceps, -1 triceps; None if the loop has no agonist.
    drive_biceps, drive_triceps : float
        x_e1, x_e2 [rad].
    deflection_biceps, deflection_triceps : float
        Delta l_1, Delta l_2 [m]; negative if the string is slack.
    joint_radius, drive_radius : float
        R_2, R_1 [m].
    max_force : float
        Where the springs saturate [N].
    joint_stiffness, max_stiffness : float
        Of the strings about the joint, now and at most [N m/rad].
    obstacle_angle : float or None
        Where an obstacle begins [rad]; None if there is none.
    obstacle_side : float
        +1 if it blocks flexion, -1 if it blocks extension.
    push_torque, contact_torque : float
        External torques, positive in flexion [N m].
    payload_mass : float
        Carried by the forearm [kg].
    failure : str
        Why the device left its limits; empty while it runs.
    """

    time: float
    joint_angle: float
    setpoint: float
    force_biceps: float
    force_triceps: float
    tension_setpoint: float | None
    agonist: float | None
    drive_biceps: float
    drive_triceps: float
    deflection_biceps: float
    deflection_triceps: float
    joint_radius: float
    drive_radius: float
    max_force: float
    joint_stiffness: float
    max_stiffness: float
    obstacle_angle: float | None
    obstacle_side: float
    push_torque: float
    contact_torque: float
    payload_mass: float
    failure: str


def frame_of(episodes: Episodes, device: int) -> Frame:
    """Return what a picture of one device needs."""
    simulation, scenario = episodes.simulation, episodes.scenario(device)
    parameters = simulation.parameters[0]
    block, lane = divmod(int(device), LANES)
    own = parameters, simulation.scenarios[block], lane

    def state(name: str) -> float:
        return float(simulation.states[name][block, lane])

    angle, biceps, triceps = state("angle"), state("drive_biceps"), state("drive_triceps")
    reach = 1.0 / float(parameters["inverse_max_deflection"])
    controls_tension = bool(parameters["tension_loop"])
    return Frame(
        time=state("tick") * simulation.control_period,
        joint_angle=angle,
        setpoint=state("setpoint"),
        force_biceps=state("force_biceps"),
        force_triceps=state("force_triceps"),
        tension_setpoint=state("tension_setpoint") if controls_tension else None,
        agonist=state("agonist") if controls_tension else None,
        drive_biceps=biceps,
        drive_triceps=triceps,
        deflection_biceps=reach * stretch_biceps(*own, biceps, angle),
        deflection_triceps=reach * stretch_triceps(*own, triceps, angle),
        joint_radius=float(parameters["joint_radius"]),
        drive_radius=float(parameters["drive_radius"]),
        max_force=simulation.max_force,
        joint_stiffness=joint_stiffness(*own, angle, biceps, triceps),
        max_stiffness=simulation.max_stiffness,
        obstacle_angle=float(scenario["obstacle_angle"]) if scenario["obstacle_stiffness"] > 0 else None,
        obstacle_side=float(scenario["obstacle_side"]),
        push_torque=state("push_torque"),
        contact_torque=state("contact_torque"),
        payload_mass=float(scenario["payload_mass"]),
        failure=FAILURES[int(state("failure"))],
    )
