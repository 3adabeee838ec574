"""Figures of `amulett bench`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from amulett_gym.reporting.style import (
    BLACK,
    BLUE,
    GREY,
    PRINT_WIDTH,
    RED,
    Figure,
    legend_below,
    new_figure,
    one_panel,
    save_figures,
    styled,
)

Data = Mapping[str, Any]


def draw(data: Data, folder: str | Path) -> list[Path]:
    """Draw the data of ``--json`` as PNG files into a folder, and return their paths."""
    figures = {}
    if "device_step_ns" in data.get("scale", {}):
        figures["scale"] = scale_figure(data["scale"]["device_step_ns"])
    if "long_run" in data.get("scale", {}):
        figures["hour"] = long_run_figure(data["scale"]["long_run"])
    if data.get("time_to_beat", {}).get("runs"):
        figures["time-to-beat"] = time_to_beat_figure(data["time_to_beat"])
    return save_figures(figures, Path(folder))


@styled
def scale_figure(costs: Mapping[Any, Data]) -> Figure:
    """Draw the cost of a device's step by the number of devices; the spread of the turns is shaded."""
    sizes = [int(size) for size in costs]
    figure, panel = one_panel(3.0, PRINT_WIDTH)
    least, median, most = ([row[key] for row in costs.values()] for key in ("least", "median", "most"))
    panel.fill_between(sizes, least, most, color=BLUE, alpha=0.2, linewidth=0)
    panel.plot(sizes, median, color=BLUE, marker="o", markersize=4)
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.set_xticks(sizes, [f"{size:,}" for size in sizes])
    panel.set_xlabel("devices in the vector environment")
    panel.set_ylabel("cost of a device's step [ns]")
    return figure


@styled
def long_run_figure(run: Data) -> Figure:
    """Draw speed and resident memory of a long run, slice by slice."""
    minutes = [run["simulated_s"] / 60 * (k + 1) / len(run["steps_per_s"]) for k in range(len(run["steps_per_s"]))]
    figure = new_figure(3.6, PRINT_WIDTH)
    speed, memory = figure.subplots(2, 1, sharex=True)
    speed.plot(minutes, [rate / 1e6 for rate in run["steps_per_s"]], color=BLUE)
    speed.set_ylim(bottom=0)
    speed.set_ylabel("million device\nsteps/s")
    if None not in run["resident_bytes"]:
        memory.plot(minutes, [size / 1e6 for size in run["resident_bytes"]], color=RED)
    memory.set_ylim(bottom=0)
    memory.set_ylabel("resident\nmemory [MB]")
    memory.set_xlabel("simulated time [min]")
    figure.align_ylabels()
    return figure


@styled
def time_to_beat_figure(found: Data) -> Figure:
    """Draw each seed's cost on the validation scenarios by the wall clock, and the lines it has to cross."""
    figure, panel = one_panel(3.4, PRINT_WIDTH)
    for k, run in enumerate(found["runs"]):
        times, _, costs = zip(*run["curve"], strict=True)
        panel.plot(times, costs, color=BLUE, alpha=0.6, linewidth=1.0, label="a seed" if k == 0 else None)
        if run["lower_s"] is not None:
            panel.plot(times[-1], costs[-1], color=BLUE, marker="o", markersize=4)
    lines = found["lines"]["validation"]
    panel.axhline(lines["eq6"], color=BLACK, linewidth=1.2, label="eq. 6")
    panel.axhline(lines["constant"], color=GREY, linestyle="--", label=f"constant {lines['constant_tension']:g} N")
    panel.set_xlim(left=0)
    panel.set_xlabel("training time [s]")
    panel.set_ylabel("cost of an episode")
    legend_below(figure, panel.get_legend_handles_labels()[0], ncols=3)
    return figure
