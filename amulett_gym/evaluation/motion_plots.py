"""Figures of motions over time, in the style of `reporting.style`; import this module only where something is drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.evaluation.plots import colours
from amulett_gym.evaluation.runner import YARDSTICK, labels
from amulett_gym.evaluation.signals import ANTAGONIST, acting, force_feedback, switch_rows
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure, Line2D, MaxNLocator, Patch
from amulett_gym.simulation.trajectory import Trajectory

_STRINGS = {"biceps": (style.BICEPS, (0, (4, 1))), "triceps": (style.TRICEPS, "-")}
"""String -> colour and line style, which distinguishes it in grey."""

_FAINT = "#b5b5b5"
"""Colour of eq. 6 behind the others."""

_PANELS = "joint angle [deg]", "antagonist's\ntension [N]", "joint stiffness\n[N m/rad]"


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
    columns = style.panels_across(min(len(names), 3))
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
