"""The generated part of ``docs/reproduction.md``: numbers and figures come from the command, the judgement from us."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.reporting.document import between_marks
from amulett_gym.storage.reading import read_text
from amulett_gym.storage.writing import write_text
from amulett_gym.studies.paper.claims import CheckedClaim
from amulett_gym.studies.paper.evidence import Evidence
from amulett_gym.studies.paper.figures import with_remark
from amulett_gym.studies.paper.hypotheses import Answer
from amulett_gym.studies.paper.reproduction import Reproduction, Row, explained
from amulett_gym.studies.paper.results import (
    bounds_in_words,
    cost_in_words,
    determined_in_words,
    force_rise_table,
    search_varies,
    sensitivity_tables,
    springs_table,
    status,
)
from amulett_gym.studies.paper.statements import NAMES
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES

BEGIN = "<!-- Written by `amulett reproduce --doc`; edit around it. -->"
END = "<!-- End of what is written. -->"

IMAGES = "images"
"""Folder of a document's figures, beside it."""

_COLUMNS = (
    ("rise_time", None, "rise time [s]"),
    ("position_ise", None, "position ISE [deg² s]"),
    ("tension_ise", None, "tension ISE [N² s]"),
    ("isav", "triceps", 'ISAV, column "triceps" [rad²/s]'),
    ("isav", "biceps", 'ISAV, column "biceps" [rad²/s]'),
)


def block(evidence: Evidence, figures: Mapping[str, str]) -> str:
    """Return the generated part as Markdown.

    Parameters
    ----------
    evidence : Evidence
    figures : mapping of str to str
        File of each figure, relative to the document, and its caption; what the figure shows on these devices is added.
    """
    parts = [
        *([] if evidence.folder is None else [status(evidence)]),
        _rows(evidence.reproduction),
        _force_rises(evidence),
        _readings(evidence.reproduction, evidence.identification),
        _predicted(evidence.predicted),
        _spread(evidence.identification),
        _springs(evidence),
        _sensitivity(evidence),
        _hypotheses(evidence.hypotheses),
        _claims(evidence.claims),
        "### Figures",
        *[
            f"![{Path(file).stem}]({file})\n\n*{with_remark(caption, evidence.remarks.get(Path(file).stem))}*"
            for file, caption in figures.items()
        ],
    ]
    return "\n\n".join(parts)


def check(path: str | Path) -> None:
    """Refuse a document that could not be renewed, before any work.

    Raises
    ------
    AmulettError
        If the file or the figures beside it cannot be written, or it has not both marks once, in their order.
    """
    between_marks(read_text(path, "document"), path, BEGIN, END, "")
    if not os.access(path, os.W_OK):
        raise AmulettError(f"cannot write document '{path}': it is read-only")
    folder = Path(path).parent
    for place in (folder, folder / IMAGES):
        if place.exists():
            try:
                with tempfile.TemporaryFile(dir=place):
                    pass
            except OSError as error:
                raise AmulettError(f"cannot write to '{place}': {error.strerror or error}") from error


def update(path: str | Path, text: str) -> None:
    """Put `text` between the two marks of a document, in the place of what was there.

    Raises
    ------
    AmulettError
        If the file cannot be read or written, or has not both marks once, in their order.
    """
    write_text(path, between_marks(read_text(path, "document"), path, BEGIN, END, text))


def _rows(reproduction: Reproduction) -> str:
    numbers = {
        (row.cell.profile, row.cell.configuration, row.cell.metric, row.cell.drive): row for row in reproduction.rows
    }
    body = []
    for device in DEVICES:
        for configuration in CONFIGURATIONS:
            cells = [numbers[device, configuration, metric, drive] for metric, drive, _ in _COLUMNS]
            body.append([device, NAMES[configuration], *map(_cell, cells)])
    total = sum(row.explained for row in reproduction.rows)
    titles = ["device", "configuration", *(title for *_, title in _COLUMNS)]
    return (
        f"### Tables 2-5\n\n{bounds_in_words()} {total} of {len(reproduction.rows)} are. In the table: paper / ours "
        f"(ratio); **bold**: not explained.\n\n{_table(titles, body)}"
    )


def _force_rises(evidence: Evidence) -> str:
    table = force_rise_table(evidence)
    return f"### Rise time of the string force\n\n{table['title']}.\n\n{_table(table['head'], table['body'])}"


def _cell(row: Row) -> str:
    if row.ours is None or row.ratio is None:
        return f"**{_short(row.cell.value)} / -**"
    text = f"{_short(row.cell.value)} / {_short(row.ours)} ({row.ratio:.2f})"
    return text if row.explained else f"**{text}**"


def _readings(reproduction: Reproduction, identification: Mapping[str, Any]) -> str:
    def counts(rows: Sequence[Row]) -> list[str]:
        return [str(count) for count, _ in explained(rows).values()]

    refitted = {(entry["reading"], entry["choice"]): entry for entry in identification["readings_refitted"]}
    body = [["as taken", *counts(reproduction.rows), str(identification["explained"]), f"{identification['cost']:.1f}"]]
    for (name, choice), rows in reproduction.alternatives.items():
        again = refitted[name, choice]
        body.append([f"`{name}`: {choice}", *counts(rows), str(again["explained"]), f"{again['cost']:.1f}"])
    titles = [
        "reading, each alone",
        "Table 2",
        "Table 3",
        "Table 4",
        "Table 5",
        "all, fitted again",
        "cost of that fit",
    ]
    return (
        f"### Readings\n\nNumbers explained, of 8, 8, 8 and 16. {cost_in_words()}\n\n{_table(titles, body)}\n\n"
        f"{search_varies(identification)}"
    )


def _predicted(predicted: Mapping[str, Sequence[Row]]) -> str:
    body = []
    for left_out, rows in predicted.items():
        ratios = {
            device: ", ".join(
                "-" if row.ratio is None else f"{row.ratio:.2f}" for row in rows if row.cell.profile == device
            )
            for device in DEVICES
        }
        body.append([NAMES[left_out], f"{sum(row.explained for row in rows)} of {len(rows)}", *ratios.values()])
    titles = ["left out of the fit", "explained", *(f"ratios, {device}" for device in DEVICES)]
    return (
        "### Cross-check: fit three configurations, predict the fourth\n\nRatios in the order of Tables 2, 3, 4, "
        "5 biceps, 5 triceps. These are single fits, the first seed's, with any spring and without the choice among "
        f"equally good sets.\n\n{_table(titles, body)}"
    )


def _spread(identification: Mapping[str, Any]) -> str:
    body = [
        [
            f"`{entry['name']}`",
            f"{_short(entry['value'])} {entry['unit']}".rstrip(),
            f"{_short(entry['low'])} to {_short(entry['high'])}",
            f"{_short(entry['bounds'][0])} to {_short(entry['bounds'][1])}",
            "yes" if entry["determined"] else "no",
        ]
        for entry in identification["spread"]
    ]
    titles = ["parameter", "value", "as good", "searched", "determined"]
    return f"### What the tables determine\n\n{determined_in_words(identification)}\n\n{_table(titles, body)}"


def _springs(evidence: Evidence) -> str:
    table = springs_table(evidence)
    return f"### Spring laws, all other parameters fitted again\n\n{_table(table['head'], table['body'])}"


def _sensitivity(evidence: Evidence) -> str:
    parts = [f"{table['title']}:\n\n{_table(table['head'], table['body'])}" for table in sensitivity_tables(evidence)]
    return "\n\n".join(["### What other judgement calls are worth", *parts])


def _hypotheses(hypotheses: Sequence[Answer]) -> str:
    truth = {True: "yes", False: "**no**", None: "open"}
    parts = ["### Hypotheses of section 1.2"]
    for answer in hypotheses:
        body = [[f"{item.case}: {item.question}", truth[item.holds], item.words] for item in answer.criteria]
        parts.append(
            f'**{answer.number}. {answer.verdict.capitalize()}.** "{answer.hypothesis}." The paper: {answer.paper}'
        )
        parts.append(_table(["on our devices", "", "numbers"], body))
    return "\n\n".join(parts)


def _claims(claims: Sequence[CheckedClaim]) -> str:
    hold = sum(item.ours.holds is True for item in claims)
    tried = [item for item in claims if item.paper is not None]
    borne_out = [item for item in tried if not item.contradicted]
    return (
        f"### Claims of sections 3 to 5\n\n{hold} of {len(claims)} hold on our devices. The paper's own tables "
        f"contradict {len(tried) - len(borne_out)} of the {len(tried)} that are about them; of the others "
        f"{sum(item.ours.holds is True for item in borne_out)} of {len(borne_out)} hold on ours. "
        "`reproduction.html` and `claims.csv` have them one by one, with numbers."
    )


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.4g}"


def _table(titles: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = [titles, ["---"] * len(titles), *body]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
