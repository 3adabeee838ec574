"""Numbers as C text. What is generated holds nothing else of a profile or a policy: no name and no text."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WIDTH = 118


def number(value: float | int | bool) -> str:
    """Return a number as a C constant: a whole one, or the shortest decimal that is the same 64-bit number.

    Raises
    ------
    AmulettError
        If it is NaN.
    """
    if isinstance(value, bool | np.bool_ | int | np.integer):
        return str(int(value))
    value = float(value)
    if math.isnan(value):
        raise AmulettError("a number of the firmware is NaN; it has to be a number")
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(value)


def defines(values: Mapping[str, float | int | bool]) -> str:
    """Return lines that define names as numbers."""
    width = max(map(len, values), default=0)
    return "".join(
        f"#define {_checked(name):{width}} {_in_brackets(number(value))}\n" for name, value in values.items()
    )


def initialiser(values: Mapping[str, float | int | str]) -> str:
    """Return the definition of a C initialiser's content by its fields; a text is the name of a table."""
    items = [f".{_checked(name)} = {_checked(v) if isinstance(v, str) else number(v)}" for name, v in values.items()]
    return ", \\\n    ".join(items)


def array(kind: str, name: str, values: NDArray[Any], flash: bool = True) -> str:
    """Return the definition of a constant array of one or two dimensions, in flash."""
    sizes = "".join(f"[{size}]" for size in values.shape)
    place = " FLASH" if flash else ""
    head = f"static const {kind} {_checked(name)}{sizes}{place} = {{\n"
    if values.ndim == 1:
        return head + "\n".join(_wrapped(map(number, values.tolist()))) + "\n};\n"
    rows = ("{" + ", ".join(map(number, row)) + "}," for row in values.tolist())
    return head + "\n".join(f"    {row}" for row in rows) + "\n};\n"


def _wrapped(items: Iterable[str]) -> list[str]:
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) + 2 > _WIDTH:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return [*lines, line]


def _in_brackets(text: str) -> str:
    return f"({text})" if text.startswith("-") else text


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise AmulettError(f"'{name[:100]}' is no name of a C constant")
    return name
