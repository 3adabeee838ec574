"""Compilation as the user of a command sees it: announced, then interruptible by Ctrl-C.

numba swallows an interrupt that arrives while LLVM works, and goes on with half of its result.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from typing import Any

COMPILING = "Compiling the simulation (10 to 40 s, once per version) ..."
STOPPING = "Stopping as soon as it is compiled ..."

_shows: list[Callable[[str], object]] = []
_spent = 0.0


def seconds_compiling() -> float:
    """Return how long numba has compiled since it is watched [s], so that estimates of remaining time can omit it."""
    return _spent


def announce_compilation(show: Callable[[str], object]) -> None:
    """Have `show` called with a line of text when this process compiles; to be called before anything is compiled."""
    _shows[:] = [show]


def watch_compilation() -> None:
    """Have numba report when it compiles, if `announce_compilation` was called before and this version of numba can."""
    if not _shows:
        return
    try:
        from numba.core.event import Listener, register
    except ImportError:
        return
    Listener.register(Watch)
    register("numba:compile", Watch(_shows[0]))


class Watch:
    """Listens to numba: announces its first compilation, and holds back interrupts until the outermost one ends."""

    def __init__(self, show: Callable[[str], object]) -> None:
        self._show = show
        self._announced = self._interrupted = False
        self._depth = 0
        self._begun = 0.0
        self._handler: Any = None

    def notify(self, event: Any) -> None:
        """Handle the start or end of a compilation; called by numba."""
        if threading.current_thread() is not threading.main_thread():
            return
        if event.is_start:
            self._start()
        else:
            self._end()

    def _start(self) -> None:
        self._depth += 1
        if self._depth > 1:
            return
        self._begun = time.monotonic()
        self._handler = signal.signal(signal.SIGINT, self._hold)
        if not self._announced:
            self._announced = True
            self._show(COMPILING)

    def _hold(self, number: int, frame: Any) -> None:
        self._interrupted = True
        self._show(STOPPING)

    def _end(self) -> None:
        self._depth -= 1
        if self._depth:
            return
        global _spent
        _spent += time.monotonic() - self._begun
        signal.signal(signal.SIGINT, self._handler)
        if self._interrupted:
            self._interrupted = False
            signal.raise_signal(signal.SIGINT)
