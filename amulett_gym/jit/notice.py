"""Announces the longest wait of a first run: that code is compiled."""

from __future__ import annotations

from collections.abc import Callable

TEXT = "Compiling the simulation (about 12 s, once per version) ..."

_listeners: list[Callable[[str], object]] = []


def announce_compilation(show: Callable[[str], object]) -> None:
    """Have `show` called with a line of text when this process compiles for the first time."""
    _listeners[:] = [show]


def compiling() -> None:
    """Announce a compilation, if this process has not compiled before."""
    while _listeners:
        _listeners.pop()(TEXT)
