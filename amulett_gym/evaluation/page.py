"""The files of a comparison, the page with its figures above all; it loads nothing from elsewhere."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.across import (
    FleetResults,
    device_table,
    family_table,
    fleet_table,
    summarise_fleet,
    write_fleet_scenarios,
)
from amulett_gym.evaluation.comparison import COMPARISON_MARKS, Summary, risen, summarise, write_scenarios
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.metrics import COST_OF, EFFORT_OF, METRICS, Metric
from amulett_gym.evaluation.runner import YARDSTICK, Results, is_bundle, labels
from amulett_gym.reporting.figure_files import KINDS
from amulett_gym.reporting.page import fill_page
from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import interval, pretty, span
from amulett_gym.simulation.batch import Simulation
from amulett_gym.storage.writing import after_results, files_together, write_json, write_text

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

FEW = 20
"""Below this number of scenarios a bootstrap interval is likely to be too narrow."""

FIGURES = ("cost", "schedule", "trade_off", "responses")

RESPONSES = 12
"""Most contenders whose responses are drawn; learned policies are preferred to laws."""

FLEET_FIGURE = "devices"

_NAMES = (
    *COMPARISON_MARKS,
    "report.html",
    *(f"{figure}.{kind}" for figure in (*FIGURES, FLEET_FIGURE) for kind in KINDS),
)

_DETAILS = (
    *("rise_time", "settling_time", "overshoot", "resting_stiffness", "push_deflection", "agonist_switches"),
    "failed",
)


def write_report(results: Results, folder: str | Path) -> Summary:
    """Write ``results.json``, ``scenarios.csv``, ``report.html`` and the figures into a folder.

    The numbers are written first and replace all files of an earlier comparison in the folder; other files stay.
    Figures are drawn then, so that an error in them loses no number. The content of ``results.json`` is returned.

    Raises
    ------
    AmulettError
        If the folder cannot be written; if it never could, an earlier comparison in it is unchanged.
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


def write_fleet_report(results: FleetResults, folder: str | Path) -> Summary:
    """Write ``results.json``, ``scenarios.csv``, ``report.html`` and ``devices.png`` of a comparison over a fleet.

    Order, returned content and errors are those of `write_report`.
    """
    summary = summarise_fleet(results)
    with files_together(folder, _NAMES) as new:
        write_json(new / "results.json", summary)
        write_fleet_scenarios(results, new / "scenarios.csv")
    with after_results(f"results.json and scenarios.csv in {folder}"):
        from amulett_gym.reporting.style import save_figures

        figures = draw_fleet(summary)
        page = render_fleet(summary, figures)
        with files_together(folder, ()) as new:
            save_figures(figures, new)
            write_text(new / "report.html", page)
    return summary


def draw_fleet(summary: Summary) -> dict[str, Figure]:
    """Return the figure ``devices`` of a comparison over a fleet; none if eq. 6 ran alone."""
    from amulett_gym.evaluation import plots

    cost = COST_OF[summary["track"]]
    ranking = sorted(summary["policies"], key=lambda name: summary["policies"][name][cost]["mean"])
    found = summary["devices"]
    ratios = {
        name: [found[device][name]["ratio_to_eq6"]["mean"] for device in found] for name in ranking if name != YARDSTICK
    }
    text = f"{METRICS[cost].name}, relative to eq. 6 on the device [1]"
    if not ratios:
        return {}
    return {FLEET_FIGURE: plots.devices_figure(ratios, list(found), summary["labels"], text)}


def render_fleet(summary: Summary, figures: dict[str, Figure]) -> str:
    """Return the report of a comparison over a fleet as one HTML page, like :func:`render`."""
    from amulett_gym.reporting.style import figure_svg

    return fill_page(
        "evaluation/fleet_page.html.j2",
        summary=summary,
        long_names={name: short for name, short in summary["labels"].items() if name != short},
        main=fleet_table(summary).html(),
        families=family_table(summary).html(),
        devices=device_table(summary).html(),
        metrics=_table(summary, METRICS),
        few=min(summary["episodes"], len(summary["fleet"])) < FEW,
        figures={name: figure_svg(figure, name) for name, figure in figures.items()},
    )


def remove_comparison(folder: Path) -> None:
    """Remove the files of an earlier comparison: the next one may not replace all of them."""
    try:
        for name in _NAMES:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise AmulettError(f"cannot write to the folder '{folder}': {error.strerror or error}") from error


def draw(results: Results, summary: Summary) -> dict[str, Figure]:
    """Return the figures of a comparison by name: `cost`, `schedule` (if there is one), `trade_off`, `responses`.

    The responses are those to the first scenario, recorded again at control rate.
    """
    from amulett_gym.evaluation import motion_plots, plots

    protocol = results.protocol
    first = sorted(results.values, key=lambda name: name != YARDSTICK and not is_bundle(name))[:RESPONSES]
    names = [name for name in results.values if name in first]
    trajectories = {name: record_episode(results.contender(name), protocol).trajectory for name in names}
    figures = {"cost": plots.cost_figure(summary)}
    if results.schedules:
        figures["schedule"] = plots.schedule_figure(results.schedules, protocol.profile.variable_stiffness)
    figures["trade_off"] = plots.trade_off_figure(summary)
    figures["responses"] = motion_plots.step_response_figure(trajectories)
    return figures


def render(results: Results, summary: Summary, figures: dict[str, Figure]) -> str:
    """Return the report as one HTML page with inline figures and styles, without scripts.

    `summary` is from :func:`amulett_gym.evaluation.comparison.summarise`, `figures` from :func:`draw`.
    """
    from amulett_gym.reporting.style import figure_svg

    label, device = summary["labels"], Simulation(results.protocol.profile, 1)
    return fill_page(
        "evaluation/page.html.j2",
        summary=summary,
        labels=label,
        long_names={name: short for name, short in label.items() if name != short},
        main=_table(summary, (COST_OF[summary["track"]], "position_ise", EFFORT_OF[summary["track"]], "tension_ise")),
        details=_table(summary, _DETAILS, ratios=False),
        everything=_table(summary, METRICS, titles=False),
        metrics=METRICS.values(),
        failures=_failures(results),
        few=summary["episodes"] < FEW,
        command=summary["command"] or _call(results),
        figures={name: figure_svg(figure, name) for name, figure in figures.items()},
        band=round(math.degrees(device.parameters["margin"][0]), 3),
        max_force=device.max_force,
    )


def _table(summary: Summary, keys: Iterable[str], ratios: bool = True, titles: bool = True) -> Markup:
    """Return a row for each contender: means, intervals, maybe ratios to eq. 6; headings are metrics' names or keys."""
    label, policies, metrics = summary["labels"], summary["policies"], [METRICS[key] for key in keys]
    rows = [[label[name], *(_cell(metric, policies, name, ratios) for metric in metrics)] for name in policies]
    head = [metric.heading if titles else metric.heading.replace(metric.name, metric.key) for metric in metrics]
    return Table("", ("contender", *head), rows).html("stack lines")


def _cell(metric: Metric, policies: Mapping[str, Any], name: str, ratios: bool) -> Markup:
    """Return a mean, bold if it is the best of several, with its interval and remarks below."""
    entry = policies[name][metric.key]
    means = {other[metric.key]["mean"] for other in policies.values()} - {None}
    best = {True: min, False: max}[metric.lower_is_better] if metric.lower_is_better is not None else None
    is_best = best is not None and len(means) > 1 and entry["mean"] == best(means)
    below = [interval(entry["low"], entry["high"], metric.digits)]
    if ratios and entry["ratio_to_eq6"]["mean"] is not None:
        below.append(f"× eq6: {span(entry['ratio_to_eq6'])}")
    if metric.key == "rise_time":
        share = risen(policies[name])
        below.append(f"{share} of the steps risen" if "%" in share else share)
    if missing := entry.get("not_reached", 0):
        below.append(f"none in {missing} scenario{'' if missing == 1 else 's'}")
    small = Markup("").join(Markup('<span class="small">{}</span>').format(pretty(text)) for text in below)
    return Markup('<span class="best">{}</span>{}' if is_best else "{}{}").format(
        pretty(metric.text(entry["mean"])), small
    )


def _failures(results: Results) -> list[str]:
    label, episodes = labels(list(results.values)), results.protocol.episodes
    where = f" on {results.push_suite}, where the push deflection was measured"
    counts = [
        (name, count, f", {reason}")
        for name, reasons in results.failures.items()
        for reason, count in sorted(Counter(filter(None, reasons)).items())
    ]
    counts += [(name, count, where) for name, count in results.push_failures.items() if count]
    return [f"{label[name]}: {count} of {episodes}{how}" for name, count, how in counts]


def _call(results: Results) -> str:
    protocol = results.protocol
    names = [name for name in results.values if results.listed or name != "eq6"]
    return (
        f"evaluate({names}, suite={protocol.suite!r}, profile=<{protocol.profile.name}>, episodes={protocol.episodes}, "
        f"seed={protocol.seed}, env_id={protocol.env_id!r}, split={protocol.split!r}, duration={protocol.duration}, "
        f"agent_period={protocol.agent_period}{', scenarios=<own>' * bool(protocol.scenarios)})"
    )
