"""Reading of logs: CSV as loggers write it, and ``.npz``."""

from __future__ import annotations

from collections.abc import Mapping as MappingType
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, nearest, shorten
from amulett_gym.logs.check import conspicuous, one_per_stamp
from amulett_gym.logs.log import COLUMNS, REQUIRED, Log
from amulett_gym.logs.mapping import Mapping, load_mapping
from amulett_gym.settings import find_config
from amulett_gym.storage.header import Found, find_columns, others
from amulett_gym.storage.reading import read_arrays
from amulett_gym.storage.table import Table, parse_table, read_table_text
from amulett_gym.storage.units import split_unit, to_si

MOST_BYTES = 400_000_000
"""Size of the largest file accepted; an hour at 400 rows per second and ten columns has about 150 MB."""


_MOST_NAMED = 20
"""Most columns named that are not read."""


def read_log(path: str | Path, mapping: str | Path | MappingType[str, Any] | Mapping | None = None) -> Log:
    """Read a log.

    Parameters
    ----------
    path : str or Path
        A CSV file (comma, semicolon or tab; decimal point or comma), or an ``.npz`` file of arrays, also a packaged
        one (``configs/logs/steps.csv``). The header, or the name of an array, has a column's name and unit, such as
        ``angle [deg]`` or ``angle_deg`` (see `COLUMNS`).
    mapping : str, Path, mapping or Mapping, optional
        Names, units, signs and offsets of a log that is written differently (see `mapping.Mapping`).

    Raises
    ------
    AmulettError
        If the file cannot be read, a required column is missing or there twice, a unit is missing or wrong, a row has
        another length than the header, a cell is no number, or the time falls. It names row and column.
    """
    mapping, what, file = load_mapping(mapping), f"log '{path}'", find_config(path, "log", kinds=("csv", "npz"))
    if file.suffix.lower() == ".npz":
        table = _read_arrays(file, mapping)
    else:
        text, notes = read_table_text(file, "log", MOST_BYTES)
        table = parse_table(text, what, mapping.wanted(), mapping.form())
        table.notes[:0] = notes
    try:
        columns, notes = _meaning(table, mapping)
        if not len(table.rows):
            raise AmulettError("it has no rows of numbers")
        columns, rows, stamps = one_per_stamp(
            columns, table.rows, table.found["time"].header, mapping.file.repeated_stamps
        )
    except AmulettError as error:
        raise AmulettError(f"{what}: {error}") from error
    notes = [*_left_out(table, mapping), *notes]
    return Log(columns, str(path), (*table.notes, *notes, *stamps, *conspicuous(columns, rows)))


def _meaning(table: Table, mapping: Mapping) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Return the columns in SI units, in the order of `COLUMNS`, and what each was taken from."""
    columns, notes = {}, []
    for name, kind in COLUMNS.items():
        if name not in table.found:
            continue
        found, how = table.found[name], mapping.of(name)
        written = table.columns[name]
        if np.isnan(written).all() and written.size:
            problem = f"column '{found.header}' has no value in any row"
            if name in REQUIRED:
                raise AmulettError(problem)
            notes.append(f"left out: {problem}")
            continue
        columns[name] = to_si(how.sign * how.scale * (written - how.offset), kind.quantity, found.unit)
        changes = [f"minus {how.offset:.10g}"] * (how.offset != 0.0) + [f"times {how.scale:.10g}"] * (how.scale != 1.0)
        changes += ["sign changed"] * (how.sign < 0)
        notes.append(f"{name}: column '{found.header}' in {found.unit}" + "".join(f", {change}" for change in changes))
    return columns, notes


def _left_out(table: Table, mapping: Mapping) -> list[str]:
    """Return notes on columns that are not read, with the name that one may have been meant to have."""
    if not mapping.file.header:
        return []
    free = [name for name in COLUMNS if name not in table.found]
    notes = [f"left out: the column '{shorten(name)}'{nearest(split_unit(name)[0], free)}" for name in table.others]
    return [
        *notes[:_MOST_NAMED],
        *([f"left out: {len(notes) - _MOST_NAMED} more columns"] if notes[_MOST_NAMED:] else []),
    ]


def _read_arrays(path: str | Path, mapping: Mapping) -> Table:
    """Return the arrays of an ``.npz`` file as a table; its rows are numbered from 0, as in Python."""
    what, arrays = f"log '{path}'", read_arrays(path, "log", MOST_BYTES)
    names = list(arrays)
    try:
        if any(isinstance(mapping.of(name).name, int) for name in COLUMNS):
            raise AmulettError("the arrays of an .npz file have names; the mapping has numbers of columns")
        found = find_columns(names, mapping.wanted(), "it")
        columns = {name: _to_numbers(arrays[names[place.place]], place) for name, place in found.items()}
        rows = len(columns["time"])
        for name, values in columns.items():
            if len(values) != rows:
                raise AmulettError(f"'{found[name].header}' has {len(values)} values, '{found['time'].header}' {rows}")
    except AmulettError as error:
        raise AmulettError(f"{what}: {error}") from error
    return Table(columns, found, np.arange(rows), others=others(names, found))


def _to_numbers(values: NDArray[Any], found: Found) -> NDArray[np.float64]:
    """Return an array as 64-bit floats; refuse what is no column of numbers."""
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        raise AmulettError(f"'{found.header}' is {values.dtype} of shape {values.shape}, not a list of numbers")
    numbers = values.astype(np.float64)
    if (wrong := np.isinf(numbers)).any():
        raise AmulettError(f"row {int(np.argmax(wrong))}, column '{found.header}': {numbers[wrong][0]} is not finite")
    return numbers
