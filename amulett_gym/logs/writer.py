"""Writing of logs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amulett_gym.logs.log import COLUMNS, Log, check_columns
from amulett_gym.storage.units import UNITS, from_si
from amulett_gym.storage.writing import atomic_path


def write_log(path: str | Path, columns: Mapping[str, NDArray[np.float64]] | Log) -> None:
    """Write a log, from which `read_log` reads the same values without a mapping.

    Parameters
    ----------
    path : str or Path
        A CSV file has 12 digits, units in the header (see `COLUMNS`) and nothing in a cell that is NaN. A file whose
        name ends in ``.npz`` has all digits, and SI units.
    columns : mapping of str to ndarray, shape (rows,), or Log
        As in `Log`: in SI units and radians.

    Raises
    ------
    AmulettError
        If the columns are no log, or the file cannot be written.
    """
    if isinstance(columns, Log):
        columns = columns.columns
    columns = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    check_columns(columns, "log")
    known = {name: kind for name, kind in COLUMNS.items() if name in columns}
    with atomic_path(path) as temporary:
        if Path(path).suffix.lower() == ".npz":
            arrays = {f"{name} [{next(iter(UNITS[kind.quantity]))}]": columns[name] for name, kind in known.items()}
            np.savez_compressed(temporary, allow_pickle=False, **arrays)
            return
        written = [from_si(columns[name], kind.quantity, kind.unit).tolist() for name, kind in known.items()]
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            file.write(",".join(f"{name} [{kind.unit}]" for name, kind in known.items()) + "\n")
            for row in zip(*written, strict=True):
                file.write(",".join("" if value != value else f"{value:.12g}" for value in row) + "\n")
