"""The numbers of a table's columns, each in the same notation as all others."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence

from amulett_gym.errors import shorten
from amulett_gym.storage.header import COMMENTS, DECIMALS, NUMBER, Form, Head, Wanted, rows_in_words

_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--"}


class Cells:
    """Collects the numbers of the columns found, row by row."""

    def __init__(self, head: Head, wanted: Sequence[Wanted], form: Form) -> None:
        may_miss = {each.name: each.may_miss for each in wanted}
        self._width = len(head.headers)
        self.values = {name: array("d") for name in head.found}
        self._columns = [
            (found.place, found.header, may_miss[name], self.values[name]) for name, found in head.found.items()
        ]
        self.rows = array("q")
        self._last = head.end
        self._decimal = DECIMALS.get(form.decimal or "")
        self._marks: dict[str, str] = {}  # decimal mark -> where it was first
        self._missing: dict[str, list[int]] = {}
        self._comments: list[int] = []
        self._longer = 0

    def add(self, number: int, cells: list[str]) -> None:
        """Add a row; ValueError names the row, and the column if a cell is wrong."""
        if len(cells) != self._width:
            if not any(cell.strip() for cell in cells):
                return  # spreadsheets leave empty rows behind
            if cells[0].lstrip().startswith(COMMENTS):
                self._comments.append(number)
                return
            if len(cells) != self._width + 1 or cells[-1].strip():
                raise ValueError(f"row {number} has {len(cells)} cells, the header has {self._width}")
            self._longer += 1
        elif not cells[0].strip() and not any(cell.strip() for cell in cells):
            return
        elif cells[0].lstrip().startswith(COMMENTS):
            self._comments.append(number)
            return
        self.rows.append(number)
        for place, header, may_miss, column in self._columns:
            column.append(self._number(cells[place].strip(), number, header, may_miss))

    def _number(self, cell: str, row: int, header: str, may_miss: bool) -> float:
        match = NUMBER.fullmatch(cell)
        if match is None:
            if may_miss and cell.lower() in _MISSING:
                self._missing.setdefault(header, []).append(row)
                return math.nan
            raise ValueError(f"row {row}, column '{header}': {shorten(cell, 50)!r} is no finite number")
        if mark := match[1] or match[2]:
            if mark not in self._marks:
                self._first(mark, cell, row, header)
            if mark == ",":
                cell = cell.replace(",", ".")
        value = float(cell)
        if not math.isfinite(value):
            raise ValueError(f"row {row}, column '{header}': {shorten(cell, 50)!r} is no finite number")
        return value

    def _first(self, mark: str, cell: str, row: int, header: str) -> None:
        """Note where a decimal mark is for the first time; refuse a second kind of marks."""
        name, here = "decimal comma" if mark == "," else "decimal point", f"row {row}, column '{header}'"
        if self._decimal is not None and mark != self._decimal:
            raise ValueError(
                f"{here}: {cell[:50]!r} has a {name}; the mapping says decimal: {'comma' if mark == '.' else 'point'}"
            )
        for other in self._marks.values():
            raise ValueError(
                f"{here}: {cell[:50]!r} has a {name}, but {other} has the other mark; thousands are not to be separated"
            )
        self._marks[mark] = here

    def notes(self) -> list[str]:
        """Return what was noticed."""
        notes = [f"decimal comma: first in {place}" for mark, place in self._marks.items() if mark == ","]
        if self._comments:
            notes.append(f"left out: {rows_in_words(self._comments)}, comments")
        if self._longer:
            notes.append(f"an empty cell behind the last column in {_count(self._longer, 'row')}")
        for header, rows in self._missing.items():
            notes.append(f"no value in column '{header}': {rows_in_words(rows)}")
        return notes


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
