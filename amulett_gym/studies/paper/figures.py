"""The paper's figures (3, 5b, 6 to 9) on our devices.

matplotlib is imported only where something is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.agonist import BICEPS
from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.evaluation.signals import acting, force_feedback
from amulett_gym.model.damping import decay_rate
from amulett_gym.model.sensors import read_slider
from amulett_gym.model.spring import build_tables, estimate_force, look_up
from amulett_gym.profile import Damping, Profile, VariableStiffness
from amulett_gym.simulation.random import normal
from amulett_gym.simulation.trajectory import Trajectory
from amulett_gym.studies.paper.motion import SWITCH_WINDOW, Switch, switching_run
from amulett_gym.studies.paper.reproduction import (
    HOLD,
    MOVES_FROM,
    STEPS_TIME,
    Readings,
    apply_readings,
    follow,
    paper_step,
    start,
    there_and_back,
)
from amulett_gym.studies.paper.tables import DEVICES, PROTOCOL, TENSION_SETPOINT
from amulett_gym.tasks.suites import START

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

Values = NDArray[np.float64]

CAPTIONS = {
    "figure_3_damping": "Decay rate over preload, clipped at zero, by the formula that the text describes and as it is "
    "printed. Points: the tension setpoints of 5 and 10 N.",
    "figure_5b_force_estimation": "True string force, and the force estimated from single readings of the testbed's "
    "potentiometers, before filter and floor. Right: root mean square of estimate minus true force as a function "
    "of the true force.",
    "figure_6_scaling_factor": "String tension scaling factor of eq. 6, as its text describes it and as it is printed.",
    "figure_7_position_only": "The first three steps without tension control, on the testbed. Force: the estimate for "
    "the antagonist's string; its setpoint is its mean over the first two seconds. Dashed: error margins.",
    "figure_8_variable_stiffness": "Step response with variable stiffness: (a) simulation, (b) testbed. Force, of "
    "the antagonist's string: thick the estimate that is fed back, thin the true force. Dashed: error margins.",
    "figure_9_switching": "Steps with tension control and a switching agonist, on the testbed. The force fed back "
    "(thick) switches between the strings. Right: the time around one switch, with the angle that would "
    "result without that switch.",
}
"""Name -> caption of the figures of `paper_figures`, in its order; `remarks` add the results on given devices."""

SLACK = 0.1
"""True force below which a string counts as slack [N]."""

BELOW_FLOOR = {
    "clamp": "clamped to it",
    "hold": "replaced by the last one above it",
    "ignore": "no error to the controller",
}
"""Treatment of estimates below the floor (`Sensors.below_floor`), in words."""

READINGS = 200
"""Single readings of the potentiometer at each deflection of Figure 5b."""


@dataclass(frozen=True)
class ForceEstimation:
    """The true string force and its estimates from single readings of the potentiometer, before filter and floor."""

    deflection: Values  # of the string, shape (n,) [m]
    force: Values  # shape (n,) [N]
    estimate: Values  # shape (n, `READINGS`) [N]

    @property
    def error(self) -> Values:
        """Root mean square of estimated minus true force over the readings, shape (n,) [N]."""
        return np.sqrt(np.mean((self.estimate - self.force[:, None]) ** 2, axis=1))


def damping_curves(damping: Damping, preload: Values) -> dict[str, Values]:
    """Return the decay rate [1/s] at preload forces [N] by both forms of Figure 3's fit, clipped at zero."""
    constant = {"shifted": damping.b * damping.c, "printed": damping.c}
    return {
        form: np.array([decay_rate(force, damping.a, damping.b, c, damping.d) for force in preload])
        for form, c in constant.items()
    }


def undamped_below(damping: Damping, form: str) -> float:
    """Return the preload force [N] up to which the decay rate is clipped to zero, 0 if nowhere."""
    if damping.a == 0.0:
        return 0.0
    if damping.d == 0.0:
        return math.inf
    exponent = math.log(-damping.d / damping.a)
    zero = exponent / damping.b - damping.c if form == "shifted" else (exponent - damping.c) / damping.b
    return max(zero, 0.0)


def force_estimation(profile: Profile, points: int = 300) -> ForceEstimation:
    """Return estimates at deflections from slack to the spring's end, `READINGS` at each (Figure 5b)."""
    tables, sensors = build_tables(profile.spring), profile.sensors
    resolution = sensors.potentiometer_travel / 2**sensors.potentiometer_bits if sensors.potentiometer_bits else 0.0
    deflection = np.linspace(0.0, tables.max_deflection, points + 1)[1:]
    noise = sensors.potentiometer_noise * normal(
        np.arange(points, dtype=np.uint64), np.zeros(points, dtype=np.uint64), READINGS
    )
    estimate = np.empty((points, READINGS))
    for k, stretch in enumerate(deflection):
        spring = look_up(tables.spring_deflection, stretch / tables.max_deflection)
        for j in range(READINGS):
            reading = read_slider(spring, noise[k, j], resolution, sensors.potentiometer_travel)
            estimate[k, j] = estimate_force(tables.estimated_force, reading, tables.max_spring_deflection)
    return ForceEstimation(deflection, np.array([tables.force_at(stretch) for stretch in deflection]), estimate)


def remarks(profiles: Mapping[str, Profile], readings: Readings) -> dict[str, str]:
    """Return the results that figures show on these devices in words, by the names of `CAPTIONS`.

    Parameters
    ----------
    profiles : mapping of str to Profile
        The devices, by `tables.DEVICES`.

    Raises
    ------
    AmulettError
        If a device cannot hold a starting posture.
    """
    steps = {name: variable_stiffness_step(profiles[name], readings) for name in DEVICES}
    return {
        "figure_5b_force_estimation": estimation_in_words(apply_readings(profiles["testbed"], readings)),
        "figure_8_variable_stiffness": " ".join(slack_in_words(name, steps[name]) for name in DEVICES),
        "figure_9_switching": switches_in_words(switching_run(profiles["testbed"], readings).switches),
    }


def with_remark(caption: str, remark: str | None) -> str:
    """Return a caption with a remark, if there is one."""
    return " ".join(filter(None, [caption, remark]))


def slack_in_words(name: str, trajectory: Trajectory) -> str:
    """Return whether the antagonist's string goes slack after a device's step, and its estimate then, in words."""
    stepped = trajectory["time"] >= START
    force, estimate = antagonist_force(trajectory)[stepped], force_feedback(trajectory)[stepped]
    where = {"simulation": "In the simulation", "testbed": "On the testbed"}[name]
    if (slack := force < SLACK).any():
        time = trajectory.control_period * np.count_nonzero(slack)
        after = force[np.flatnonzero(slack)[-1] :].max()
        return (
            f"{where} the antagonist goes slack far from the setpoint: the true force is below {SLACK:g} N for "
            f"{time:.2g} s, while the filtered estimate is at least {estimate[slack].min():.2g} N. "
            f"When the string is tensioned again, its force reaches {after:.3g} N."
        )
    least = int(np.argmin(force))
    return f"{where} the true force falls to {force[least]:.2g} N, while the estimate is {estimate[least]:.2g} N."


def switches_in_words(switches: Sequence[Switch]) -> str:
    """Return the largest effects of the switches of Figure 9 on the joint and on the force fed back, in words."""
    if not switches:
        return "The agonist never switches."
    worst = max(switches, key=lambda switch: switch.deviation)
    jump = max(switches, key=lambda switch: abs(switch.force_jump))
    return (
        f"Of {len(switches)} switches, that at {worst.time:.2f} s moves the joint most: by {worst.deviation:.2g} deg "
        f"within {SWITCH_WINDOW:g} s. At {jump.time:.2f} s the force fed back jumps by {abs(jump.force_jump):.2g} N."
    )


def estimation_in_words(profile: Profile) -> str:
    """Return a device's treatment of estimates below its floor, and whether its error grows there, in words."""
    data, floor = force_estimation(profile), profile.sensors.force_floor
    below = data.force < floor
    if not below.any() or below.all():
        return "There is no floor below which estimates are not trusted."
    error, at_floor = data.error, float(np.interp(floor, data.force, data.error))
    low, high = error[below].mean(), error[~below].mean()
    end = data.force[-1]
    grows = (
        f"So does the model's: {low:.2g} N on average for forces below the floor, {high:.2g} N above"
        if low > high
        else f"The model's does not: its mean is {low:.2g} N for forces below the floor and {high:.2g} N "
        f"above. Only its ratio to the force grows at low forces, from {100.0 * error[-1] / end:.2g} % at {end:.3g} N "
        f"to {100.0 * at_floor / floor:.2g} % at {floor:g} N"
    )
    return (
        f"Estimates below the floor of {floor:g} N (shaded) are {BELOW_FLOOR[profile.sensors.below_floor]}. The "
        f"paper's error grows at low forces. {grows}."
    )


def scaling_curves(law: VariableStiffness, error_deg: Values) -> dict[str, Values]:
    """Return f_sigma at position errors [deg] by both forms of eq. 6; the printed one is clipped at 1."""
    forms = {"text": scaling_factor, "printed": scaling_factor_printed}
    return {
        form: np.array(
            [factor(error, law.nominal_tension, law.minimum_tension, law.error_offset_deg) for error in error_deg]
        )
        for form, factor in forms.items()
    }


def position_only_steps(profile: Profile, readings: Readings) -> Trajectory:
    """Return the three steps of Figure 7, without tension control.

    The tension setpoint is the mean of the force signal before the first step, as in the paper.
    """
    device = apply_readings(profile, readings)
    scenario = there_and_back(device, "position-only")
    trajectory = follow(start(device, "position-only", [scenario]), STEPS_TIME)
    setpoint = force_feedback(trajectory)[trajectory["time"] < MOVES_FROM].mean()
    signals = {**trajectory.signals, "tension_setpoint": np.full(len(trajectory), setpoint)}
    return Trajectory(trajectory.profile, trajectory.control_period, signals)


def variable_stiffness_step(profile: Profile, readings: Readings) -> Trajectory:
    """Return the step of Figure 8: the paper's, with the tension setpoint of eq. 6."""
    device = apply_readings(profile, readings)
    scenario = paper_step(device, "variable", readings.eq6)
    return follow(start(device, "variable", [scenario], readings.eq6), START + HOLD)


def antagonist_force(trajectory: Trajectory) -> Values:
    """Return the true force of the string whose estimate is fed back [N], shape (ticks + 1,)."""
    biceps_is_agonist = acting(trajectory, "agonist") == BICEPS
    return np.where(biceps_is_agonist, trajectory["force_triceps"], trajectory["force_biceps"])


def paper_figures(profiles: Mapping[str, Profile], readings: Readings) -> dict[str, Figure]:
    """Simulate and draw the paper's figures on the devices of `tables.DEVICES`; return them by the names of `CAPTIONS`.

    Raises AmulettError if a device cannot hold a starting posture.
    """
    from amulett_gym.evaluation import motion_plots

    testbed = profiles["testbed"]
    tracking = partial(
        motion_plots.tracking_figure,
        position_margin=PROTOCOL.position_margin_deg,
        tension_margin=PROTOCOL.tension_margin,
    )
    responses = {name: variable_stiffness_step(profiles[name], readings) for name in DEVICES}
    switching = switching_run(testbed, readings)
    whole = motion_plots.Tracked(switching.trajectory, title="three steps", shows_switches=True)
    worst = replace(whole, span=_around_worst(switching.switches), title="the switch that moves the joint most")
    worst = replace(worst, without=[switch.without for switch in switching.switches])
    return {
        "figure_3_damping": _draw_damping(testbed.damping, readings.damping),
        "figure_5b_force_estimation": _draw_estimation(apply_readings(testbed, readings)),
        "figure_6_scaling_factor": _draw_scaling(testbed.variable_stiffness, readings.eq6),
        "figure_7_position_only": tracking([motion_plots.Tracked(position_only_steps(testbed, readings))]),
        "figure_8_variable_stiffness": tracking(
            [
                motion_plots.Tracked(responses[name], span, title, true_force=antagonist_force(responses[name]))
                for name, span, title in (
                    ("simulation", (START - 0.1, START + 0.9), "(a) simulation"),
                    ("testbed", (0.0, START + HOLD), "(b) testbed"),
                )
            ]
        ),
        "figure_9_switching": tracking([whole, worst]),
    }


def _draw_damping(damping: Damping, used: str) -> Figure:
    from amulett_gym.evaluation import plots

    preload = np.linspace(0.0, 12.0, 601)
    curves = damping_curves(damping, preload)
    formulas = {"shifted": r"$a\,e^{b(x+c)}+d$", "printed": r"$a\,e^{bx+c}+d$, as printed"}
    ordered = {f"{formulas[form]}{' (used)' * (form == used)}": curves[form] for form in _first(used, curves)}
    first = next(iter(ordered.values()))
    marks = {force: f"{np.interp(force, preload, first):.2f} 1/s at {force:g} N" for force in TENSION_SETPOINT.values()}
    if 0.0 < (zero := undamped_below(damping, used)) < preload[-1]:
        marks[zero] = f"clipped to zero\nbelow {zero:.2f} N"
    return plots.curves_figure(preload, ordered, "preload force [N]", "decay rate δ [1/s]", marks)


def _draw_estimation(profile: Profile) -> Figure:
    from amulett_gym.evaluation import motion_plots

    data, sensors = force_estimation(profile), profile.sensors
    below = f"below {sensors.force_floor:g} N: {BELOW_FLOOR[sensors.below_floor]}"
    return motion_plots.force_estimation_figure(
        1000.0 * data.deflection, data.force, data.estimate, data.error, sensors.force_floor, below
    )


def _draw_scaling(law: VariableStiffness, used: str) -> Figure:
    from amulett_gym.evaluation import plots

    error = np.linspace(0.0, PROTOCOL.target_deg - PROTOCOL.start_deg, 451)
    curves = scaling_curves(law, error)
    names = {"text": "as the text describes it", "printed": "as printed, clipped at 1"}
    ordered = {f"{names[form]}{' (used)' * (form == used)}": curves[form] for form in _first(used, curves)}
    offset = law.error_offset_deg
    marks = {offset: f"$d_{{offset}}$ = {offset:g} deg"}
    return plots.curves_figure(error, ordered, "|position error| [deg]", "scaling factor $f_σ$ [1]", marks)


def _first(name: str, names: Iterable[str]) -> list[str]:
    return sorted(names, key=lambda other: other != name)


def _around_worst(switches: Sequence[Switch]) -> tuple[float, float]:
    """Return a span [s] around the switch that moves the joint most, or around the second step if there is none."""
    worst = max(switches, key=lambda switch: switch.deviation, default=None)
    time = MOVES_FROM + HOLD if worst is None else worst.time
    return time - 0.5 * SWITCH_WINDOW, time + SWITCH_WINDOW
