"""Columns of numbers from a CSV file: whatever does not fit is refused by its row."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

from amulett_gym.errors import AmulettError, nearest
from amulett_gym.storage.reading import read_text


def read_columns(
    path: str | Path, what: str, names: Sequence[str], limit: int, optional: Sequence[str] = ()
) -> list[list[float]]:
    """Return columns of a CSV file (comma or semicolon) with a header; other columns may hold anything.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file holds, for the error message.
    names : sequence of str
        Of the columns, in the order wanted.
    limit : int
        Largest size accepted, in bytes.
    optional : sequence of str
        Further columns, returned after the others if they are there.

    Raises
    ------
    AmulettError
        If the file cannot be read, a column is missing or there twice, a row has more or fewer cells than the header,
        or a cell is no finite number. Rows are numbered as a spreadsheet numbers them: the header is row 1.
    """
    text = read_text(path, what, limit)
    lines = csv.reader(io.StringIO(text), delimiter=";" if ";" in text.partition("\n")[0] else ",", strict=True)
    try:
        header = [name.strip() for name in next(lines, [])]
        names = [*names, *(name for name in optional if name in header)]
        for name in names:
            if header.count(name) != 1:
                problem = f"names the column '{name}' {header.count(name)} times" if name in header else ""
                missing = f"has no column '{name}'{nearest(name, header)} (there are: {', '.join(header)[:200]})"
                raise ValueError(f"row 1 {problem or missing}")
        places = [(header.index(name), name) for name in names]
        columns: list[list[float]] = [[] for _ in names]
        for number, cells in enumerate(lines, start=2):
            if not any(cell.strip() for cell in cells):
                continue  # spreadsheets leave empty rows behind
            if len(cells) != len(header):
                raise ValueError(f"row {number} has {len(cells)} cells, the header has {len(header)}")
            for column, (place, name) in zip(columns, places, strict=True):
                column.append(_number(cells[place], name, number))
    except csv.Error as error:
        raise AmulettError(f"{what} '{path}' is not valid CSV: row {lines.line_num}: {error}") from error
    except ValueError as error:
        raise AmulettError(f"{what} '{path}': {error}") from error
    return columns


def _number(cell: str, name: str, row: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"row {row}, column '{name}': {cell[:50]!r} is no finite number")
    return value
