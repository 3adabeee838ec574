"""Columns of numbers from the text that loggers and spreadsheets write; an error names its row and column.

Read are columns apart by comma, semicolon or tab, with decimal points or decimal commas, below a header. The header may
follow other lines, may be commented out, and may be followed by a row of units. What is done is noted, not guessed: the
header is the first row with all the columns wanted, and each number has to be one in the same notation as all others.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, nearest, shorten
from amulett_gym.storage.reading import read_bytes
from amulett_gym.storage.units import check_unit, is_unit, plain_unit, split_unit

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ","}
DECIMALS = {"point": ".", "comma": ","}
_MOST_ROWS_BEFORE = 100
"""Rows in which the header is searched."""

_LONGEST_HEADER = 20_000
"""Characters of the longest row that may be a header."""

_NUMBER = re.compile(r"[-+]?(?:[0-9]+([.,]?)[0-9]*|([.,])[0-9]+)(?:[eE][-+]?[0-9]+)?")
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
_COMMENTS = ("#", "%", "//")


class Wanted(NamedTuple):
    """A column that is wanted.

    Attributes
    ----------
    name : str
        Its key in the result, and without its unit its name in the header, unless `header` is given.
    quantity : str, optional
        One of `units.UNITS`; the column then needs a unit. None: the header is exactly `name`, without a unit.
    required : bool
        Whether a table without it is refused.
    may_miss : bool
        Whether cells may be empty, or say that there is no value; they are then NaN.
    header : str or int, optional
        The header as in the file, or the column's number, from 1.
    unit : str, optional
        Replaces the file's unit.
    """

    name: str
    quantity: str | None = None
    required: bool = True
    may_miss: bool = False
    header: str | int | None = None
    unit: str | None = None


class Form(NamedTuple):
    """What is known about a file: names of `SEPARATORS` and `DECIMALS` (None: found), and whether it has a header."""

    separator: str | None = None
    decimal: str | None = None
    header: bool = True


class Found(NamedTuple):
    """Where a column was found: its place, its header as in the file, and its unit ("" if it has no quantity)."""

    place: int
    header: str
    unit: str


@dataclass(frozen=True)
class Table:
    """Columns of numbers as written in a file.

    Attributes
    ----------
    columns : mapping of str to ndarray, shape (rows,)
        In the units of `found`.
    found : mapping of str to Found
    rows : ndarray of int, shape (rows,)
        Their numbers in the file, from 1.
    notes : list of str
        How the file is written, and which rows and cells were left out.
    others : list of str
        Headers of the columns that were not wanted.
    """

    columns: Mapping[str, NDArray[np.float64]]
    found: Mapping[str, Found]
    rows: NDArray[np.int64]
    notes: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def parse_columns(
    text: str, what: str, names: Sequence[str], optional: Sequence[str] = ()
) -> tuple[list[list[float]], list[int]]:
    """Return columns with exactly these headers, and their rows' numbers.

    Parameters
    ----------
    text : str
    what : str
        What the text is, for the error message.
    names : sequence of str
        Of the columns, in the order wanted.
    optional : sequence of str
        Further columns, returned after the others if they exist.

    Raises
    ------
    AmulettError
        As of `parse_table`.
    """
    wanted = [*map(Wanted, names), *(Wanted(name, required=False) for name in optional)]
    table = parse_table(text, what, wanted)
    return [table.columns[each.name].tolist() for each in wanted if each.name in table.columns], table.rows.tolist()


def read_table_text(path: str | Path, what: str, limit: int) -> tuple[str, list[str]]:
    """Return the text of a file with line ends normalised, and a note if it is not UTF-8.

    A byte order mark is left out. Text with that of UTF-16 is read as such; text that is not UTF-8, as Windows-1252.

    Raises
    ------
    AmulettError
        If the file cannot be read, has more than `limit` bytes, or is no text.
    """
    content, notes = read_bytes(path, what, limit), []
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            text, notes = content.decode("utf-16"), ["encoding: UTF-16"]
        else:
            text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        try:
            text, notes = content.decode("cp1252"), ["encoding: Windows-1252, since it is no UTF-8"]
        except UnicodeDecodeError:
            raise AmulettError(f"{what} '{path}' is not UTF-8 text, and no text in Windows-1252") from error
    return text.replace("\r\n", "\n").replace("\r", "\n"), notes


def parse_table(text: str, what: str, wanted: Sequence[Wanted], form: Form = Form()) -> Table:  # noqa: B008
    """Return the columns that are wanted of a table in a text with normalised line ends.

    Other columns may hold anything. Rows are numbered as a spreadsheet numbers them, from 1. Empty rows are left out.

    Raises
    ------
    AmulettError
        If a column is missing or there twice, has no unit or another one than its quantity's, a row has more or fewer
        cells than the header, or a cell is no finite number, or one in another notation.
    """
    lines = text.removesuffix("\n").split("\n")
    try:
        head = _find_head(lines, wanted, form)
        records = csv.reader(_with_ends(lines, head.end), delimiter=head.separator, strict=True)
        cells = _Cells(head, wanted, form)
        for number, record in enumerate(records, start=head.end + 1):
            cells.add(number, record)
    except csv.Error as error:
        raise AmulettError(f"{what} is not valid CSV: row {head.end + records.line_num}: {error}") from error
    except ValueError as error:
        raise AmulettError(f"{what}: {error}") from error
    columns = {name: np.array(values) for name, values in cells.values.items()}
    return Table(
        columns,
        head.found,
        np.array(cells.rows, dtype=np.int64),
        head.notes(lines) + cells.notes(),
        others(head.headers, head.found),
    )


def others(headers: Sequence[str], found: Mapping[str, Found]) -> list[str]:
    """Return the headers of the columns that were not found, those without a header left out."""
    taken = {each.place for each in found.values()}
    return [header.strip() for k, header in enumerate(headers) if k not in taken and header.strip()]


def find_columns(
    headers: Sequence[str], wanted: Sequence[Wanted], where: str, units: Sequence[str] = ()
) -> dict[str, Found]:
    """Return where the columns that are wanted are, by their names, without optional ones that are missing.

    Parameters
    ----------
    headers : sequence of str
    wanted : sequence of Wanted
    where : str
        Begins an error message, e.g. ``"row 1"``.
    units : sequence of str
        A row of units, or empty.

    Raises
    ------
    AmulettError
        If a column is missing or there twice, or it has no unit or a wrong one.
    """
    found: dict[str, Found] = {}
    for each in wanted:
        places = _places(headers, each)
        if not places and not each.required and each.header is None:
            continue
        name = each.name if each.header is None else each.header
        if not places:
            if isinstance(name, int):
                raise AmulettError(f"{where} has no column {name}; it has {len(headers)} columns")
            there = _printable(shorten(", ".join(header.strip() for header in headers), 200))
            raise AmulettError(f"{where} has no column '{name}'{nearest(name, _bare(headers))} (there are: {there})")
        if len(places) > 1:
            same = ", ".join(repr(header) for header in dict.fromkeys(headers[place].strip() for place in places))
            which = f"names the column '{name}' {len(places)} times"
            raise AmulettError(f"{where} {which}" + (f": {same}" if "," in same else ""))
        header, unit = headers[places[0]].strip(), ""
        if each.quantity is not None:
            below = units[places[0]] if places[0] < len(units) else ""
            unit = plain_unit(each.unit or split_unit(header)[1] or below.strip().strip("[]()"))
            if not unit:
                raise AmulettError(
                    f"{where}: the column '{header}' has no unit; write it behind the name, as in "
                    f"'{split_unit(name)[0] if isinstance(name, str) else each.name} [...]', or name it in a mapping"
                )
            check_unit(unit, each.quantity, f"{where}: the column '{header}'")
        found[each.name] = Found(places[0], header, unit)
    return found


@dataclass(frozen=True)
class _Head:
    """The part of a file before the numbers: where it ends, what it says, and its notes."""

    row: int
    end: int
    headers: list[str]
    units: list[str]
    separator: str
    found: dict[str, Found]

    def notes(self, lines: Sequence[str]) -> list[str]:
        """Return what was taken for what."""
        name = next(name for name, mark in SEPARATORS.items() if mark == self.separator)
        notes = [f"separator: {name}"] if len(self.headers) > 1 else []
        if before := [number for number in range(1, self.row) if lines[number - 1].strip()]:
            notes.append(f"left out: {_rows(before)} before the header")
        if self.row and lines[self.row - 1].lstrip().startswith(_COMMENTS):
            notes.append(f"header: the comment in row {self.row}")
        elif self.row > 1:
            notes.append(f"header: row {self.row}")
        return notes + ([f"units: row {self.end}"] if self.units else [])


def _find_head(lines: Sequence[str], wanted: Sequence[Wanted], form: Form) -> _Head:
    """Return the header; ValueError describes the row that comes closest to one."""
    if not any(line.strip() for line in lines):
        raise ValueError("it is empty")
    separators = [SEPARATORS[form.separator]] if form.separator else list(SEPARATORS.values())
    if not form.header:
        return _without_header(lines, wanted, separators)
    required = [each for each in wanted if each.required]
    closest, most = (1, list[str]()), (-1, 0)
    for k, line in enumerate(lines[:_MOST_ROWS_BEFORE]):
        if not line.strip() or len(line) > _LONGEST_HEADER:
            continue
        for separator in separators:
            headers = _split(_uncommented(line), separator)
            count = sum(bool(_places(headers, each)) for each in required)
            if count == len(required):
                end, units = _units_below(lines, k + 1, separator, len(headers))
                return _Head(
                    k + 1, end, headers, units, separator, find_columns(headers, wanted, f"row {k + 1}", units)
                )
            if (count, len(headers)) > most and (count or most < (0, 2)):
                closest, most = (k + 1, headers), (count, len(headers))
    row, headers = closest
    find_columns(headers, required, f"row {row}")
    raise ValueError("it has no header")  # not reached: a required column is missing in every row


def _without_header(lines: Sequence[str], wanted: Sequence[Wanted], separators: Sequence[str]) -> _Head:
    """Return the head of a file that begins with numbers; its columns are known by their numbers."""
    row = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith(_COMMENTS)), 0)
    widths = {separator: len(_split(lines[row], separator)) for separator in separators}
    separator = max(separators, key=lambda mark: (mark != ",", widths[mark]) if widths[mark] > 1 else (False, 0))
    headers = [f"column {k}" for k in range(1, widths[separator] + 1)]
    return _Head(0, row, headers, [], separator, find_columns(headers, wanted, f"row {row + 1}"))


def _units_below(lines: Sequence[str], end: int, separator: str, width: int) -> tuple[int, list[str]]:
    """Return the number of rows up to a row of units and its cells, if the first row from `end` on is one."""
    row = next((k for k in range(end, len(lines)) if lines[k].strip()), None)
    if row is None:
        return end, []
    cells = [cell.strip() for cell in _split(_uncommented(lines[row]), separator)]
    numbers = any(_NUMBER.fullmatch(cell) for cell in cells if cell != "1")
    if len(cells) == width and any(map(is_unit, cells)) and not numbers:
        return row + 1, cells
    return end, []


class _Cells:
    """Collects the numbers of the columns found, row by row."""

    def __init__(self, head: _Head, wanted: Sequence[Wanted], form: Form) -> None:
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
            if cells[0].lstrip().startswith(_COMMENTS):
                self._comments.append(number)
                return
            if len(cells) != self._width + 1 or cells[-1].strip():
                raise ValueError(f"row {number} has {len(cells)} cells, the header has {self._width}")
            self._longer += 1
        elif not cells[0].strip() and not any(cell.strip() for cell in cells):
            return
        elif cells[0].lstrip().startswith(_COMMENTS):
            self._comments.append(number)
            return
        self.rows.append(number)
        for place, header, may_miss, column in self._columns:
            column.append(self._number(cells[place].strip(), number, header, may_miss))

    def _number(self, cell: str, row: int, header: str, may_miss: bool) -> float:
        match = _NUMBER.fullmatch(cell)
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
            notes.append(f"left out: {_rows(self._comments)}, comments")
        if self._longer:
            notes.append(f"an empty cell behind the last column in {_count(self._longer, 'row')}")
        for header, rows in self._missing.items():
            notes.append(f"no value in column '{header}': {_rows(rows)}")
        return notes


def _places(headers: Sequence[str], wanted: Wanted) -> list[int]:
    """Return the places of the headers that are the wanted column's."""
    if isinstance(wanted.header, int):
        return [wanted.header - 1] if 1 <= wanted.header <= len(headers) else []
    name = (wanted.header or wanted.name).strip()
    exact = [k for k, header in enumerate(headers) if header.strip() == name]
    if wanted.quantity is None or (exact and wanted.header is not None):
        return exact
    name, _ = split_unit(name)
    return [k for k, header in enumerate(headers) if split_unit(header)[0] == name]


def _printable(text: str) -> str:
    """Return text with escapes for the characters that a terminal would obey or not show."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


def _bare(headers: Sequence[str]) -> list[str]:
    return [header.strip() for header in headers]


def _split(line: str, separator: str) -> list[str]:
    """Return the cells of one line; the whole line if it is no valid CSV."""
    try:
        return next(csv.reader([line], delimiter=separator, strict=True), [])
    except csv.Error:
        return [line]


def _uncommented(line: str) -> str:
    line = line.lstrip(" ")
    return line.lstrip("#%/ ") if line.startswith(_COMMENTS) else line


def _with_ends(lines: Sequence[str], first: int) -> Iterator[str]:
    """Yield the lines from `first` on with their ends: a quoted cell may hold some."""
    return (lines[k] + "\n" for k in range(first, len(lines)))


def _rows(numbers: Sequence[int]) -> str:
    """Return rows in words: ``row 3``, ``rows 3 and 5``, or ``12 rows, the first is 3``."""
    if len(numbers) == 1:
        return f"row {numbers[0]}"
    if len(numbers) == 2:
        return f"rows {numbers[0]} and {numbers[1]}"
    return f"{len(numbers)} rows, the first is {numbers[0]}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
