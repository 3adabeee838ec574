"""What `amulett hil` prints and writes: tables, a page, and memory and cycles for the firmware's README."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.hil import Comparison
from amulett_gym.firmware.readme import MEASURED, README, needs
from amulett_gym.firmware.toolchain import FLASH, FREQUENCY, RAM
from amulett_gym.reporting.document import update_document
from amulett_gym.reporting.figure_files import figure_files
from amulett_gym.reporting.page import fill_page
from amulett_gym.reporting.table import Table
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.storage.writing import write_json, write_text

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

FILES = ("hil.json", "index.html")
"""What :func:`write_comparison` writes."""

LIMITS = f"ATmega2560 at {FREQUENCY / 1e6:g} MHz: {FLASH:,} bytes of flash, {RAM:,} bytes of memory."


def table(found: Comparison) -> Table:
    """Return the mean costs, and their differences from the simulation's own loop."""
    rows = []
    for each in found.rows:
        mean, largest = found.difference(each)
        interval = found.interval(each)
        shown = "-" if interval is None else f"{100.0 * interval[0]:.2g} to {_percent(interval[1])}"
        apart = ("-",) * 3 if each is found.kernel else (_percent(mean), shown, _percent(largest))
        rows.append((each.label, f"{each.costs.mean():.5g}", *apart))
    head = ("loop in", "cost", "difference", "95 % interval", "largest of a scenario")
    return Table("", head, rows, note=remarks(found))


def chip_table(found: Comparison) -> Table | None:
    """Return cycles and memory of a simulated chip; None if there is none."""
    rows = []
    for each in found.played:
        if (chip := each.measurement) is not None:
            share = _percent(chip.share_of_period(found.period))
            cycles = f"{chip.most:,}", share, f"{chip.mean:,.0f}", f"{chip.ticks:,}"
            rows.append((each.label, *cycles, f"{chip.flash:,}", f"{chip.static:,}", f"{chip.stack:,}"))
    head = ("loop in", "longest tick", "of the period", "mean tick", "ticks", "flash", "static memory", "stack")
    note = f"Ticks in cycles, memory in bytes. {LIMITS}"
    return Table("", head, rows, note) if rows else None


def family_table(found: Comparison) -> Table | None:
    """Return the mean cost in each family of scenarios; None if there is one family."""
    families = found.kernel.families
    present = np.unique(families)
    if len(present) < 2:
        return None
    rows = [
        (FAMILIES[family], str(int((families == family).sum())), *_costs(found, families == family))
        for family in present
    ]
    firmware = [text for each in found.played for text in (each.label, "difference")]
    return Table("", ("family", "scenarios", "simulation", *firmware), rows)


def remarks(found: Comparison) -> str:
    """Return what else happened, as a sentence each; empty if nothing did."""
    text = []
    for each in found.played:
        for count, what in ((each.failures, "devices failed"), (each.let_go, "times the strings were let go")):
            if count:
                text.append(f"{each.label}: {count} {what}.")
        if each.retries:
            text.append(f"{each.label}: {each.retries} requests were sent again.")
    return " ".join(text)


def write_comparison(found: Comparison, out: Path, words: Sequence[str] = ()) -> None:
    """Write ``hil.json`` and the page ``index.html``; `words` are those of the command.

    If a kind of files is chosen (`figures_as`), the page's figure is also written as ``hil`` of that kind.
    """
    from amulett_gym.reporting.style import figure_svg, save_figures

    content, page = FILES
    write_json(out / content, found.content())
    tables = {"costs": table(found), "chip": chip_table(found), "families": family_table(found)}
    figure = _figure(found)
    values = {"found": found, **tables, "figure": figure_svg(figure, "hil-"), "command": shlex.join(words)}
    write_text(out / page, fill_page("firmware/hil.html.j2", **values))
    if figure_files().kind is not None:
        save_figures({"hil": figure}, out)


def write_needs(found: Comparison) -> None:
    """Write the memory and cycles that a simulated chip has measured into the ``README.md`` of the firmware's folder.

    Raises
    ------
    AmulettError
        If none has, or the file has no place for them.
    """
    chip = next((each for each in found.played if each.measurement is not None), None)
    if chip is None or chip.measurement is None:
        raise AmulettError("memory and cycles are those of the simulated chip: it has to be among the transports")
    protocol, (mean, _) = found.protocol, found.difference(chip)
    run = (
        f"in lock step with the simulation in {protocol.episodes} scenarios of `{protocol.suite}`, {protocol.split}, "
        f"{protocol.duration:g} s each, whose mean cost differs by {_percent(mean)} from that of the simulation's loop"
    )
    update_document(found.description.folder / README, {MEASURED: needs(chip.measurement, found.period, run)})


def _costs(found: Comparison, chosen: NDArray[np.bool_]) -> list[str]:
    """Return the mean cost of the chosen scenarios in the simulation, and in each firmware with its difference."""
    own = float(found.kernel.costs[chosen].mean())
    text = [f"{own:.5g}"]
    for each in found.played:
        mean = float(each.costs[chosen].mean())
        text += [f"{mean:.5g}", _percent((mean - own) / (own or 1.0))]
    return text


def _figure(found: Comparison) -> Figure:
    """Draw the difference of each scenario's cost from the simulation's, by family."""
    from amulett_gym.reporting.style import (
        BLUE,
        GREEN,
        ORANGE,
        PURPLE,
        SKY,
        legend_beside,
        name_rows,
        one_panel,
        styled,
    )

    @styled
    def draw() -> Figure:
        families = np.unique(found.kernel.families)
        names = [FAMILIES[family] or found.protocol.suite for family in families]
        figure, panel = one_panel(0.9 + 0.35 * len(names))
        reference = float(found.kernel.costs.mean()) or 1.0
        count = len(found.played)
        for k, each in enumerate(found.played):
            place = len(families) - 1 - np.searchsorted(families, found.kernel.families)
            rows = place + (0.5 * (count - 1) - k) * 0.6 / max(count, 2)
            apart = 100.0 * (each.costs - found.kernel.costs) / reference
            colour = (BLUE, ORANGE, GREEN, PURPLE, SKY)[k % 5]
            panel.plot(apart, rows, "o", color=colour, markersize=3.5, alpha=0.7, markeredgewidth=0, label=each.label)
        panel.axvline(0.0, color="0.8", linewidth=0.7, zorder=0)
        name_rows(panel, names)
        panel.set_xlabel("cost, difference from the simulation [% of its mean cost]")
        legend_beside(panel)
        return figure

    return draw()


def _percent(share: float) -> str:
    """Return a share in percent with two digits; what is below 0.001 %, but not 0, is 0.000 %."""
    return "0.000 %" if 0.0 < abs(share) < 1e-5 else f"{100.0 * share:.2g} %"
