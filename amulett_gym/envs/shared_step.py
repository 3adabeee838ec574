"""An agent step that threads take together."""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

from amulett_gym.envs.action import ALL_NUMBERS
from amulett_gym.envs.shares import AWAKE, Turns, offer, turns_of, withdraw
from amulett_gym.jit.compiled import compiled_for

LOOKS = 400_000
"""Looks for a share before a thread sleeps, some 0.2 ms: Python does less than that from step to step."""
PAUSE = 5e-5
"""Time between further looks for the others' end, once `LOOKS` were in vain [s]."""
FOREVER = 2**62
"""As many looks as it takes."""

_Calls = SimpleQueue[bool]


class SharedStep:
    """An agent step, and threads that wait for it until it is closed or nobody refers to it any more.

    Between two steps that follow each other at once, a thread stays awake, in compiled code without the GIL: waking it
    takes as long as hundreds of control ticks.

    Parameters
    ----------
    take : callable
        Compiled; called by each thread with the turns, and the looks for a share after which it goes.
    blocks : int
    threads : int
        That of the caller among them, at least 2.
    given : tuple
        Arrays like those of a step.
    """

    def __init__(self, take: Callable[[Turns, int], None], blocks: int, threads: int, given: tuple[Any, ...]) -> None:
        self._take, self._blocks, self._size = take, blocks, threads - 1
        turns = turns_of(blocks, threads)
        self._offer: Callable[..., int] = compiled_for(offer, (turns, *given))
        self._withdraw: Callable[[Turns, int], bool] = compiled_for(withdraw, (turns, LOOKS))
        self._start()

    def __call__(self, *given: Any) -> int:
        """Take one agent step; return the first device whose action is NaN, before any is stepped, or `ALL_NUMBERS`.

        Once it returns or raises, no thread works any more. A thread that has not begun when this one is done, as its
        core is busy, is not waited for.
        """
        if self._process != os.getpid():  # a forked process inherits no threads
            self._finalizer()
            self._start()
        try:
            wrong = self._offer(self._turns, *given)
            if wrong == ALL_NUMBERS:
                for _ in range(self._size - int(self._turns[AWAKE, 0]) - self._calls.qsize()):
                    self._calls.put(True)
                self._take(self._turns, 1)
                while not self._withdraw(self._turns, LOOKS):
                    time.sleep(PAUSE)  # another thread's core is busy: it may have this one
            return wrong
        finally:  # the others write to the caller's arrays
            self._withdraw(self._turns, FOREVER)

    def close(self) -> None:
        """End the threads."""
        _dismiss(self._calls, self._size)
        for thread in self._threads:
            thread.join()

    def _start(self) -> None:
        """Start the threads."""
        self._turns, self._calls = turns_of(self._blocks, 1 + self._size), _Calls()
        self._finalizer = weakref.finalize(self, _dismiss, self._calls, self._size)
        serve = partial(_serve, self._calls, partial(self._take, self._turns, LOOKS))
        self._threads: list[threading.Thread] = []
        for index in range(self._size):
            # Daemons, so that waiting ones do not hold up the process's end.
            thread = threading.Thread(target=serve, name=f"amulett-gym_{index}", daemon=True)
            thread.start()
            self._threads.append(thread)
        self._process = os.getpid()  # last: if this is interrupted, the next step begins anew


def _serve(calls: _Calls, take: Callable[[], None]) -> None:
    """Do a thread's work. It knows no `SharedStep`, which can thus be collected."""
    while calls.get():
        take()


def _dismiss(calls: _Calls, size: int) -> None:
    for _ in range(size):
        calls.put(False)
