"""The output of a benchmark over devices: tables, figures, page, generated part of ``docs/devices-benchmark.md``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amulett_gym.evaluation.metrics import COST_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.parametric import PARAMETRIC
from amulett_gym.reporting.document import image, marks, update_document
from amulett_gym.reporting.table import Table, csv_text, fill
from amulett_gym.reporting.words import number, pretty, span, with_interval
from amulett_gym.storage.writing import after_results, write_json, write_text
from amulett_gym.studies.benchmark.claims import Claim, as_plain
from amulett_gym.studies.benchmark.devices.description import (
    ADAPTED,
    CONSTANT,
    EQ6_WITH_GAINS,
    OWN_CONSTANT,
    SPECIALIST,
)
from amulett_gym.studies.benchmark.devices.results import Content
from amulett_gym.studies.benchmark.devices.stages import Evidence
from amulett_gym.studies.benchmark.page import FIGURES, PAGE, RESULTS, filled, not_met
from amulett_gym.studies.benchmark.tables import FOLDER as TABLES
from amulett_gym.studies.benchmark.tables import claims_table

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

MARKS = marks("amulett benchmark")

CAPTIONS = {
    "devices": "Cost on each held-out device, divided by that of eq. 6 on that device: mean over training seeds and "
    "scenarios. Devices are sorted by the learned policy.",
    "families": "Cost by family of scenarios, divided by that of eq. 6, over all held-out devices, with 95 % intervals "
    "over training seeds, devices and scenarios; the number of scenarios in parentheses.",
    "learning": "Cost on the choosing devices during training, over agent steps and over wall-clock time: a line for "
    "each training seed. The policy of the lowest cost is judged.",
}


def write_devices_benchmark(
    evidence: Evidence, found: Content, claims: Sequence[Claim], folder: str | Path
) -> dict[str, Figure]:
    """Write ``benchmark.json``, tables and all costs, then figures and ``benchmark.html``; return the figures.

    Raises AmulettError if the folder cannot be written.
    """
    folder, made = Path(folder), tables(found, claims)
    for name, table in made.items():
        write_text(folder / TABLES / f"{name}.csv", csv_text(table.head, table.rows))
    write_text(
        folder / TABLES / "costs.csv",
        csv_text(("entry", "seed", "device", "scenario", "family", "cost"), _costs(evidence)),
    )
    write_json(folder / RESULTS, judged(found, claims))
    with after_results(f"{RESULTS} and {TABLES} in {folder}"):
        from amulett_gym.reporting.style import save_figures

        figures = draw(found)
        save_figures(figures, folder / FIGURES)
        template = "studies/benchmark/devices/devices.html.j2"
        page = filled(template, found, claims, made, figures, CAPTIONS, verdict=verdict(found, claims))
        write_text(folder / PAGE, page)
    return figures


def _costs(evidence: Evidence) -> Iterable[Sequence[Any]]:
    """Yield the cost of each entry's members in each scenario on each device."""
    families = evidence.families.tolist()
    for name, entry in evidence.entries.items():
        for seed, of_member in zip(entry.seeds or ("",), evidence.values(name), strict=True):
            for device, costs in zip(entry.devices, of_member.tolist(), strict=True):
                for k, (family, cost) in enumerate(zip(families, costs, strict=True)):
                    yield name, seed, device, evidence.description.seed + k, family, cost


def write_document(found: Content, claims: Sequence[Claim], figures: Mapping[str, Figure], path: str | Path) -> None:
    """Renew the generated part of a document, and its figures; AmulettError as `reporting.document.check_document`."""
    prefix = Path(path).stem.replace("-", "_")  # several documents have figures in one folder
    parts = [
        "" if found["command"] is None else f"`{found['command']}` on {found['machine']}",
        pretty(f"**{verdict(found, claims)}**"),
        pretty("\n".join(f"- {line}" for line in not_met(claims))),
        *(pretty(table.markdown()) for table in tables(found, claims).values()),
        *(image(f"{prefix}_{name}", CAPTIONS[name]) for name in figures),
    ]
    files = {f"{prefix}_{name}": figure for name, figure in figures.items()}
    update_document(path, {MARKS: "\n\n".join(filter(None, parts))}, files)


def judged(found: Content, claims: Sequence[Claim]) -> Content:
    """Return the content of ``benchmark.json``: measurements, claims, verdict."""
    return {**found, "claims": as_plain(list(claims)), "verdict": verdict(found, claims)}


def verdict(found: Content, claims: Sequence[Claim]) -> str:
    """Return in a few sentences the learned policy's cost over the devices, and how many claims are met."""
    best, description = found["best_learned"], found["description"]
    mine = found["results"][best]
    count, cost = len(found["entries"][best]["seeds"]), METRICS[COST_OF[found["track"]]].name
    eq6 = mine["lower_on"][YARDSTICK]
    text = (
        f"{best}, over {count} training seed{'s' * (count > 1)}, has {with_interval(mine['ratio'][YARDSTICK])} of eq. "
        f"6's {cost} on {mine['devices']} held-out devices, in {description['episodes']} held-out scenarios of "
        f"{description['suite']} on each; it is below eq. 6 on {eq6['count']} of them"
    )
    against = [f"{_ratio(mine['ratio'][law])} of {law}'s" for law in found["laws"] if law != YARDSTICK]
    against += [f"{_ratio(mine['ratio'][OWN_CONSTANT])} of the best constant's of each device"]
    if EQ6_WITH_GAINS in mine["ratio"]:
        ratio = _ratio(mine["ratio"][EQ6_WITH_GAINS])
        against.append(f"{ratio} of eq. 6's with the gains of {found['eq6_gains']}")
    text += f", and has {', '.join(against)}."
    if found.get("quick"):
        return f"{text} This was a quick run, which only shows that everything works. No claim is judged by it."
    judged = [claim for claim in claims if claim.holds is not None]
    return f"{text} {sum(bool(claim.holds) for claim in judged)} of {len(judged)} claims are met."


def tables(found: Content, claims: Sequence[Claim]) -> dict[str, Table]:
    """Return all tables by name, without empty ones."""
    made = {
        "claims": claims_table(claims),
        "contenders": contenders_table(found),
        "lower": lower_table(found),
        "families": families_table(found),
        "families_to_laws": families_to_laws_table(found),
        "devices": devices_table(found),
        "adaptation": adaptation_table(found),
        "seeds": seeds_table(found),
        "budgets": budgets_table(found),
    }
    return {name: table for name, table in made.items() if table.rows}


def contenders_table(found: Content) -> Table:
    """Return all contenders, the lowest ratio to eq. 6 first."""
    others, rows = _compared(found), []
    for name, numbers in _ranked(found):
        worst, failures = numbers["worst"], numbers["failures"]
        rows.append(
            [
                label(found, name),
                with_interval(numbers["ratio"][YARDSTICK]),
                f"{number(worst['ratio_to_eq6'])} ({worst['device']})",
                *(_ratio(numbers["ratio"].get(other)) for other in others),
                f"{failures['count']} of {failures['total']}",
            ]
        )
    head = ("", "ratio to eq6", "worst device", *(f"ratio to {label(found, other)}" for other in others), "failed")
    note = (
        "Ratios of costs over all devices and scenarios, with 95 % intervals over training seeds, devices and "
        "scenarios. Costs on a device are divided by those of eq. 6 on that device. Specialists and adapted policies "
        "play on the first devices only."
    )
    return Table("Held-out devices: all contenders", head, rows, note)


def lower_table(found: Content) -> Table:
    """Return on how many devices each contender costs less than the hand-tuned laws."""
    others = (YARDSTICK, *_compared(found))
    rows = [
        [label(found, name), *(_of(numbers["lower_on"].get(other)) for other in others)]
        for name, numbers in _ranked(found)
    ]
    head = ("", *(label(found, other) for other in others))
    return Table("Number of held-out devices on which the mean cost is lower than that of", head, rows)


def _compared(found: Content) -> list[str]:
    """Return the entries with which all are compared, besides eq. 6 as it is."""
    others = [law for law in found["laws"] if law != YARDSTICK] + [OWN_CONSTANT]
    return others + [EQ6_WITH_GAINS] * (EQ6_WITH_GAINS in found["entries"])


def _ranked(found: Content) -> list[tuple[str, Content]]:
    return sorted(found["results"].items(), key=lambda item: item[1]["ratio"][YARDSTICK]["mean"])


def families_table(found: Content) -> Table:
    """Return by family the ratio to eq. 6 of each entry that plays on all devices."""
    names = [name for name, entry in found["entries"].items() if entry["devices"] == found["fleets"]["judge"]]
    names.remove(YARDSTICK)
    rows = [
        [f"{family} ({numbers['scenarios']})", *(with_interval(numbers["ratio_to_eq6"][name]) for name in names)]
        for family, numbers in found["families"].items()
    ]
    head = ("", *(label(found, name) for name in names))
    return Table("By family of scenarios: ratios of costs to eq. 6", head, rows)


def families_to_laws_table(found: Content) -> Table:
    """Return the learned entry's ratio to the hand-tuned laws by family."""
    laws, best = [law for law in found["laws"] if law != YARDSTICK], label(found, found["best_learned"])
    rows = [
        [f"{family} ({numbers['scenarios']})", *(_ratio(numbers["ratio_of_learned"][law]) for law in laws)]
        for family, numbers in found["families"].items()
    ]
    head = ("", *(f"to {label(found, law)}" for law in laws))
    return Table(f"By family of scenarios: ratios of the costs of {best}", head, rows if laws else [])


def devices_table(found: Content) -> Table:
    """Return the ratio of each entry to eq. 6 on each device, and the device's best constant."""
    names = [name for name in found["entries"] if name != YARDSTICK]
    rows = [
        [
            device,
            number(found["constants"]["of_devices"][device]["tension"]),
            *(number(numbers["ratio_to_eq6"].get(name, {"mean": None})["mean"]) for name in names),
        ]
        for device, numbers in found["devices"].items()
    ]
    head = ("device", "its best constant [N]", *(label(found, name) for name in names))
    return Table("By device: cost divided by that of eq. 6", head, rows, "Intervals: benchmark.json, `devices`.")


def adaptation_table(found: Content) -> Table:
    """Return the costs of adapted policies, of their start, and of what was made for the device."""
    rows = [
        [
            device,
            *(number(one.get(key)) for key in ("start", ADAPTED, OWN_CONSTANT, SPECIALIST, YARDSTICK)),
            f"{one['seconds']:.0f}",
        ]
        for device, one in found["adaptation"].items()
    ]
    head = (
        "device",
        "policy it started from",
        "adapted",
        "best constant of the device",
        "specialist",
        "eq6",
        "time [s]",
    )
    return Table("Adaptation to a device: mean costs", head, rows)


def seeds_table(found: Content) -> Table:
    """Return the ratio of each training seed of the learned entries to eq. 6 and to the tuned laws."""
    rows = []
    for name, entry in found["entries"].items():
        if entry["kind"] != "learned":
            continue
        numbers, runs = found["results"][name], found["training"][name]["runs"]
        for k, seed in enumerate(entry["seeds"]):
            each = (numbers["seed_ratios"][law][k] for law in (*found["laws"], OWN_CONSTANT))
            ratios = [span({"mean": one, "low": None, "high": None}) for one in each]
            rows.append([f"{name}, seed {seed}", *ratios, f"{runs[str(seed)]['seconds']:.0f}"])
    laws = (f"to {label(found, law)}" for law in (*found["laws"], OWN_CONSTANT))
    return Table("By training seed: ratios of costs", ("", *laws, "training [s]"), rows)


def budgets_table(found: Content) -> Table:
    """Return the number of episodes that each learned or tuned entry was given, and the time."""
    runs: dict[str, list[Content]] = {}
    for name, entry in found["training"].items():
        if "runs" in entry:  # specialists and adapted policies: of all devices together
            runs.setdefault(name.partition("/")[0], []).extend(entry["runs"].values())
    rows = [
        [
            name,
            str(len(each)),
            f"{max(run['episodes'] for run in each):,}",
            f"{max(run['seconds'] for run in each):.0f}",
        ]
        for name, each in runs.items()
    ]
    tuned = {name: entry["tuned_episodes"] for name, entry in found["training"].items() if "tuned_episodes" in entry}
    rows += [[label(found, name), "1", f"{episodes:,}", "-"] for name, episodes in tuned.items()]
    return Table(
        "Price of tuning and training", ("", "runs", "simulated episodes, of one run", "longest run [s]"), rows
    )


def in_words(found: Content, claims: Sequence[Claim]) -> str:
    """Return the text for the terminal: claims, contenders, verdict."""
    made = tables(found, claims)
    shown = [made["contenders"], made["lower"]]
    if claims:
        table = made["claims"]
        shown = [replace(table, head=table.head[:5], rows=[row[:5] for row in table.rows], left=(0, 1)), *shown]
    lines = "\n".join(map(fill, (verdict(found, claims), *not_met(claims))))
    return "\n\n".join([*(table.text() for table in shown), lines])


def label(found: Content, name: str) -> str:
    """Return an entry's label: constants with their tension, learned entries with the number of their seeds."""
    if name == CONSTANT and found["constants"]["tuned"] is not None:
        return f"best constant ({number(found['constants']['tuned'])} N)"
    if name == OWN_CONSTANT:
        return "best constant of the device"
    if name == EQ6_WITH_GAINS:
        return f"eq6, gains of {found['eq6_gains']}"
    count = len(found["entries"][name]["seeds"]) if name in found["entries"] else 0
    return f"{name} ({count} seeds)" if count > 1 else name


def draw(found: Content) -> dict[str, Figure]:
    """Return the figures by name."""
    from amulett_gym.evaluation import plots
    from amulett_gym.studies.benchmark.learning import learning_figure

    ranking = sorted(found["results"], key=lambda name: found["results"][name]["ratio"][YARDSTICK]["mean"])
    best = found["best_learned"]
    names = [best, *(name for name in ranking if name not in (best, YARDSTICK))]
    ratios = {
        name: [
            numbers["ratio_to_eq6"].get(name, {"mean": float("nan")})["mean"] for numbers in found["devices"].values()
        ]
        for name in names
    }
    labels = {name: label(found, name) for name in names}
    text = f"{METRICS[COST_OF[found['track']]].name}, relative to eq. 6 on the device [1]"
    colours = _colours(found)
    figures = {"devices": plots.devices_figure(ratios, list(found["devices"]), labels, text, colours)}
    if len(found["families"]) > 1:
        rows = {f"{name} ({family['scenarios']})": family["ratio_to_eq6"] for name, family in found["families"].items()}
        figures["families"] = plots.ratios_figure(rows, labels, colours, "cost, relative to eq. 6 [1]")
    curves = {name: [np.array(run) for run in runs.values()] for name, runs in found["validations"].items()}
    figures["learning"] = learning_figure(curves, labels, colours, {})
    return figures


def _colours(found: Content) -> dict[str, str]:
    from amulett_gym.reporting import style

    fixed = {CONSTANT: style.BLUE, OWN_CONSTANT: style.SKY, PARAMETRIC.name: style.PURPLE, "eq6-tuned": style.GREEN}
    fixed |= {SPECIALIST: style.ORANGE, ADAPTED: "#F0708A", found["best_learned"]: "#D62718", YARDSTICK: style.BLACK}
    others = cycle((style.BROWN, style.OLIVE, style.INDIGO, style.GREY))
    return {name: fixed.get(name) or next(others) for name in found["entries"]}


def _ratio(estimate: Any) -> str:
    """Return a ratio with its interval, with enough digits to differ from 1; a dash if there is none."""
    return "-" if estimate is None else span(estimate)


def _of(lower: Any) -> str:
    return "-" if lower is None else f"{lower['count']} of {lower['devices']}"
