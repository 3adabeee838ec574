"""Figures of comparisons and schedules, in the style of `reporting.style`; import it only where something is drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.envs.reward import SCHEDULE
from amulett_gym.evaluation.metrics import CONTROL_TERMS, COST_OF, COSTS, EFFORT_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK, Schedule, is_bundle, labels
from amulett_gym.laws.contenders import PRETRAINED, split_loop
from amulett_gym.profile import VariableStiffness
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure, FuncFormatter, Line2D, LogLocator
from amulett_gym.reporting.words import number, pretty, span

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
_NAMED_DEVICES = 64
_COLUMNS, _BESIDE = (10.0, 48.0), ("axes fraction", "data")  # [pt] to the right of the panel
_BESIDE_TEXT: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 8.0}
_ARROW = {"arrowstyle": "->", "color": style.GREY}


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
            panel.annotate(text, (1.0, row), (column, 0.0), xycoords=_BESIDE, **_BESIDE_TEXT)
    for text, column in zip(("mean", f"ratio to {YARDSTICK}"), _COLUMNS, strict=True):
        place = (1.0, len(names) - 0.45), (column, 0.0)
        panel.annotate(text, *place, xycoords=_BESIDE, color=style.GREY, **_BESIDE_TEXT)
    panel.axvline(policies[YARDSTICK][key]["mean"], color=style.BLACK, linestyle=":", linewidth=1.0)
    panel.set(xlim=(0.0, end), xlabel=f"mean {METRICS[key].name} of an episode [1]; dotted: eq. 6")
    style.name_rows(panel, [label[name] for name in names])
    style.legend_below(figure, panel.get_legend_handles_labels()[0], len(COSTS), "outside upper center")
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
