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
        "scheduling_laws": by_family(found, "the best tuned law", best_law_in),
        "scheduling": scheduling(found),
        "safety": safety(found),
        "constants": constants(found),
    }


def answers(found: Content) -> list[str]:
    """Return the answers to the track's questions, one sentence each; those without numbers are left out."""
    headline, top = found["description"]["headline"], found["constants"]["overall"]
    loop, results = loop_of(top), found["results"][f"{headline}/held-out"]
    ratio = with_interval(results[top]["ratio"][YARDSTICK])
    said = [
        f"On full control, {loop} with its best constant ({top}) costs {ratio} of eq. 6's cost in the paper's loop, on "
        f"{headline}, held-out."
    ]
    best = {purpose: name for purpose, _, name, *_ in purposes(found).rows}
    said.append(f"Best loop, each with its best constant: {', '.join(f'{p}: {name}' for p, name in best.items())}.")
    for what, choose in (("a learned schedule", learned_in), ("a tuned law", best_law_in)):
        shares = {each: _to_constant(found, choose(found, each)) for each in best_constants(found)}
        known = {each: share for each, share in shares.items() if share and share["mean"] is not None}
        if known:
            least = min(known, key=lambda each: known[each]["mean"])
            said.append(
                f"On full control, scheduling with {what} lowers the cost most in {least}: to "
                f"{with_interval(known[least])} of that loop's best constant, on {headline}, held-out."
            )
    learned, law = learned_in(found, loop), best_law_in(found, loop)
    if learned and law:
        said.append(
            f"On full control, in {loop}, the loop of the best constant, {learned} costs "
            f"{with_interval(_to_constant(found, learned))} of the best constant, and "
            f"{with_interval(results[learned]['ratio'].get(law))} of the best tuned law ({law}); its cost is below the "
            f"constant's with an interval below 1 in {_below_one(found, learned)} of {len(found['families'])} families."
        )
    return said


def purposes(found: Content) -> Table:
    """Return the best loop for each purpose, with its best constant, and the best of all contenders."""
    best, rows = list(best_constants(found).values()), []
    everyone = [name for name, entry in found["entries"].items() if entry["kind"] in ("law", "learned", "own")]
    for purpose, suite, split, key in _PURPOSES:
        place = f"{suite or found['description']['headline']}/{split}"
        values = {name: _value(found, place, name, key) for name in dict.fromkeys([*best, *everyone, YARDSTICK])}
        known = {name: value for name, value in values.items() if value and value["mean"] is not None}
        order = sorted((name for name in known if name in best), key=lambda name: known[name]["mean"])
        if not order:
            continue
        first = min(known, key=lambda name: known[name]["mean"])
        cells = [cell for name in (*order[:2], first) for cell in (_contender(name), with_interval(known[name]))]
        what = f"{METRICS[key].heading if key else 'cost, ratio to eq6'}: {place.replace('/', ', ')}"
        cells = cells if len(order) > 1 else [*cells[:2], "-", "-", *cells[2:]]
        rows.append([purpose, what, *cells, with_interval(known.get(YARDSTICK))])
    note = (
        "Each loop with its best constant on the split train of the main suite; lower is better in all rows, with 95 % "
        "intervals. Where the intervals of the best and the next loop overlap, neither is clearly better. Best of all: "
        "with any law or learned schedule, in any loop. Noise-x2 and wrong-parameters: the same held-out scenarios "
        "with twice the sensor noise, or with springs, inertia and damping 20 % above or below, unknown to the loops."
    )
    head = ("purpose", "measured by", "best loop", "value", "next loop", "its value", "best of all", "its value", "eq6")
    return Table("The best loop for each purpose", head, rows, note, left=(0, 1, 2, 4, 6))


def gains(found: Content) -> Table:
    """Return by loop how much each schedule lowers the cost of the loop's best constant."""
    results = found["results"][f"{found['description']['headline']}/held-out"]
    kinds = [split_loop(name)[1] for name, entry in found["entries"].items() if entry["kind"] == "law"]
    laws, rows = [law for law in dict.fromkeys(kinds) if law != "position-only"], []
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
        "the laws on the left in that loop, chosen in hindsight. Families: in so many the learned schedule's interval "
        "is below 1."
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
    return numbers["metrics"][key] if key else numbers["ratio"].get(YARDSTICK)


def _contender(name: str) -> str:
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
        columns.append([number(mean) + (BEST if mean is not None and mean == least else "") for mean in means])
        what = METRICS[key].heading if key else "cost, ratio to eq6"
        head.append(f"{what}: {suite or headline}" + ("" if split == "held-out" else f", {split}"))
    rows = [[f"{loop}, {_tension(best[loop])} N", *cells] for loop, *cells in zip(best, *columns, strict=True)]
    note = (
        f"Each loop with its best constant on {headline}. An asterisk marks the lowest value of a column. Scenarios of "
        "payload have masses that the loops do not know; those of the split shifted have device parameters and sensor "
        "noise outside the ranges of the others."
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


def _tension(name: str) -> str:
    return split_loop(name)[1].removeprefix(CONSTANT)
