"""Figures of `amulett loops`."""

from __future__ import annotations

import numpy as np

from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure
from amulett_gym.studies.loops.study import Study, least_ise

_COLOURS = (
    *(style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.SKY, style.RED),
    *(style.INDIGO, style.OLIVE, style.BROWN, "#D62718", "#008080", "#B0508C"),
)
_PAPER = {"eq6": style.BLACK, "constant:10": style.GREY, "decentralized": style.GREY}
_LINES = {"minimum-jerk": "-", "first-order": "--"}
_SOME = style.FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "1235" else "")
"""Labels some of a logarithmic axis's ticks, which would overlap."""
_BEFORE, _AFTER = 0.4, 2.5  # [s]; the step is at 0.5 s


def draw(study: Study) -> dict[str, Figure]:
    """Return the figures by name: ``loops_step`` and ``loops_trade_off``."""
    return {"loops_step": step_figure(study), "loops_trade_off": trade_off_figure(study)}


def _colours(names: list[str]) -> dict[str, str]:
    others = [name for name in names if name not in _PAPER]
    return _PAPER | {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(others)}


@style.styled
def step_figure(study: Study) -> Figure:
    """Draw the joint angle, the biceps' drive, and the co-contraction under each contender."""
    colours = _colours(list(study.steps))
    figure = style.new_figure(6.2)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.4, 1.2))
    for name, path in study.steps.items():
        time = path["time"]
        shown = (time >= _BEFORE) & (time <= _AFTER)
        lowest = np.minimum(path["force_biceps"], path["force_triceps"])
        for panel, values in zip(
            panels, (np.degrees(path["angle"]), np.degrees(path["drive_biceps"]), lowest), strict=True
        ):
            wide = {"linewidth": 2.0} if name in _PAPER else {}
            panel.plot(time[shown], values[shown], color=colours[name], label=name, **wide)
    first = next(iter(study.steps.values()))
    panels[0].plot(first["time"], np.degrees(first["setpoint"]), color=style.SETPOINT, linestyle=":", label="setpoint")
    panels[0].set_xlim(_BEFORE, _AFTER)
    for panel, label in zip(
        panels, ("joint angle [deg]", "drive of the\nbiceps [deg]", "antagonist's\nforce [N]"), strict=True
    ):
        panel.set_ylabel(label)
    panels[-1].set_xlabel("time [s]")
    style.legend_below(figure, panels[0].get_lines(), 3)
    return figure


@style.styled
def trade_off_figure(study: Study) -> Figure:
    """Draw position ISE against the drives' effort: each loop over its reference time, the paper's over tensions."""
    colours = _colours(list(study.fronts))
    figure, panel = style.one_panel(4.6)
    for name, rows in study.fronts.items():
        for shape, line in _LINES.items():
            shown = [row for row in rows if row.get("reference", "minimum-jerk") == shape]
            if not shown:
                continue
            across, up = ([row[key] for row in shown] for key in ("drive_effort", "position_ise"))
            label = "decentralized, 5 to 15 N" if name == "decentralized" else name if line == "-" else ""
            panel.plot(across, up, color=colours[name], linestyle=line, marker="o", markersize=3, label=label)
    eq6 = study.results.values["eq6"]
    effort, error = eq6["drive_effort"].mean(), eq6["position_ise"].mean()
    panel.plot(effort, error, "*", color=style.BLACK, markersize=12, label="eq6")
    panel.set_xscale("log")
    panel.set_yscale("log")
    limits, heights = np.array(panel.get_xlim()), panel.get_ylim()
    least = [least_ise(study.results.protocol.profile, limit) for limit in limits]
    panel.plot(limits, least, color=style.GREY, linewidth=0.8, label="least of a joint that follows its drives")
    panel.set(xlim=limits, ylim=heights)
    panel.plot([], [], color=style.GREY, linestyle="--", label="first-order reference")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(_SOME)
        axis.set_minor_formatter(_SOME)
    panel.set_xlabel(METRICS["drive_effort"].heading)
    panel.set_ylabel(METRICS["position_ise"].heading)
    style.legend_beside(panel)
    return figure
