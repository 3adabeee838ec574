"""A reproduction as one HTML page that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from amulett_gym import __version__
from amulett_gym.evaluation.results import number, pretty
from amulett_gym.paper.claims import CheckedClaim
from amulett_gym.paper.hypotheses import Answer
from amulett_gym.paper.reproduction import BOUNDS, MEASUREMENT_TIME, Reproduction, Row, explained, moved
from amulett_gym.paper.results import STATUS, by_table, note
from amulett_gym.paper.statements import METRICS, NAMES
from amulett_gym.paper.tables import PROTOCOL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TABLES = {2: "rise_time", 3: "position_ise", 4: "tension_ise", 5: "isav"}

_READINGS = {
    "eq6": "form of eq. 6",
    "damping": "form of Figure 3's fit",
    "preload": "which preload damps",
    "wiring": "what the antagonist follows",
    "agonist": "which drive is the agonist",
    "floor": "forces below the 5 N floor",
    "derivative_on": "what the derivatives are of",
    "rise_time": "rise time",
    "tension_error": "force in the tension ISE",
    "isav_unit": "unit of ISAV",
    "isav_kick": "jump at the step, in ISAV",
    "isav_columns": "columns of Table 5",
}
"""Readings in words; one that is not here goes by its name."""


def render(
    reproduction: Reproduction,
    claims: Sequence[CheckedClaim],
    hypotheses: Sequence[Answer],
    figures: Mapping[str, Figure],
    identification: Mapping[str, Any] | None = None,
    captions: Mapping[str, str] | None = None,
) -> str:
    """Return a reproduction as one HTML page with inline figures, styles and no script.

    Parameters
    ----------
    reproduction : Reproduction
    claims : sequence of CheckedClaim
        From `claims.check_claims`.
    hypotheses : sequence of Answer
        From `hypotheses.answer_hypotheses`.
    figures : mapping of str to Figure
        By names like ``figure_5b_force_estimation``; may be empty.
    identification : mapping, optional
        How the parameters came about. All of its entries are optional, and each makes a section: ``cross_check``, rows
        as in ``reproduction.json`` with the configuration that was ``left_out`` of the fit; ``spread``, one
        ``{"name", "unit", "value", "low", "high", "determined", "source"}`` a parameter; ``springs``, one
        ``{"law", "length_ratio", "cost", "met", "of", "stiffening"}`` a spring law; ``readings_refitted``, one
        ``{"reading", "choice", "explained"}`` a reading, beside the ``explained`` of the readings taken.
    captions : mapping of str to str, optional
        What the figures show, by the same names.
    """
    from amulett_gym.evaluation.plots import figure_svg
    from amulett_gym.evaluation.report import fill_page

    found = identification or {}
    printed = [item for item in claims if item.paper is not None]
    return fill_page(
        "paper/reproduction.html.j2",
        verdict=_verdict(reproduction.rows, claims),
        status=STATUS,
        bounds=_bounds(),
        tables=[_table(reproduction, table) for table in _TABLES],
        repetitions=PROTOCOL.repetitions_testbed,
        rise_time=reproduction.readings.rise_time,
        readings=_readings(reproduction, found),
        taken={_READINGS.get(name, name): choice for name, choice in asdict(reproduction.readings).items()},
        cross_check=[_row_in_words(row) for row in found.get("cross_check", ())],
        spread=[_numbers_in_words(item, ("value", "low", "high")) for item in found.get("spread", ())],
        springs=[_numbers_in_words(item, ("length_ratio", "cost", "stiffening")) for item in found.get("springs", ())],
        claims=claims,
        counts={
            "hold": sum(item.ours.holds is True for item in claims),
            "fail": sum(item.ours.holds is False for item in claims),
            "open": sum(item.ours.holds is None for item in claims),
            "printed": len(printed),
            "contradicted": sum(item.contradicted for item in claims),
        },
        hypotheses=hypotheses,
        figures=[
            {"svg": figure_svg(figure, name), "title": _title(name), "caption": (captions or {}).get(name, "")}
            for name, figure in figures.items()
        ],
        words=_words,
        measurement_time=f"{MEASUREMENT_TIME:g}",
        versions={package: version(package) for package in ("numba", "numpy")} | {"amulett-gym": __version__},
    )


def _verdict(rows: Sequence[Row], claims: Sequence[CheckedClaim]) -> str:
    borne_out = [item for item in claims if item.paper is not None and item.paper.holds]
    return (
        f"{sum(row.explained for row in rows)} of the {len(rows)} numbers of Tables 2-5 are explained: "
        f"{by_table(rows)}. "
        f"Of {len(claims)} claims of sections 3 to 5, {sum(item.ours.holds is True for item in claims)} hold on our "
        f"devices; of the {len(borne_out)} that the paper's own tables bear out, "
        f"{sum(item.ours.holds is True for item in borne_out)} do."
    )


def _bounds() -> list[str]:
    """Return within which ratios a number is explained, devices with the same bounds together."""
    devices: dict[tuple[str, tuple[float, float]], list[str]] = {}
    for (metric, device), ratios in BOUNDS.items():
        devices.setdefault((metric, ratios), []).append(device)
    return [
        f"{low:.3g} to {high:.3g} ({METRICS[metric]}, {' and '.join(names)})"
        for (metric, (low, high)), names in devices.items()
    ]


def _table(reproduction: Reproduction, table: int) -> dict[str, Any]:
    indices = [index for index, row in enumerate(reproduction.rows) if row.cell.table == table]
    rows = [reproduction.rows[index] for index in indices]
    return {
        "number": table,
        "metric": METRICS[_TABLES[table]],
        "unit": _unit(rows[0].cell.unit),
        "our_unit": _unit(rows[0].unit),
        "drives": any(row.cell.drive for row in rows),
        "explained": sum(row.explained for row in rows),
        "unexplained": [
            f"{_place(row)} ({'no number' if row.ratio is None else f'×{pretty(number(row.ratio))}'})"
            for row in rows
            if not row.explained
        ],
        "rows": [
            {
                "device": row.cell.profile,
                "configuration": NAMES[row.cell.configuration],
                "drive": row.cell.drive,
                "paper": pretty(f"{row.cell.value:g}"),
                "ours": pretty(number(row.ours, 4)),
                "spread": "" if row.spread is None else pretty(number(row.spread, 2)),
                "ratio": pretty(number(row.ratio)),
                "explained": row.explained,
                "note": _words(note(reproduction, index)),
            }
            for index, row in zip(indices, rows, strict=True)
        ],
    }


def _readings(reproduction: Reproduction, found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a line for each reading; what explains as much when everything is fitted again, where that is known."""
    refitted = {(item["reading"], item["choice"]): item["explained"] for item in found.get("readings_refitted", ())}
    taken = {"name": "as taken", "choice": "", "nearer": "", "farther": "", "refitted": found.get("explained", "")}
    lines: list[dict[str, Any]] = [{**taken, "explained": _counts(reproduction.rows)}]
    for (name, choice), rows in reproduction.alternatives.items():
        moves = moved(rows, reproduction.rows)
        lines.append(
            {
                "name": _READINGS.get(name, name),
                "choice": choice,
                "explained": _counts(rows),
                "nearer": moves.count("nearer"),
                "farther": moves.count("farther"),
                "refitted": refitted.get((name, choice), ""),
            }
        )
    return lines


def _counts(rows: Sequence[Row]) -> list[int]:
    return [count for count, _ in explained(rows).values()]


def _place(row: Row) -> str:
    return " ".join(filter(None, [row.cell.profile, NAMES[row.cell.configuration], row.cell.drive]))


def _row_in_words(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the cross-check as the page shows it."""
    return {
        "left_out": NAMES.get(row["left_out"], row["left_out"]),
        "table": f"Table {row['table']}",
        "device": row["profile"],
        "configuration": NAMES.get(row["configuration"], row["configuration"]),
        "drive": row.get("drive") or "",
        "paper": pretty(f"{row['paper']:g}"),
        "ours": pretty(number(row["ours"], 4)),
        "unit": _unit(row.get("unit", "")),
        "ratio": pretty(number(row["ratio"])),
        "explained": row["explained"],
    }


def _numbers_in_words(item: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    return {**item, **{key: pretty(number(item[key])) for key in keys}}


def _words(text: str) -> str:
    """Return a text with numbers as people write them, which do not part from their units at the end of a line."""
    return re.sub(r"(?<=[\d⁰¹²³⁴-⁹]) (?=%|N|deg|s\b)", "\N{NO-BREAK SPACE}", pretty(text))


def _unit(unit: str) -> str:
    return unit.replace("^2", "²")


def _title(name: str) -> str:
    """Return ``Figure 5b`` for ``figure_5b_force_estimation``."""
    return " ".join(name.split("_")[:2]).capitalize()
