"""A reproduction as one HTML page that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from amulett_gym import __version__
from amulett_gym.reporting.words import number, pretty
from amulett_gym.studies.paper.claims import CheckedClaim
from amulett_gym.studies.paper.evidence import Evidence
from amulett_gym.studies.paper.figures import CAPTIONS, with_remark
from amulett_gym.studies.paper.reproduction import MEASUREMENT_TIME, Reproduction, Row, best_reading, explained, moved
from amulett_gym.studies.paper.results import (
    bounds_in_words,
    by_table,
    cost_in_words,
    determined_in_words,
    force_rise_table,
    search_varies,
    sensitivity_tables,
    springs_table,
    status,
    within,
)
from amulett_gym.studies.paper.statements import METRICS, NAMES
from amulett_gym.studies.paper.tables import DEVICES, PROTOCOL

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

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


def render(evidence: Evidence, figures: Mapping[str, Figure]) -> str:
    """Return a reproduction as one HTML page with inline figures, styles and no script.

    Parameters
    ----------
    evidence : Evidence
    figures : mapping of str to Figure
        By the names of `figures.CAPTIONS`; may be empty.
    """
    from amulett_gym.reporting.page import fill_page
    from amulett_gym.reporting.style import figure_svg

    reproduction, claims, found = evidence.reproduction, evidence.claims, evidence.identification
    printed = [item for item in claims if item.paper is not None]
    return fill_page(
        "studies/paper/reproduction.html.j2",
        verdict=_verdict(reproduction.rows, claims),
        status=status(evidence),
        bounds=bounds_in_words(),
        tables=[_table(reproduction, table) for table in _TABLES],
        repetitions=PROTOCOL.repetitions_testbed,
        rise_time=reproduction.readings.rise_time,
        readings=_readings(reproduction, found),
        cost=cost_in_words(),
        search_varies=search_varies(found),
        taken={_READINGS.get(name, name): choice for name, choice in asdict(reproduction.readings).items()},
        devices=DEVICES,
        predicted=[_prediction(left_out, rows) for left_out, rows in evidence.predicted.items()],
        determined=determined_in_words(found),
        spread=[_spread(item) for item in found["spread"]],
        springs=springs_table(evidence),
        force_rise=force_rise_table(evidence),
        sensitivity=sensitivity_tables(evidence),
        claims=claims,
        counts={
            "hold": sum(item.ours.holds is True for item in claims),
            "fail": sum(item.ours.holds is False for item in claims),
            "open": sum(item.ours.holds is None for item in claims),
            "printed": len(printed),
            "contradicted": sum(item.contradicted for item in claims),
        },
        hypotheses=evidence.hypotheses,
        figures=[
            {
                "id": _title(name).lower().replace(" ", "-"),
                "svg": figure_svg(figure, name),
                "title": _title(name),
                "caption": with_remark(CAPTIONS.get(name, ""), evidence.remarks.get(name)),
            }
            for name, figure in figures.items()
        ],
        words=_words,
        measurement_time=f"{MEASUREMENT_TIME:g}",
        study=evidence.folder,
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


def _table(reproduction: Reproduction, table: int) -> dict[str, Any]:
    indices = [index for index, row in enumerate(reproduction.rows) if row.cell.table == table]
    rows = [reproduction.rows[index] for index in indices]
    return {
        "number": table,
        "metric": METRICS[_TABLES[table]],
        "bounds": {device: within(_TABLES[table], device) for device in DEVICES},
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
                **_row(row),
                "spread": "" if row.spread is None else pretty(number(row.spread, 2)),
                "nearest": _nearest(reproduction, index),
            }
            for index, row in zip(indices, rows, strict=True)
        ],
    }


def _row(row: Row) -> dict[str, Any]:
    return {
        "table": row.cell.table,
        "device": row.cell.profile,
        "configuration": NAMES[row.cell.configuration],
        "drive": row.cell.drive or "",
        "paper": pretty(f"{row.cell.value:g}"),
        "ours": pretty(number(row.ours, 4)),
        "unit": _unit(row.unit),
        "ratio": pretty(number(row.ratio)),
        "explained": row.explained,
        "trouble": _words(row.trouble),
    }


def _nearest(reproduction: Reproduction, index: int) -> str:
    """Return the reading under which a row comes nearest to the paper, its ratio then, and whether that explains it."""
    key, nearest = best_reading(reproduction, index)
    if key is None:
        return "" if nearest.explained else "as taken"
    verdict = "explained" if nearest.explained else "not explained either"
    return f"{_READINGS.get(key[0], key[0])}: `{key[1]}` (×{pretty(number(nearest.ratio))}, {verdict})"


def _readings(reproduction: Reproduction, found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a line for each reading, with what it explains when everything is fitted again, and that fit's cost."""
    refitted = {(item["reading"], item["choice"]): item for item in found["readings_refitted"]}

    def line(name: str, choice: str, rows: Sequence[Row], again: Mapping[str, Any]) -> dict[str, Any]:
        moves = moved(rows, reproduction.rows)
        return {
            "name": _READINGS.get(name, name),
            "choice": choice,
            "explained": [count for count, _ in explained(rows).values()],
            "nearer": moves.count("nearer"),
            "farther": moves.count("farther"),
            "refitted": again["explained"],
            "cost": f"{again['cost']:.1f}",
        }

    taken = {**line("as taken", "", reproduction.rows, found), "nearer": "", "farther": ""}
    others = reproduction.alternatives.items()
    return [taken, *(line(name, choice, rows, refitted[name, choice]) for (name, choice), rows in others)]


def _prediction(left_out: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return what the cross-check says about one configuration, by device, and all rows of it."""
    ratios = {device: [pretty(number(row.ratio)) for row in rows if row.cell.profile == device] for device in DEVICES}
    return {
        "left_out": NAMES[left_out],
        "explained": sum(row.explained for row in rows),
        "ratios": {device: ", ".join(words) for device, words in ratios.items()},
        "rows": [_row(row) for row in rows],
    }


def _spread(item: Mapping[str, Any]) -> dict[str, Any]:
    low, high = item["bounds"]
    return {
        **_numbers_in_words(item, ("value", "low", "high")),
        "searched": f"{pretty(number(low, 2))} to {pretty(number(high, 2))}",
    }


def _place(row: Row) -> str:
    return " ".join(filter(None, [row.cell.profile, NAMES[row.cell.configuration], row.cell.drive]))


def _numbers_in_words(item: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    return {**item, **{key: pretty(number(item[key])) for key in keys}}


def _words(text: str) -> Markup:
    """Return a text as HTML: numbers as people write them, which keep their units beside them, and `code` as code."""
    together = re.sub(r"(?<=[\d⁰¹²³⁴-⁹]) (?=%|N|deg|s\b)", "\N{NO-BREAK SPACE}", pretty(text))
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(together))))


def _unit(unit: str) -> str:
    return unit.replace("^2", "²")


def _title(name: str) -> str:
    """Return ``Figure 5b`` for ``figure_5b_force_estimation``."""
    return " ".join(name.split("_")[:2]).capitalize()
