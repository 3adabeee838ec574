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

from amulett_gym.jit.turns import count_once, new_number, reaches

LOOKS = 0 if numba.config.DISABLE_JIT else 100_000
"""Looks for the others' end before a thread sleeps: about as long as it takes to wake up."""

T = TypeVar("T")
_Calls = SimpleQueue["_Run | None"]


class ThreadPool:
    """Threads that wait for work, until the pool is closed or nobody refers to it any more.

    A `ThreadPoolExecutor` takes twice as long to begin and end work, which counts where that lasts a millisecond.

    Parameters
    ----------
    size : int
        Threads besides the one that calls.
    """

    def __init__(self, size: int) -> None:
        count_once(new_number())  # compiled here, where an error is raised
        reaches(new_number(), 0, 1)
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
        for. Ctrl-C does not end the wait for the others, but a second one does: then the pool must not be used again.
        """
        run = _Run(work)
        try:
            run.call(self._calls, len(self._threads))
            found = work()
            run.end(self._calls)
        except BaseException:  # the others work on what the caller uses next
            run.end(self._calls)
            raise
        if run.errors:
            raise run.errors[0]
        return found

    def close(self) -> None:
        """End the threads."""
        self._finalizer()
        for thread in self._threads:
            thread.join()


class _Run:
    """Work that threads do together.

    A signal's handler may raise between two steps of the interpreter, so threads are called, and taken back, in one.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        self.errors: list[BaseException] = []
        self._work, self._ended, self._wakes = work, new_number(), SimpleQueue[None]()
        self._called: list[None] = []
        self._taken_back: list[object] = []

    def call(self, calls: _Calls, threads: int) -> None:
        """Ask threads to do it."""
        self._called.extend(map(calls.put, [self] * threads))

    def do(self) -> None:
        """Do it as one of these threads."""
        try:
            self._work()
        except BaseException as error:
            self.errors.append(error)
        count_once(self._ended)
        self._wakes.put(None)

    def end(self, calls: _Calls) -> None:
        """Wait until none of them works any more; those that have not begun never will."""
        with suppress(Empty):
            self._taken_back.extend(iter(calls.get_nowait, ...))
        begun = len(self._called) - len(self._taken_back)
        if begun and not reaches(self._ended, begun, LOOKS):
            while not reaches(self._ended, begun, 1):
                self._wakes.get()


def _serve(calls: _Calls) -> None:
    """Do a thread's work. It knows the queue alone, not the pool, which can thus be collected."""
    while (run := calls.get()) is not None:
        run.do()
        del run  # or its arrays are kept until there is more


def _end(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(None)
