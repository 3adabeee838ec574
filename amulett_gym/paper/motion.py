"""What the paper says about motions without printing a number, read off ours: overshoot, stiffness, switching."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulett_gym.config import Profile
from amulett_gym.paper.reproduction import MEASUREMENT_TIME, Readings, Reproduction, apply_readings, paper_step
from amulett_gym.paper.tables import CONFIGURATIONS, DEVICES, PROTOCOL, TENSION_SETPOINT
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.kernel import joint_stiffness
from amulett_gym.simulation.layout import STATE_NAMES, Control
from amulett_gym.simulation.trajectory import Trajectory
from amulett_gym.tasks.scenario import Move, Scenario, pack
from amulett_gym.tasks.suites import START

Key = tuple[str, str, str, str | None]
"""Metric, device, configuration, drive."""

MOVES, MOVES_FROM = 3, 2.0
"""Steps of Figures 7 and 9, to 45 deg and back and again, `MEASUREMENT_TIME` apart, and when they begin [s]."""

WINDOW = 0.2
"""How long what a switch does to the joint angle is followed [s]."""

UNITS = {
    "overshoot": "deg",
    "swing_back": "deg",
    "force_range": "%",
    "stiffness_at_rest": "N m/rad",
    "stiffness_flexed": "N m/rad",
    "stiffness_far": "N m/rad",
    "stiffness_near": "N m/rad",
    "tension_far": "N",
    "tension_near": "N",
    "switches": "1",
    "switch_deviation": "deg",
    "force_jump": "N",
    "force_swings": "1",
    "switching_ise": "deg^2 s",
    "fixed_ise": "deg^2 s",
}
"""Unit of each observed metric; "1" is dimensionless. Those of the step:

overshoot
    How far the joint goes beyond the setpoint.
swing_back
    How far it is short of the setpoint again after that.
stiffness_at_rest, stiffness_flexed
    Joint stiffness before the step, at 0 deg, and at its end, at 45 deg.
stiffness_far, stiffness_near
    Mean joint stiffness while the position error is above d_offset of eq. 6, and while it is within the error margin.
tension_far, tension_near
    Mean true force of the triceps' string, the antagonist's in flexion, over the same times.

Those of `MOVES` steps to and fro on the testbed:

force_range
    Largest minus smallest true force of the triceps' string without tension control, over its mean.
switches
    Of the agonist.
switch_deviation
    Largest difference of the joint angle, within `WINDOW`, from what it would be had that one switch not happened.
force_jump
    Largest difference of both strings' estimated forces at a switch: the jump of the tension controller's feedback.
force_swings
    How often, per step, that feedback goes from one side of its error margin of 5 % to the other.
switching_ise, fixed_ise
    Position ISE with the agonist switching, and with the biceps as agonist throughout.
"""


@dataclass(frozen=True)
class Motion:
    """A recorded motion.

    Attributes
    ----------
    path : Trajectory
    stiffness : ndarray, shape (ticks + 1,)
        True joint stiffness [N m/rad].
    deviations : ndarray, shape (switches,)
        What each switch of the agonist did to the joint angle (see `UNITS`, switch_deviation) [deg].
    """

    path: Trajectory
    stiffness: NDArray[np.float64]
    deviations: NDArray[np.float64]

    @property
    def failed(self) -> bool:
        """Whether the device left its limits."""
        return bool(self.path["failure"][-1])


def observe(reproduction: Reproduction) -> dict[Key, float]:
    """Return all metrics of `UNITS` that exist, by metric, device and configuration; the drive is None.

    The paper's step is done once on each device, with the sensor noise of the first repetition. A device that fails
    has no metrics.
    """
    observed: dict[Key, float] = {}
    readings = reproduction.readings
    for device in DEVICES:
        for configuration in CONFIGURATIONS:
            profile = apply_readings(reproduction.profiles[device], readings)
            step = paper_step(profile, configuration, readings.eq6)
            motion = play(profile, configuration, readings.eq6, step, START + MEASUREMENT_TIME)
            if not motion.failed:
                for metric, value in _step_metrics(motion, profile.variable_stiffness.error_offset_deg).items():
                    observed[metric, device, configuration, None] = value
    for configuration in CONFIGURATIONS:
        for metric, value in _switching_metrics(reproduction.profiles["testbed"], configuration, readings).items():
            observed[metric, "testbed", configuration, None] = value
    return observed


def play(
    profile: Profile, configuration: str, eq6: str, scenario: Scenario, duration: float, follow_switches: bool = False
) -> Motion:
    """Play a scenario in one of the paper's configurations and keep every control tick.

    Parameters
    ----------
    profile : Profile
    configuration : str
        One of `tables.CONFIGURATIONS`.
    eq6 : {"text", "printed"}
    scenario : Scenario
    duration : float
        [s]
    follow_switches : bool
        Whether to find out what each switch of the agonist does, which takes time.

    Raises
    ------
    AmulettError
        If the device cannot hold the posture in which the scenario starts.
    """
    simulation = _simulation(profile, configuration, eq6)
    simulation.reset(pack(scenario, profile))
    if configuration in TENSION_SETPOINT:
        simulation.command_tension(TENSION_SETPOINT[configuration])
    ticks = round(duration / simulation.control_period)
    live = {name: simulation.states[name][0, 0, ...] for name in STATE_NAMES}
    signals = {name: np.empty(ticks + 1, dtype=view.dtype) for name, view in live.items()}
    stiffness = np.empty(ticks + 1)
    before_switches = []
    for row in range(ticks + 1):
        if row > 0:
            before = simulation.get_state() if follow_switches else {}
            simulation.advance(1)
            if follow_switches and live["agonist"] != signals["agonist"][row - 1]:
                before_switches.append((row - 1, before))
        for name, view in live.items():
            signals[name][row] = view
        stiffness[row] = joint_stiffness(simulation.parameters[0], simulation.states[0], 0)
    deviations = []
    for row, before in before_switches:
        agonist = "biceps" if signals["agonist"][row] > 0 else "triceps"
        other = _simulation(_with_agonist(profile, agonist), configuration, eq6)
        other.set_state(before)
        after = signals["angle"][row + 1 : row + 1 + round(WINDOW / simulation.control_period)]
        differences = []
        for angle in after:
            other.advance(1)
            differences.append(abs(angle - other.read("angle")[0]))
        deviations.append(math.degrees(max(differences)))
    path = Trajectory(profile.name, simulation.control_period, signals)
    return Motion(path, stiffness, np.array(deviations))


def _step_metrics(motion: Motion, far_deg: float) -> dict[str, float]:
    path = motion.path
    first = round(START / path.control_period)
    error = np.degrees(path["setpoint"] - path["angle"])
    after = error[first:]
    peak = int(np.argmin(after))
    values = {
        "overshoot": max(-float(after[peak]), 0.0),
        "swing_back": max(float(after[peak:].max()), 0.0) if after[peak] < 0.0 else 0.0,
        "stiffness_at_rest": float(motion.stiffness[:first].mean()),
        "stiffness_flexed": float(motion.stiffness[-first:].mean()),
    }
    stepped = np.arange(len(path)) > first
    for where, when in (("far", np.abs(error) > far_deg), ("near", np.abs(error) <= PROTOCOL.position_margin_deg)):
        if (when & stepped).any():
            values[f"stiffness_{where}"] = float(motion.stiffness[when & stepped].mean())
            values[f"tension_{where}"] = float(path["force_triceps"][when & stepped].mean())
    return values


def _switching_metrics(device: Profile, configuration: str, readings: Readings) -> dict[str, float]:
    start = paper_step(device, configuration, readings.eq6)
    moves = [
        Move(time=MOVES_FROM + k * MEASUREMENT_TIME, angle_deg=(PROTOCOL.target_deg, PROTOCOL.start_deg)[k % 2])
        for k in range(MOVES)
    ]
    scenario = start.model_copy(update={"moves": moves, "measure_from": MOVES_FROM})
    duration = MOVES_FROM + MOVES * MEASUREMENT_TIME
    profile = apply_readings(device, replace(readings, agonist="switching"))
    if configuration == "position-only":
        motion = play(profile, configuration, readings.eq6, scenario, duration)
        force = motion.path["force_triceps"]
        return {} if motion.failed else {"force_range": float(100.0 * np.ptp(force) / force.mean())}
    motion = play(profile, configuration, readings.eq6, scenario, duration, follow_switches=True)
    fixed = play(_with_agonist(profile, "biceps"), configuration, readings.eq6, scenario, duration)
    if motion.failed or fixed.failed:
        return {}
    path = motion.path
    biceps, triceps = path["estimate_biceps"][:-1], path["estimate_triceps"][:-1]
    switches = np.flatnonzero(np.diff(path["agonist"]))
    # Agonist and setpoint stand in the row in which their tick ends; the tick acts on the estimates of the row before.
    feedback = np.where(path["agonist"][1:] > 0, triceps, biceps)
    side = np.trunc((feedback / path["tension_setpoint"][1:] - 1.0) / PROTOCOL.tension_margin)
    side = np.sign(side[side != 0.0])
    return {
        "switches": float(switches.size),
        "switch_deviation": float(motion.deviations.max(initial=0.0)),
        "force_jump": float(np.abs(triceps - biceps)[switches].max(initial=0.0)),
        "force_swings": float(np.count_nonzero(np.diff(side)) / MOVES),
        "switching_ise": _to_degrees(path["position_ise"][-1]),
        "fixed_ise": _to_degrees(fixed.path["position_ise"][-1]),
    }


def _to_degrees(ise: float) -> float:
    return float(ise) * math.degrees(1.0) ** 2


def _simulation(profile: Profile, configuration: str, eq6: str) -> Simulation:
    control: Control = "position-only" if configuration == "position-only" else "decentralized"
    law = {"text": "eq6", "printed": "eq6-printed"}[eq6] if configuration == "variable" else "agent"
    return Simulation(profile, 1, control, law)


def _with_agonist(profile: Profile, agonist: str) -> Profile:
    return profile.model_copy(update={"loop": profile.loop.model_copy(update={"agonist": agonist})})
