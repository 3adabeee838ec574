"""Threads that work together with the one that calls them."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

import numba

from amulett_gym.jit.turns import Number, count_once, new_number, reaches

LOOKS = 0 if numba.config.DISABLE_JIT else 100_000
"""Looks for the others' end before a thread sleeps: as long as it takes to wake up, or twice as long."""

T = TypeVar("T")
_Errors = list[BaseException]
_Wakes = SimpleQueue[None]
_Calls = SimpleQueue[tuple[Callable[[], object], Number, _Errors, _Wakes] | None]


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

    def run(self, work: Callable[[], T]) -> T:
        """Call `work` in this thread and in others; once none of them works any more, return what it returned here.

        Or raise the first error. A thread that has not begun when this one is done, as its core is busy, is not waited
        for. Ctrl-C does not end the wait for the others, but a second one in it does: then the pool must not be used
        again.
        """
        ended, errors, wakes = new_number(), _Errors(), _Wakes()
        begun = len(self._threads)
        for _ in self._threads:
            self._calls.put((work, ended, errors, wakes))
        try:
            found = work()
        finally:
            with suppress(Empty):
                while True:
                    self._calls.get_nowait()
                    begun -= 1
            _wait(ended, begun, wakes)
        if errors:
            raise errors[0]
        return found

    def close(self) -> None:
        """End the threads."""
        self._finalizer()
        for thread in self._threads:
            thread.join()


def _wait(ended: Number, begun: int, wakes: _Wakes) -> None:
    """Wait until so many threads have ended their work; raise what a signal's handler raises only then."""
    try:
        if begun and not reaches(ended, begun, LOOKS):
            while ended[0] < begun:
                wakes.get()
    except BaseException:  # the others work on what the caller uses next
        while ended[0] < begun:
            wakes.get()
        raise


def _serve(calls: _Calls) -> None:
    """Do a thread's work. It knows the queues alone, not the pool, which can thus be collected."""
    while (call := calls.get()) is not None:
        _do(*call)
        del call  # or its arrays are kept until there is more


def _do(work: Callable[[], object], ended: Number, errors: _Errors, wakes: _Wakes) -> None:
    """Do the work, note how it ended, and wake who waits for it."""
    try:
        work()
    except BaseException as error:
        errors.append(error)
    count_once(ended)
    wakes.put(None)


def _end(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(None)
