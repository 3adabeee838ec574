"""Threads that work together with the one that calls them."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

_Ends = list[BaseException | None]
_Calls = SimpleQueue[tuple[Callable[[], object], _Ends] | None]


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
        self._wakes: SimpleQueue[None] = SimpleQueue()
        self._finalizer = weakref.finalize(self, _end, self._calls, size)
        # Daemons, so that waiting ones do not hold up the process's end.
        self._threads = [
            threading.Thread(target=_serve, args=(self._calls, self._wakes), name=f"amulett-gym_{index}", daemon=True)
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
        the wait, but a second one does: then the pool must not be used again.
        """
        ends: _Ends = []
        begun = len(self._threads)
        while not self._wakes.empty():  # those that the work before did not need
            self._wakes.get()
        for _ in self._threads:
            self._calls.put((work, ends))
        try:
            work()
        finally:
            with suppress(Empty):
                while True:
                    self._calls.get_nowait()
                    begun -= 1
            self._wait(ends, begun)
        for error in ends:
            if error is not None:
                raise error

    def _wait(self, ends: _Ends, count: int) -> None:
        """Wait until so many threads have ended their work."""
        try:
            while len(ends) < count:
                self._wakes.get()
        except KeyboardInterrupt:  # they work on what the caller uses next
            while len(ends) < count:
                self._wakes.get()
            raise

    def close(self) -> None:
        """End the threads."""
        self._finalizer()
        for thread in self._threads:
            thread.join()


def _serve(calls: _Calls, wakes: SimpleQueue[None]) -> None:
    """Do a thread's work. It knows the queues alone, not the pool, which can thus be collected."""
    while (call := calls.get()) is not None:
        _do(*call)
        del call  # or its arrays are kept until there is more
        wakes.put(None)


def _do(work: Callable[[], object], ends: _Ends) -> None:
    try:
        work()
    except BaseException as error:
        ends.append(error)
    else:
        ends.append(None)


def _end(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(None)
