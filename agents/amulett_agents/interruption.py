"""Signals that end a training run after its present rollout."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stop_on_signals(stop: Callable[[], bool]) -> Iterator[None]:
    """Call `stop` at SIGTERM and Ctrl-C instead of ending the process; only the main thread receives signals.

    `stop` returns whether it was called before: then Ctrl-C raises KeyboardInterrupt at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: Any) -> None:
        if stop() and number == signal.SIGINT:
            raise KeyboardInterrupt

    # Ignored signals stay ignored: shells start background processes that way.
    both = (signal.SIGINT, signal.SIGTERM)
    handled = [number for number in both if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    earlier = {number: signal.signal(number, handle) for number in handled}
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)
