"""Command lines of the measurements that run as ``python -m amulett_gym.studies.speed.NAME``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence


def command(description: str, name: str, turns: int, devices: Sequence[int] = ()) -> argparse.ArgumentParser:
    """Return a parser of ``--turns``, ``--json`` and, if there are default numbers of them, ``--devices``."""
    parser = argparse.ArgumentParser(f"python -m amulett_gym.studies.speed.{name}", None, description.split("\n")[0])
    if devices:
        parser.add_argument("--devices", type=int, nargs="+", default=[*devices], help="numbers of devices")
    parser.add_argument("--turns", type=int, default=turns, help=f"interleaved turns (default: {turns})")
    parser.add_argument("--json", metavar="FILE", help="write the numbers as JSON, too")
    return parser
