"""Threads that work together with the one that calls them."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

_Ends = list[BaseException | None]
_Wakes = SimpleQueue[None]
_Calls = SimpleQueue[tuple[Callable[[], object], _Ends, _Wakes] | None]


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
        self._finalizer = weakref.finalize(self, _end, self._calls, size)
        # Daemons, so that waiting ones do not hold up the process's end.
        self._threads = [
            threading.Thread(target=_serve, args=(self._calls,), name=f"amulett-gym_{index}", daemon=True)
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
        """Call `work` in this thread and in others; raise the first error once none of them works any more.

        A thread that has not begun when this one is done, as its core is busy, is not waited for. Ctrl-C does not end
        the wait for the others, but a second one in it does: then the pool must not be used again.
        """
        ends: _Ends = []
        wakes: _Wakes = SimpleQueue()
        begun = len(self._threads)
        for _ in self._threads:
            self._calls.put((work, ends, wakes))
        try:
            work()
        finally:
            with suppress(Empty):
                while True:
                    self._calls.get_nowait()
                    begun -= 1
            _wait(ends, begun, wakes)
        for error in ends:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads."""
        self._finalizer()
        for thread in self._threads:
            thread.join()


def _wait(ends: _Ends, count: int, wakes: _Wakes) -> None:
    """Wait until so many threads have ended their work; raise what a signal's handler raises only then."""
    try:
        while len(ends) < count:
            wakes.get()
    except BaseException:  # the others work on what the caller uses next
        while len(ends) < count:
            wakes.get()
        raise


def _serve(calls: _Calls) -> None:
    """Do a thread's work. It knows the queues alone, not the pool, which can thus be collected."""
    while (call := calls.get()) is not None:
        _do(*call)
        del call  # or its arrays are kept until there is more


def _do(work: Callable[[], object], ends: _Ends, wakes: _Wakes) -> None:
    """Do the work, note how it ended, and wake who waits for it."""
    try:
        work()
    except BaseException as error:
        ends.append(error)
    else:
        ends.append(None)
    wakes.put(None)


def _end(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(None)
