"""Markdown documents with generated parts, each between two lines."""

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
"""Folder of a document's figures, next to the document."""

Marks = tuple[str, str]
"""The line before a generated part, and the line after it."""


def marks(command: str) -> Marks:
    """Return the lines around the part that a command such as ``"amulett bench"`` generates."""
    return f"<!-- Written by `{command} --doc`; edit around it. -->", f"<!-- End of what `{command}` wrote. -->"


def image(name: str, caption: str, text: str | None = None) -> str:
    """Return a figure of `IMAGES` with its caption as Markdown; `text` is its alternative text if not the caption."""
    return f"![{caption if text is None else text}]({IMAGES}/{name}.png)\n\n*{caption}*"


def check_document(path: str | Path, parts: Iterable[Marks], images: bool = False) -> None:
    """Refuse a document in which the parts between these marks (and its images) could not be updated.

    Raises
    ------
    AmulettError
        If it does not have both lines of each part once, in their order, or cannot be read or written.
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
    """Replace the parts of a document between these marks, and figures by the names that `image` refers to.

    Other parts stay as they are. Errors are those of `check_document`.
    """
    write_text(path, _renewed(path, texts))
    if figures:
        from amulett_gym.reporting.style import save_figures

        save_figures(figures, Path(path).parent / IMAGES, "png")


def _renewed(path: str | Path, texts: Mapping[Marks, str]) -> str:
    document = read_text(path, "document")
    for (first, last), text in texts.items():
        begin, end = document.find(first), document.find(last)
        if begin < 0 or end < begin or document.count(first) != 1 or document.count(last) != 1:
            raise AmulettError(f"document '{path}' has to hold the line '{first}' once, and after it '{last}' once")
        document = f"{document[:begin]}{first}\n\n{text}\n\n{document[end:]}"
    return document
