"""Threads that work together with the one that calls them."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

_Calls = SimpleQueue[Callable[[], object] | None]
_Ends = SimpleQueue[BaseException | None]


class ThreadPool:
    """Threads that wait for work, until the pool is closed or nobody refers to it any more.

    A `ThreadPoolExecutor` takes twice as long to begin and end work, which counts where that lasts a millisecond.

    Parameters
    ----------
    size : int
        Threads besides the one that calls.
    """

    def __init__(self, size: int) -> None:
        self._calls: _Calls = SimpleQueue()
        self._ends: _Ends = SimpleQueue()
        self._finalizer = weakref.finalize(self, _end, self._calls, size)
        # Daemons, so that waiting ones do not hold up the process's end.
        self._threads = [
            threading.Thread(target=_serve, args=(self._calls, self._ends), name=f"amulett-gym_{index}", daemon=True)
            for index in range(size)
        ]
        for thread in self._threads:
            thread.start()
        self._process = os.getpid()

    @property
    def is_here(self) -> bool:
        """Whether the threads are in this process: a forked one inherits none."""
        return self._process == os.getpid()

    def run(self, work: Callable[[], object]) -> None:
        """Call `work` in this thread and in others; raise the first error once all are done.

        A thread that has not begun when this one is done, as its core is busy, is not waited for. After any error,
        such as Ctrl-C while this waits, the pool must not be used again.
        """
        begun = len(self._threads)
        for _ in self._threads:
            self._calls.put(work)
        try:
            work()
        finally:
            with suppress(Empty):
                while True:
                    self._calls.get_nowait()
                    begun -= 1
            errors = [self._ends.get() for _ in range(begun)]  # even after an error, none works on
        for error in errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads."""
        self._finalizer()
        for thread in self._threads:
            thread.join()


def _serve(calls: _Calls, ends: _Ends) -> None:
    """Do a thread's work. It knows the queues alone, not the pool, which can thus be collected."""
    while (work := calls.get()) is not None:
        error = None
        try:
            work()
        except BaseException as caught:
            error = caught
        work = None  # or its arrays are kept until there is more
        ends.put(error)


def _end(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(None)
