"""Numbers as text: significant digits, intervals, units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from markupsafe import Markup, escape

EQUAL = "practically 1"
_MOST_DIGITS = 6

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with its significant digits, a dash if there is none; no exponent below a million."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -4 <= exponent < 6:
        return f"{value:.{digits - 1}e}"
    return f"{round(value, digits - 1 - exponent):.{max(digits - 1 - exponent, 0)}f}"


def interval(low: float | None, high: float | None, digits: int = 3) -> str:
    """Return ``"[low, high]"``; an empty string if one of them is None."""
    return "" if low is None or high is None else f"[{number(low, digits)}, {number(high, digits)}]"


def with_interval(estimate: Mapping[str, float | None] | None) -> str:
    """Return ``"mean [low, high]"``, the mean alone where the interval is none or a point, a dash without a mean."""
    if estimate is None or estimate["mean"] is None:
        return "-"
    mean, low, high = (estimate[key] for key in ("mean", "low", "high"))
    return number(mean) if low == high else f"{number(mean)} {interval(low, high)}".rstrip()


def span(ratio: Mapping[str, float | None]) -> str:
    """Return a ratio with its interval, with enough digits to differ from 1, like ``"0.853 [0.841, 0.866]"``.

    `ratio` has ``"mean"``, ``"low"``, ``"high"``, None or NaN if undefined. If six digits show no difference from 1,
    `EQUAL` is returned.
    """
    values = [ratio[key] for key in ("mean", "low", "high")]
    for digits in range(3, _MOST_DIGITS + 1):
        mean, low, high = (number(value, digits) for value in values)
        if values == [1.0] * 3 or any(float(text) != 1.0 for text in (mean, low, high) if text != "-"):
            return mean if low == high == "-" else f"{mean} [{low}, {high}]"
    return EQUAL if values[0] is not None and math.isfinite(values[0]) else "-"


def pretty(text: str) -> str:
    """Return a text with typeset numbers: 4.33×10⁶ for 4.33e+06, deg² for deg2, a true minus."""
    text = re.sub(r"(?<=\d)e([+-]\d+)\b", lambda match: f"×10{str(int(match[1])).translate(_SUPERSCRIPTS)}", text)
    text = re.sub(r"\b(deg|rad|N|m)2\b", r"\1²", text)
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


def html(text: str) -> Markup:
    """Return a text as HTML, with typeset numbers, unbroken intervals and `code`; `Markup` is returned unchanged."""
    if isinstance(text, Markup):
        return text
    unbroken = re.sub(r"\[(\S+), (\S+)\]", "[\\1,\N{NO-BREAK SPACE}\\2]", pretty(text))
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(unbroken))))
