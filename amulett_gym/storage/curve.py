"""A measured force-deflection curve: read from a CSV file once, checked, and kept with the profile by its content."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from pydantic import Field, ValidationError, model_validator

from amulett_gym.errors import AmulettError
from amulett_gym.settings import Group, describe
from amulett_gym.storage.reading import read_text

COLUMNS = ("deflection_m", "force_N", "spring_deflection_m")
MOST_POINTS = 1000
_MOST_BYTES = 1_000_000
_LEAST_RISE = 1e-9  # [m]: far below what can be measured, and far above where slopes overflow


class Curve(Group):
    """A curve from rest on, or joined to it: deflections rise by a nanometre or more, the force never falls."""

    deflection_m: list[float] = Field(min_length=3, max_length=MOST_POINTS, description="of the string, 0 to 10 [m]")
    force_N: list[float] = Field(description="of the string, 0 to 1e6 [N]")
    spring_deflection_m: list[float] | None = Field(
        default=None, description="of the linear spring, 0 to 10 [m]; null: the potentiometer sees the string's"
    )

    @model_validator(mode="after")
    def _check_points(self) -> Curve:
        columns = {name: values for name, values in self if values is not None}
        for name, values in columns.items():
            if len(values) != len(self.deflection_m):
                raise ValueError(f"'{name}' has {len(values)} values, 'deflection_m' has {len(self.deflection_m)}")
            if values[0] < 0.0:
                raise ValueError(f"'{name}' starts at {values[0]}; it has to be >= 0")
            least, most = (0.0, 1e6) if name == "force_N" else (_LEAST_RISE, 10.0)
            for before, value in pairwise(values):
                if value - before < least:
                    raise ValueError(f"'{name}' has to rise from row to row; {value} follows {before}")
            if values[-1] > most:
                raise ValueError(f"'{name}' reaches {values[-1]}; it has to be at most {most:g}")
        if self.force_N[-1] <= 0.0:
            raise ValueError("'force_N' has no force above 0")
        starts = {name: values[0] for name, values in columns.items()}
        if any(starts.values()) and not all(starts.values()):
            raise ValueError(f"it starts at {starts}; all of them have to be 0, or all above")
        return self


def read_curve(path: str | Path) -> Curve:
    """Read a measured curve.

    Parameters
    ----------
    path : str or Path
        CSV file (comma or semicolon) with a header and the columns ``deflection_m``, ``force_N`` and optionally
        ``spring_deflection_m`` (without it the potentiometer is taken to measure the string's deflection itself). A
        curve that starts above zero is joined to the origin. Average repeated and noisy measurements first.

    Raises
    ------
    AmulettError
        If the file is unreadable or empty, a column is missing or there twice, a row has more or fewer cells than the
        header, a cell is no finite number, or `Curve` refuses the values. Rows are numbered as a spreadsheet numbers
        them: the header is row 1.
    """
    what = f"measured spring curve '{path}'"
    text = read_text(path, "measured spring curve", _MOST_BYTES)
    lines = csv.reader(io.StringIO(text), delimiter=";" if ";" in text.partition("\n")[0] else ",", strict=True)
    try:
        header = [name.strip() for name in next(lines, [])]
        _check_header(header)
        rows = list(_rows(lines, header))
        columns = zip(*rows, strict=True) if rows else ([] for _ in header)
        content = {name: list(values) for name, values in zip(header, columns, strict=True) if name in COLUMNS}
        return Curve.model_validate(content)
    except ValidationError as error:
        raise describe(error, Curve, what) from error
    except csv.Error as error:
        raise AmulettError(f"{what} is not valid CSV: row {lines.line_num}: {error}") from error
    except ValueError as error:
        raise AmulettError(f"{what}: {error}") from error


def _check_header(header: list[str]) -> None:
    if not header:
        raise ValueError("it is empty; it needs a header and at least 3 rows")
    missing = [name for name in COLUMNS[:2] if name not in header]
    if missing:
        raise ValueError(f"it has no column {missing}; it has {', '.join(header)[:200]}")
    twice = [name for name in COLUMNS if header.count(name) > 1]
    if twice:
        raise ValueError(f"row 1 names the column '{twice[0]}' {header.count(twice[0])} times")


def _rows(lines: Iterator[list[str]], header: list[str]) -> Iterator[list[float]]:
    """Yield the rows as numbers; a cell of a column that is not read may hold anything, and is 0."""
    for number, cells in enumerate(lines, start=2):
        if not any(cell.strip() for cell in cells):
            continue  # spreadsheets leave empty rows behind
        if len(cells) != len(header):
            raise ValueError(f"row {number} has {len(cells)} cells, the header has {len(header)}")
        named = zip(header, cells, strict=True)
        yield [_number(cell, name, number) if name in COLUMNS else 0.0 for name, cell in named]


def _number(cell: str, name: str, row: int) -> float:
    try:
        value = float(cell)
        if not math.isfinite(value):
            raise ValueError("it is not finite")
    except ValueError as error:
        raise ValueError(f"row {row}, column '{name}': {cell[:50]!r} is no finite number") from error
    return value
