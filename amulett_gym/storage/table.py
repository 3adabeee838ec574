"""Columns of numbers from CSV; an error names its row."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from amulett_gym.errors import AmulettError, nearest


def parse_columns(
    text: str, what: str, names: Sequence[str], optional: Sequence[str] = ()
) -> tuple[list[list[float]], list[int]]:
    """Return columns of CSV text (comma or semicolon) with a header, and their rows' numbers.

    Other columns may hold anything. Rows are numbered as a spreadsheet numbers them: the header is row 1.

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
        If a column is missing or there twice, a row has more or fewer cells than the header, or a cell is no finite
        number.
    """
    lines = csv.reader(io.StringIO(text), delimiter=";" if ";" in text.partition("\n")[0] else ",", strict=True)
    try:
        header = [name.strip() for name in next(lines, [])]
        names = [*names, *(name for name in optional if name in header)]
        for name in names:
            if header.count(name) != 1:
                problem = f"names the column '{name}' {header.count(name)} times" if name in header else ""
                missing = f"has no column '{name}'{nearest(name, header)} (there are: {', '.join(header)[:200]})"
                raise ValueError(f"row 1 {problem or missing}")
        columns: list[list[float]] = [[] for _ in names]
        rows: list[int] = []
        for number, cells in enumerate(lines, start=2):
            if not any(cell.strip() for cell in cells):
                continue  # spreadsheets leave empty rows behind
            if len(cells) != len(header):
                raise ValueError(f"row {number} has {len(cells)} cells, the header has {len(header)}")
            rows.append(number)
            for name, column in zip(names, columns, strict=True):
                column.append(_number(cells[header.index(name)], name, number))
    except csv.Error as error:
        raise AmulettError(f"{what} is not valid CSV: row {lines.line_num}: {error}") from error
    except ValueError as error:
        raise AmulettError(f"{what}: {error}") from error
    return columns, rows


def _number(cell: str, name: str, row: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"row {row}, column '{name}': {cell[:50]!r} is no finite number")
    return value
