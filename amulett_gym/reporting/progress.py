"""Progress of long work on stderr: a bar on a terminal, else a plain line every few seconds."""

from __future__ import annotations

import os
import sys
import time
from types import TracebackType
from typing import Self

from tqdm import tqdm

from amulett_gym.jit.notice import seconds_compiling
from amulett_gym.reporting.table import fill

FIRST, BETWEEN = 2.0, 10.0
"""Time until the first plain line (or the bar), and between plain lines [s]."""

_LARGE = 10_000
"""Totals from this on are shown as thousands and millions."""


def say(text: str, wrap: bool = True) -> None:
    """Print text on stdout above the bars; `wrap` it to 80 columns, unless it is a command to be copied."""
    with tqdm.external_write_mode():
        print(fill(text) if wrap else text, flush=True)


class Progress:
    """Shows how much of some work is done, with an estimate of the remaining time, which omits compilation.

    Parameters
    ----------
    total : int or None
        Units of all work; None if unknown.
    what : str
        Name of the work, in a word or two.
    unit : str
    show : bool
        False shows nothing.
    done : int
        Units that were done in an earlier run; the estimate does not count them.
    """

    def __init__(self, total: int | None, what: str, unit: str = "", show: bool = True, done: int = 0) -> None:
        terminal = show and sys.stderr.isatty() and _has_width()
        self._bar = tqdm(
            total=total,
            initial=done,
            desc=what,
            unit=f" {unit}",
            disable=not terminal,
            unit_scale=(total or 0) >= _LARGE,
            delay=FIRST,
            leave=False,
            dynamic_ncols=True,
        )
        self._total, self.what, self._unit, self.done, self._before = total, what, unit, done, done
        self._started, self._compiled = time.monotonic(), seconds_compiling()
        self._due = self._started + FIRST if show and not terminal else float("inf")

    def update(self, count: int = 1, note: str = "") -> None:
        """Add `count` units to what is done; `note` names the last of them."""
        self.done += count
        if note:
            self._bar.set_postfix_str(note[-40:], refresh=False)
        compiled = seconds_compiling() - self._compiled
        self._started += compiled
        self._compiled += compiled
        if not self._bar.disable:
            self._bar.start_t += compiled
        self._bar.update(count)
        now = time.monotonic()
        if note and not count and now - self._started >= FIRST:
            self._bar.refresh()
        if now >= self._due:
            self._due = now + BETWEEN
            print(self._line(now - self._started, note), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Remove the bar; may be called again."""
        self._bar.close()
        self._due = float("inf")

    def _line(self, passed: float, note: str) -> str:
        unit, ending = f" {self._unit}" if self._unit else "", f": {note}" if note else ""
        if self._total is None or self.done == self._before:
            return f"{self.what}: {self.done:,}{unit}, {passed:.0f} s{ending}"
        left = passed * max(self._total - self.done, 0) / (self.done - self._before)
        share = f"{self.done:,} of {self._total:,}{unit} ({100 * self.done / self._total:.0f} %)"
        return f"{self.what}: {share} in {passed:.0f} s, about {left:.0f} s left{ending}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _has_width() -> bool:
    """Return whether stderr's terminal has columns; one made by `script` or a container may have none for a bar."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except (OSError, ValueError):
        return True
