"""What a call tells while it is made: how far it is, and that its files are complete as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


def _nothing(*given: Any) -> None:
    """Listen to nothing."""


_advance: Callable[[int], object] = _nothing
_keep: Callable[[], object] = _nothing


def advance(units: int) -> None:
    """Report progress, in the units of the progress bar; nothing if no one listens.

    If the worker is lost, the units since the last `keep` do not count.
    """
    _advance(units)


def keep() -> None:
    """Report that the files in the call's folder are complete, with all progress until now.

    On a cluster, they are copied to the driver.
    """
    _keep()


@contextmanager
def listening(to_advance: Callable[[int], object], to_keep: Callable[[], object] = _nothing) -> Iterator[None]:
    """Call `to_advance` and `to_keep` at each report in this process during the block."""
    global _advance, _keep
    before = _advance, _keep
    _advance, _keep = to_advance, to_keep
    try:
        yield
    finally:
        _advance, _keep = before
