"""Documents with generated parts: text between two marks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    pass


def between_marks(document: str, path: str | Path, first: str, last: str, text: str) -> str:
    """Return a document with `text` between two of its lines, in the place of what was there.

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
