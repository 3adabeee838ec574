"""How a command writes its figures: the kind of file, and the width in print."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

KINDS = ("png", "svg", "pdf")
"""Kinds of files of figures."""

COLUMN_WIDTHS = {1: 3.5, 2: 7.16}
"""Width of a figure over so many columns of a printed page [in], as in IEEE's journals."""


@dataclass(frozen=True)
class FigureFiles:
    """How figures are written.

    Attributes
    ----------
    kind : str, optional
        One of `KINDS`. None: PNG, and no file of figures that a page contains anyway.
    columns : int, optional
        Columns of a printed page that a figure is as wide as. None: as wide as on a screen.
    """

    kind: str | None = None
    columns: int | None = None

    @property
    def width(self) -> float | None:
        """Width in print [in]; None: as on a screen."""
        return None if self.columns is None else COLUMN_WIDTHS[self.columns]


_ON_SCREEN = FigureFiles()
_chosen: ContextVar[FigureFiles] = ContextVar("figure files")


def figure_files() -> FigureFiles:
    """Return how figures are written at present."""
    return _chosen.get(_ON_SCREEN)


@contextmanager
def figures_as(kind: str | None = None, columns: int | None = None) -> Iterator[None]:
    """Draw and write all figures so during the block; parameters as of `FigureFiles`."""
    token = _chosen.set(FigureFiles(kind, columns))
    try:
        yield
    finally:
        _chosen.reset(token)
