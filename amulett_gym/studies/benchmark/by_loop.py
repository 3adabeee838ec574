"""The tables of the track *full control*, by control loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.contenders import CONSTANT, split_loop
from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import number, with_interval
from amulett_gym.simulation.layout import DRIVES
from amulett_gym.studies.benchmark.description import PAPER_STEP, PAPERS, loop_of, named

Content = dict[str, Any]

BEST = " *"
"""Marks the best of a column."""

_PURPOSES = (
    ("speed", PAPER_STEP, "held-out", "settling_time"),
    ("accuracy", "", "held-out", "position_ise"),
    ("little effort", "", "held-out", "drive_effort"),
    ("soft contact", "contact", "held-out", "contact_peak"),
    ("tasks with contact", "contact", "held-out", ""),
    ("resistance to pushes", "hold-push", "held-out", "push_deflection"),
    ("unknown payload", "payload", "held-out", ""),
    ("twice the sensor noise", "", "noise-x2", ""),
    ("wrong parameters", "", "wrong-parameters", ""),
    ("unusual devices and tasks", "", "shifted", ""),
    ("all tasks together", "", "held-out", ""),
)
"""Purpose, suite (empty: the headline), split or altered scenarios, metric (empty: the ratio of costs to eq. 6's)."""


_UNSETTLED = (
    "Settling time: a step that did not settle counts as long as an episode; beside it the number that settled. A time "
    "near an episode's length is of a joint that still swung when the episode ended."
)


def by_loop(found: Content) -> dict[str, Table]:
    """Return the tables by name; some may be empty."""
    return {
        "purposes": purposes(found),
        "gains": gains(found),
        "loops": loops_and_laws(found, "held-out"),
        "loops_shifted": loops_and_laws(found, "shifted"),
        "best_at": best_at(found),
        "altered": altered(found),
        "scheduling_learned": by_family(found, "a learned schedule", learned_in),
        "scheduling_laws": by_family(found, "the best law in hindsight", best_law_in),
        "scheduling": scheduling(found),
        "safety": safety(found),
        "constants": constants(found),
    }


def answers(found: Content) -> list[str]:
    """Return the answers to the track's questions, one sentence each; those without numbers are left out."""
    said = [_overall(found), _best_loops(found)]
    laws = f"the best law of each loop (chosen by these costs, in hindsight, among {', '.join(_laws(found))})"
    said += [_scheduling(found, "a learned schedule", learned_in), _scheduling(found, laws, best_law_in)]
    return [line for line in (*said, _in_the_best_loop(found), *_budgets(found)) if line]


def _overall(found: Content) -> str:
    headline, top = found["description"]["headline"], found["constants"]["overall"]
    ratio = with_interval(found["results"][f"{headline}/held-out"][top]["ratio"][YARDSTICK])
    text = (
        f"On full control, {loop_of(top)} with its best constant ({_full_name(top)}) costs {ratio} of eq. 6's cost in "
        f"the paper's loop, on {headline}, held-out"
    )
    papers = found.get("paper_gains", {}).get(headline)
    if papers is None:
        return f"{text}."
    constant, eq6 = (with_interval(papers["ratio"][name]) for name in (top, YARDSTICK))
    return (
        f"{text}; eq. 6 acts there with the gains of the profile {found['description']['profile']}, which are not "
        f"the paper's. With the paper's own gains, eq. 6 costs {number(papers['cost'])} (in the unit of all costs: eq. "
        f"6 in training on {papers['unit']}); relative to that, this constant costs {constant}, and eq. 6 with the "
        f"profile's gains {eq6}."
    )


def _best_loops(found: Content) -> str:
    """Return the best loop for each purpose, with those whose intervals overlap with its own."""
    parts = []
    for purpose, place, key, _ in _measured(found):
        ranked = _ranked(found, place, key)
        parts.append(f"{purpose}: {_full_name(ranked[0][0])}{_not_told_apart(ranked)}")
    return (
        f"On full control, the best loop for each purpose, each loop with its best constant on train of "
        f"{found['description']['headline']}: {'; '.join(parts)}."
        if parts
        else ""
    )


def _not_told_apart(ranked: list[tuple[str, Any]]) -> str:
    """Return the contenders whose interval overlaps with that of the first, in parentheses; empty if there are none."""
    (_, first), *others = ranked
    near = [
        _full_name(name)
        for name, value in others
        if first["high"] is None or value["low"] is None or value["low"] <= first["high"]
    ]
    return f" (not told apart from {' and '.join(near)})" if near else ""


def _scheduling(found: Content, what: str, choose: Callable[[Content, str], str | None]) -> str:
    """Return in how many loops a schedule lowers the cost, its interval below 1, and where most; empty if unknown."""
    names = {loop: choose(found, loop) for loop in best_constants(found)}
    shares = {name: _to_constant(found, name) for name in names.values() if name is not None}
    known = {name: share for name, share in shares.items() if share and share["mean"] is not None}
    if not known:
        return ""
    lower = [name for name, share in known.items() if share["high"] is not None and share["high"] < 1.0]
    ranked = sorted(((name, known[name]) for name in lower or known), key=lambda each: each[1]["mean"])
    least = ranked[0][0]
    loop, beside = found["entries"][least]["loop"], _not_told_apart(ranked)
    ratio, where = with_interval(known[least]), f"on {found['description']['headline']}, held-out"
    if not lower:
        return (
            f"On full control, scheduling with {what} lowers the cost in none of {len(known)} loops with an interval "
            f"below 1: the lowest ratio to the loop's best constant is {ratio} ({least}), {where}."
        )
    return (
        f"On full control, scheduling with {what} lowers the cost in {len(lower)} of {len(known)} loops with an "
        f"interval below 1, most in {loop}{beside}: {least} costs {ratio} of that loop's best constant, {where}."
    )


def _in_the_best_loop(found: Content) -> str:
    headline, loop = found["description"]["headline"], loop_of(found["constants"]["overall"])
    learned, law = learned_in(found, loop), best_law_in(found, loop)
    share = _to_constant(found, learned)
    if learned is None or not share or share["mean"] is None:
        return ""
    beside = found["results"][f"{headline}/held-out"][learned]["ratio"].get(law)
    to_law = f", and {with_interval(beside)} of {law}, the best law there in hindsight" if beside else ""
    return (
        f"On full control, in {loop}, the loop of the best constant, {learned} costs {with_interval(share)} of the "
        f"best constant{to_law}, on {headline}, held-out; its cost is below the constant's with an interval below 1 in "
        f"{_below_one(found, learned)} of {len(found['families'])} families."
    )


def _budgets(found: Content) -> list[str]:
    """Return the budgets of tuning and learning, and what has one training seed only."""
    said = []
    tuned = [f"{law} {budget:,}" for law, budget in found["description"]["tuned_budget"].items()]
    if tuned:
        said.append(
            f"On full control, laws are tuned with at most so many simulated episodes in each loop: {', '.join(tuned)}."
        )
    runs: dict[tuple[int, int], list[str]] = {}
    for name, entry in found["training"].items():
        for run in list(entry.get("runs", {}).values())[:1]:
            runs.setdefault((run["steps"], run["episodes"]), []).append(name)
    for (steps, episodes), names in runs.items():
        said.append(
            f"On full control, each training run has {steps:,} agent steps, about {episodes:,} episodes: "
            f"{', '.join(names)}."
        )
    single = [name for name, entry in found["entries"].items() if len(entry["seeds"]) == 1]
    if single:
        said.append(
            "On full control, these have one training seed, so that their intervals are over scenarios alone, and do "
            f"not cover the chance of training: {', '.join(single)}."
        )
    return said


def purposes(found: Content) -> Table:
    """Return the best loop for each purpose, with its best constant, and the best of all contenders."""
    rows = []
    everyone = [name for name, entry in found["entries"].items() if entry["kind"] in ("law", "learned", "own")]
    for purpose, place, key, heading in _measured(found):
        order = [name for name, _ in _ranked(found, place, key)]
        values = {name: _value(found, place, name, key) for name in dict.fromkeys([*order, *everyone])}
        first = min(
            (n for n, value in values.items() if value and value["mean"] is not None), key=lambda n: values[n]["mean"]
        )
        shown = [order[0], order[1] if len(order) > 1 else None, first]
        cells = [cell for name in shown for cell in (_contender(name), _cell(found, place, name, key))]
        rows.append([purpose, f"{heading}: {place.replace('/', ', ')}", *cells, _cell(found, place, YARDSTICK, key)])
    note = (
        f"{_UNSETTLED} "
        "Each loop with its best constant on the split train of the main suite; lower is better in all rows, with 95 % "
        "intervals. Where the intervals of the best and the next loop overlap, neither is clearly better. Best of all: "
        "with any law or learned schedule, in any loop. Noise-x2 and wrong-parameters: the same held-out scenarios "
        "with twice the sensor noise, or with springs, inertia and damping 20 % above or below, unknown to the loops."
    )
    head = ("purpose", "measured by", "best loop", "value", "next loop", "its value", "best of all", "its value", "eq6")
    return Table("The best loop for each purpose", head, rows, note, left=(0, 1, 2, 4, 6))


def _measured(found: Content) -> list[tuple[str, str, str, str]]:
    """Return purpose, suite and split, metric, and heading of what was measured of at least one loop."""
    headline = found["description"]["headline"]
    asked = [(purpose, f"{suite or headline}/{split}", key) for purpose, suite, split, key in _PURPOSES]
    return [(*each, _heading(each[2])) for each in asked if _ranked(found, *each[1:])]


def _ranked(found: Content, place: str, key: str) -> list[tuple[str, Any]]:
    """Return each loop's best constant with its value, the lowest first; without those that have none."""
    values = [(name, _value(found, place, name, key)) for name in best_constants(found).values()]
    return sorted(
        (each for each in values if each[1] and each[1]["mean"] is not None), key=lambda each: each[1]["mean"]
    )


def _heading(key: str) -> str:
    return METRICS[key].heading if key else "cost, ratio to eq6"


def gains(found: Content) -> Table:
    """Return by loop how much each schedule lowers the cost of the loop's best constant."""
    results = found["results"][f"{found['description']['headline']}/held-out"]
    laws, rows = _laws(found), []
    for loop, constant in best_constants(found).items():
        learned, law = learned_in(found, loop), best_law_in(found, loop)
        beside = results[learned]["ratio"].get(law) if learned else None
        rows.append(
            [
                f"{loop}, {_tension(constant)} N",
                *(with_interval(_to_constant(found, named(loop, each))) for each in laws),
                with_interval(_to_constant(found, learned)),
                with_interval(beside),
                f"{_below_one(found, learned)} of {len(found['families'])}" if learned else "-",
            ]
        )
    note = (
        "Full-control cost divided by that of the best constant in the same loop, on the main suite, held-out, with "
        "95 % intervals: below 1 the schedule is better. Learned, to the best law: divided by the cost of the best of "
        "the laws on the left in that loop, chosen in hindsight. Learned: if several are, the one of the lowest "
        "cost, in hindsight. Families: in so many the learned schedule's interval is below 1."
    )
    head = ("control loop", *laws, "learned", "learned, to the best law", "families")
    return Table("Where scheduling the stiffness lowers the cost", head, rows, note)


def by_family(found: Content, what: str, choose: Callable[[Content, str], str | None]) -> Table:
    """Return by loop and family the cost of a schedule relative to the loop's best constant."""
    families, rows = found["families"], []
    for loop in best_constants(found):
        name = choose(found, loop)
        if name is not None:
            cells = (with_interval(family["ratio_to_constant"].get(name)) for family in families.values())
            rows.append([name, *cells])
    head = ("", *(f"{family} ({content['scenarios']})" for family, content in families.items()))
    note = (
        "Full-control cost divided by that of the best constant in the same loop, held-out, with 95 % intervals; "
        "number of scenarios in parentheses."
    )
    return Table(f"{what[0].upper()}{what[1:]} compared with the loop's constant, by family", head, rows, note)


def altered(found: Content) -> Table:
    """Return how much costs grow with sensor noise alone, and with wrong parameters alone."""
    headline, changes = found["description"]["headline"], found["description"]["altered"]
    kinds: dict[str, Callable[[str], str | None]] = {
        "best constant": lambda loop: best_constants(found)[loop],
        "learned": lambda loop: learned_in(found, loop),
    }
    rows = []
    for loop in best_constants(found) if changes else ():
        names = [(change, kind(loop)) for change in changes for kind in kinds.values()]
        numbers = (found["results"][f"{headline}/{change}"].get(name, {}) for change, name in names)
        rows.append([loop, *(with_interval(each.get("ratio_to_unaltered")) for each in numbers)])
    note = (
        "Full-control cost divided by that of the same contender in the same held-out scenarios without the change, "
        "with 95 % intervals: 1 is insensitive."
    )
    return Table(
        "How much noise and wrong parameters raise the cost",
        ("control loop", *(f"{c}: {k}" for c in changes for k in kinds)),
        rows,
        note,
    )


def safety(found: Content) -> Table:
    """Return failures, resting stiffness, push deflection and contact torque of all contenders."""
    headline = f"{found['description']['headline']}/held-out"
    shown = [name for name, numbers in found["results"][headline].items() if "iqm" in numbers]
    measures = (
        ("resting_stiffness", headline),
        ("push_deflection", "hold-push/held-out"),
        ("contact_peak", "contact/held-out"),
    )
    columns = tuple((key, place) for key, place in measures if place in found["results"])
    rows = []
    for name in shown if len(columns) > 1 else ():
        failed = found["results"][headline][name]["failures"]
        share = {"mean": failed["count"] / failed["total"], "low": failed["low"], "high": failed["high"]}
        cells = (with_interval(found["results"][place][name]["metrics"][key]) for key, place in columns)
        rows.append([_contender(name), with_interval(share), *cells])
    head = ("", "failed, share", *(f"{METRICS[key].heading}: {place.split('/')[0]}" for key, place in columns))
    note = "Held-out, with 95 % intervals. Failed: share of episodes in which the device left its limits."
    return Table("Failures, stiffness at rest, pushes and contact", head, rows, note)


def learned_in(found: Content, loop: str) -> str | None:
    """Return the schedule learned in a loop, the one of the lowest cost on the main suite, if any."""
    return _cheapest(found, loop, "learned")


def best_law_in(found: Content, loop: str) -> str | None:
    """Return the law of the lowest cost in a loop on the main suite, constants apart, if any."""
    return _cheapest(found, loop, "law")


def _cheapest(found: Content, loop: str, kind: str) -> str | None:
    results = found["results"][f"{found['description']['headline']}/held-out"]
    names = [name for name, entry in found["entries"].items() if (entry["kind"], entry["loop"]) == (kind, loop)]
    return min(names, key=lambda name: results[name]["cost"]["mean"], default=None)


def _to_constant(found: Content, name: str | None) -> Any:
    """Return the cost of a contender relative to the best constant in its loop, on the main suite, held-out."""
    results = found["results"][f"{found['description']['headline']}/held-out"]
    if name not in results:
        return None
    return results[name]["ratio"].get(best_constants(found).get(found["entries"][name]["loop"], ""))


def _below_one(found: Content, name: str) -> int:
    """Return in how many families a contender's cost is below that of its loop's best constant, with its interval."""
    ratios = (family["ratio_to_constant"].get(name) for family in found["families"].values())
    return sum(bool(ratio) and ratio["high"] is not None and ratio["high"] < 1.0 for ratio in ratios)


def _value(found: Content, place: str, name: str, key: str) -> Any:
    numbers = found["results"].get(place, {}).get(name)
    if numbers is None:
        return None
    if key == "settling_time":
        return numbers["settling"]["time"]
    return numbers["metrics"][key] if key else numbers["ratio"].get(YARDSTICK)


def _cell(found: Content, place: str, name: str | None, key: str, text: Callable[[Any], str] = with_interval) -> str:
    """Return a value as `text`, of the settling time with the number of steps that settled."""
    value = None if name is None else _value(found, place, name, key)
    if name is None or value is None or value["mean"] is None:
        return "-"
    if key != "settling_time":
        return text(value)
    settling = found["results"][place][name]["settling"]
    return f"{text(value)}, {settling['settled']:,} of {settling['steps']:,} settled"


def _full_name(name: str) -> str:
    """Return a contender's name with its loop, the paper's as well."""
    return f"{loop_of(name)}/{split_loop(name)[1]}"


def _laws(found: Content) -> list[str]:
    """Return the laws that play in a loop, constants apart."""
    kinds = [split_loop(name)[1] for name, entry in found["entries"].items() if entry["kind"] == "law"]
    return [law for law in dict.fromkeys(kinds) if law != "position-only"]


def _contender(name: str | None) -> str:
    if name is None:
        return "-"
    loop, law = split_loop(name)
    return f"{loop or PAPERS}, {_tension(name)} N" if law.startswith(CONSTANT) else name


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
    for _, suite, split, key in _PURPOSES:
        results = found["results"].get(f"{suite or headline}/{split}")
        if results is None:
            continue
        values = [_value(found, f"{suite or headline}/{split}", name, key) for name in best.values()]
        means = [None if value is None else value["mean"] for value in values]
        least = min((mean for mean in means if mean is not None), default=None)
        cells = [_cell(found, f"{suite or headline}/{split}", name, key, _mean) for name in best.values()]
        marks = [BEST if mean is not None and mean == least else "" for mean in means]
        columns.append([cell + mark for cell, mark in zip(cells, marks, strict=True)])
        head.append(f"{_heading(key)}: {suite or headline}" + ("" if split == "held-out" else f", {split}"))
    rows = [[f"{loop}, {_tension(best[loop])} N", *cells] for loop, *cells in zip(best, *columns, strict=True)]
    note = (
        f"{_UNSETTLED} Each loop with its best constant on {headline}. An asterisk marks the lowest value of a column. "
        "Scenarios of payload have masses that the loops do not know; those of the split shifted have device "
        "parameters and sensor noise outside the ranges of the others."
    )
    return Table("What each loop is good at", ("control loop", *head), rows, note)


def scheduling(found: Content) -> Table:
    """Return by family how much a schedule lowers the cost of its loop's best constant."""
    best, families = best_constants(found), found["families"]
    top = loop_of(found["constants"]["overall"])
    shown = [
        name
        for name, entry in found["entries"].items()
        if (entry["kind"] in ("learned", "law") and entry["loop"] == top) or entry["loop"] == DRIVES
    ]
    rows = []
    for family, content in families.items():
        ratios = content["ratio_to_constant"]
        cells = (with_interval(ratios.get(name)) for name in shown)
        rows.append([f"{family} ({content['scenarios']})", *cells, with_interval(content.get("clairvoyant"))])
    note = (
        f"Full-control cost divided by that of the best constant in the same loop ({best[top]}; of "
        "drives, too), held-out, with 95 % intervals; below 1 the schedule is better. "
        f"Clairvoyant: the best schedule in {top} of the first scenarios that a search finds with everything known."
    )
    return Table(
        f"Schedules in {top}, the loop of the best constant, by family", ("family", *shown, "clairvoyant"), rows, note
    )


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


def _mean(value: Any) -> str:
    return number(value["mean"])


def _tension(name: str) -> str:
    return split_loop(name)[1].removeprefix(CONSTANT)
