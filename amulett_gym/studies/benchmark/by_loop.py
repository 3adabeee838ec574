"""The tables of the track *full control*, by control loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.contenders import CONSTANT, split_loop
from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import number, with_interval
from amulett_gym.studies.benchmark.description import PAPER_STEP, loop_of

Content = dict[str, Any]

BEST = " *"
"""Marks the best of a column."""

_MEASURES = (
    (PAPER_STEP, "held-out", "settling_time"),
    ("", "held-out", "position_ise"),
    ("", "held-out", "drive_effort"),
    ("contact", "held-out", "contact_peak"),
    ("contact", "held-out", "contact_ise"),
    ("hold-push", "held-out", "push_deflection"),
    ("payload", "held-out", ""),
    ("", "shifted", ""),
)
"""Suite (empty: the headline), split, and metric (empty: the ratio of costs to eq. 6's) by which loops are compared."""


def by_loop(found: Content) -> dict[str, Table]:
    """Return the tables by name; some may be empty."""
    return {
        "loops": loops_and_laws(found, "held-out"),
        "loops_shifted": loops_and_laws(found, "shifted"),
        "best_at": best_at(found),
        "scheduling": scheduling(found),
        "constants": constants(found),
    }


def loops_and_laws(found: Content, split: str) -> Table:
    """Return the cost of each law in each loop relative to that of eq. 6 in the paper's loop."""
    headline = found["description"]["headline"]
    results, best = found["results"].get(f"{headline}/{split}", {}), best_constants(found)
    entries = {name: entry for name, entry in found["entries"].items() if entry["kind"] not in ("constant", "ablation")}
    loops = list(dict.fromkeys([*best, *(entry["loop"] for entry in entries.values())]))
    laws = list(dict.fromkeys(split_loop(name)[1] for name in entries))
    names = {(entry["loop"], split_loop(name)[1]): name for name, entry in entries.items()}

    def cell(name: str | None) -> str:
        if name not in results:
            return "-"
        count = results[name]["failures"]["count"]
        return with_interval(results[name]["ratio"][YARDSTICK]) + (f", {count} failed" if count else "")

    rows = []
    for loop in loops if results else []:
        tension = f"{_tension(best[loop])} N: " if loop in best else ""
        rows.append([loop, tension + cell(best.get(loop)), *(cell(names.get((loop, law))) for law in laws)])
    note = (
        "Full-control cost divided by that of eq. 6 in the paper's loop, in the same scenarios, with 95 % intervals; "
        "failed: number of episodes in which the device left its limits, if any. Each loop's best constant is chosen "
        "on the split train."
    )
    return Table(f"Loops and laws: {headline}, {split}", ("control loop", "best constant", *laws), rows, note)


def best_at(found: Content) -> Table:
    """Return what each loop is good at, with its best constant."""
    headline, best = found["description"]["headline"], best_constants(found)
    columns, head = [], []
    for suite, split, key in _MEASURES:
        results = found["results"].get(f"{suite or headline}/{split}")
        if results is None:
            continue
        values = [
            (results[name]["metrics"][key] if key else results[name]["ratio"][YARDSTICK]) for name in best.values()
        ]
        means = [value["mean"] for value in values]
        least = min((mean for mean in means if mean is not None), default=None)
        columns.append([number(mean) + (BEST if mean is not None and mean == least else "") for mean in means])
        what = METRICS[key].heading if key else "cost, ratio to eq6"
        head.append(f"{what}: {suite or headline}" + ("" if split == "held-out" else f", {split}"))
    rows = [[f"{loop}, {_tension(best[loop])} N", *cells] for loop, *cells in zip(best, *columns, strict=True)]
    note = (
        f"Each loop with its best constant on {headline}. An asterisk marks the lowest value of a column. Scenarios of "
        "payload have masses that the loops do not know; those of the split shifted have device parameters and sensor "
        "noise outside the ranges of the others."
    )
    return Table("Which loop is best at what", ("control loop", *head), rows, note)


def scheduling(found: Content) -> Table:
    """Return by family how much a schedule lowers the cost of its loop's best constant."""
    best, families = best_constants(found), found["families"]
    top = loop_of(found["constants"]["overall"])
    shown = [
        name
        for name, entry in found["entries"].items()
        if entry["kind"] == "learned" or (entry["kind"] == "law" and entry["loop"] == top)
    ]
    rows = []
    for family, content in families.items():
        ratios = content["ratio_to_constant"]
        cells = (with_interval(ratios.get(name)) for name in shown)
        rows.append([f"{family} ({content['scenarios']})", *cells, with_interval(content.get("clairvoyant"))])
    note = (
        f"Full-control cost divided by that of the best constant in the same loop ({', '.join(best.values())}; what "
        "has another loop: of the best of all), held-out, with 95 % intervals; below 1 the schedule is better. "
        f"Clairvoyant: the best schedule in {top} of the first scenarios that a search finds with everything known."
    )
    return Table("Where a schedule is better than a constant", ("family", *shown, "clairvoyant"), rows, note)


def constants(found: Content) -> Table:
    """Return the best constant of each loop on each suite's split train."""
    tried, by_suite = found["constants"]["tried"], found["constants"]["best_by_loop"]
    rows = []
    for loop in best_constants(found):
        names = {suite: next(name for name in best if loop_of(name) == loop) for suite, best in by_suite.items()}
        cells = (f"{_tension(name)} N: {number(tried[suite][name])}" for suite, name in names.items())
        rows.append([loop, *cells])
    note = "The constant of the lowest mean full-control cost on the split train, with that cost."
    return Table("The best constant of each loop", ("control loop", *tried), rows, note)


def best_constants(found: Content) -> Mapping[str, str]:
    """Return by loop the best constant on the headline suite."""
    return {loop_of(name): name for name in found["constants"]["best_by_loop"][found["description"]["headline"]]}


def _tension(name: str) -> str:
    return split_loop(name)[1].removeprefix(CONSTANT)
