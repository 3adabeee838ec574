"""Units of the columns in tables: how they are written, and their size."""

from __future__ import annotations

import math
import re
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, nearest, shorten

_DEGREES = 180.0 / math.pi
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1.0 / 60.0},
    "angle": {"rad": 1.0, "mrad": 1e3, "deg": _DEGREES, "rev": 0.5 / math.pi},
    "length": {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6},
    "force": {"N": 1.0, "mN": 1e3, "kN": 1e-3},
}
"""Quantity -> unit -> how many of it are one SI unit. The first unit is the SI unit; angles are in radians."""

_SPELLINGS = {
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("°", "degree", "degrees"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("µm", "μm"), "um"),
    **dict.fromkeys(("newton", "newtons"), "N"),
}
_KNOWN = {unit for units in UNITS.values() for unit in units} | set(_SPELLINGS)
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")
_APART = re.compile(r"[\s\-.]+")


def plain_unit(unit: str) -> str:
    """Return a unit as it is spelled in `UNITS`, e.g. ``"deg"`` for ``"°"``; an unknown one is unchanged."""
    unit = unit.strip()
    return _SPELLINGS.get(unit, unit)


def is_unit(text: str) -> bool:
    """Return whether a text is the name of a unit, also in brackets."""
    bare = text.strip().strip("[]()").strip()
    return bare in _KNOWN


@lru_cache(maxsize=1024)  # each header is compared with each column that is wanted
def split_unit(header: str) -> tuple[str, str]:
    """Return the name and the unit in a column's header; the unit is empty if there is none.

    A unit stands in brackets, behind a slash or, if it is a known one, behind an underscore: ``angle [deg]``,
    ``angle (deg)``, ``angle/deg``, ``angle_deg``. The name is in lower case, with underscores between words.
    """
    header = header.strip()
    if match := _IN_BRACKETS.fullmatch(header):
        name, unit = match[1], match[2] if match[2] is not None else match[3]
    else:
        for mark in "/_":
            name, _, unit = header.rpartition(mark)
            if name and unit.strip() in _KNOWN:
                break
        else:
            name, unit = header, ""
    return _APART.sub("_", name.strip().lower()), plain_unit(unit)


def check_unit(unit: str, quantity: str, where: str) -> None:
    """Raise AmulettError if `unit` is none of the quantity's; `where` begins the message."""
    if unit not in UNITS[quantity]:
        allowed = f"{', '.join(UNITS[quantity])}{nearest(unit, UNITS[quantity])}"
        raise AmulettError(f"{where} has the unit '{shorten(unit)}'; units of {quantity} are {allowed}")


def to_si(values: NDArray[np.float64], quantity: str, unit: str) -> NDArray[np.float64]:
    """Return values of a unit in `UNITS` in the SI unit."""
    return values / UNITS[quantity][unit]


def from_si(values: NDArray[np.float64], quantity: str, unit: str) -> NDArray[np.float64]:
    """Return values in the SI unit in another one; the inverse of `to_si`."""
    return values * UNITS[quantity][unit]
