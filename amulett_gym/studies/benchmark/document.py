"""The generated part of ``docs/benchmark.md``: numbers and figures come from the command, the judgement from us."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.evaluation.comparison import pretty
from amulett_gym.reporting.document import between_marks
from amulett_gym.storage.reading import read_text
from amulett_gym.storage.writing import check_writable, write_text
from amulett_gym.studies.benchmark.claims import Claim
from amulett_gym.studies.benchmark.page import CAPTIONS, verdict
from amulett_gym.studies.benchmark.results import Content
from amulett_gym.studies.benchmark.tables import tables

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

BEGIN = "<!-- Written by `amulett benchmark --doc`; edit around it. -->"
END = "<!-- End of what `amulett benchmark` wrote. -->"

IMAGES = "images"
"""Folder of a document's figures, beside it."""

SHOWN = ("score", "pareto", "law", "law_by_velocity", "learning", "families")


def check_document(path: str | Path) -> None:
    """Refuse a document that could not be renewed, before any work.

    Raises
    ------
    AmulettError
        If it has not both marks once, in their order, or cannot be read or written.
    """
    between_marks(read_text(path, "document"), path, BEGIN, END, "")
    check_writable(path)


def block(found: Content, claims: Sequence[Claim], figures: Mapping[str, str]) -> str:
    """Return the generated part as Markdown.

    Parameters
    ----------
    found : dict
    claims : sequence of Claim
    figures : mapping of str to str
        File of each figure, relative to the document.
    """
    parts = [
        "" if found["command"] is None else f"`{found['command']}` on {found['machine']}",
        pretty(f"**{verdict(found, claims)}**"),
        *(pretty(table.markdown()) for table in tables(found, claims).values()),
    ]
    parts += [f"![{CAPTIONS[name]}]({file})\n\n*{CAPTIONS[name]}*" for name, file in figures.items()]
    return "\n\n".join(part for part in parts if part)


def write_document(found: Content, claims: Sequence[Claim], figures: Mapping[str, Figure], path: str | Path) -> None:
    """Renew the generated part of a document, and its figures in ``images/`` beside it.

    Raises
    ------
    AmulettError
        As `check_document`.
    """
    from amulett_gym.reporting.style import save_figure

    path = Path(path)
    document = read_text(path, "document")
    files = {name: f"{IMAGES}/benchmark_{name}.png" for name in SHOWN if name in figures}
    renewed = between_marks(document, path, BEGIN, END, block(found, claims, files))
    for name, file in files.items():
        save_figure(figures[name], path.parent / file)
    write_text(path, renewed)
