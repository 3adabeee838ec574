"""The figure of a benchmark's learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from amulett_gym.reporting import style

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure


@style.styled
def learning_figure(
    curves: Mapping[str, Sequence[NDArray[np.float64]]],
    label: Mapping[str, str],
    colour: Mapping[str, str],
    laws: Mapping[str, float],
) -> Figure:
    """Draw capped costs on the validation scenarios by agent steps and by wall clock.

    Parameters
    ----------
    curves : dict of str to sequence of ndarray, shape (n, 3)
        Learned entry -> validations of each training run, from `runs.learning_curve`.
    label, colour : dict of str to str
        Entry -> its name and its colour.
    laws : dict of str to float
        Law -> its cost in the same scenarios, a dotted line.
    """
    figure, grid = style.panel_grid(2, 2, 0.0, 4.2, sharey=True)
    for name, runs in curves.items():
        for k, panel in enumerate(grid):
            for seed, run in enumerate(runs):
                text = label[name] if seed == 0 else None
                panel.plot(run[:, k], run[:, 2], color=colour[name], linewidth=0.9, alpha=0.7, label=text)
    for law, cost in laws.items():
        for panel in grid:
            panel.axhline(cost, color=colour[law], linewidth=1.0, linestyle=":")
    costs = np.concatenate([run[:, 2] for runs in curves.values() for run in runs])
    top, bottom = max([float(np.percentile(costs, 90)), *laws.values()]), 0.97 * min([costs.min(), *laws.values()])
    grid[0].set_ylim(bottom, 1.03 * top)
    place = -np.inf
    for law, cost in sorted(laws.items(), key=lambda item: item[1]):
        place = max(cost, place + 0.035 * (1.03 * top - bottom))  # names of equal costs stand above each other
        beside = {"xycoords": ("axes fraction", "data"), "va": "center", "fontsize": 8}
        grid[1].annotate(label[law], (1.01, place), color=colour[law], **beside)
    for panel in grid:
        panel.set_xlim(left=0.0)
    grid[0].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1e6:g}"))
    grid[0].set_xlabel("agent steps [million]")
    grid[1].set_xlabel("wall clock [s]")
    grid[0].set_ylabel("capped cost on the validation\nscenarios (minus the return)")
    style.legend_below(figure, grid[0].get_legend_handles_labels()[0], 6, "outside upper center")
    return figure
