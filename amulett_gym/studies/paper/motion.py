"""Measurements for which the paper prints no number.

They are the overshoot, the joint stiffness, the string force's rise time, and the effects of switching the agonist
(section 3.5, Figure 9). To isolate the effect of one switch, the same device with the same noise is simulated from the
moment before it with its agonist unchanged. Judgement calls that no table decides are varied, each alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from amulett_gym.evaluation.signals import ANTAGONIST, acting, force_feedback, switch_rows
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.studies.paper.reproduction import (
    MEASUREMENT_TIME,
    MOVES_FROM,
    STEPS,
    STEPS_TIME,
    Readings,
    Reproduction,
    antagonist_force,
    apply_readings,
    compare,
    explained,
    follow,
    measure,
    paper_step,
    start,
    there_and_back,
    with_agonist,
)
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, PROTOCOL, TENSION_SETPOINT, repetitions
from amulett_gym.tasks.suites import START

_TO_DEGREES = math.degrees(1.0)

Key = tuple[str, str, str, str | None]
"""Metric, device, configuration, drive."""

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

overshoot, swing_back
    Largest angle beyond the setpoint, and largest angle short of it after that.
stiffness_at_rest, stiffness_flexed
    Joint stiffness before the step, at 0 deg, and at its end, at 45 deg.
stiffness_far, stiffness_near
    Mean joint stiffness while the position error is above d_offset of eq. 6, and while it is within the error margin.
tension_far, tension_near
    Mean true force of the triceps' string, the antagonist's in flexion, over the same times.

Those of three steps to and fro on the testbed (`reproduction.there_and_back`):

force_range
    Largest minus smallest true force of the triceps' string without tension control, over its mean.
switches, switch_deviation
    Number of the agonist's switches; largest difference of the joint angle within `SWITCH_WINDOW` that one makes.
force_jump
    Largest difference of both strings' estimated forces at a switch: the jump of the tension controller's feedback.
force_swings
    Number of changes, per step, of that feedback from one side of its error margin of 5 % to the other.
switching_ise, fixed_ise
    Position ISE with the agonist switching, and with the biceps as agonist throughout.
"""


@dataclass(frozen=True)
class ForceRise:
    """Rise time of the string force: when it reaches its error margin of 5 % after the paper's step (section 2.2).

    The paper defines this rise time and prints none. Force and setpoint are those of Table 4: the antagonist's true
    force in the simulation, its estimate on the testbed. Times are means over repetitions, from the step on [s]: the
    first entry is None unless all reach the margin, the last entry is of those that are within the margin at T.
    """

    profile: str
    configuration: str
    first_entry: float | None
    last_entry: float | None
    inside_at_end: int  # repetitions within the margin at T
    repetitions: int
    share_inside: float  # part of the last second before T within the margin


def force_rise_times(profiles: Mapping[str, Profile], readings: Readings) -> tuple[ForceRise, ...]:
    """Return the string force's rise times for each device and configuration of Tables 2-5.

    Raises AmulettError if a device cannot hold the posture at which a configuration starts.
    """
    return tuple(_force_rise(profiles[name], name, item, readings) for name in DEVICES for item in CONFIGURATIONS)


def _force_rise(profile: Profile, name: str, configuration: str, readings: Readings) -> ForceRise:
    device = apply_readings(profile, readings)
    keys = range(1, repetitions(name) + 1)
    steps = [paper_step(device, configuration, readings.eq6, key) for key in keys]
    simulation = start(device, configuration, steps, readings.eq6)
    force, setpoint = antagonist_force(simulation, START + MEASUREMENT_TIME, estimated=name == "testbed")
    period, first = simulation.control_period, math.ceil(START / simulation.control_period - 1e-9)
    inside = (np.abs(force - setpoint) <= PROTOCOL.tension_margin * setpoint)[first:]
    inside[:, simulation.read("failure") > 0] = False
    entered = np.where(inside.any(axis=0), inside.argmax(axis=0) * period, math.nan)
    since = np.where(inside.all(axis=0), 0, len(inside) - (~inside[::-1]).argmax(axis=0)) * period
    settled = inside[-1]
    return ForceRise(
        name,
        configuration,
        None if np.isnan(entered).any() else float(entered.mean()),
        float(since[settled].mean()) if settled.any() else None,
        int(settled.sum()),
        len(keys),
        float(inside[-round(1.0 / period) :].mean()),
    )


def observe(reproduction: Reproduction) -> dict[Key, float]:
    """Return all metrics of `UNITS` that exist, by metric, device and configuration; the drive is None.

    The paper's step is done once on each device, with the sensor noise of the first repetition. A device that fails
    has no metrics.
    """
    observed: dict[Key, float] = {}
    readings = reproduction.readings
    for device in DEVICES:
        profile = apply_readings(reproduction.profiles[device], readings)
        for configuration in CONFIGURATIONS:
            for metric, value in _step_metrics(profile, configuration, readings.eq6).items():
                observed[metric, device, configuration, None] = value
    for configuration in CONFIGURATIONS:
        for metric, value in _steps_metrics(reproduction.profiles["testbed"], configuration, readings).items():
            observed[metric, "testbed", configuration, None] = value
    return observed


def _step_metrics(profile: Profile, configuration: str, eq6: str) -> dict[str, float]:
    """Return the metrics of the paper's step, none if the device fails."""
    simulation = start(profile, configuration, [paper_step(profile, configuration, eq6)], eq6)
    ticks = round((START + MEASUREMENT_TIME) / simulation.control_period)
    path = record(simulation, ticks)
    if path["failure"][-1]:
        return {}
    first = round(START / path.control_period)
    stiffness = path["joint_stiffness"][:-1]
    error = np.degrees(path["setpoint"] - path["angle"])[:-1]
    after = error[first:]
    peak = int(np.argmin(after))
    values = {
        "overshoot": max(-float(after[peak]), 0.0),
        "swing_back": max(float(after[peak:].max()), 0.0) if after[peak] < 0.0 else 0.0,
        "stiffness_at_rest": float(stiffness[:first].mean()),
        "stiffness_flexed": float(stiffness[-first:].mean()),
    }
    stepped = np.arange(ticks) > first
    far = np.abs(error) > profile.variable_stiffness.error_offset_deg
    near = np.abs(error) <= PROTOCOL.position_margin_deg
    for where, when in (("far", far & stepped), ("near", near & stepped)):
        if when.any():
            values[f"stiffness_{where}"] = float(stiffness[when].mean())
            values[f"tension_{where}"] = float(path["force_triceps"][:-1][when].mean())
    return values


def _steps_metrics(device: Profile, configuration: str, readings: Readings) -> dict[str, float]:
    """Return the metrics of the steps to and fro, none if a device fails."""
    if configuration == "position-only":
        profile = apply_readings(device, readings)
        path = follow(start(profile, configuration, [there_and_back(profile, configuration)]), STEPS_TIME)
        force = path["force_triceps"]
        return {} if path["failure"][-1] else {"force_range": float(100.0 * np.ptp(force) / force.mean())}
    run = switching_run(device, readings, configuration)
    path = run.trajectory
    profile = apply_readings(device, replace(readings, agonist="biceps"))
    scenario = there_and_back(profile, configuration, readings.eq6)
    fixed = follow(start(profile, configuration, [scenario], readings.eq6), STEPS_TIME)
    if path["failure"][-1] or fixed["failure"][-1]:
        return {}
    side = np.trunc((force_feedback(path) / acting(path, "tension_setpoint") - 1.0) / PROTOCOL.tension_margin)
    side = np.sign(side[side != 0.0])
    return {
        "switches": float(len(run.switches)),
        "switch_deviation": max((switch.deviation for switch in run.switches), default=0.0),
        "force_jump": max((abs(switch.force_jump) for switch in run.switches), default=0.0),
        "force_swings": float(np.count_nonzero(np.diff(side)) / len(STEPS)),
        "switching_ise": float(path["position_ise"][-1]) * _TO_DEGREES**2,
        "fixed_ise": float(fixed["position_ise"][-1]) * _TO_DEGREES**2,
    }


SWITCH_WINDOW = 0.2
"""Time after a switch in which its effect on the position is measured [s]."""

FIGURE_9 = "tension-10"
"""Its configuration: the paper says "with tension control" only. 10 N is well above the 5 N floor of the estimation."""


@dataclass(frozen=True)
class Switch:
    """One switch of the agonist, compared with the same moments without it.

    `force_jump` is the estimated force of the new antagonist's string minus that of the old one's, at the same moment.
    `deviation` is the largest difference of the joint angle from that without the switch, within `SWITCH_WINDOW`; the
    agonist may switch again within it.
    """

    time: float  # start of the control tick of the switch [s]
    force_jump: float  # [N]
    deviation: float  # [deg]
    without: Trajectory = field(repr=False)  # with the agonist unchanged


@dataclass(frozen=True)
class SwitchingRun:
    """The movements of Figure 9, with the switches of the agonist in the order of time."""

    trajectory: Trajectory
    switches: tuple[Switch, ...]


def switching_run(profile: Profile, readings: Readings, configuration: str = FIGURE_9) -> SwitchingRun:
    """Do three steps, there, back and there again, with tension control and an agonist that switches.

    Parameters
    ----------
    profile : Profile
        Of the device without readings.
    readings : Readings
        Taken as given, but for `agonist`: section 3.5 is about movements with switching enabled.
    configuration : str
        One of `tables.CONFIGURATIONS`.

    Raises
    ------
    AmulettError
        If the device cannot hold the starting posture.
    """
    device = apply_readings(profile, replace(readings, agonist="switching"))
    scenario = there_and_back(device, configuration, readings.eq6)
    trajectory = follow(start(device, configuration, [scenario], readings.eq6), STEPS_TIME)
    again = start(device, configuration, [scenario], readings.eq6)
    switches = []
    for row in switch_rows(trajectory):
        again.advance(int(row - again.read("tick")[0]))
        stays = {+1: "biceps", -1: "triceps"}[int(trajectory["agonist"][row])]
        fixed = start(with_agonist(device, stays), configuration, [scenario], readings.eq6)
        fixed.set_state(again.get_state())
        switches.append(_switch(trajectory, int(row), follow(fixed, SWITCH_WINDOW)))
    return SwitchingRun(trajectory, tuple(switches))


def _switch(trajectory: Trajectory, row: int, without: Trajectory) -> Switch:
    rows = min(len(without), len(trajectory) - row)
    angle, angle_without = (np.degrees(values)[:rows] for values in (trajectory["angle"][row:], without["angle"]))
    after, before = (f"estimate_{ANTAGONIST[int(trajectory['agonist'][place])]}" for place in (row + 1, row))
    return Switch(
        time=float(trajectory["time"][row]),
        force_jump=float(trajectory[after][row] - trajectory[before][row]),
        deviation=float(np.abs(angle - angle_without).max(initial=0.0)),
        without=without,
    )


FIRST_KEYS = (1, 11, 21, 31, 41, 51)
"""Keys of the first repetition's noise."""

MEASUREMENT_TIMES = (3.0, 5.0, 10.0, 20.0)
"""T [s]."""

HYSTERESES = (0.6, 1.0, 1.6, 2.4)
"""Factors of the testbed's `switch_hysteresis`; the shipped one is 5 standard deviations of the noise."""

FLOORS: tuple[Literal["clamp", "hold", "ignore"], ...] = ("clamp", "hold", "ignore")
"""Treatments of forces estimated below the floor (`Readings.floor`)."""

REST = (5.0, 20.0)
"""Times at which an arm at rest with a tension setpoint of 5 N is measured [s]."""


@dataclass(frozen=True)
class Sensitivity:
    """Results of the variations.

    by_noise, by_time
        Key of the first repetition's noise, or T [s] -> numbers explained of each table.
    by_hysteresis
        Factor -> configuration with tension control -> switches in the movements of Figure 9, and the largest
        difference of the joint angle that one of them makes [deg].
    by_floor
        Treatment -> the antagonist's true force [N] after each of `REST`, mean of all repetitions: the testbed at rest
        in the starting posture of the paper's step, with a setpoint of 5 N.
    by_setpoint
        Reference of the error -> tension ISE of the testbed without tension control [N^2 s], mean of all repetitions.
        The reference is the true force at rest, as in Table 4, or as in the paper the force signal's mean over the two
        seconds before the step.
    """

    by_noise: dict[int, tuple[int, ...]]
    by_time: dict[float, tuple[int, ...]]
    by_hysteresis: dict[float, dict[str, tuple[int, float]]]
    by_floor: dict[str, tuple[float, ...]]
    by_setpoint: dict[str, float]


def vary(profiles: Mapping[str, Profile], readings: Readings) -> Sensitivity:
    """Vary the judgement calls, each alone.

    Parameters
    ----------
    profiles : mapping of str to Profile
        The devices, by `tables.DEVICES`.

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    testbed = profiles["testbed"]
    return Sensitivity(
        {key: _explained(profiles, readings, MEASUREMENT_TIME, key) for key in FIRST_KEYS},
        {time: _explained(profiles, readings, time) for time in MEASUREMENT_TIMES},
        {factor: _switches(testbed, readings, factor) for factor in HYSTERESES},
        {floor: _forces_at_rest(testbed, replace(readings, floor=floor)) for floor in FLOORS},
        _position_only_ise(apply_readings(testbed, readings)),
    )


def _explained(profiles: Mapping[str, Profile], readings: Readings, time: float, first_key: int = 1) -> tuple[int, ...]:
    durations = dict.fromkeys(DEVICES, time)
    rows = compare(measure(profiles, readings, duration=durations, first_key=first_key), readings)
    return tuple(count for count, _ in explained(rows).values())


def _switches(testbed: Profile, readings: Readings, factor: float) -> dict[str, tuple[int, float]]:
    loop = {"switch_hysteresis": factor * testbed.loop.switch_hysteresis}
    loop["tie_width"] = min(testbed.loop.tie_width, loop["switch_hysteresis"])
    device = load_profile(merge(testbed.model_dump(), {"loop": loop}))
    found = {}
    for configuration in (*TENSION_SETPOINT, "variable"):
        switches = switching_run(device, readings, configuration).switches
        found[configuration] = len(switches), max((switch.deviation for switch in switches), default=0.0)
    return found


def _forces_at_rest(testbed: Profile, readings: Readings) -> tuple[float, ...]:
    device = apply_readings(testbed, readings)
    repetitions = range(1, PROTOCOL.repetitions_testbed + 1)
    still = [paper_step(device, "tension-5", noise_seed=key).model_copy(update={"moves": []}) for key in repetitions]
    simulation = start(device, "tension-5", still)
    forces, passed = [], 0.0
    for time in REST:
        simulation.advance(round((time - passed) / simulation.control_period))
        forces.append(float(np.mean(simulation.read("force_triceps"))))
        passed = time
    return tuple(forces)


def _position_only_ise(testbed: Profile) -> dict[str, float]:
    scenario = paper_step(testbed, "position-only")
    late = {"moves": [scenario.moves[0].model_copy(update={"time": MOVES_FROM})], "measure_from": MOVES_FROM}
    keys = range(1, PROTOCOL.repetitions_testbed + 1)
    scenarios = [scenario.model_copy(update={**late, "noise_seed": key}) for key in keys]
    simulation = start(testbed, "position-only", scenarios)
    force, at_rest = antagonist_force(simulation, MOVES_FROM + MEASUREMENT_TIME, estimated=True)
    first = round(MOVES_FROM / simulation.control_period)
    mean = force[:first].mean(axis=0)
    setpoints = {"true force at rest (as in Table 4)": at_rest[0], "mean of the signal before the step": mean}
    return {
        name: float(np.mean(np.sum((force[first:] - setpoint) ** 2, axis=0)) * simulation.control_period)
        for name, setpoint in setpoints.items()
    }
