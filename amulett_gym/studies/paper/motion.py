"""What the paper says about motions without printing a number, read off ours: overshoot, stiffness, switching."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from amulett_gym.evaluation.signals import acting, force_feedback
from amulett_gym.profile import Profile
from amulett_gym.simulation.trajectory import record
from amulett_gym.studies.paper.reproduction import (
    MEASUREMENT_TIME,
    Readings,
    Reproduction,
    apply_readings,
)
from amulett_gym.studies.paper.runs import (
    HOLD,
    MOVES_FROM,
    STEPS,
    antagonist_force,
    follow,
    paper_step,
    start,
    there_and_back,
)
from amulett_gym.studies.paper.switching import switching_run
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, PROTOCOL, repetitions
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

Those of three steps to and fro on the testbed (`runs.there_and_back`):

force_range
    Largest minus smallest true force of the triceps' string without tension control, over its mean.
switches
    Of the agonist.
switch_deviation
    Largest difference of the joint angle, within `switching.SWITCH_WINDOW`, from what it would be had that one switch
    not happened.
force_jump
    Largest difference of both strings' estimated forces at a switch: the jump of the tension controller's feedback.
force_swings
    How often, per step, that feedback goes from one side of its error margin of 5 % to the other.
switching_ise, fixed_ise
    Position ISE with the agonist switching, and with the biceps as agonist throughout.
"""


@dataclass(frozen=True)
class ForceRise:
    """When the string force reaches its error margin of 5 % after the paper's step (section 2.2).

    The paper defines this rise time and prints none. Force and setpoint are those of Table 4: the antagonist's true
    force in the simulation, its estimate on the testbed.

    Attributes
    ----------
    profile, configuration : str
    first_entry : float or None
        Time from the step to the first moment within the margin, mean over the repetitions [s]; 0 where the step finds
        the force within it. None: not reached in all repetitions, or one of them failed.
    last_entry : float or None
        Time to the last entry, mean over those repetitions that are within the margin at T [s]; None: there are none.
    inside_at_end, repetitions : int
        Repetitions that are within the margin at T, and all of them.
    share_inside : float
        Part of the last second before T that the force is within the margin [1].
    """

    profile: str
    configuration: str
    first_entry: float | None
    last_entry: float | None
    inside_at_end: int
    repetitions: int
    share_inside: float


def force_rise_times(profiles: Mapping[str, Profile], readings: Readings) -> tuple[ForceRise, ...]:
    """Return the string force's rise times for each device and configuration of Tables 2-5.

    Raises
    ------
    AmulettError
        If a device cannot hold the posture at which a configuration starts.
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
    """Return what the paper's step shows, nothing if the device fails."""
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
    """Return what the steps to and fro show, nothing if a device fails."""
    if configuration == "position-only":
        profile = apply_readings(device, readings)
        path = follow(
            start(profile, configuration, [there_and_back(profile, configuration)]), MOVES_FROM + len(STEPS) * HOLD
        )
        force = path["force_triceps"]
        return {} if path["failure"][-1] else {"force_range": float(100.0 * np.ptp(force) / force.mean())}
    run = switching_run(device, readings, configuration)
    path = run.trajectory
    profile = apply_readings(device, replace(readings, agonist="biceps"))
    scenario = there_and_back(profile, configuration, readings.eq6)
    fixed = follow(start(profile, configuration, [scenario], readings.eq6), MOVES_FROM + len(STEPS) * HOLD)
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
