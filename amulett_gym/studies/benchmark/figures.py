"""The benchmark's figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.variable_stiffness import scaling_factor
from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.evaluation import motion_plots, plots
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.metrics import EFFORT_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK, Protocol, Schedule
from amulett_gym.laws.contenders import constant_tension, split_loop
from amulett_gym.reporting import style
from amulett_gym.reporting.style import Figure
from amulett_gym.reporting.words import pretty
from amulett_gym.simulation.layout import DRIVES
from amulett_gym.simulation.trajectory import Trajectory
from amulett_gym.studies.benchmark.description import PAPER_STEP, PAPERS, loop_of, named
from amulett_gym.studies.benchmark.learning import learning_figure
from amulett_gym.studies.benchmark.results import POSITION_ONLY, TUNED_EQ6, TUNED_LAW, Content
from amulett_gym.studies.benchmark.runs import learning_curve
from amulett_gym.studies.benchmark.stages import Evidence
from amulett_gym.studies.benchmark.tables import is_main, label

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
_SUITES = (style.BLACK, style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.RED, style.SKY, style.BROWN)
_LOOPS = (*_SUITES[1:], style.OLIVE, style.INDIGO, style.GREY, "#F0708A")
_MARKERS = {"constant": "o", "law": "s", "own": "h", "learned": "P", "reference": "^", "ablation": "."}

SPEED_LIMIT = 120.0
"""Largest joint rate that the law is drawn for [deg/s]."""

MOST_MEMBERS = 4
"""Largest number of learned entries whose law or response is drawn."""


def draw(evidence: Evidence, found: Content) -> dict[str, Figure]:
    """Return all figures by name, without those that have no data."""
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
        looks = {name: look[0] for name, look in styles(found).items()}
        labels = {name: label(found, name) for name in looks}
        made["learning"] = learning_figure(curves, labels, looks, found["validation"])
    if found["worst"]:
        made["worst"] = worst_figure(evidence, found)
    return made


def styles(found: Content) -> dict[str, tuple[str, str]]:
    """Return a colour and a marker for each entry: eq. 6 is black, what was learned is red.

    On *full control* the colour is that of the loop, and the marker that of the kind.
    """
    if found["track"] == FULL_CONTROL:
        colours = loop_colours(found)
        own = {name: (colours[entry["loop"]], _MARKERS[entry["kind"]]) for name, entry in found["entries"].items()}
        return {**own, YARDSTICK: _LAWS[YARDSTICK]}
    laws, constants, ablations = cycle(_OTHER_LAWS), cycle([_BEST_CONSTANT]), cycle([_ABLATION])
    palettes = {"law": laws, "own": laws, "constant": constants, "ablation": ablations}
    palettes |= {"learned": cycle(_LEARNED), "reference": cycle(_REFERENCES)}
    return {name: _LAWS.get(name) or next(palettes[entry["kind"]]) for name, entry in found["entries"].items()}


def loop_colours(found: Content) -> dict[str, str]:
    """Return a colour for each control loop."""
    return dict(zip(dict.fromkeys(entry["loop"] for entry in found["entries"].values()), cycle(_LOOPS)))


@style.styled
def score_figure(found: Content) -> Figure:
    """Draw each entry's score on every suite that was searched: 0 is the best constant overall, 1 the clairvoyant."""
    clairvoyant = found["references"]["clairvoyant"]
    rows = {f"{suite} ({goal['scenarios']})": goal["score"] for suite, goal in clairvoyant.items()}
    x_label = "score: 0 is the best constant overall, 1 the clairvoyant reference"
    return _dots(found, rows, x_label, (-1.5, 1.2), {0.0: style.BLUE, 1.0: style.ORANGE})


@style.styled
def ratio_figure(found: Content) -> Figure:
    """Draw each entry's cost divided by eq. 6's, on every suite and split."""
    rows = {
        place.replace("/", ", "): {name: numbers["ratio"][YARDSTICK] for name, numbers in results.items()}
        for place, results in found["results"].items()
    }
    return _ratios(found, rows, (0.0, 2.0) if found["track"] == FULL_CONTROL else (0.2, 1.6))


@style.styled
def families_figure(found: Content) -> Figure:
    """Draw each entry's cost divided by eq. 6's in each family of the headline suite, held-out."""
    rows = {f"{name} ({entry['scenarios']})": entry["ratio_to_eq6"] for name, entry in found["families"].items()}
    return _ratios(found, rows, (0.0, 1.8))


def _main_names(found: Content) -> list[str]:
    """Return the main entries; on *full control* those of a loop one after the other, eq. 6 first."""
    names = [name for name in found["entries"] if is_main(found, name)]
    if found["track"] == FULL_CONTROL:
        loops = list(loop_colours(found))
        names.sort(key=lambda name: (name != YARDSTICK, loops.index(found["entries"][name]["loop"])))
    return names


def _ratios(found: Content, rows: dict[str, dict[str, Any]], limits: tuple[float, float]) -> Figure:
    others = {title: {name: row[name] for name in row if name != YARDSTICK} for title, row in rows.items()}
    return _dots(found, others, "cost divided by eq. 6's", limits, {1.0: style.BLACK})


def _dots(
    found: Content,
    rows: Mapping[str, Mapping[str, Any]],
    x_label: str,
    limits: tuple[float, float],
    marks: Mapping[float, str],
) -> Figure:
    """Draw a panel for each row with a dot and its interval for each main entry; what lies beyond is an arrow."""
    looks = styles(found)
    names = [name for name in _main_names(found) if any(name in row for row in rows.values())]
    figure, panels = style.panel_grid(len(rows), 3, 1.1, 0.55 + 0.2 * len(names), sharex=True, sharey=True)
    for k, (panel, (title, estimates)) in enumerate(zip(panels, rows.items(), strict=True)):
        panel.set_title(title)
        for mark, colour in marks.items():
            panel.axvline(mark, color=colour, linewidth=0.9)
        for row, name in enumerate(reversed(names)):
            estimate = estimates.get(name)
            if estimate is None or estimate["mean"] is None:
                continue
            (colour, marker), middle, (least, most) = looks[name], estimate["mean"], limits
            if least <= middle <= most:
                style.draw_dot(panel, estimate, row, colour, marker, markersize=5.5, elinewidth=1.2, markeredgewidth=0)
                continue
            side, where, text = (least, "left", "◀ {:.2g}") if middle < least else (most, "right", "{:.2g} ▶")
            panel.annotate(text.format(middle), (side, row), color=colour, va="center", ha=where, fontsize=7)
        style.name_rows(panel, [label(found, name) for name in names])
        panel.set_xlim(*limits)
        panel.tick_params(axis="y", labelleft=k % 3 == 0)
        panel.tick_params(axis="x", labelbottom=True)
    figure.supxlabel(x_label, fontsize=9.0)
    return figure


@style.styled
def pareto_figure(found: Content) -> Figure:
    """Draw position ISE against both drives' ISAV, and contact torque against push deflection, as ratios to eq. 6's."""
    headline = f"{found['description']['headline']}/held-out"
    pairs = [(("position_ise", headline), (EFFORT_OF[found["track"]], headline))]
    if {"contact/held-out", "hold-push/held-out"} <= set(found["results"]):
        pairs.append((("contact_peak", "contact/held-out"), ("push_deflection", "hold-push/held-out")))
    looks = styles(found)
    figure, panels = style.panel_grid(len(pairs), 2, 0.0, 4.9)
    for panel, axes in zip(panels, pairs, strict=True):
        constants: dict[str, list[tuple[float, float, float]]] = {}
        panel.axhline(1.0, color=style.GREY, linewidth=0.7)
        panel.axvline(1.0, color=style.GREY, linewidth=0.7)
        for name, entry in found["entries"].items():
            if any(name not in found["results"][place] for _, place in axes):
                continue
            across, up = (_to_eq6(found, place, name, metric) for metric, place in axes)
            if across["mean"] is None or up["mean"] is None:
                continue
            if entry["kind"] == "constant":
                constants.setdefault(entry["loop"], []).append((_newtons(name), across["mean"], up["mean"]))
            if not is_main(found, name):
                continue
            style.draw_dot(panel, across, up, *looks[name], label(found, name), zorder=4)
        for loop, tried in constants.items():
            line, colour = np.array(sorted(tried)), loop_colours(found)[loop]
            panel.plot(line[:, 1], line[:, 2], color=colour, linewidth=0.9, marker=".", markersize=4, alpha=0.8)
            for tension, x, y in line[:: max(len(line) // 4, 1)] if len(constants) == 1 else ():
                panel.annotate(f"{tension:g} N", (x, y), (4, 4), textcoords="offset points", fontsize=7, color=colour)
        for put, (key, place) in zip((panel.set_xlabel, panel.set_ylabel), axes, strict=True):
            metric, suite = METRICS[key], "" if place == headline else f" on {place.split('/')[0]}"
            one = pretty(f"{metric.text(found['results'][place][YARDSTICK]['metrics'][key]['mean'])} {metric.unit}")
            put(f"{metric.name}{suite},\nin units of eq. 6's {one}")
    handles, names = figure.axes[0].get_legend_handles_labels()
    style.legend_below(figure, handles, ncols=4 if max(map(len, names)) > 24 else 5)
    return figure


def _to_eq6(found: Content, place: str, name: str, metric: str) -> Mapping[str, Any]:
    """Return a metric's ratio to eq. 6's, without an interval for a constant of which there is only the mean."""
    numbers = found["results"][place][name]["metrics"][metric]
    if "ratio_to_eq6" in numbers:
        return dict(numbers["ratio_to_eq6"])
    one = found["results"][place][YARDSTICK]["metrics"][metric]["mean"]
    return {"mean": numbers["mean"] / one if one else None, "low": None, "high": None}


@style.styled
def constants_figure(found: Content) -> Figure:
    """Draw the cost of each constant on each suite's split `train`, the lowest marked.

    On *full control*: in each loop on the headline suite.
    """
    tried = found["constants"]["tried"]
    curves, what, loops = tried, "suite", dict[str, str]()
    if found["track"] == FULL_CONTROL:
        overall, what, curves = tried[found["description"]["headline"]], "control loop", {}
        loops = loop_colours(found)
        for name, cost in overall.items():
            curves.setdefault(loop_of(name), {})[name] = cost
    figure, panel = style.one_panel(3.7)
    for k, (suite, costs) in enumerate(curves.items()):
        tensions, means = [_newtons(name) for name in costs], np.array(list(costs.values()))
        colour, best = loops.get(suite, _SUITES[k % len(_SUITES)]), int(means.argmin())
        dashes = "-" if k < len(_SUITES) else "--"
        panel.plot(
            tensions, means / means[best], color=colour, linestyle=dashes, label=f"{suite}: {tensions[best]:g} N"
        )
        panel.plot(tensions[best], 1.0, color=colour, marker="o", markersize=6, markeredgecolor="white", zorder=5)
    panel.set_ylim(0.97, min(max(panel.get_ylim()[1], 1.1), 2.0))
    panel.set_xlabel("constant tension setpoint [N]")
    panel.set_ylabel(f"cost, divided by that of\nthe {what}'s best constant")
    style.legend_beside(panel, title=f"{what}: its best constant")
    return figure


def _newtons(name: str) -> float:
    """Return the tension of a constant, in any loop [N]."""
    return constant_tension(split_loop(name)[1])


def _curves(evidence: Evidence) -> dict[str, list[NDArray[np.float64]]]:
    """Return the validations of all runs but the ablations', by entry."""
    curves: dict[str, list[NDArray[np.float64]]] = {}
    for run in evidence.runs:
        if evidence.entries[run.entry].kind != "ablation":
            curves.setdefault(run.entry, []).append(learning_curve(run))
    return curves


def _drawn_schedules(evidence: Evidence) -> dict[str, Schedule]:
    """Return the schedules to draw: of learned entries' chosen members and the tuned laws.

    On *full control* those in the loop of the best constant, and those learned in the paper's loop and without a loop.
    """
    learned = [name for name in evidence.schedules if evidence.entries[name].kind in ("learned", "reference")]
    laws, loop = [TUNED_LAW, TUNED_EQ6], loop_of(evidence.best_constant())
    if evidence.description.track == FULL_CONTROL:
        best = evidence.description.best_learned
        learned = [*dict.fromkeys([best, *learned])] if best in learned else learned
        learned = [name for name in learned if name == best or loop_of(name) in (loop, PAPERS)]
        laws = [named(loop, law) for law in laws]
    names = [*learned[:MOST_MEMBERS], *(name for name in laws if name in evidence.schedules)]
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
    low = min(float(np.nanmin(values)) for values in maps.values())
    high = max(float(np.nanmax(values)) for values in maps.values())
    figure, panels = style.panel_grid(len(maps), -(-len(maps) // -(-len(maps) // 4)), 0.7, 2.6, sharey=True)
    for panel, (name, tensions) in zip(panels, maps.items(), strict=True):
        panel.pcolormesh(errors, rates, tensions, cmap="viridis", vmin=low, vmax=high, rasterized=True)
        panel.axhline(0.0, color="white", linewidth=0.7)
        panel.set_title(name)
        panel.grid(False)
        panel.set_facecolor("#ececec")
    style.label_outer(panels, "|position error| [deg]", "rate towards\nthe setpoint [deg/s]")
    figure.colorbar(panels[0].collections[0], ax=figure.axes, label="median tension setpoint [N]", shrink=0.9)
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
    """Draw the main contenders' responses to the paper's step, or else in the headline suite's first scenario."""
    suite = PAPER_STEP if PAPER_STEP in evidence.description.suites else evidence.description.headline
    protocol = replace(evidence.protocol, suite=suite, duration=4.0 if suite == PAPER_STEP else 10.0)
    paths = _trajectories(evidence, _main(evidence), protocol)
    return motion_plots.step_response_figure(paths, f"{suite}, held-out", _colours(found))


def worst_figure(evidence: Evidence, found: Content) -> Figure:
    """Draw the learned policy's worst scenario, with eq. 6, the best tuned law, and the policy."""
    item = found["worst"][0]
    names = list(dict.fromkeys([YARDSTICK, found["best_by_hand"], found["best_learned"]]))
    protocol = replace(evidence.protocol, seed=item["seed"])
    costs = f"cost {item['learned']:.2f} of the learned policy, {item['by_hand']:.2f} of the best tuned law"
    title = f"{item['family']}, seed {item['seed']}: {costs}"
    return motion_plots.step_response_figure(_trajectories(evidence, names, protocol), title, _colours(found))


def _main(evidence: Evidence) -> list[str]:
    learned = [name for name, entry in evidence.entries.items() if entry.kind in ("learned", "reference")]
    if evidence.description.track == FULL_CONTROL:
        best = evidence.description.best_learned
        drawn = [name for name in learned if name == best or evidence.entries[name].loop == DRIVES]
        return [YARDSTICK, *evidence.best_constants(), *(drawn or learned[:MOST_MEMBERS])]
    asked = (YARDSTICK, evidence.best_constant(), TUNED_EQ6, TUNED_LAW, POSITION_ONLY, *learned[:MOST_MEMBERS])
    return [name for name in dict.fromkeys(asked) if name in evidence.entries]


def _trajectories(evidence: Evidence, names: list[str], protocol: Protocol) -> dict[str, Trajectory]:
    """Return the entries' trajectories in a protocol's first scenario, of trained entries the chosen member's."""
    entries = evidence.entries
    return {name: record_episode(entries[name].members[_member(evidence, name)], protocol).trajectory for name in names}


def _colours(found: Content) -> dict[str, str]:
    return {name: colour for name, (colour, _) in styles(found).items()}


@style.styled
def resting_figure(found: Content) -> Figure:
    """Draw every contender's resting stiffness and its deflection under pushes: shows slack arms."""
    headline = f"{found['description']['headline']}/held-out"
    pushed = "hold-push/held-out" if "hold-push/held-out" in found["results"] else headline
    shown = (("resting_stiffness", headline), ("push_deflection", pushed))
    full = found["track"] == FULL_CONTROL
    names = _main_names(found) if full else list(found["entries"])
    looks = styles(found)
    figure, panels = style.panel_grid(2, 2, 0.0, 0.9 + 0.2 * len(names), sharey=True)
    for panel, (key, place) in zip(panels, shown, strict=True):
        for row, name in enumerate(reversed(names)):
            estimate = found["results"][place][name]["metrics"][key]
            if estimate["mean"] is not None:
                bar = {"height": 0.62, "color": looks[name][0], "ecolor": "#444"}
                panel.barh(row, estimate["mean"], xerr=style.reach(estimate), **bar)
        style.name_rows(panel, [label(found, name) for name in names])
        panel.set_xlabel(f"{pretty(METRICS[key].heading)} on {place.split('/')[0]}")
    return figure


@style.styled
def profiles_figure(found: Content) -> Figure:
    """Draw the share of episodes over the highest cost that they have: upper left is better."""
    looks, profiles = styles(found), found["profiles"]
    figure, panel = style.one_panel(4.0)
    costs = profiles["costs"]
    for name, shares in profiles.items():
        if name == "costs" or (found["track"] == FULL_CONTROL and not is_main(found, name)):
            continue
        colour = looks[name][0]
        panel.plot(costs, [share["mean"] for share in shares], color=colour, label=label(found, name))
        if found["entries"][name]["kind"] == "learned":
            low, high = ([share[key] for share in shares] for key in ("low", "high"))
            panel.fill_between(costs, low, high, color=colour, alpha=0.15, linewidth=0)
    reached = [np.interp(0.99, [share["mean"] for share in shares], costs) for shares in list(profiles.values())[1:]]
    panel.set_xlim(0.0, max(*reached, 1.0))
    panel.set_ylim(0.0, 1.0)
    panel.set_xlabel("cost of an episode")
    panel.set_ylabel("share of episodes\nwith at most that cost")
    style.legend_beside(panel)
    return figure


@style.styled
def search_figure(found: Content) -> Figure:
    """Draw the clairvoyant search's mean cost over the episodes tried for each scenario."""
    clairvoyant = found["references"]["clairvoyant"]
    figure, panel = style.one_panel(3.2)
    for k, (suite, goal) in enumerate(clairvoyant.items()):
        curve = np.array(goal["curve"])
        text = f"{suite} ({goal['scenarios']})"
        panel.plot(curve[:, 0], curve[:, 1] / curve[-1, 1], color=_SUITES[k % len(_SUITES)], label=text)
    panel.set_xlabel("episodes tried for each scenario")
    panel.set_ylabel("mean cost / final mean cost")
    panel.set_xlim(left=0.0)
    style.legend_beside(panel)
    return figure
