"""The header of a table: which row it is, which columns are wanted, where they are, and their units."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from amulett_gym.errors import AmulettError, nearest, shorten
from amulett_gym.storage.units import check_unit, is_unit, plain_unit, split_unit

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ","}

DECIMALS = {"point": ".", "comma": ","}

_MOST_ROWS_BEFORE = 100
"""Rows in which the header is searched."""

_LONGEST_HEADER = 20_000
"""Characters of the longest row that may be a header."""

NUMBER = re.compile(r"[-+]?(?:[0-9]+([.,]?)[0-9]*|([.,])[0-9]+)(?:[eE][-+]?[0-9]+)?")

COMMENTS = ("#", "%", "//")


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


def others(headers: Sequence[str], found: Mapping[str, Found]) -> list[str]:
    """Return the headers of the columns that were not found, those without a header left out."""
    taken = {each.place for each in found.values()}
    return [header for k, header in enumerate(_bare(headers)) if k not in taken and header]


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
            there = shorten(", ".join(_bare(headers)), 200)
            raise AmulettError(f"{where} has no column '{name}'{nearest(name, _bare(headers))} (there are: {there})")
        if len(places) > 1:
            same = ", ".join(repr(header) for header in dict.fromkeys(headers[place].strip() for place in places))
            which = f"names the column '{name}' {len(places)} times"
            raise AmulettError(f"{where} {which}" + (f": {same}" if "," in same else ""))
        header, unit = _printable(headers[places[0]].strip()), ""
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
class Head:
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
            notes.append(f"left out: {rows_in_words(before)} before the header")
        if self.row and lines[self.row - 1].lstrip().startswith(COMMENTS):
            notes.append(f"header: the comment in row {self.row}")
        elif self.row > 1:
            notes.append(f"header: row {self.row}")
        return notes + ([f"units: row {self.end}"] if self.units else [])


def find_head(lines: Sequence[str], wanted: Sequence[Wanted], form: Form) -> Head:
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
            headers = split_line(_uncommented(line), separator)
            count = sum(bool(_places(headers, each)) for each in required)
            if count == len(required):
                end, units = _units_below(lines, k + 1, separator, len(headers))
                return Head(k + 1, end, headers, units, separator, find_columns(headers, wanted, f"row {k + 1}", units))
            if (count, len(headers)) > most and (count or most < (0, 2)):
                closest, most = (k + 1, headers), (count, len(headers))
    row, headers = closest
    find_columns(headers, required, f"row {row}")
    raise ValueError("it has no header")  # not reached: a required column is missing in every row


def _without_header(lines: Sequence[str], wanted: Sequence[Wanted], separators: Sequence[str]) -> Head:
    """Return the head of a file that begins with numbers; its columns are known by their numbers."""
    row = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith(COMMENTS)), 0)
    widths = {separator: len(split_line(lines[row], separator)) for separator in separators}
    separator = max(separators, key=lambda mark: (mark != ",", widths[mark]) if widths[mark] > 1 else (False, 0))
    headers = [f"column {k}" for k in range(1, widths[separator] + 1)]
    return Head(0, row, headers, [], separator, find_columns(headers, wanted, f"row {row + 1}"))


def _units_below(lines: Sequence[str], end: int, separator: str, width: int) -> tuple[int, list[str]]:
    """Return the number of rows up to a row of units and its cells, if the first row from `end` on is one."""
    row = next((k for k in range(end, len(lines)) if lines[k].strip()), None)
    if row is None:
        return end, []
    cells = [cell.strip() for cell in split_line(_uncommented(lines[row]), separator)]
    numbers = any(NUMBER.fullmatch(cell) for cell in cells if cell != "1")
    if len(cells) == width and any(map(is_unit, cells)) and not numbers:
        return row + 1, cells
    return end, []


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
    """Return headers as they are shown."""
    return [_printable(header.strip()) for header in headers]


def split_line(line: str, separator: str) -> list[str]:
    """Return the cells of one line; the whole line if it is no valid CSV."""
    try:
        return next(csv.reader([line], delimiter=separator, strict=True), [])
    except csv.Error:
        return [line]


def _uncommented(line: str) -> str:
    line = line.lstrip(" ")
    return line.lstrip("#%/ ") if line.startswith(COMMENTS) else line


def rows_in_words(numbers: Sequence[int]) -> str:
    """Return rows in words: ``row 3``, ``rows 3 and 5``, or ``12 rows, the first is 3``."""
    if len(numbers) == 1:
        return f"row {numbers[0]}"
    if len(numbers) == 2:
        return f"rows {numbers[0]} and {numbers[1]}"
    return f"{len(numbers)} rows, the first is {numbers[0]}"
