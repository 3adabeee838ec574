"""Markdown documents with generated parts: text between two lines, and figures in a folder beside the document."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import read_text
from amulett_gym.storage.writing import check_writable, write_text

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

IMAGES = "images"
"""Folder of a document's figures, beside it."""

Marks = tuple[str, str]
"""The line before a generated part, and the line after it."""


def marks(command: str) -> Marks:
    """Return the lines around what a command generates, such as ``"amulett bench"``."""
    return f"<!-- Written by `{command} --doc`; edit around it. -->", f"<!-- End of what `{command}` wrote. -->"


def image(name: str, caption: str, text: str | None = None) -> str:
    """Return a figure of `IMAGES` and its caption as Markdown; its alternative text is the caption unless given."""
    return f"![{caption if text is None else text}]({IMAGES}/{name}.png)\n\n*{caption}*"


def between_marks(document: str, path: str | Path, first: str, last: str, text: str) -> str:
    """Return a document with `text` between two of its lines, instead of what was there.

    Parameters
    ----------
    document : str
        Its content.
    path : str or Path
        Where it is, for the error message.
    first, last : str
        The lines.
    text : str

    Raises
    ------
    AmulettError
        If the document has not both lines once, in their order.
    """
    begin, end = document.find(first), document.find(last)
    if begin < 0 or end < begin or document.count(first) != 1 or document.count(last) != 1:
        raise AmulettError(f"document '{path}' has to hold the line '{first}' once, and after it '{last}' once")
    return f"{document[:begin]}{first}\n\n{text}\n\n{document[end:]}"


def check_document(path: str | Path, parts: Iterable[Marks], images: bool = False) -> None:
    """Refuse a document that could not be renewed, before any work.

    Parameters
    ----------
    path : str or Path
    parts : iterable of Marks
        Lines around the parts that are to be renewed.
    images : bool
        Whether figures are to be written beside it.

    Raises
    ------
    AmulettError
        If it has not both lines of each part once, in their order, or cannot be read or written.
    """
    _renewed(path, dict.fromkeys(parts, ""))
    if not os.access(path, os.W_OK):
        raise AmulettError(f"cannot write document '{path}': it is read-only")
    check_writable(path)
    folder = Path(path).parent / IMAGES
    if images and folder.exists():
        try:
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise AmulettError(f"cannot write to '{folder}': {error.strerror or error}") from error


def update_document(path: str | Path, texts: Mapping[Marks, str], figures: Mapping[str, Figure] | None = None) -> None:
    """Put texts between the marks of a document instead of what is there, and figures beside it.

    Parts that are not given stay as they are.

    Parameters
    ----------
    path : str or Path
    texts : mapping of Marks to str
    figures : mapping of str to Figure, optional
        By the names that `image` refers to.

    Raises
    ------
    AmulettError
        As `check_document`.
    """
    write_text(path, _renewed(path, texts))
    if figures:
        from amulett_gym.reporting.style import save_figures

        save_figures(figures, Path(path).parent / IMAGES)


def _renewed(path: str | Path, texts: Mapping[Marks, str]) -> str:
    document = read_text(path, "document")
    for (first, last), text in texts.items():
        document = between_marks(document, path, first, last, text)
    return document
