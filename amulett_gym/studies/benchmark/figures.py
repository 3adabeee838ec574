"""The benchmark's figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.variable_stiffness import scaling_factor
from amulett_gym.evaluation import plots
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import YARDSTICK, Protocol, Schedule
from amulett_gym.laws.contenders import CONSTANT, constant_tension
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure, FuncFormatter
from amulett_gym.reporting.words import number, pretty
from amulett_gym.simulation.trajectory import Trajectory
from amulett_gym.studies.benchmark.description import PAPER_STEP
from amulett_gym.studies.benchmark.results import POSITION_ONLY, TUNED_EQ6, TUNED_LAW, Content
from amulett_gym.studies.benchmark.runs import learning_curve
from amulett_gym.studies.benchmark.stages import Evidence

_LAWS = {
    YARDSTICK: (style.BLACK, "o"),
    "eq6-printed": (style.GREY, "o"),
    TUNED_EQ6: (style.GREEN, "s"),
    TUNED_LAW: (style.PURPLE, "D"),
    POSITION_ONLY: (style.BROWN, "v"),
}
_OTHER_LAWS = ((style.SKY, "<"), (style.OLIVE, ">"), (style.INDIGO, "h"))
_LEARNED = (("#D62718", "P"), ("#F0708A", "X"), ("#8C1020", "*"), ("#E8A090", "d"))
_REFERENCES = ((style.ORANGE, "^"), ("#B8860B", "^"))
_ABLATION = ("#c9a0a0", ".")
_BEST_CONSTANT = (style.BLUE, "o")

SPEED_LIMIT = 120.0
"""Largest joint rate that the law is drawn for [deg/s]."""

MOST_MEMBERS = 4
"""Learned entries whose law or response is drawn."""


def draw(evidence: Evidence, found: Content) -> dict[str, Figure]:
    """Return all figures by name; those that nothing was measured for are left out."""
    made = {
        "ratios": ratio_figure(found),
        "pareto": pareto_figure(found),
        "constants": constants_figure(found),
        "responses": responses_figure(evidence, found),
        "resting": resting_figure(found),
        "profiles": profiles_figure(found),
    }
    if found["references"]["clairvoyant"]:
        made |= {"score": score_figure(found), "search": search_figure(found)}
    if len(found["families"]) > 1:
        made["families"] = families_figure(found)
    schedules = _drawn_schedules(evidence)
    if schedules:
        law = evidence.profile.variable_stiffness
        made |= {"law": plots.schedule_figure(schedules, law), "law_by_velocity": velocity_figure(schedules, law)}
    curves = _curves(evidence)
    if curves:
        made["learning"] = learning_figure(curves, found)
    if found["worst"]:
        made["worst"] = worst_figure(evidence, found)
    return made


def styles(found: Content) -> dict[str, tuple[str, str]]:
    """Return a colour and a marker for each entry: eq. 6 is black, what was learned is red."""
    given: dict[str, tuple[str, str]] = {}
    counts = dict.fromkeys(("law", "learned", "reference"), 0)
    palettes = {"law": _OTHER_LAWS, "learned": _LEARNED, "reference": _REFERENCES}
    for name, entry in found["entries"].items():
        kind = "law" if entry["kind"] == "own" else entry["kind"]
        if name in _LAWS:
            given[name] = _LAWS[name]
        elif kind == "constant":
            given[name] = _BEST_CONSTANT
        elif kind == "ablation":
            given[name] = _ABLATION
        else:
            given[name] = palettes[kind][counts[kind] % len(palettes[kind])]
            counts[kind] += 1
    return given


@style.styled
def score_figure(found: Content) -> Figure:
    """Draw each entry's score on every suite that was searched: 0 is the best constant overall, 1 the clairvoyant."""
    clairvoyant = found["references"]["clairvoyant"]
    rows = {
        suite: {name: score for name, score in goal["score"].items() if _is_shown(found, name)}
        for suite, goal in clairvoyant.items()
    }
    titles = {suite: f"{suite} ({goal['scenarios']})" for suite, goal in clairvoyant.items()}
    label = "score: 0 is the best constant overall, 1 the clairvoyant reference"
    return _dots(found, rows, titles, label, (-1.5, 1.2), {0.0: style.BLUE, 1.0: style.ORANGE})


@style.styled
def ratio_figure(found: Content) -> Figure:
    """Draw each entry's cost as a share of eq. 6's, on every suite and split."""
    rows, titles = {}, {}
    for place, results in found["results"].items():
        rows[place] = {
            name: numbers["ratio"][YARDSTICK]
            for name, numbers in results.items()
            if name != YARDSTICK and _is_shown(found, name)
        }
        titles[place] = place.replace("/", ", ")
    return _dots(found, rows, titles, "cost as a share of eq. 6's", (0.2, 1.6), {1.0: style.BLACK})


def _dots(
    found: Content,
    rows: Mapping[str, Mapping[str, Any]],
    titles: Mapping[str, str],
    label: str,
    limits: tuple[float, float],
    marks: Mapping[float, str],
) -> Figure:
    """Draw a panel for each place with a dot and its interval for each entry; what lies beyond is an arrow."""
    looks = styles(found)
    names = [name for name in found["entries"] if any(name in entries for entries in rows.values())]
    columns = min(3, len(rows))
    lines = -(-len(rows) // columns)
    figure = Figure(figsize=(style.WIDTH, 1.1 + lines * (0.55 + 0.2 * len(names))), layout="constrained")
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for k, panel in enumerate(grid.flat):
        if k >= len(rows):
            panel.set_axis_off()
            continue
        place = list(rows)[k]
        panel.set_title(titles[place])
        for mark, colour in marks.items():
            panel.axvline(mark, color=colour, linewidth=0.9)
        for row, name in enumerate(reversed(names)):
            estimate = rows[place].get(name)
            if estimate is None or estimate["mean"] is None:
                continue
            colour, marker = looks[name]
            middle = estimate["mean"]
            if not limits[0] <= middle <= limits[1]:
                side = limits[0] if middle < limits[0] else limits[1]
                text = f"◀ {middle:.2g}" if middle < limits[0] else f"{middle:.2g} ▶"
                panel.annotate(
                    text,
                    (side, row),
                    color=colour,
                    va="center",
                    ha="left" if middle < limits[0] else "right",
                    fontsize=7,
                )
                continue
            panel.errorbar(
                middle,
                row,
                xerr=style.reach(estimate),
                color=colour,
                marker=marker,
                markersize=5.5,
                linewidth=0,
                elinewidth=1.2,
            )
        panel.set_yticks(range(len(names)), [_label(found, name) for name in reversed(names)])
        panel.set_ylim(-0.6, len(names) - 0.4)
        panel.set_xlim(*limits)
        panel.grid(False, axis="y")
        panel.tick_params(axis="y", length=0, labelleft=k % columns == 0)
        panel.tick_params(axis="x", labelbottom=True)
    figure.supxlabel(label, fontsize=9.0)
    return figure


@style.styled
def pareto_figure(found: Content) -> Figure:
    """Draw position ISE against both drives' ISAV, and contact torque against push deflection, as ratios to eq. 6's."""
    headline = f"{found['description']['headline']}/held-out"
    pairs = [
        (("position_ise", headline, "position ISE"), ("effort", headline, "ISAV of both drives, without the jump"))
    ]
    if {"contact/held-out", "hold-push/held-out"} <= set(found["results"]):
        torque = "contact_peak", "contact/held-out", "peak contact torque on contact"
        pairs.append((torque, ("push_deflection", "hold-push/held-out", "push deflection on hold-push")))
    looks = styles(found)
    figure = Figure(figsize=(style.WIDTH, 4.9), layout="constrained")
    for panel, axes in zip(figure.subplots(1, len(pairs), squeeze=False)[0], pairs, strict=True):
        constants = []
        panel.axhline(1.0, color=style.GREY, linewidth=0.7)
        panel.axvline(1.0, color=style.GREY, linewidth=0.7)
        for name, entry in found["entries"].items():
            across, up = (_to_eq6(found, place, name, metric) for metric, place, _ in axes)
            if across["mean"] is None or up["mean"] is None:
                continue
            if entry["kind"] == "constant":
                constants.append((constant_tension(name), across["mean"], up["mean"]))
            if not _is_shown(found, name):
                continue
            colour, marker = looks[name]
            panel.errorbar(
                across["mean"],
                up["mean"],
                xerr=style.reach(across),
                yerr=style.reach(up),
                color=colour,
                marker=marker,
                markersize=7,
                markeredgecolor="white",
                markeredgewidth=0.6,
                linewidth=0,
                elinewidth=1.1,
                zorder=4,
            )
            panel.plot([], [], color=colour, marker=marker, linewidth=0, label=_label(found, name))
        line = np.array(sorted(constants))
        panel.plot(line[:, 1], line[:, 2], color=style.BLUE, linewidth=0.9, marker=".", markersize=4, alpha=0.8)
        for tension, x, y in line[:: max(len(line) // 4, 1)]:
            panel.annotate(f"{tension:g} N", (x, y), (4, 4), textcoords="offset points", fontsize=7, color=style.BLUE)
        for put, (metric, place, title) in zip((panel.set_xlabel, panel.set_ylabel), axes, strict=True):
            paid = found["results"][place][YARDSTICK]["metrics"][metric]["mean"]
            put(f"{title},\nin units of eq. 6's {pretty(number(paid))} {_unit(found['units'][metric])}")
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5)
    return figure


def _to_eq6(found: Content, place: str, name: str, metric: str) -> Mapping[str, Any]:
    """Return a metric's ratio to eq. 6's; of a constant that is told no more of, without an interval."""
    numbers = found["results"][place][name]["metrics"][metric]
    if "ratio_to_eq6" in numbers:
        return dict(numbers["ratio_to_eq6"])
    paid = found["results"][place][YARDSTICK]["metrics"][metric]["mean"]
    return {"mean": numbers["mean"] / paid if paid else None, "low": None, "high": None}


@style.styled
def constants_figure(found: Content) -> Figure:
    """Draw what each constant costs on each suite's split `train`, its least marked."""
    figure = Figure(figsize=(style.WIDTH, 3.7), layout="constrained")
    panel = figure.subplots()
    palette = (style.BLACK, style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.RED, style.SKY, style.BROWN)
    for k, (suite, costs) in enumerate(found["constants"]["tried"].items()):
        tensions, means = [constant_tension(name) for name in costs], np.array(list(costs.values()))
        colour, best = palette[k % len(palette)], int(means.argmin())
        dashes = "-" if k < len(palette) else "--"
        panel.plot(
            tensions, means / means[best], color=colour, linestyle=dashes, label=f"{suite}: {tensions[best]:g} N"
        )
        panel.plot(tensions[best], 1.0, color=colour, marker="o", markersize=6, markeredgecolor="white", zorder=5)
    panel.set_ylim(0.97, min(max(panel.get_ylim()[1], 1.1), 2.0))
    panel.set_xlabel("constant tension setpoint [N]")
    panel.set_ylabel("cost, over the least\nof any constant on that suite")
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="suite: its best constant")
    return figure


def _curves(evidence: Evidence) -> dict[str, list[NDArray[np.float64]]]:
    """Return the validations of all runs but the ablations', by entry."""
    curves: dict[str, list[NDArray[np.float64]]] = {}
    for run in evidence.runs:
        if evidence.entries[run.entry].kind != "ablation":
            curves.setdefault(run.entry, []).append(learning_curve(run))
    return curves


@style.styled
def learning_figure(curves: Mapping[str, list[NDArray[np.float64]]], found: Content) -> Figure:
    """Draw the validation costs of runs by agent steps and by wall clock; `curves` are from `runs.learning_curve`."""
    looks = styles(found)
    figure = Figure(figsize=(style.WIDTH, 4.2), layout="constrained")
    grid = figure.subplots(1, 2, sharey=True)
    for name, runs in curves.items():
        for k, panel in enumerate(grid):
            for seed, run in enumerate(runs):
                label = _label(found, name) if seed == 0 else None
                panel.plot(run[:, k], run[:, 2], color=looks[name][0], linewidth=0.9, alpha=0.7, label=label)
    for law, cost in found["validation"].items():
        for panel in grid:
            panel.axhline(cost, color=looks[law][0], linewidth=1.0, linestyle=":")
        grid[1].annotate(
            _label(found, law),
            (1.01, cost),
            xycoords=("axes fraction", "data"),
            va="center",
            color=looks[law][0],
            fontsize=8,
        )
    costs = np.concatenate([run[:, 2] for runs in curves.values() for run in runs])
    lines = list(found["validation"].values())
    top = max([float(np.percentile(costs, 90)), *lines])
    grid[0].set_ylim(0.97 * min([float(costs.min()), *lines]), 1.03 * top)
    for panel in grid:
        panel.set_xlim(left=0.0)
    grid[0].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1e6:g}"))
    grid[0].set_xlabel("agent steps [million]")
    grid[1].set_xlabel("wall clock [s]")
    grid[0].set_ylabel("cost on the validation scenarios (minus the return)")
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    return figure


def _drawn_schedules(evidence: Evidence) -> dict[str, Schedule]:
    """Return the schedules to draw: of learned entries' chosen members and the tuned richer law."""
    learned = [name for name in evidence.schedules if evidence.entries[name].kind in ("learned", "reference")]
    names = [*learned[:MOST_MEMBERS], *(name for name in (TUNED_LAW, TUNED_EQ6) if name in evidence.schedules)]
    return {name: evidence.schedules[name][_member(evidence, name)] for name in names}


def _member(evidence: Evidence, name: str) -> int:
    return evidence.chosen_member(name) if evidence.entries[name].seeds else 0


@style.styled
def velocity_figure(schedules: Mapping[str, Schedule], law: Any) -> Figure:
    """Draw the median tension over position error and the rate at which the joint approaches its setpoint.

    Eq. 6 (text), which does not look at the rate, is the last panel.
    """
    errors, rates = np.linspace(0.0, 60.0, 25), np.linspace(-SPEED_LIMIT, SPEED_LIMIT, 25)
    maps = {name: _median_map(schedule, errors, rates) for name, schedule in schedules.items()}
    middles = 0.5 * (errors[1:] + errors[:-1])
    eq6 = [
        law.nominal_tension * scaling_factor(x, law.nominal_tension, law.minimum_tension, law.error_offset_deg)
        for x in middles
    ]
    maps["eq. 6, text"] = np.repeat(np.array(eq6)[None], len(rates) - 1, axis=0)
    lines = -(-len(maps) // 4)
    columns = -(-len(maps) // lines)
    low = min(float(np.nanmin(values)) for values in maps.values())
    high = max(float(np.nanmax(values)) for values in maps.values())
    figure = Figure(figsize=(style.WIDTH, 0.7 + 2.6 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
    for k, panel in enumerate(grid.flat):
        if k >= len(maps):
            panel.set_axis_off()
            continue
        name = list(maps)[k]
        panel.pcolormesh(errors, rates, maps[name], cmap="viridis", vmin=low, vmax=high, rasterized=True)
        panel.axhline(0.0, color="white", linewidth=0.7)
        panel.set_title(name)
        panel.grid(False)
        panel.set_facecolor("#ececec")
        if k % columns == 0:
            panel.set_ylabel("rate towards\nthe setpoint [deg/s]")
        if k + columns >= len(maps):
            panel.set_xlabel("|position error| [deg]")
    figure.colorbar(grid[0, 0].collections[0], ax=grid, label="median tension setpoint [N]", shrink=0.9)
    return figure


def _median_map(
    schedule: Schedule, errors: NDArray[np.float64], rates: NDArray[np.float64], fewest: int = 8
) -> NDArray[np.float64]:
    """Return the median tension in each cell of rate and error; NaN where there are few agent steps."""
    columns, rows = np.digitize(schedule.error, errors) - 1, np.digitize(schedule.approach, rates) - 1
    inside = (columns >= 0) & (columns < len(errors) - 1) & (rows >= 0) & (rows < len(rates) - 1)
    cells = rows[inside] * (len(errors) - 1) + columns[inside]
    order = np.argsort(cells, kind="stable")
    tensions, cells = schedule.tension[inside][order], cells[order]
    found = np.full((len(rates) - 1) * (len(errors) - 1), np.nan)
    starts = np.flatnonzero(np.diff(cells, prepend=-1))
    for start, end in zip(starts, [*starts[1:], cells.size], strict=True):
        if end - start >= fewest:
            found[cells[start]] = np.median(tensions[start:end])
    return found.reshape(len(rates) - 1, len(errors) - 1)


def responses_figure(evidence: Evidence, found: Content) -> Figure:
    """Draw what the main contenders do in the paper's step, or else in the headline suite's first scenario."""
    suite = PAPER_STEP if PAPER_STEP in evidence.description.suites else evidence.description.headline
    protocol = replace(evidence.protocol, suite=suite, duration=4.0 if suite == PAPER_STEP else 10.0)
    paths = _trajectories(evidence, _main(evidence), protocol)
    return plots.step_response_figure(paths, f"{suite}, held-out", _colours(found))


def worst_figure(evidence: Evidence, found: Content) -> Figure:
    """Draw the scenario in which the learned policy loses most, with eq. 6, the best law by hand, and the policy."""
    item = found["worst"][0]
    names = list(dict.fromkeys([YARDSTICK, found["best_by_hand"], found["best_learned"]]))
    protocol = replace(evidence.protocol, seed=item["seed"])
    paid = f"{item['learned']:.2f} in the place of {item['by_hand']:.2f}"
    title = f"{item['family']}, seed {item['seed']}: the learned policy pays {paid}"
    return plots.step_response_figure(_trajectories(evidence, names, protocol), title, _colours(found))


def _main(evidence: Evidence) -> list[str]:
    learned = [name for name, entry in evidence.entries.items() if entry.kind in ("learned", "reference")]
    asked = (YARDSTICK, evidence.best_constant(), TUNED_EQ6, TUNED_LAW, POSITION_ONLY, *learned[:MOST_MEMBERS])
    return [name for name in dict.fromkeys(asked) if name in evidence.entries]


def _trajectories(evidence: Evidence, names: list[str], protocol: Protocol) -> dict[str, Trajectory]:
    """Return what entries do in a protocol's first scenario, of what was learned the chosen member."""
    entries = evidence.entries
    return {name: record_episode(entries[name].members[_member(evidence, name)], protocol).trajectory for name in names}


def _colours(found: Content) -> dict[str, str]:
    return {name: colour for name, (colour, _) in styles(found).items()}


@style.styled
def resting_figure(found: Content) -> Figure:
    """Draw how stiff every contender rests and how far pushes deflect it: a slack arm must not win."""
    headline = f"{found['description']['headline']}/held-out"
    panels = [("resting_stiffness", headline, "resting stiffness")]
    pushed = "hold-push/held-out" if "hold-push/held-out" in found["results"] else headline
    panels.append(("push_deflection", pushed, f"push deflection on {pushed.split('/')[0]}"))
    names = list(found["entries"])
    looks = styles(found)
    figure = Figure(figsize=(style.WIDTH, 0.9 + 0.2 * len(names)), layout="constrained")
    for panel, (metric, place, title) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
        for row, name in enumerate(reversed(names)):
            estimate = found["results"][place][name]["metrics"][metric]
            if estimate["mean"] is not None:
                panel.barh(
                    row, estimate["mean"], xerr=style.reach(estimate), height=0.62, color=looks[name][0], ecolor="#444"
                )
        panel.set_yticks(range(len(names)), [_label(found, name) for name in reversed(names)])
        panel.set_ylim(-0.6, len(names) - 0.4)
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_xlabel(f"{title} [{_unit(found['units'][metric])}]")
    return figure


@style.styled
def profiles_figure(found: Content) -> Figure:
    """Draw which share of episodes costs at most so much: the more to the upper left, the better."""
    looks, profiles = styles(found), found["profiles"]
    figure = Figure(figsize=(style.WIDTH, 4.0), layout="constrained")
    panel = figure.subplots()
    costs = profiles["costs"]
    for name, shares in profiles.items():
        if name == "costs":
            continue
        colour = looks[name][0]
        panel.plot(costs, [share["mean"] for share in shares], color=colour, label=_label(found, name))
        if found["entries"][name]["kind"] == "learned":
            low, high = ([share[key] for share in shares] for key in ("low", "high"))
            panel.fill_between(costs, low, high, color=colour, alpha=0.15, linewidth=0)
    reached = [np.interp(0.99, [share["mean"] for share in shares], costs) for shares in list(profiles.values())[1:]]
    panel.set_xlim(0.0, max(*reached, 1.0))
    panel.set_ylim(0.0, 1.0)
    panel.set_xlabel("cost of an episode")
    panel.set_ylabel("share of episodes\nthat cost at most that")
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@style.styled
def families_figure(found: Content) -> Figure:
    """Draw each entry's share of eq. 6's cost in each family of the headline suite, held-out."""
    rows = {
        family: {
            name: ratio for name, ratio in entry["ratio_to_eq6"].items() if name != YARDSTICK and _is_shown(found, name)
        }
        for family, entry in found["families"].items()
    }
    titles = {family: f"{family} ({entry['scenarios']})" for family, entry in found["families"].items()}
    return _dots(found, rows, titles, "cost as a share of eq. 6's", (0.0, 1.8), {1.0: style.BLACK})


@style.styled
def search_figure(found: Content) -> Figure:
    """Draw how the clairvoyant search's mean cost fell with the episodes that it tried for each scenario."""
    clairvoyant = found["references"]["clairvoyant"]
    figure = Figure(figsize=(style.WIDTH, 3.2), layout="constrained")
    panel = figure.subplots()
    palette = (style.BLACK, style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.RED, style.SKY, style.BROWN)
    for k, (suite, goal) in enumerate(clairvoyant.items()):
        curve = np.array(goal["curve"])
        label = f"{suite} ({goal['scenarios']})"
        panel.plot(curve[:, 0], curve[:, 1] / curve[-1, 1], color=palette[k % len(palette)], label=label)
    panel.set_xlabel("episodes tried for each scenario")
    panel.set_ylabel("mean cost, over the last")
    panel.set_xlim(left=0.0)
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _is_shown(found: Content, name: str) -> bool:
    kind = found["entries"][name]["kind"]
    return kind not in ("constant", "ablation") or name == found["constants"]["overall"]


def _label(found: Content, name: str) -> str:
    if name.startswith(CONSTANT):
        return f"{constant_tension(name):g} N, the best constant" if name == found["constants"]["overall"] else name
    count = len(found["entries"][name]["seeds"])
    return f"{name} ({count} seeds)" if count > 1 else name


def _unit(unit: str) -> str:
    return pretty(unit)
