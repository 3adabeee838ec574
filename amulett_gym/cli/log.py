"""`amulett log check`: what a recorded file is read as."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_json, check_file
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from amulett_gym.logs import Log

HELP = "check a log of a device, or a measured spring curve: what is taken for what"
EXAMPLES = """  amulett log check configs/logs/steps.csv
  amulett log check mine.csv --mapping mine.yaml --out steps.csv
  amulett log check spring.csv --curve
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("action", choices=("check",), help="check: read a file and say what it was taken for")
    parser.add_argument("file", metavar="FILE", help="CSV (comma, semicolon or tab) or .npz")
    parser.add_argument("--mapping", metavar="FILE.yaml", help="names, units, signs and offsets of the log's columns")
    parser.add_argument("--curve", action="store_true", help="the file is a measured force-deflection curve")
    parser.add_argument("--out", metavar="FILE", help="write the log in the units of docs/logs.md (.csv or .npz)")
    add_json(parser, "columns and notes")


def run(arguments: argparse.Namespace) -> int:
    """Read the file, print what it is, and write it again if asked to."""
    if arguments.curve:
        if given := [name for name in ("mapping", "out") if getattr(arguments, name) is not None]:
            raise AmulettError(f"--{given[0]} is for logs; leave it out with --curve")
        return _check_curve(arguments)
    from amulett_gym.logs import read_log, write_log

    check_file("out", arguments.out, (".csv", ".npz"))
    log = read_log(arguments.file, arguments.mapping)
    _print(arguments, f"{arguments.file}: a log of {len(log)} rows", "column", _columns(log), log.notes)
    if arguments.out is not None:
        write_log(arguments.out, log)
        printer(arguments)(f"Written: {arguments.out}")
    return 0


def _check_curve(arguments: argparse.Namespace) -> int:
    from amulett_gym.storage.curve import read_measurement

    curve, notes = read_measurement(arguments.file)
    rows = {
        name: {"values": len(values), "least": min(values), "most": max(values)} for name, values in curve if values
    }
    title = f"{arguments.file}: a curve of {len(curve.deflection_m)} points"
    _print(arguments, title, "column", rows, notes)
    return 0


def _columns(log: Log) -> dict[str, dict[str, Any]]:
    """Return the unit of each column in a written log, its number of known values, and their range in that unit."""
    import numpy as np

    from amulett_gym.logs import COLUMNS
    from amulett_gym.storage.units import from_si

    found = {}
    for name, values in log.columns.items():
        known = from_si(values[np.isfinite(values)], COLUMNS[name].quantity, COLUMNS[name].unit)
        least, most = float(known.min()), float(known.max())
        found[name] = {"unit": COLUMNS[name].unit, "values": int(known.size), "least": least, "most": most}
    return found


def _print(
    arguments: argparse.Namespace, title: str, head: str, columns: dict[str, dict[str, Any]], notes: Any
) -> None:
    from amulett_gym.reporting.table import Table

    if arguments.json:
        print_json({"file": arguments.file, "columns": columns, "notes": list(notes)})
        return
    show, keys = printer(arguments), tuple(next(iter(columns.values())))
    rows = [
        (name, *(f"{entry[key]:.6g}" if isinstance(entry[key], float) else str(entry[key]) for key in keys))
        for name, entry in columns.items()
    ]
    show(title)
    show(Table("", (head, *keys), rows, left=(0, 1) if "unit" in keys else (0,)).text())
    for note in notes:
        show(f"- {note}")
