"""The generated part of ``docs/benchmark.md``, or of ``docs/full-control.md``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.reporting.document import image, marks, update_document
from amulett_gym.reporting.words import pretty
from amulett_gym.studies.benchmark.claims import Claim
from amulett_gym.studies.benchmark.page import CAPTIONS, not_met, said, verdict
from amulett_gym.studies.benchmark.results import Content
from amulett_gym.studies.benchmark.tables import tables

if TYPE_CHECKING:
    from pathlib import Path

    from amulett_gym.reporting.style import Figure

MARKS = marks("amulett benchmark")

SHOWN = ("score", "pareto", "law", "law_by_velocity", "learning", "families")
"""Figures of the document."""

SHOWN_OF_LOOPS = ("pareto", "families", "constants", "responses", "law", "learning")
"""Figures of the document on the track *full control*."""


def write_document(found: Content, claims: Sequence[Claim], figures: Mapping[str, Figure], path: str | Path) -> None:
    """Renew the generated part of a document, and its figures in the folder ``images`` next to it.

    Raises
    ------
    AmulettError
        As `reporting.document.check_document`.
    """
    full = found["track"] == FULL_CONTROL
    shown = [name for name in (SHOWN_OF_LOOPS if full else SHOWN) if name in figures]
    title = "full_control" if full else "benchmark"
    parts = [
        "" if found["command"] is None else f"`{found['command']}` on {found['machine']}",
        pretty(f"**{verdict(found, claims)}**"),
        pretty("\n".join(f"- {line}" for line in (*said(found), *not_met(claims)))),
        *(pretty(table.markdown()) for table in tables(found, claims).values()),
        *(image(f"{title}_{name}", CAPTIONS[name]) for name in shown),
    ]
    files = {f"{title}_{name}": figures[name] for name in shown}
    update_document(path, {MARKS: "\n\n".join(filter(None, parts))}, files)
