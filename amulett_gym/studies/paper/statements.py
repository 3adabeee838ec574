"""Statements about the numbers of Tables 2-5 and about motions, which are true, false, or lack a number."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from amulett_gym.studies.paper.motion import UNITS, Key
from amulett_gym.studies.paper.reproduction import Reproduction
from amulett_gym.studies.paper.tables import CONFIGURATIONS, TABLES_2_TO_5

Numbers = Mapping[Key, float]
"""Metric, device, configuration and drive -> a number; one that does not exist is not there."""

NAMES = dict(zip(CONFIGURATIONS, ("position only", "5 N", "10 N", "variable"), strict=True))
"""Configurations in words."""

METRICS = {"rise_time": "rise time", "position_ise": "position ISE", "tension_ise": "tension ISE", "isav": "ISAV"}
"""Metrics of the tables in words."""

_UNITS = {"rise_time": "s", "position_ise": "deg^2 s", "tension_ise": "N^2 s", "isav": ""} | UNITS


@dataclass(frozen=True)
class Quantity:
    """Something that numbers give.

    Attributes
    ----------
    of : callable
        Numbers -> its value, NaN if a number is missing.
    say : callable
        Numbers -> what it is, and its value with a unit.
    """

    of: Callable[[Numbers], float]
    say: Callable[[Numbers], str]


@dataclass(frozen=True)
class Within:
    """The statement that a quantity lies between two bounds, both excluded."""

    quantity: Quantity
    low: float | Quantity = -math.inf
    high: float | Quantity = math.inf


@dataclass(frozen=True)
class Verdict:
    """Whether statements hold (None: a number that decides it is missing), and the numbers that say so."""

    holds: bool | None
    words: str


def judge(statements: Sequence[Within], numbers: Numbers) -> Verdict:
    """Try statements, all of which have to be true, on a set of numbers."""
    true = [_is_true(statement, numbers) for statement in statements]
    said: dict[str, None] = {}  # an ordered set: a quantity may be bounded twice
    for statement in statements:
        for part in (statement.quantity, statement.low, statement.high):
            if isinstance(part, Quantity):
                said[part.say(numbers)] = None
    return Verdict(False if False in true else None if None in true else True, "; ".join(said))


def our_numbers(reproduction: Reproduction) -> dict[Key, float]:
    """Return our numbers of Tables 2-5."""
    return {
        (row.cell.metric, row.cell.profile, row.cell.configuration, row.cell.drive): row.ours
        for row in reproduction.rows
        if row.ours is not None
    }


def paper_numbers() -> dict[Key, float]:
    """Return the paper's numbers of Tables 2-5."""
    return {(cell.metric, cell.profile, cell.configuration, cell.drive): cell.value for cell in TABLES_2_TO_5}


def value(key: Key, label: str = "") -> Quantity:
    """Return a number as it is; the label stands in the place of device, configuration and drive."""
    unit = _UNITS[key[0]].replace("^2", "²")
    suffix = "" if unit in ("", "1") else f" {unit}"
    return _quantity(label or _label(key), lambda numbers: numbers.get(key, math.nan), lambda x: f"{x:.3g}{suffix}")


def ratio(top: Key, bottom: Key, label: str = "") -> Quantity:
    """Return one number over another."""

    def of(numbers: Numbers) -> float:
        below = numbers.get(bottom, math.nan)
        return numbers.get(top, math.nan) / below if below else math.nan

    return _quantity(label or _label(top), of, _ratio_in_words)


def difference(one: Key, other: Key, label: str = "") -> Quantity:
    """Return one number minus another of the same metric."""
    unit = _UNITS[one[0]].replace("^2", "²")
    return _quantity(
        label or _label(one),
        lambda numbers: numbers.get(one, math.nan) - numbers.get(other, math.nan),
        lambda x: f"{x:+.2g} {unit}",
    )


def extreme(pick: Callable[[list[float]], float], quantities: Sequence[Quantity], label: str) -> Quantity:
    """Return the largest or smallest (`max` or `min`) of several ratios; NaN if one is missing."""

    def of(numbers: Numbers) -> float:
        values = [quantity.of(numbers) for quantity in quantities]
        return math.nan if any(map(math.isnan, values)) else pick(values)

    return _quantity(label, of, _ratio_in_words)


def bound(quantity: Quantity, transform: Callable[[float], float]) -> Quantity:
    """Return a bound that hangs on a quantity, and says that quantity."""
    return Quantity(lambda numbers: transform(quantity.of(numbers)), quantity.say)


def _is_true(statement: Within, numbers: Numbers) -> bool | None:
    low, middle, high = (
        part.of(numbers) if isinstance(part, Quantity) else part
        for part in (statement.low, statement.quantity, statement.high)
    )
    return None if any(map(math.isnan, (low, middle, high))) else low < middle < high


def _quantity(label: str, of: Callable[[Numbers], float], words: Callable[[float], str]) -> Quantity:
    def say(numbers: Numbers) -> str:
        result = of(numbers)
        return f"{label} {'has no number' if math.isnan(result) else words(result)}"

    return Quantity(of, say)


def _label(key: Key) -> str:
    _, device, configuration, drive = key
    return " ".join([device, NAMES[configuration], *([drive] if drive else [])])


def _ratio_in_words(ratio: float) -> str:
    """Return a ratio as a change in percent, or as a factor if percents would not show it."""
    return f"{100.0 * (ratio - 1.0):+.1f} %" if ratio == 0.0 or 0.01 <= ratio < 2.0 else f"×{ratio:.3g}"
