"""The files of a comparison: numbers, figures, and a page that explains them and needs nothing else."""

from __future__ import annotations

import math
from collections import Counter
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.comparison import (
    COMPARISON_MARKS,
    Summary,
    number,
    pretty,
    risen,
    span,
    summarise,
    write_scenarios,
)
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.metrics import UNITS
from amulett_gym.evaluation.runner import YARDSTICK, Results, is_bundle, labels
from amulett_gym.simulation.batch import Simulation
from amulett_gym.storage.writing import after_results, files_together, write_json, write_text

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

FEW = 20
"""Below this number of scenarios a bootstrap interval is likely to be too narrow."""

FIGURES = ("cost", "schedule", "trade_off", "responses")

RESPONSES = 12
"""Most contenders whose responses are drawn side by side; learned policies come before laws."""

_NAMES = (*COMPARISON_MARKS, "report.html", *(f"{figure}.png" for figure in FIGURES))

_MAIN = {
    "cost": "cost",
    "position_ise": "position ISE",
    "effort": "effort: ISAV of both drives without the setpoint's jump",
    "tension_ise": "tension ISE",
}
_DETAILS = {
    "rise_time": "rise time",
    "settling_time": "settling time",
    "overshoot": "overshoot",
    "resting_stiffness": "resting stiffness",
    "push_deflection": "push deflection",
    "agonist_switches": "agonist switches",
    "failed": "failed",
}
_LOWER_IS_BETTER = ("cost", "position_ise", "effort", "tension_ise")


def write_report(results: Results, folder: str | Path) -> Summary:
    """Write ``results.json``, ``scenarios.csv``, ``report.html`` and the figures into a folder.

    The numbers come first, together, and replace all files of an earlier comparison in the folder; other files stay.
    The figures are drawn after that, so that an error in one of them loses no number.

    Returns
    -------
    dict
        The content of ``results.json``.

    Raises
    ------
    AmulettError
        If the folder cannot be written. If that is so from the start, an earlier comparison in it stays as it was.
    """
    summary = summarise(results)
    with files_together(folder, _NAMES) as new:
        write_json(new / "results.json", summary)
        write_scenarios(results, new / "scenarios.csv")
    with after_results(f"results.json and scenarios.csv in {folder}"):
        from amulett_gym.reporting.style import save_figures

        figures = draw(results, summary)
        page = render(results, summary, figures)
        with files_together(folder, ()) as new:
            save_figures(figures, new)
            write_text(new / "report.html", page)
    return summary


def remove_comparison(folder: Path) -> None:
    """Remove the files of an earlier comparison: none may stay that the next one does not replace."""
    try:
        for name in _NAMES:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise AmulettError(f"cannot write to the folder '{folder}': {error.strerror or error}") from error


def draw(results: Results, summary: Summary) -> dict[str, Figure]:
    """Return the figures of a comparison by name: `cost`, `schedule` (if one chose tensions), `trade_off`, `responses`.

    The responses are those to the first scenario, recorded again at control rate.
    """
    protocol = results.protocol
    first = sorted(results.values, key=lambda name: name != YARDSTICK and not is_bundle(name))[:RESPONSES]
    from amulett_gym.evaluation import plots

    names = [name for name in results.values if name in first]
    trajectories = {name: record_episode(results.contender(name), protocol).trajectory for name in names}
    figures = {"cost": plots.cost_figure(summary)}
    if results.schedules:
        figures["schedule"] = plots.schedule_figure(results.schedules, protocol.profile.variable_stiffness)
    figures["trade_off"] = plots.trade_off_figure(summary)
    figures["responses"] = plots.step_response_figure(trajectories)
    return figures


def render(results: Results, summary: Summary, figures: dict[str, Figure]) -> str:
    """Return the report as one HTML page with inline figures, styles and no script.

    Parameters
    ----------
    results : Results
    summary : dict
        From :func:`amulett_gym.evaluation.comparison.summarise`.
    figures : dict of str to Figure
        From :func:`draw`.
    """
    from amulett_gym.reporting.style import figure_svg

    label, device = summary["labels"], Simulation(results.protocol.profile, 1)
    return fill_page(
        "evaluation/page.html.j2",
        summary=summary,
        labels=label,
        long_names={name: short for name, short in label.items() if name != short},
        main=_columns(summary, _MAIN),
        details=_columns(summary, _DETAILS),
        everything=_columns(summary, {metric: metric for metric in UNITS}),
        risen={name: risen(metrics) for name, metrics in summary["policies"].items()},
        failures=_failures(results),
        few=summary["episodes"] < FEW,
        command=summary["command"] or _call(results),
        figures={name: figure_svg(figure, name) for name, figure in figures.items()},
        pretty=pretty,
        band=round(math.degrees(device.parameters["margin"][0]), 3),
        max_force=device.max_force,
    )


def fill_page(template: str, **values: Any) -> str:
    """Fill one of the package's templates; `style` is what all pages look like.

    Parameters
    ----------
    template : str
        Its path in the package.
    **values
        What the template needs; text is escaped.
    """
    files = resources.files("amulett_gym")
    style = files.joinpath("reporting/page.css").read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.from_string(files.joinpath(template).read_text(encoding="utf-8")).render(style=style, **values)


def _columns(summary: Summary, titles: dict[str, str]) -> list[dict[str, Any]]:
    """Return one column of cells for each metric, in words."""
    columns = []
    for metric, title in titles.items():
        entries = {name: metrics[metric] for name, metrics in summary["policies"].items()}
        means = [entry["mean"] for entry in entries.values() if entry["mean"] is not None]
        cells = {}
        for name, entry in entries.items():
            ratio = entry["ratio_to_eq6"]
            cells[name] = {
                "mean": pretty(number(entry["mean"])),
                "interval": _interval(entry),
                "ratio": "" if ratio["mean"] is None else pretty(span(ratio)),
                "best": metric in _LOWER_IS_BETTER and entry["mean"] == min(means),
                "missing": entry.get("not_reached", 0),
            }
        columns.append({"metric": metric, "title": title, "unit": pretty(UNITS[metric]), "cells": cells})
    return columns


def _interval(entry: dict[str, Any]) -> str:
    if entry["low"] is None and entry["high"] is None:
        return ""
    return f"[{pretty(number(entry['low']))}, {pretty(number(entry['high']))}]"


def _failures(results: Results) -> list[str]:
    label, episodes = labels(list(results.values)), results.protocol.episodes
    failures = [
        f"{label[name]}: {count} of {episodes}, {reason}"
        for name, reasons in results.failures.items()
        for reason, count in sorted(Counter(reasons).items())
        if reason
    ]
    pushed = [
        f"{label[name]}: {count} of {episodes} on {results.push_suite}, where the push deflection was measured"
        for name, count in results.push_failures.items()
        if count
    ]
    return failures + pushed


def _call(results: Results) -> str:
    protocol = results.protocol
    names = [name for name in results.values if results.listed or name != "eq6"]
    return (
        f"evaluate({names}, suite={protocol.suite!r}, profile=<{protocol.profile.name}>, episodes={protocol.episodes}, "
        f"seed={protocol.seed}, env_id={protocol.env_id!r}, split={protocol.split!r}, duration={protocol.duration}, "
        f"agent_period={protocol.agent_period})"
    )
