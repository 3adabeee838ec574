"""Figures of episodes, in the style of `reporting.style`; import this module only where something is drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.envs.reward import SCHEDULE
from amulett_gym.evaluation.metrics import CONTROL_TERMS, COST_OF, COSTS, EFFORT_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK, Schedule, is_bundle, labels
from amulett_gym.evaluation.signals import ANTAGONIST, acting, force_feedback, switch_rows
from amulett_gym.laws.contenders import PRETRAINED, split_loop
from amulett_gym.profile import VariableStiffness
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure, FuncFormatter, Line2D, LogLocator, MaxNLocator, Patch
from amulett_gym.reporting.words import number, pretty, span
from amulett_gym.simulation.trajectory import Trajectory

_STRINGS = {"biceps": (style.BICEPS, (0, (4, 1))), "triceps": (style.TRICEPS, "-")}
"""String -> colour and line style, which distinguishes it in grey."""

_FIXED_COLOURS = {"eq6": style.BLACK, "eq6-printed": style.GREY}
_LAW_COLOURS = (style.BLUE, style.GREEN, style.PURPLE, style.SKY, style.INDIGO, style.OLIVE, style.BROWN, style.ORANGE)
_LEARNED_COLOURS = ("#D62718", "#8C1020", "#F0708A")
"""Colours of learned policies only."""
_MARKERS = "osD^vPXh<>p"
_TERM_COLOURS = dict(zip(COSTS, (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.RED), strict=True))
_PHASES = {
    1: ("joint moves towards the setpoint", style.INDIGO),
    0: ("joint stands", "#4FA3A5"),
    -1: ("joint moves away from the setpoint", "#C29A00"),
}
_POINTS = 3000
"""Points drawn of a schedule; its medians use all points."""
_PANELS = "joint angle [deg]", "antagonist's\ntension [N]", "joint stiffness\n[N m/rad]"
_FAINT = "#b5b5b5"
"""Colour of eq. 6 behind the others."""


def colours(names: Sequence[str]) -> dict[str, str]:
    """Return a colour for each contender: eq. 6 is black, learned policies are red."""
    learned = [name for name in names if is_bundle(name) or split_loop(name)[1] in PRETRAINED]
    laws = [name for name in names if name not in learned and name not in _FIXED_COLOURS]
    return {
        **_FIXED_COLOURS,
        **{name: _LAW_COLOURS[k % len(_LAW_COLOURS)] for k, name in enumerate(laws)},
        **{name: _LEARNED_COLOURS[k % len(_LEARNED_COLOURS)] for k, name in enumerate(learned)},
    }


@style.styled
def trajectory_figure(trajectory: Trajectory, title: str = "") -> Figure:
    """Draw one episode: joint angle, string tensions, joint stiffness, drive commands, and external torques if any."""
    time = trajectory["time"]
    torques = {"push": trajectory["push_torque"], "contact": trajectory["contact_torque"]}
    torques = {name: torque for name, torque in torques.items() if np.any(torque != 0.0)}
    heights = [3.0, 3.0, 1.7, 2.4] + [1.4] * bool(torques)
    figure = style.new_figure(1.0 + 0.72 * sum(heights), 7.2)
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    angle, tension, stiffness, command = axes[:4]

    dashed = {"color": style.SETPOINT, "linestyle": "--", "linewidth": 1.0}
    angle.plot(time, np.degrees(trajectory["setpoint"]), label="setpoint", **dashed)
    angle.plot(time, np.degrees(trajectory["angle"]), color=style.JOINT, label="joint angle")
    for string, (colour, _) in _STRINGS.items():
        estimate = trajectory[f"estimate_{string}"]
        tension.plot(time, estimate, color=colour, alpha=0.35, linewidth=0.9, label=f"{string}, estimated")
        tension.plot(time, trajectory[f"force_{string}"], color=colour, label=f"{string}, true")
        commanded = np.degrees(trajectory[f"command_{string}"])
        command.plot(time, commanded, color=colour, drawstyle="steps-pre", label=string)
    wanted = trajectory["tension_setpoint"]
    tension.plot(time, wanted, drawstyle="steps-pre", label="antagonist's setpoint", **dashed)
    stiffness.plot(time, trajectory["joint_stiffness"], color=style.JOINT, label="of both strings")
    angle.set(ylabel="joint angle [deg]")
    tension.set(ylabel="string tension [N]", ylim=(0.0, None))
    stiffness.set(ylabel="joint stiffness\n[N m/rad]", ylim=(0.0, None))
    command.set(ylabel="drive command [deg]")
    shaded = _shade_triceps(axes, time, trajectory["agonist"])
    for (name, torque), dashes in zip(torques.items(), ("-", "--"), strict=False):
        axes[4].plot(time, torque, color=style.GREY, linestyle=dashes, drawstyle="steps-pre", label=f"{name} torque")
        axes[4].set_ylabel("torque [N m]")
    for panel in axes:
        handles, names = panel.get_legend_handles_labels()
        if panel is angle and shaded:
            handles, names = [*handles, shaded], [*names, "triceps is agonist"]
        style.legend_beside(panel, handles=handles, labels=names)
    return _over_time(figure, axes, time, title)


@style.styled
def overlay_figure(trajectories: Mapping[str, Trajectory], title: str = "") -> Figure:
    """Draw the same scenario with several contenders, by name: one curve of each in every panel."""
    label, colour = labels(list(trajectories)), colours(list(trajectories))
    figure = style.new_figure(6.4, 7.2)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 2.4, 1.9])
    for name, trajectory in trajectories.items():
        time = trajectory["time"]
        curves = np.degrees(trajectory["angle"]), _antagonist_tension(trajectory), trajectory["joint_stiffness"]
        for panel, values in zip(axes, curves, strict=True):
            panel.plot(time, values, color=colour[name], linewidth=1.1, label=label[name])
    longest = max(trajectories.values(), key=len)
    time, setpoint = longest["time"], np.degrees(longest["setpoint"])
    axes[0].plot(time, setpoint, color=style.GREY, linestyle="--", linewidth=1.0, label="setpoint")
    for panel, text in zip(axes, _PANELS, strict=True):
        panel.set(ylabel=text)
        if panel is not axes[0]:
            panel.set(ylim=(0.0, None))
    style.legend_beside(axes[0])
    return _over_time(figure, axes, time, title)


@style.styled
def step_response_figure(
    trajectories: Mapping[str, Trajectory], title: str = "", colour: Mapping[str, str] | None = None
) -> Figure:
    """Draw the same scenario with several contenders, by name, side by side, eq. 6 behind each.

    `colour` has one colour for each contender; if it is None, those of `colours` are used.
    """
    names = list(trajectories)
    label, colour = labels(names), colours(names) if colour is None else colour
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    figure = style.new_figure(0.8 + 3.8 * rows)
    grid = figure.subplots(3 * rows, columns, sharex=True, squeeze=False, height_ratios=[3, 2, 1.6] * rows)
    reference = trajectories.get(YARDSTICK)
    paths = trajectories.values()
    angles = np.degrees(np.concatenate([path[signal] for path in paths for signal in ("angle", "setpoint")]))
    room = 0.05 * max(float(np.ptp(angles)), 1.0)
    highest = max(s.max() for path in paths for s in (_antagonist_tension(path), path["tension_setpoint"]))
    stiffest = max(path["joint_stiffness"].max() for path in paths)
    longest = max(float(path["time"][-1]) for path in paths)
    dashed: dict[str, Any] = {"color": style.SETPOINT, "linestyle": "--", "linewidth": 0.9}
    for k, name in enumerate(names):
        row, column = divmod(k, columns)
        angle, tension, stiffness = panels = grid[3 * row : 3 * row + 3, column]
        trajectory = trajectories[name]
        time = trajectory["time"]
        angle.set_title(label[name], color=colour[name], fontweight="bold")
        angle.plot(time, np.degrees(trajectory["setpoint"]), **dashed)
        if reference is not None and name != YARDSTICK:
            angle.plot(reference["time"], np.degrees(reference["angle"]), color=_FAINT, linewidth=1.1)
        angle.plot(time, np.degrees(trajectory["angle"]), color=colour[name])
        tension.plot(time, _antagonist_tension(trajectory), color=colour[name], linewidth=1.0)
        tension.plot(time, trajectory["tension_setpoint"], **dashed)
        stiffness.plot(time, trajectory["joint_stiffness"], color=colour[name], linewidth=1.0)
        angle.set(xlim=(time[0], longest), ylim=(angles.min() - room, angles.max() + room))
        tension.set(ylim=(0.0, 1.05 * highest))
        stiffness.set(ylim=(0.0, 1.05 * stiffest), xlabel="time [s]")
        for panel, first, text in zip(panels, grid[:3, 0], _PANELS, strict=True):
            panel.sharey(first)
            if column == 0:
                panel.set_ylabel(text)
            else:
                panel.tick_params(labelleft=False)
        stiffness.tick_params(labelbottom=True)
    for k in range(len(names), rows * columns):
        for panel in grid[3 * (k // columns) : 3 * (k // columns) + 3, k % columns]:
            panel.set_axis_off()
    handles = [
        Line2D([], [], color=style.BLACK, label="contender"),
        Line2D([], [], color=_FAINT, label=f"{YARDSTICK}, for comparison"),
        Line2D([], [], label="setpoint", **dashed),
    ]
    style.legend_below(figure, handles, ncols=3)
    if title:
        figure.suptitle(title, fontsize=10.5)
    return figure


@style.styled
def schedule_figure(schedules: Mapping[str, Schedule], law: VariableStiffness) -> Figure:
    """Draw the tension that policies choose against the position error, over both readings of eq. 6, `law`.

    The colours are those of the joint's phases of motion, thick lines the phases' medians. Faint lines show the action
    range of a learned policy. Constant tensions are omitted, unless there are no others.
    """
    names = [name for name, schedule in schedules.items() if np.ptp(schedule.tension) > 0.01] or list(schedules)
    label = labels(names)
    figure, panels = style.panel_grid(max(len(names), 1), 3, 1.1, 2.9, sharex=True, sharey=True)
    widest = max([float(np.percentile(schedules[name].error, 99.8)) for name in names], default=0.0)
    widest = min(max(widest, 1.3 * law.error_offset_deg), 90.0)
    for panel, name in zip_longest(panels, names):
        if name is not None:
            panel.set_title(label[name], fontweight="bold")
            if is_bundle(name):
                for bound in schedules[name].tension_range:
                    panel.axhline(bound, color=_LEARNED_COLOURS[0], linewidth=0.8, alpha=0.5, zorder=1)
            _draw_schedule(panel, schedules[name])
        _draw_eq6(panel, law, widest)
    style.label_outer(panels, "|position error| [deg]", "tension setpoint [N]")
    tops = [schedules[name].tension_range[1] for name in names if is_bundle(name)]
    highest = max([law.nominal_tension, *tops, *[float(schedules[name].tension.max()) for name in names]])
    panels[0].set(xlim=(0.0, widest), ylim=(0.0, 1.06 * highest))
    handles = [
        Line2D([], [], color=style.BLACK, label="eq. 6, text"),
        Line2D([], [], color=style.BLACK, linestyle=":", label="eq. 6, as printed"),
        Line2D([], [], color=style.GREY, linestyle="", marker="o", markersize=2.5, label="an agent step"),
        *[Line2D([], [], color=colour, linewidth=2.2, label=f"{text}, median") for text, colour in _PHASES.values()],
    ]
    if tops:
        text = "ends of the policy's action range"
        handles.append(Line2D([], [], color=_LEARNED_COLOURS[0], linewidth=0.8, alpha=0.5, label=text))
    style.legend_below(figure, handles, ncols=3)
    return figure


@style.styled
def cost_figure(summary: Mapping[str, Any]) -> Figure:
    """Draw each contender's mean cost as a bar of its terms, with its interval; see `comparison.summarise`."""
    policies, key = summary["policies"], COST_OF[summary["track"]]
    terms = COSTS if summary["track"] == SCHEDULE else CONTROL_TERMS
    names = list(policies)
    label = labels(names)
    figure, panel = style.one_panel(1.5 + 0.36 * len(names))
    # A failure costs as much as hundreds of episodes: the axis must not extend to it.
    sound = [policies[name][key] for name in names if not policies[name]["failed"]["mean"]]
    shown = sound or [policies[name][key] for name in names]
    end = 1.08 * max(max(cost["high"] or 0.0, cost["mean"]) for cost in shown)
    rows = np.arange(len(names))[::-1]
    left = np.zeros(len(names))
    shares = {term: f"{key}_{term}" for term in terms} | {"failure": "cost_failure"}
    for term, share in shares.items():
        widths = np.array([policies[name][share]["mean"] for name in names])
        if widths.any():
            panel.barh(rows, widths, left=left, height=0.62, color=_TERM_COLOURS[term], label=term)
            left += widths
    for row, name in zip(rows, names, strict=True):
        cost = policies[name][key]
        inside = cost["mean"] <= end
        if inside:
            panel.errorbar(cost["mean"], row, xerr=style.reach(cost), color=style.BLACK, capsize=3, linewidth=1.1)
        texts = (pretty(number(cost["mean"])) + ("" if inside else " ▶"), span(cost["ratio_to_eq6"]))
        for text, column in zip(texts, _COLUMNS, strict=True):
            panel.annotate(text, (column, row), xycoords=_BESIDE, va="center", fontsize=8.5)
    for text, column in zip(("mean", f"ratio to {YARDSTICK}"), _COLUMNS, strict=True):
        panel.annotate(text, (column, len(names) - 0.45), xycoords=_BESIDE, va="center", fontsize=8.5, color=style.GREY)
    panel.axvline(policies[YARDSTICK][key]["mean"], color=style.BLACK, linestyle=":", linewidth=1.0)
    panel.set(xlim=(0.0, end), xlabel=f"mean {METRICS[key].name} of an episode [1]; dotted: eq. 6")
    style.name_rows(panel, [label[name] for name in names])
    figure.legend(loc="outside upper center", ncols=len(COSTS))
    return figure


@style.styled
def trade_off_figure(summary: Mapping[str, Any]) -> Figure:
    """Draw position ISE against both drives' effort, as ratios to eq. 6 with their intervals: lower left is better.

    `summary` is from `comparison.summarise`; a contender without ratios is omitted.
    """
    policies, effort_key = summary["policies"], EFFORT_OF[summary["track"]]
    label, colour = labels(list(policies)), colours(list(policies))
    figure, panel = style.one_panel(4.6)
    panel.axhline(1.0, color=style.GREY, linewidth=0.8)
    panel.axvline(1.0, color=style.GREY, linewidth=0.8)
    efforts = []
    for k, (name, metrics) in enumerate(policies.items()):
        position, effort = (metrics[metric]["ratio_to_eq6"] for metric in ("position_ise", effort_key))
        if position["mean"] is None or effort["mean"] is None:
            continue
        efforts.append(effort["mean"])
        style.draw_dot(panel, position, effort, colour[name], _MARKERS[k % len(_MARKERS)], label[name], capsize=2)
    if efforts and 0 < 10 * min(efforts) < max(efforts):
        panel.set_yscale("log")
        for which in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
            which(style.PLAIN)
    for put, key in ((panel.set_xlabel, "position_ise"), (panel.set_ylabel, effort_key)):
        metric = METRICS[key]
        one = pretty(f"{metric.text(policies[YARDSTICK][key]['mean'])} {metric.unit}")
        put(f"{metric.name}, in units of {YARDSTICK}'s {one}")
    panel.annotate("better", (0.03, 0.04), (0.11, 0.13), xycoords="axes fraction", color=style.GREY, arrowprops=_ARROW)
    style.legend_beside(panel)
    return figure


@style.styled
def curves_figure(
    x: NDArray[Any],
    curves: Mapping[str, NDArray[Any]],
    x_label: str,
    y_label: str,
    marks: Mapping[float, str] | None = None,
) -> Figure:
    """Draw curves, shape (n,), by their labels, over a common abscissa `x`, shape (n,); the first one is thick.

    `marks` are texts by abscissa, for points on the first curve.
    """
    figure, panel = style.one_panel(3.0, style.PRINT_WIDTH)
    styles = zip(curves.items(), ((style.BLUE, "-", 2.0), (style.RED, "--", 1.3), (style.GREY, ":", 1.3)), strict=False)
    for (name, values), (colour, dashes, width) in styles:
        panel.plot(x, values, color=colour, linestyle=dashes, linewidth=width, label=name)
    first = next(iter(curves.values()))
    panel.margins(y=0.08)
    panel.set(xlim=(x[0], x[-1]), xlabel=x_label, ylabel=y_label)
    middle = 0.5 * sum(panel.get_ylim())
    for mark, text in (marks or {}).items():
        height = float(np.interp(mark, x, first))
        panel.plot(mark, height, color=style.BLUE, marker="o", markersize=6, markeredgecolor="white", zorder=5)
        # Away from the nearer end of the axis: the text has to fit inside.
        side, edge = (1.0, "bottom") if height < middle else (-1.0, "top")
        panel.annotate(text, (mark, height), (11.0, 5.0 * side), textcoords="offset points", va=edge, fontsize=8.5)
    style.legend_below(figure, panel.lines, ncols=len(curves))
    return figure


@style.styled
def force_estimation_figure(
    deflection: NDArray[Any], force: NDArray[Any], estimate: NDArray[Any], rms: NDArray[Any], floor: float, below: str
) -> Figure:
    """Draw estimates of a string's force from single sensor readings, with their errors (Figure 5b).

    Parameters
    ----------
    deflection : ndarray, shape (n,)
        String deflection [mm].
    force : ndarray, shape (n,)
        True string force [N].
    estimate : ndarray, shape (n, readings)
        Estimated force [N].
    rms : ndarray, shape (n,)
        Root mean square of the error over the readings [N].
    floor : float
        Estimates below this are not used [N]; shaded.
    below : str
        Label of the shaded range.
    """
    figure = style.new_figure(4.0, style.PRINT_WIDTH)
    grid = figure.add_gridspec(2, 2)
    curve, error, relative = (figure.add_subplot(place) for place in (grid[:, 0], grid[0, 1], grid[1, 1]))
    drawn = slice(None, None, max(force.size // 100, 1))
    dots: dict[str, Any] = {"color": style.RED, "marker": "o", "linewidth": 0}
    dots["label"] = "estimate from a single reading"
    curve.plot(deflection[drawn], estimate[drawn, 0], markersize=3.2, **dots)
    curve.plot(deflection, force, color=style.BLACK, label="true force")
    error.plot(force[drawn], (estimate[:, 0] - force)[drawn], markersize=2.4, **dots)
    for bound in (rms, -rms):
        error.plot(force, bound, color=style.BLUE, linewidth=1.1, label="rms error of all readings")
    relative.plot(force, 100.0 * rms / force, color=style.BLUE, linewidth=1.1)
    relative.set_yscale("log")
    relative.set_ylim(top=200.0)
    relative.yaxis.set_major_formatter(style.PLAIN)
    curve.axhspan(0.0, floor, color="#ececec", linewidth=0, zorder=0)
    curve.set(xlim=(0.0, deflection[-1]), ylim=(0.0, 1.05 * max(force[-1], estimate.max())))
    curve.set(xlabel="string deflection [mm]", ylabel="string force [N]")
    for panel, y_label in ((error, "error [N]"), (relative, "error / true force [%]")):
        panel.axvspan(0.0, floor, color="#ececec", linewidth=0, zorder=0)
        panel.set(xlim=(0.0, force[-1]), xlabel="true string force [N]", ylabel=y_label)
    figure.align_ylabels([error, relative])
    floors = [Patch(color="#ececec", label=below)] if floor > 0.0 else []
    style.legend_below(figure, [*reversed(curve.lines), error.lines[-1], *floors], ncols=2)
    return figure


@dataclass(frozen=True)
class Tracked:
    """A column of `tracking_figure`.

    Attributes
    ----------
    trajectory : Trajectory
    span : tuple of float, optional
        Range of time [s]; all of it if None.
    title : str
    shows_switches : bool
        Whether to mark the switches of the agonist, and to draw the string that is not fed back.
    true_force : ndarray, optional
        True force of the antagonist's string [N], drawn with the estimate that is fed back.
    without : sequence of Trajectory
        Trajectories without a switch, for the angle's panel.
    """

    trajectory: Trajectory
    span: tuple[float, float] | None = None
    title: str = ""
    shows_switches: bool = False
    true_force: NDArray[np.float64] | None = None
    without: Sequence[Trajectory] = ()


@style.styled
def tracking_figure(columns: Sequence[Tracked], position_margin: float, tension_margin: float) -> Figure:
    """Draw joint angle and fed-back force with their setpoints and error margins, as in Figures 7-9.

    Setpoints are solid and black, margins dashed: `position_margin` [deg], and `tension_margin`, a fraction of the
    setpoint. The force is the antagonist's, in the colour of its string.
    """
    figure = style.new_figure(4.6, style.PRINT_WIDTH)
    grid = figure.subplots(2, len(columns), sharex="col", sharey="row", squeeze=False)
    for (angle, tension), column in zip(grid.T, columns, strict=True):
        trajectory = column.trajectory
        time = trajectory["time"]
        angle.set_title(column.title)
        setpoint = np.degrees(trajectory["setpoint"])
        _draw_setpoint(angle, time, setpoint, setpoint - position_margin, setpoint + position_margin)
        angle.plot(time, np.degrees(trajectory["measured_angle"]), color=style.BLUE, label="joint angle")
        for other in column.without:
            dots = {"color": style.RED, "linestyle": ":", "linewidth": 1.2}
            angle.plot(other["time"], np.degrees(other["measured_angle"]), label="without that switch", **dots)
        setpoint = acting(trajectory, "tension_setpoint")
        _draw_setpoint(tension, time, setpoint, (1.0 - tension_margin) * setpoint, (1.0 + tension_margin) * setpoint)
        if column.true_force is not None:
            tension.plot(time, column.true_force, color=style.INDIGO, linewidth=0.8, label="true force", zorder=1.8)
        _draw_feedback(tension, trajectory, column.shows_switches)
        if column.shows_switches:
            for moment in time[switch_rows(trajectory)]:
                dots = {"color": style.GREY, "linestyle": (0, (1, 1)), "linewidth": 0.8, "zorder": 1}
                for panel in (angle, tension):
                    panel.axvline(moment, label="switch of the agonist", **dots)
        angle.set_xlim(column.span or (time[0], time[-1]))
        angle.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10], prune="upper"))
        tension.set_xlabel("time [s]")
    grid[0, 0].set_ylabel("joint angle [deg]")
    true = any(column.true_force is not None for column in columns)
    grid[1, 0].set_ylabel("string force [N]" if true else "estimated force [N]")
    figure.align_ylabels(grid[:, 0])
    style.legend_below(figure, [line for panel in grid.flat for line in panel.lines], ncols=4)
    return figure


@style.styled
def devices_figure(
    ratios: Mapping[str, Sequence[float]],
    devices: Sequence[str],
    label: Mapping[str, str],
    text: str,
    colour: Mapping[str, str] | None = None,
) -> Figure:
    """Draw the cost of contenders on each device of a fleet, divided by that of eq. 6 there; log axis.

    Parameters
    ----------
    ratios : dict of str to sequence of float
        Contender -> ratio on each device, NaN where there is none. The devices are sorted by the first contender's.
    devices : sequence of str
        Names, which are shown if there are at most `_NAMED_DEVICES`.
    label : dict of str to str
        Contender -> its name in the legend.
    text : str
        Of the vertical axis.
    colour : dict of str to str, optional
        Contender -> its colour; if it is None, those of `colours` are used.
    """
    figure, panel = style.one_panel(4.4)
    order = np.argsort(next(iter(ratios.values())), kind="stable")
    places, look_of = np.arange(len(devices)), colours(list(ratios)) if colour is None else colour
    for k, (name, values) in enumerate(ratios.items()):
        look = {"color": look_of[name], "marker": _MARKERS[k % len(_MARKERS)], "label": label[name]}
        panel.plot(places, np.asarray(values)[order], linewidth=0.6, markersize=4.5, **look)
    panel.axhline(1.0, color=style.BLACK, linestyle=":", linewidth=1.0)
    panel.set_yscale("log")
    _log_ticks(panel.yaxis, panel.get_ylim())
    panel.grid(True, axis="y", which="both")
    panel.set(ylabel=text, xlabel=f"device, sorted by {label[next(iter(ratios))]}", xlim=(-0.7, len(devices) - 0.3))
    if len(devices) <= _NAMED_DEVICES:
        panel.set_xticks(places, [devices[k] for k in order], rotation=60, ha="right", rotation_mode="anchor")
    style.legend_beside(panel)
    return figure


@style.styled
def ratios_figure(
    rows: Mapping[str, Mapping[str, Mapping[str, Any]]], label: Mapping[str, str], colour: Mapping[str, str], text: str
) -> Figure:
    """Draw a panel for each row with the estimates of contenders, and their intervals, log axis.

    Parameters
    ----------
    rows : dict of str to dict
        Title of a panel -> contender -> ``{"mean", "low", "high"}``.
    label, colour : dict of str to str
        Contender -> its name, in the order of the panels' lines, and its colour.
    text : str
        Of the horizontal axis.
    """
    figure, panels = style.panel_grid(len(rows), 3, 0.6, 0.55 + 0.2 * len(label), sharex=True, sharey=True)
    for k, (panel, (title, estimates)) in enumerate(zip(panels, rows.items(), strict=True)):
        panel.set_title(title)
        panel.axvline(1.0, color=style.BLACK, linewidth=0.9)
        for row, name in enumerate(reversed(list(label))):
            estimate = estimates.get(name, {"mean": None})
            if estimate["mean"] is not None:
                look: dict[str, Any] = {"markersize": 5.5, "elinewidth": 1.2, "markeredgewidth": 0}
                style.draw_dot(panel, estimate, row, colour[name], "o", **look)
        style.name_rows(panel, list(label.values()))
        panel.tick_params(axis="y", labelleft=k % 3 == 0)
        panel.tick_params(axis="x", which="both", labelbottom=True)
    for panel in panels:
        panel.set_xscale("log")
        _log_ticks(panel.xaxis, panels[0].get_xlim())
    figure.supxlabel(text, fontsize=9.0)
    return figure


def _log_ticks(axis: Any, limits: tuple[float, float]) -> None:
    """Label a logarithmic axis at 1, 2 and 5 of each decade, a short one at all digits."""
    axis.set_major_locator(LogLocator(10, (1.0, 2.0, 5.0)))
    axis.set_major_formatter(style.PLAIN)
    axis.set_minor_locator(LogLocator(10, [0.1 * k for k in range(1, 10)]))
    axis.set_minor_formatter(FuncFormatter(_between if math.log10(limits[1] / limits[0]) < 0.9 else _nothing))


def _between(value: float, _: Any) -> str:
    """Return a minor tick's label; none where labels would touch."""
    digit = round(value / 10.0 ** math.floor(math.log10(value)))
    return f"{value:g}" if digit in (3, 4, 6, 7, 8, 9) else ""


def _nothing(value: float, _: Any) -> str:
    return ""


_NAMED_DEVICES = 64
_COLUMNS, _BESIDE = (1.02, 1.10), ("axes fraction", "data")
_ARROW = {"arrowstyle": "->", "color": style.GREY}


def _over_time(figure: Figure, axes: Sequence[Any], time: NDArray[Any], title: str) -> Figure:
    """Return a figure with a labelled common time axis, and a title if there is one."""
    figure.align_ylabels(axes)
    axes[-1].set(xlabel="time [s]", xlim=(time[0], max(time[-1], time[0] + 1e-9)))
    if title:
        figure.suptitle(title, fontsize=10.5)
    return figure


def _shade_triceps(axes: Sequence[Any], time: NDArray[Any], agonist: NDArray[Any]) -> Patch | None:
    """Shade the spans in which the triceps is the agonist; return the legend's handle if there are any."""
    triceps = agonist < 0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], triceps, [False]]).astype(int)))
    for start, end in edges.reshape(-1, 2):
        # An agonist belongs to the tick that ends at its row.
        first, last = time[max(start - 1, 0)], time[end - 1]
        for panel in axes:
            panel.axvspan(first, last, color="#eef3f8", linewidth=0, zorder=0)
    return Patch(color="#dfe8f1", label="triceps is agonist") if triceps.any() else None


def _antagonist_tension(trajectory: Trajectory) -> NDArray[np.float64]:
    return np.where(trajectory["agonist"] > 0, trajectory["force_triceps"], trajectory["force_biceps"])


def _draw_setpoint(panel: Any, time: NDArray[Any], setpoint: NDArray[Any], *margins: NDArray[Any]) -> None:
    look = {"color": style.BLACK, "drawstyle": "steps-post"}
    panel.plot(time, setpoint, linewidth=1.0, label="setpoint", **look)
    for margin in margins:
        panel.plot(time, margin, linestyle="--", linewidth=0.7, label="error margin", **look)


def _draw_feedback(panel: Any, trajectory: Trajectory, both: bool) -> None:
    """Draw the force that is fed back, in the colour of its string; if `both`, also the other one, thin."""
    time, acting_agonist, feedback = trajectory["time"], acting(trajectory, "agonist"), force_feedback(trajectory)
    for agonist, string in ANTAGONIST.items():
        colour, dashes = _STRINGS[string]
        fed_back = acting_agonist == agonist
        if fed_back.any():
            force = np.where(fed_back, feedback, np.nan)
            label = f"{string}, fed back" if both else f"{string}' string, estimated"
            panel.plot(time, force, color=colour, linestyle=dashes, label=label)
        if both:
            force = trajectory[f"estimate_{string}"]
            panel.plot(time, force, color=colour, linewidth=0.6, zorder=1.5, label=f"{string}, not fed back")


def _draw_eq6(panel: Any, law: VariableStiffness, end: float) -> None:
    errors = np.linspace(0.0, end, 200)
    nominal, minimum, offset = law.nominal_tension, law.minimum_tension, law.error_offset_deg
    for factor, dashes in ((scaling_factor, "-"), (scaling_factor_printed, ":")):
        tensions = [factor(error, nominal, minimum, offset) * nominal for error in errors]
        panel.plot(errors, tensions, color=style.BLACK, linestyle=dashes, linewidth=1.3, zorder=4)


def _draw_schedule(panel: Any, schedule: Schedule) -> None:
    error, tension, phase = schedule.error, schedule.tension, schedule.phase
    many, drawn = error.size > _POINTS, np.arange(error.size)
    if many:
        drawn = np.random.default_rng(0).choice(error.size, _POINTS, replace=False)
    look = {"s": 3.0, "linewidths": 0, "alpha": 0.35 if many else 0.5, "rasterized": many}
    panel.scatter(error[drawn], tension[drawn], color=[_PHASES[int(p)][1] for p in phase[drawn]], **look)
    for code, (_, colour) in _PHASES.items():
        centres, medians = _medians(error[phase == code], tension[phase == code])
        panel.plot(centres, medians, color="white", linewidth=4.0, zorder=5)
        panel.plot(centres, medians, color=colour, linewidth=2.2, zorder=6)


def _medians(error: NDArray[Any], tension: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the median error [deg] and tension [N] of every bin of the error; NaN if it has too few points.

    A bin needs a hundredth of all points and at least 30: the median of fewer shows single episodes.
    """
    edges = np.concatenate([[0.0, 0.5, 1.0, 2.0, 3.5, 5.0], np.arange(7.5, 90.1, 2.5)])
    bins = np.digitize(error, edges)
    enough = max(30.0, 0.01 * error.size)
    centres, medians = np.full((2, len(edges) - 1), np.nan)
    for k in range(len(edges) - 1):
        inside = bins == k + 1
        if np.count_nonzero(inside) >= enough:
            centres[k], medians[k] = np.median(error[inside]), np.median(tension[inside])
    return centres, medians
