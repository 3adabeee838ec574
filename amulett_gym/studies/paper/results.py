"""The study's results on our devices, in the forms of data, tables, sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from amulett_gym import __version__
from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import number
from amulett_gym.studies.paper.claims import (
    METRICS,
    NAMES,
    Answer,
    CheckedClaim,
    answer_hypotheses,
    check_claims,
    claims_content,
    hypotheses_content,
    our_numbers,
)
from amulett_gym.studies.paper.figures import remarks
from amulett_gym.studies.paper.motion import REST, ForceRise, Sensitivity, force_rise_times, observe, vary
from amulett_gym.studies.paper.objective import WEIGHTS
from amulett_gym.studies.paper.own_study import OwnStudy
from amulett_gym.studies.paper.reproduction import (
    BOUNDS,
    MEASUREMENT_TIME,
    MOVES_FROM,
    Readings,
    Reproduction,
    Row,
    best_reading,
    explained,
    moved,
    our_drive,
    reproduce,
)
from amulett_gym.studies.paper.study import cross_check, shipped, spring_laws
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, DRIVES, PROTOCOL, published
from amulett_gym.tasks.suites import START

STATUS = (
    "What the paper does not print was fitted to all rows of both devices at once (`amulett identify`), with one set "
    "of mechanical parameters and one set of interpretations for all rows; nothing is tuned per row."
)
"""Origin of the parameters of any study."""

TABLES = dict(zip((2, 3, 4, 5), METRICS, strict=True))
"""Number of a table of the paper -> its metric."""

READINGS = {
    "eq6": "form of eq. 6",
    "damping": "form of Figure 3's fit",
    "preload": "preload that determines the damping",
    "wiring": "command of the antagonist's drive",
    "agonist": "which drive is the agonist",
    "floor": "forces below the 5 N floor",
    "derivative_on": "input of the derivative terms",
    "rise_time": "rise time",
    "tension_error": "force in the tension ISE",
    "isav_unit": "unit of ISAV",
    "isav_kick": "drives whose jump at the step counts in the ISAV",
    "isav_columns": "columns of Table 5",
    "spring_end": "what ends the spring's curve",
}
"""Readings in words; one that is not here goes by its name."""

_TABLE_5_NOTE = (
    "The paper prints no unit in Table 5. ±, in all four tables: standard deviation of the testbed's "
    f"{PROTOCOL.repetitions_testbed} repetitions, which differ by their sensor noise."
)

HOLDS = {True: "yes", False: "no", None: "open"}

_EACH = [f"Table {table}" for table in TABLES]
_ROW_KEYS = ("table", "profile", "configuration", "metric", "drive")


@dataclass(frozen=True)
class Evidence:
    """All results of the study on our devices."""

    reproduction: Reproduction
    identification: dict[str, Any]  # origin of the parameters (`study.shipped`)
    predicted: dict[str, tuple[Row, ...]]  # `study.cross_check`
    springs: dict[str, tuple[Row, ...]]  # `study.spring_laws`
    claims: tuple[CheckedClaim, ...]
    hypotheses: tuple[Answer, ...]
    remarks: dict[str, str]  # `figures.remarks`, by the figures' names
    sensitivity: Sensitivity  # `motion.vary`
    force_rises: tuple[ForceRise, ...]  # `motion.force_rise_times`
    folder: str | None = None  # of the devices' study; None: the shipped one


PARTS = 7
"""Parts of the work of `gather`."""


def gather(study: OwnStudy | None = None, report: Callable[[str], None] = lambda part: None) -> Evidence:
    """Run the paper's protocol, and test its claims and hypotheses.

    Parameters
    ----------
    study : OwnStudy, optional
        Devices instead of the shipped ones (`own_study.read_study`).
    report : callable
        Called with the name of each of the `PARTS` when it is done.

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """

    def done(part: str, result: Any) -> Any:
        report(part)
        return result

    identification = shipped() if study is None else study.identification
    reproduction = done("step responses", reproduce(None if study is None else study.profiles))
    profiles, readings = reproduction.profiles, reproduction.readings
    observed = done("motions", observe(reproduction))
    return Evidence(
        reproduction,
        identification,
        done("cross-check", cross_check(identification, readings)),
        done("spring laws", spring_laws(identification, readings)),
        check_claims(reproduction, observed),
        answer_hypotheses({**our_numbers(reproduction), **observed}),
        done("figures' data", remarks(profiles, readings)),
        done("judgement calls", vary(profiles, readings)),
        done("string force", force_rise_times(profiles, readings)),
        None if study is None else study.folder,
    )


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
        "rows": [{**_entry(row), "note": _note(reproduction, index)} for index, row in enumerate(reproduction.rows)],
        "cross_check": [
            {**_entry(row), "left_out": left_out} for left_out, rows in evidence.predicted.items() for row in rows
        ],
        "claims": claims_content(evidence.claims),
        "hypotheses": hypotheses_content(evidence.hypotheses),
        "sensitivity": asdict(evidence.sensitivity),
        "force_rise_time": [asdict(item) for item in evidence.force_rises],
    }


def rows_content(evidence: Evidence, result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of ``reproduction.json`` with their spread and the reading under which they come nearest."""
    rows = []
    for index, (written, row) in enumerate(zip(result["rows"], evidence.reproduction.rows, strict=True)):
        key, nearest = best_reading(evidence.reproduction, index)
        best = {"nearest_reading": "as taken" if key is None else " ".join(key), "nearest_ratio": nearest.ratio}
        rows.append({**written, "spread": row.spread, **best})
    return rows


def readings_content(reproduction: Reproduction) -> list[dict[str, Any]]:
    """Return every row under every reading."""
    return [
        {"reading": name, "choice": choice, **_entry(row), "than_as_taken": move}
        for (name, choice), under in {("as taken", ""): reproduction.rows, **reproduction.alternatives}.items()
        for row, move in zip(under, moved(under, reproduction.rows), strict=True)
    ]


def paper_table(reproduction: Reproduction, table: int, short: bool = False) -> Table:
    """Return one of the paper's Tables 2-5 with our numbers and the nearest reading of each row.

    `short` names readings as `Readings` does.
    """
    places = [index for index, row in enumerate(reproduction.rows) if row.cell.table == table]
    rows = [reproduction.rows[index] for index in places]
    nearest = "nearest under" if short else "interpretation that alone comes nearer"
    paper, ours = (f" [{unit.replace('^2', '2')}]" if unit else "" for unit in (rows[0].cell.unit, rows[0].unit))
    return Table(
        f"Table {table}: {METRICS[TABLES[table]]}",
        ("", f"paper{paper}", f"ours{ours}", "±", "ratio", "explained", nearest),
        [
            [
                *(place(row), f"{row.cell.value:g}", number(row.ours, 4)),
                *("" if row.spread is None else number(row.spread, 2), number(row.ratio), HOLDS[row.explained]),
                "; ".join(filter(None, [_nearest(reproduction, index, short), row.trouble])),
            ]
            for index, row in zip(places, rows, strict=True)
        ],
        f"{_TABLE_5_NOTE} {exchange_in_words(reproduction.readings)}".rstrip() if table == 5 else "",
        left=(0, 6),
    )


def overview(reproduction: Reproduction) -> Table:
    """Return all numbers in eight rows, as paper / ours (ratio), for a document; bold: not explained."""

    def cell(row: Row) -> str:
        text = f"{_short(row.cell.value)} / "
        text += "-" if row.ours is None or row.ratio is None else f"{_short(row.ours)} ({row.ratio:.2f})"
        return text if row.explained else f"**{text}**"

    columns: list[tuple[str, str | None]] = [(metric, None) for metric in METRICS if metric != "isav"]
    columns += [("isav", drive) for drive in reversed(DRIVES)]
    numbers = {
        (row.cell.profile, row.cell.configuration, row.cell.metric, row.cell.drive): row for row in reproduction.rows
    }
    units = {(row.cell.metric, row.cell.drive): row.unit.replace("^2", "2") for row in reproduction.rows}

    def heading(metric: str, drive: str | None) -> str:
        name = METRICS[metric]
        if drive is not None:
            name += f", column {drive} / drive of the {our_drive(drive, reproduction.readings)}"
        return f"{name} [{units[metric, drive]}]"

    head = [heading(*column) for column in columns]
    return Table(
        "",
        ("device", "configuration", *head),
        [
            [device, NAMES[configuration], *(cell(numbers[device, configuration, *column]) for column in columns)]
            for device in DEVICES
            for configuration in CONFIGURATIONS
        ],
        left=(0, 1),
    )


def force_rise_table(evidence: Evidence) -> Table:
    """Return the string force's rise times."""
    return Table(
        "Rise time of the string force",
        (
            "device",
            "configuration",
            "first entry [s]",
            "last entry [s]",
            "inside at T",
            "inside during the last second",
        ),
        [
            [
                item.profile,
                NAMES[item.configuration],
                *("-" if time is None else f"{time:.2f}" for time in (item.first_entry, item.last_entry)),
                f"{item.inside_at_end} of {item.repetitions}",
                f"{100.0 * item.share_inside:.0f} %",
            ]
            for item in evidence.force_rises
        ],
        "Time after the step until the string force is within 5 % of its setpoint (section 2.2). The paper defines "
        "this rise time and prints no number. Force and setpoint are those of Table 4; 0 s: the force is within the "
        "margin when the step comes. On the testbed, noise repeatedly takes the estimate out of the margin: the last "
        "entry is the last time that it came back.",
        left=(0, 1),
    )


def readings_table(evidence: Evidence) -> Table:
    """Return the readings: numbers explained of each table, rows that come nearer, result of a new fit."""
    reproduction, found = evidence.reproduction, evidence.identification
    refitted = {(item["reading"], item["choice"]): item for item in found["readings_refitted"]}

    def line(name: str, rows: Sequence[Row], again: Mapping[str, Any], moves: Sequence[str]) -> list[str]:
        fit = [str(again["explained"]), f"{again['cost']:.1f}"] if again else ["", ""]
        return [name, *_counts(rows), *moves, *fit]

    body = [line("as chosen", reproduction.rows, found, ["", ""])]
    for (name, choice), rows in reproduction.alternatives.items():
        moves = moved(rows, reproduction.rows)
        counts = [str(moves.count(way)) for way in ("nearer", "farther")]
        body.append(line(f"{READINGS.get(name, name)}: `{choice}`", rows, refitted.get((name, choice), {}), counts))
    weights = " and ".join(f"{METRICS[metric]} {weight:g}" for metric, weight in WEIGHTS.items() if weight != 1.0)
    least = found["ensemble"]["least_cost"]
    above = sorted({f"{start['cost'] - least:.1f}" for start in found["starts"]}, key=float)
    taken = ", ".join(f"{READINGS.get(name, name)} `{item}`" for name, item in asdict(reproduction.readings).items())
    return Table(
        "Interpretations",
        ("interpretation", *_EACH, "closer", "less close", "explained after a new fit", "cost"),
        body,
        "Each line changes one of the chosen interpretations of what the paper leaves open. The columns: how many "
        "numbers of each table are explained (of 8, 8, 8 and 16); how many numbers are closer to the paper's, and how "
        "many are less close, than with the chosen interpretations; how many of all 40 are explained after all "
        "parameters are fitted again with this interpretation, and the cost of that fit (empty: not fitted). The cost "
        "is a smooth count of the rows that are outside their bounds; it grows slightly with the distance from them. "
        "Weights of rows: "
        f"{weights}, all others 1. The search is not exact: its independent starts ended "
        f"{' to '.join(dict.fromkeys((above[0], above[-1])))} above the lowest cost found, so smaller differences of "
        f"cost are not significant. The chosen interpretations: {taken}.",
    )


def cross_check_table(evidence: Evidence) -> Table:
    """Return the predictions of the fits to three configurations for the fourth."""
    first, second = (
        f"{drive} (here drive of the {our_drive(drive, evidence.reproduction.readings)})" for drive in DRIVES
    )
    return Table(
        "Cross-check: fit three configurations, predict the fourth",
        ("left out of the fit", "explained", *(f"ratios, {device}" for device in DEVICES)),
        [
            [
                NAMES[left_out],
                f"{sum(row.explained for row in rows)} of {len(rows)}",
                *(", ".join(number(row.ratio) for row in rows if row.cell.profile == device) for device in DEVICES),
            ]
            for left_out, rows in evidence.predicted.items()
        ],
        "Ratios to the paper's numbers, in this order: Table 2, Table 3, Table 4; of Table 5 first the paper's column "
        f"{first}, then its column {second}. Each line is a single fit, that of the first seed, without a condition on "
        "the spring and without the choice among equally good sets.",
        left=(0, 2, 3),
    )


def predictions_table(evidence: Evidence) -> Table:
    """Return every prediction of the cross-check."""
    return Table(
        "Every predicted number",
        ("left out", "table", "", "paper", "predicted", "unit", "ratio", "explained"),
        [
            [
                *(NAMES[left_out], str(row.cell.table), f"{row.cell.profile} {row.cell.drive or ''}".rstrip()),
                *(f"{row.cell.value:g}", number(row.ours, 4), row.unit.replace("^2", "2")),
                *(number(row.ratio), HOLDS[row.explained]),
            ]
            for left_out, rows in evidence.predicted.items()
            for row in rows
        ],
        left=(0, 2, 5),
    )


def springs_table(evidence: Evidence) -> Table:
    """Return the result of the best fit with each spring law."""
    body = []
    for spring in evidence.identification["springs"]:
        rows = evidence.springs[spring["law"]]
        variable = {
            row.cell.metric: number(row.ratio)
            for row in rows
            if (row.cell.profile, row.cell.configuration) == ("testbed", "variable")
        }
        body.append(
            [
                spring["law"],
                *(f"{spring['length_ratio']:g}", f"{spring['stiffening']:.2f}", f"{spring['cost']:.1f}"),
                *_counts(rows),
                str(sum(row.explained for row in rows)),
                f"{variable['rise_time']}, {variable['position_ise']}",
            ]
        )
    return Table(
        "Which spring laws the tables allow",
        ("spring law", "length_ratio", "stiffness at 10 N / at 4 N", "cost", *_EACH, "of 40", "ratios"),
        body,
        "`length_ratio`: free length of a spring over the half-width, as in the table above. The best fit with each "
        "law, all other parameters fitted again. Ratios to the paper's numbers: rise time and position ISE of the "
        "testbed with variable stiffness.",
    )


def sensitivity_tables(evidence: Evidence) -> list[Table]:
    """Return the variations of the judgement calls that no table decides."""
    found, hysteresis = evidence.sensitivity, evidence.reproduction.profiles["testbed"].loop.switch_hysteresis
    configurations = list(next(iter(found.by_hysteresis.values())))
    last = PROTOCOL.repetitions_testbed - 1
    reference = published("tension_ise", "testbed", "position-only").value
    in_table_4 = our_numbers(evidence.reproduction).get(("tension_ise", "testbed", "position-only", None))
    first = next(iter(found.by_setpoint.values()))

    def explained_by(name: Callable[[Any], str], counts: Mapping[Any, Sequence[int]]) -> list[list[str]]:
        return [[name(key), *map(str, numbers), str(sum(numbers))] for key, numbers in counts.items()]

    return [
        Table(
            "Sensor noise: numbers explained",
            ("repetitions", *_EACH, "of 40"),
            explained_by(lambda key: f"{key} to {key + last}{' (reported)' * (key == 1)}", found.by_noise),
        ),
        Table(
            "T of eqs. 7 and 8: numbers explained",
            ("T [s]", *_EACH, "of 40"),
            explained_by(lambda time: f"{time:g}", found.by_time),
        ),
        Table(
            "Hysteresis of the agonist's switch on the testbed",
            ("hysteresis [mm]", *(NAMES[name] for name in configurations)),
            [
                [
                    f"{1000 * factor * hysteresis:.2g}{' (shipped)' * (factor == 1.0)}",
                    *(f"{count}, {deviation:.1f} deg" for count, deviation in switches.values()),
                ]
                for factor, switches in found.by_hysteresis.items()
            ],
            "Number of switches in the movements of Figure 9, and the largest movement of the joint by one of them.",
        ),
        Table(
            "Forces estimated below the floor",
            ("treatment", *(f"after {time:g} s [N]" for time in REST)),
            [[floor, *(f"{force:.1f}" for force in forces)] for floor, forces in found.by_floor.items()],
            "The antagonist's true force at rest, with a setpoint of 5 N.",
        ),
        Table(
            "Setpoint of the tension ISE without tension control",
            ("setpoint", "tension ISE [N2 s]", "divided by the paper's"),
            [[name, f"{ise:.3f}", f"{ise / reference:.2f}"] for name, ise in found.by_setpoint.items()],
            f"On the testbed. The paper takes the mean of the force signal over the first {MOVES_FROM:g} s. So here "
            f"the step comes after {MOVES_FROM:g} s, in Table 4 after {START:g} s. The sensor noise then differs: with "
            f"the same setpoint the first row has {first:.3f} N2 s, and Table 4 has {number(in_table_4)} N2 s.",
        ),
    ]


def hypothesis_table(answer: Answer) -> Table:
    """Return the criteria of a hypothesis with our numbers."""
    return Table(
        "",
        ("on our devices", "holds", "numbers"),
        [[f"{item.case}: {item.question}", HOLDS[item.holds], item.words] for item in answer.criteria],
        f"The paper: {answer.paper}",
        left=(0, 1, 2),
    )


def status(evidence: Evidence) -> str:
    """Return the origin of the parameters, with the study's folder if it is not the shipped one."""
    if evidence.folder is None:
        return STATUS
    recipe = evidence.identification["recipe"]
    sizes = ", ".join(f"{name} {count}" for name, count in recipe.items() if name != "seeds")
    seeds = ", ".join(map(str, recipe["seeds"]))
    return f"{STATUS} These are the devices of the study in {evidence.folder}: seeds {seeds}; {sizes}."


def within(metric: str, device: str) -> str:
    """Return the bounds of an explained number in words."""
    low, high = BOUNDS[metric, device]
    if math.isclose(low + high, 2.0):
        return f"within {100.0 * (high - 1.0):.3g} %"
    if math.isclose(low * high, 1.0):
        return f"within a factor of {high:.3g}"
    return f"from {low:.3g} to {high:.3g} times the paper's"


def bounds_in_words() -> str:
    """Return the bounds of all explained numbers in words; a bound of both devices is named once."""
    parts = []
    for metric, name in METRICS.items():
        bounds = {device: within(metric, device) for device in DEVICES}
        same = len(set(bounds.values())) == 1
        said = bounds[DEVICES[0]] if same else ", ".join(f"{words} ({device})" for device, words in bounds.items())
        parts.append(f"{name} {said}")
    return f"A number is explained if ours divided by the paper's is within its bounds: {'; '.join(parts)}."


def counts_in_words(evidence: Evidence) -> str:
    """Return the counts of explained numbers and of claims that hold, in words."""
    rows, claims = evidence.reproduction.rows, evidence.claims
    tried = [item for item in claims if item.paper is not None]
    borne_out = [item for item in tried if not item.contradicted]
    hold = [sum(item.ours.holds is True for item in some) for some in (claims, borne_out)]
    undecided = sum(item.ours.holds is None for item in claims)
    by_table = ", ".join(f"{count} of {size} of Table {table}" for table, (count, size) in explained(rows).items())
    return (
        f"{sum(row.explained for row in rows)} of the {len(rows)} numbers of Tables 2-5 are explained: {by_table}. "
        f"{hold[0]} of {len(claims)} claims of sections 3 to 5 hold on our devices"
        f"{f', {undecided} cannot be decided' if undecided else ''}. {len(tried)} of the {len(claims)} claims are "
        f"about the paper's tables. The tables themselves contradict {len(tried) - len(borne_out)} of these "
        f"{len(tried)}. Of the remaining {len(borne_out)}, {hold[1]} hold on the simulated devices."
    )


def exchange_in_words(readings: Readings) -> str:
    """Return a sentence on exchanged columns of Table 5, an empty string if they are taken as printed."""
    if readings.isav_columns != "swapped":
        return ""
    return (
        "The columns of Table 5 are taken as exchanged: the paper's column triceps is compared with the ISAV of this "
        "model's biceps' drive, and its column biceps with that of the triceps' drive."
    )


def place(row: Row) -> str:
    """Return device, configuration and drive of a row in words."""
    return ", ".join(filter(None, [row.cell.profile, NAMES[row.cell.configuration], row.cell.drive]))


def _entry(row: Row) -> dict[str, Any]:
    """Return a row as ``reproduction.json`` has it, without its note."""
    return {
        **{key: getattr(row.cell, key) for key in _ROW_KEYS},
        "paper": row.cell.value,
        **{key: getattr(row, key) for key in ("ours", "ratio", "unit", "explained")},
    }


def _note(reproduction: Reproduction, index: int) -> str:
    """Return a row's note: its spread, the reason why it is unexplained, the nearest reading."""
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
        parts.append(f"{' '.join(key)} alone {verb} (ratio {number(nearest.ratio, 5)})")
    return "; ".join(parts)


def _nearest(reproduction: Reproduction, index: int, short: bool) -> str:
    """Return in words the reading under which a row is nearest to the paper, its ratio, and whether it is explained."""
    key, nearest = best_reading(reproduction, index)
    if key is None:
        return "" if nearest.explained else "as taken"
    if short:
        return f"{' '.join(key)} ({number(nearest.ratio)})"
    verdict = "explained" if nearest.explained else "not explained either"
    return f"{READINGS.get(key[0], key[0])}: `{key[1]}` ({number(nearest.ratio)}, {verdict})"


def _counts(rows: Iterable[Row]) -> list[str]:
    return [str(count) for count, _ in explained(rows).values()]


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.4g}"
