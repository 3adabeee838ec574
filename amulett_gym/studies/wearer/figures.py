"""Figures of `amulett wearer`."""

from __future__ import annotations

import numpy as np

from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure
from amulett_gym.studies.wearer.baselines import BY_INTENTION, TWO_ASSISTANCES, TWO_LEVEL
from amulett_gym.studies.wearer.comparison import DOFFED
from amulett_gym.studies.wearer.results import Content

CAPTIONS = {
    "wearer_headroom": "Cost over that of the same wearers without the device, per suite and loop: the best constant, "
    "two assistances, or two levels of both, by the true intention, and a clairvoyant, on the first of the wearers. "
    "Lines: 95 % intervals.",
    "wearer_ratios": "Each held-out wearer's cost over that without the device, from the best off to the worst. "
    "Dashed: schedules by the true intention; dash-dotted: learned policies.",
}

_KINDS = {"constant": style.GREY, TWO_ASSISTANCES: style.SKY, TWO_LEVEL: style.BLUE, "clairvoyant": style.GREEN}
_COLOURS = (style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.SKY, style.RED, style.BROWN, style.OLIVE)


def draw(found: Content) -> dict[str, Figure]:
    """Return the figures by name."""
    return {"wearer_headroom": headroom_figure(found), "wearer_ratios": ratios_figure(found)}


@style.styled
def headroom_figure(found: Content) -> Figure:
    """Draw the ratios to doffed of each suite and loop."""
    cells = found["headroom"]
    figure, panel = style.one_panel(0.9 + 0.32 * max(len(cells), 4))
    for k, (name, colour) in enumerate(_KINDS.items()):
        ratios = [cell["over_doffed"][name] for cell in cells]
        places = np.arange(len(cells)) + 0.18 * (k - 1.5)
        means = np.array([ratio["mean"] for ratio in ratios], dtype=float)
        ends = np.array([[ratio["low"], ratio["high"]] for ratio in ratios], dtype=float).T
        panel.errorbar(means, places, xerr=np.abs(ends - means), fmt="o", markersize=4, color=colour, label=name)
    panel.axvline(1.0, color=style.BLACK, linewidth=0.8)
    suites = [cell["suite"] for cell in cells]
    for k in (k for k in range(1, len(cells)) if suites[k] != suites[k - 1]):
        panel.axhline(k - 0.5, color=style.BLACK, linewidth=0.8)
    panel.set_yticks(range(len(cells)), [f"{cell['suite']}, {cell['control']}" for cell in cells])
    panel.grid(False, axis="y")
    panel.set_ylim(len(cells) - 0.5, -0.5)
    panel.set_xlabel("cost / doffed")
    style.legend_beside(panel)
    return figure


@style.styled
def ratios_figure(found: Content) -> Figure:
    """Draw the sorted ratios of all wearers, one line for each contender."""
    figure, panel = style.one_panel(4.0)
    rows = {name: row for name, row in found["comparison"].items() if name != DOFFED}
    for k, (name, row) in enumerate(rows.items()):
        ratios = np.sort(row["cost_ratios"])
        line = "--" if name in BY_INTENTION else "-." if name in found["policies"] else "-"
        shares = 100.0 * (np.arange(ratios.size) + 0.5) / ratios.size
        panel.plot(shares, ratios, line, color=_COLOURS[k % len(_COLOURS)], label=name)
    panel.axhline(1.0, color=style.BLACK, linewidth=0.8)
    panel.set_xlabel("share of wearers [%]")
    panel.set_ylabel("cost / doffed")
    style.legend_beside(panel)
    return figure
