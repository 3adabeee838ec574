"""The evidence as JSON content, rows of CSV files, and text for the terminal."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from amulett_gym import __version__
from amulett_gym.studies.paper.claims import claims_content
from amulett_gym.studies.paper.evidence import Evidence
from amulett_gym.studies.paper.hypotheses import Answer, hypotheses_content
from amulett_gym.studies.paper.identification import WEIGHTS
from amulett_gym.studies.paper.reproduction import (
    BOUNDS,
    MEASUREMENT_TIME,
    Reproduction,
    Row,
    best_reading,
    explained,
    moved,
)
from amulett_gym.studies.paper.runs import MOVES_FROM
from amulett_gym.studies.paper.sensitivity import REST
from amulett_gym.studies.paper.statements import METRICS, NAMES
from amulett_gym.studies.paper.study import DETERMINED
from amulett_gym.studies.paper.tables import DEVICES, PROTOCOL, published
from amulett_gym.tasks.suites import START

STATUS = (
    "What the paper does not print was fitted to all rows of both devices at once (`amulett identify`), with one set "
    "of mechanical parameters and one set of readings for all rows; nothing is tuned per row."
)
"""How the parameters of any study came about."""

_ROW_KEYS = ("table", "profile", "configuration", "metric", "drive")


def content(evidence: Evidence) -> dict[str, Any]:
    """Return the content of ``reproduction.json``.

    Returns
    -------
    dict
        ``{"parameters": {...}, "rows": [{"table", "profile", "configuration", "metric", "drive", "paper", "ours",
        "ratio", "unit", "explained", "note"}], "cross_check": [rows, with what was "left_out"], "claims": [...],
        "hypotheses": [...], "sensitivity": {...}, "force_rise_time": [...]}``; a number that does not exist is None.
    """
    reproduction = evidence.reproduction
    return {
        "parameters": {
            "status": status(evidence),
            "profiles": {name: reproduction.profiles[name].model_dump() for name in DEVICES},
            "readings": asdict(reproduction.readings),
            "identified": {entry["name"]: entry["value"] for entry in evidence.identification["spread"]},
            "protocol": {**asdict(PROTOCOL), "time_before_step": START, "measurement_time": MEASUREMENT_TIME},
            "bounds": {f"{metric}, {device}": list(ratios) for (metric, device), ratios in BOUNDS.items()},
            "versions": {"amulett-gym": __version__, "numba": version("numba"), "numpy": version("numpy")},
        },
        "rows": [{**entry(row), "note": note(reproduction, index)} for index, row in enumerate(reproduction.rows)],
        "cross_check": [
            {**entry(row), "left_out": left_out} for left_out, rows in evidence.predicted.items() for row in rows
        ],
        "claims": claims_content(evidence.claims),
        "hypotheses": hypotheses_content(evidence.hypotheses),
        "sensitivity": asdict(evidence.sensitivity),
        "force_rise_time": [asdict(item) for item in evidence.force_rises],
    }


def force_rise_table(evidence: Evidence) -> dict[str, Any]:
    """Return the string force's rise times as a table: ``title``, ``head`` and ``body``, all of them words."""
    return {
        "title": "Time after the step until the string force is within 5 % of its setpoint (section 2.2). The paper "
        "defines this rise time and prints no number. Force and setpoint are those of Table 4; 0 s: the step finds "
        "the force within the margin. On the testbed, noise takes the estimate out of the margin again and again: the "
        "last entry is when it last came back",
        "head": ["device", "configuration", "first entry [s]", "last entry [s]", "within at T", "of the last second"],
        "body": [
            [
                item.profile,
                NAMES[item.configuration],
                *("-" if time is None else f"{time:.2f}" for time in (item.first_entry, item.last_entry)),
                f"{item.inside_at_end} of {item.repetitions}",
                f"{100.0 * item.share_inside:.0f} %",
            ]
            for item in evidence.force_rises
        ],
    }


def springs_table(evidence: Evidence) -> dict[str, Any]:
    """Return what the best fit with each spring law gives as a table: ``head`` and ``body``, all of them words."""
    body = []
    for spring in evidence.identification["springs"]:
        rows = evidence.springs[spring["law"]]
        variable = {
            row.cell.metric: "-" if row.ratio is None else f"{row.ratio:.2f}"
            for row in rows
            if (row.cell.profile, row.cell.configuration) == ("testbed", "variable")
        }
        counts = [count for count, _ in explained(rows).values()]
        body.append(
            [
                spring["law"],
                f"{spring['length_ratio']:g}",
                f"{spring['stiffening']:.2f}",
                f"{spring['cost']:.1f}",
                ", ".join(map(str, counts)),
                str(sum(counts)),
                f"{variable['rise_time']}, {variable['position_ise']}",
            ]
        )
    head = [
        "spring law",
        "free length / half width",
        "stiffness at 10 N / at 4 N",
        "cost",
        "explained of Tables 2, 3, 4, 5",
        f"of {len(evidence.reproduction.rows)}",
        "ratios of the rise time and the position ISE measured with variable stiffness",
    ]
    return {"head": head, "body": body}


def sensitivity_tables(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the variations as tables: ``title``, ``head`` and ``body``, all of them words."""
    found, hysteresis = evidence.sensitivity, evidence.reproduction.profiles["testbed"].loop.switch_hysteresis
    configurations = list(next(iter(found.by_hysteresis.values())))
    return [
        {
            "title": f"Sensor noise: numbers explained by {PROTOCOL.repetitions_testbed} repetitions",
            "head": ["repetitions", *(f"Table {table}" for table in (2, 3, 4, 5)), "of 40"],
            "body": [
                [
                    f"{key} to {key + PROTOCOL.repetitions_testbed - 1}" + (" (reported)" if key == 1 else ""),
                    *map(str, counts),
                    str(sum(counts)),
                ]
                for key, counts in found.by_noise.items()
            ],
        },
        {
            "title": "T of eqs. 7 and 8: numbers explained",
            "head": ["T [s]", *(f"Table {table}" for table in (2, 3, 4, 5)), "of 40"],
            "body": [[f"{time:g}", *map(str, counts), str(sum(counts))] for time, counts in found.by_time.items()],
        },
        {
            "title": "Hysteresis of the agonist's switch on the testbed: switches in the movements of Figure 9, and "
            "the most that one of them moves the joint",
            "head": ["hysteresis [mm]", *(NAMES[name] for name in configurations)],
            "body": [
                [
                    f"{1000 * factor * hysteresis:.2g}" + (" (shipped)" if factor == 1.0 else ""),
                    *(f"{count}, {deviation:.1f} deg" for count, deviation in switches.values()),
                ]
                for factor, switches in found.by_hysteresis.items()
            ],
        },
        {
            "title": "Forces estimated below the floor: the antagonist's true force at rest, with a setpoint of 5 N",
            "head": ["treatment", *(f"after {time:g} s [N]" for time in REST)],
            "body": [[floor, *(f"{force:.1f}" for force in forces)] for floor, forces in found.by_floor.items()],
        },
        {
            "title": "Setpoint of the tension ISE without tension control, on the testbed: the paper takes the mean of "
            f"the signal over {MOVES_FROM:g} s",
            "head": ["error against the", "tension ISE [N² s]", "over the paper's"],
            "body": [
                [name, f"{ise:.3f}", f"{ise / published('tension_ise', 'testbed', 'position-only').value:.2f}"]
                for name, ise in found.by_setpoint.items()
            ],
        },
    ]


def status(evidence: Evidence) -> str:
    """Say how the parameters came about, and by whose study if it is not the shipped one."""
    if evidence.folder is None:
        return STATUS
    recipe = evidence.identification["recipe"]
    sizes = ", ".join(f"{name} {count}" for name, count in recipe.items() if name != "seeds")
    seeds = ", ".join(map(str, recipe["seeds"]))
    return f"{STATUS} These are the devices of the study in {evidence.folder}: seeds {seeds}; {sizes}."


def within(metric: str, device: str) -> str:
    """Say how far ours may be from the paper's number for that one to count as explained."""
    low, high = BOUNDS[metric, device]
    if math.isclose(low + high, 2.0):
        return f"within {100.0 * (high - 1.0):.3g} %"
    if math.isclose(low * high, 1.0):
        return f"within a factor of {high:.3g}"
    return f"from {low:.3g} to {high:.3g} times the paper's"


def bounds_in_words() -> str:
    """Say which numbers count as explained; a bound that holds for both devices is said once."""
    parts = []
    for metric, name in METRICS.items():
        bounds = {device: within(metric, device) for device in DEVICES}
        same = len(set(bounds.values())) == 1
        said = bounds[DEVICES[0]] if same else ", ".join(f"{words} ({device})" for device, words in bounds.items())
        parts.append(f"{name} {said}")
    return f"A number is explained if ours over the paper's is within its bounds: {'; '.join(parts)}."


def cost_in_words() -> str:
    """Say what the cost of a fit is."""
    weights = " and ".join(f"{METRICS[metric]} {weight:g}" for metric, weight in WEIGHTS.items() if weight != 1.0)
    return (
        "The cost of a fit is a smooth count of the rows that are out of their bounds, which goes on growing a little "
        f"for a row far off; rows weigh 1, those of {weights}."
    )


def determined_in_words(identification: Mapping[str, Any]) -> str:
    """Say which parameter sets are as good as the best, and when they determine a parameter."""
    weight = PROTOCOL.damping_mass * PROTOCOL.damping_arm**2
    return (
        f"As good: sets of parameters whose cost is within {identification['ensemble']['equal_cost']:g} of the least "
        f"one. Determined: those sets cover at most {100.0 * DETERMINED:g} % of the range that was searched, and touch "
        f"none of its bounds. For comparison with the inertia: the weight of the damping experiment alone, "
        f"{1000.0 * PROTOCOL.damping_mass:g} g at {1000.0 * PROTOCOL.damping_arm:g} mm, has {weight:.2g} kg m2."
    )


def search_varies(identification: Mapping[str, Any]) -> str:
    """Say by how much costs differ although nothing but the search's random numbers does."""
    least = identification["ensemble"]["least_cost"]
    above = sorted({f"{start['cost'] - least:.1f}" for start in identification["starts"]}, key=float)
    return (
        f"The search itself varies: its independent starts ended {' to '.join(dict.fromkeys((above[0], above[-1])))} "
        "above the least cost that was found. Smaller differences of costs say nothing."
    )


def note(reproduction: Reproduction, index: int) -> str:
    """Say what a reader of one row has to know: its spread, why it is unexplained, and which reading comes nearer."""
    row = reproduction.rows[index]
    cell = row.cell
    parts = []
    if row.spread is not None:
        parts.append(f"mean of {PROTOCOL.repetitions_testbed} repetitions, standard deviation {row.spread:.3g}")
    if row.explained:
        return "; ".join(parts)
    parts.append(f"not explained: {row.trouble or f'ours is not {within(cell.metric, cell.profile)}'}")
    key, nearest = best_reading(reproduction, index)
    if key is None:
        parts.append("no other reading comes nearer")
    else:
        verb = "would explain it" if nearest.explained else "comes nearest, and does not explain it either"
        parts.append(f"{_reading(key)} alone {verb} (ratio {_number(nearest.ratio)})")
    return "; ".join(parts)


def in_words(evidence: Evidence) -> str:
    """Return the evidence for the terminal: the rows, the readings, and what a reader has to know."""
    reproduction = evidence.reproduction
    hold = sum(item.ours.holds is True for item in evidence.claims)
    predicted = [row.explained for rows in evidence.predicted.values() for row in rows]
    taken = reproduction.readings
    return (
        f"{rows_table(reproduction)}\n\n"
        "Readings, each alone: numbers explained, and how many come nearer to the paper or go farther from it\n"
        f"{readings_table(reproduction)}\n\n"
        "Hypotheses of section 1.2: criteria that hold, and the numbers that say so\n"
        f"{hypotheses_table(evidence.hypotheses)}\n\n"
        f"Explained: {by_table(reproduction.rows)}.\n"
        f"{bounds_in_words()}\n"
        f"The testbed's numbers are means of {PROTOCOL.repetitions_testbed} repetitions with sensor noise, +- their "
        f"standard deviation; T is {MEASUREMENT_TIME:g} s. Table 2 is compared with the {taken.rise_time} time.\n"
        f"Fitted to three configurations, the model explains {sum(predicted)} of {len(predicted)} numbers of the one "
        f"left out, over all four.\n"
        f"Claims of sections 3 to 5: {hold} of {len(evidence.claims)} hold.\n"
        f"{status(evidence)}"
    )


def rows_table(reproduction: Reproduction) -> str:
    """Return all rows as aligned text, and for each the reading under which it comes nearest to the paper."""
    lines = [["table", "", "", "metric", "", "paper", "ours", "", "ratio", "unit", "", "nearest under (ratio)"]]
    for index, row in enumerate(reproduction.rows):
        cell = row.cell
        key, nearest = best_reading(reproduction, index)
        lines.append(
            [
                str(cell.table),
                cell.profile,
                cell.configuration,
                cell.metric,
                cell.drive or "",
                _number(cell.value),
                _number(row.ours),
                "" if row.spread is None else f"+-{row.spread:.2g}",
                _number(row.ratio, 3),
                row.unit,
                "explained" if row.explained else "NOT explained",
                "" if key is None else f"{_reading(key)} ({_number(nearest.ratio, 3)})",
            ]
        )
    return _aligned(lines, right=(5, 6, 8))


def readings_table(reproduction: Reproduction) -> str:
    """Return the readings as aligned text: how many numbers of each table they explain, what gets better or worse."""
    lines = [["reading", "Table 2", "Table 3", "Table 4", "Table 5", "nearer", "farther"]]
    lines.append(
        ["as taken: " + ", ".join(asdict(reproduction.readings).values()), *_counts(reproduction.rows), "", ""]
    )
    for key, rows in reproduction.alternatives.items():
        moves = moved(rows, reproduction.rows)
        lines.append([_reading(key), *_counts(rows), str(moves.count("nearer")), str(moves.count("farther"))])
    return _aligned(lines, right=(1, 2, 3, 4, 5, 6))


def hypotheses_table(answers: Sequence[Answer]) -> str:
    """Return the hypotheses as aligned text: for each device or configuration the criteria that hold, and numbers."""
    lines = []
    for answer in answers:
        title = f"{answer.number} {answer.verdict}"
        for case in dict.fromkeys(item.case for item in answer.criteria):
            items = [item for item in answer.criteria if item.case == case]
            numbers = dict.fromkeys(part for item in items for part in item.words.split("; "))
            lines.append([title, case, f"{sum(item.holds is True for item in items)}/{len(items)}", "; ".join(numbers)])
            title = ""
    return _aligned(lines, right=())


def rows_content(evidence: Evidence, result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of ``reproduction.json`` with their spread and the reading under which they come nearest."""
    rows = []
    for index, (written, row) in enumerate(zip(result["rows"], evidence.reproduction.rows, strict=True)):
        key, nearest = best_reading(evidence.reproduction, index)
        best = {"nearest_reading": "as taken" if key is None else _reading(key), "nearest_ratio": nearest.ratio}
        rows.append({**written, "spread": row.spread, **best})
    return rows


def readings_content(reproduction: Reproduction) -> list[dict[str, Any]]:
    """Return every row under every reading."""
    return [
        {"reading": name, "choice": choice, **entry(row), "than_as_taken": move}
        for (name, choice), under in {("as taken", ""): reproduction.rows, **reproduction.alternatives}.items()
        for row, move in zip(under, moved(under, reproduction.rows), strict=True)
    ]


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of the same keys as CSV with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def entry(row: Row) -> dict[str, Any]:
    """Return a row as ``reproduction.json`` has it, without its note."""
    return {
        **{key: getattr(row.cell, key) for key in _ROW_KEYS},
        "paper": row.cell.value,
        "ours": row.ours,
        "ratio": row.ratio,
        "unit": row.unit,
        "explained": row.explained,
    }


def by_table(rows: Iterable[Row]) -> str:
    """Say how many rows of each table are explained."""
    return ", ".join(f"{count} of {size} of Table {table}" for table, (count, size) in explained(rows).items())


def _counts(rows: Iterable[Row]) -> list[str]:
    return [f"{count}/{size}" for count, size in explained(rows).values()]


def _reading(key: tuple[str, str]) -> str:
    return f"{key[0]} {key[1]}"


def _number(value: float | None, digits: int = 5) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _aligned(lines: list[list[str]], right: tuple[int, ...]) -> str:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            word.rjust(width) if place in right else word.ljust(width)
            for place, (word, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
