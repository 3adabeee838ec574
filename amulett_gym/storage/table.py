"""Columns of numbers from the text that loggers and spreadsheets write; an error names its row and column.

Read are columns apart by comma, semicolon or tab, with decimal points or decimal commas, below a header. The header may
follow other lines, may be commented out, and may be followed by a row of units. What is done is noted, not guessed: the
header is the first row with all the columns wanted, and each number has to be one in the same notation as all others.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.storage.cells import Cells
from amulett_gym.storage.header import Form, Found, Wanted, find_head, others
from amulett_gym.storage.reading import read_bytes


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
        head = find_head(lines, wanted, form)
        records = csv.reader(_with_ends(lines, head.end), delimiter=head.separator, strict=True)
        cells = Cells(head, wanted, form)
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


def _with_ends(lines: Sequence[str], first: int) -> Iterator[str]:
    """Yield the lines from `first` on with their ends: a quoted cell may hold some."""
    return (lines[k] + "\n" for k in range(first, len(lines)))
