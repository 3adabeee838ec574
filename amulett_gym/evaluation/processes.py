"""Independent calls of one function in several processes, as they finish."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any, TypeVar

T = TypeVar("T")
K = TypeVar("K")

_BETWEEN = 1.0
"""Longest time between two reports of progress [s]."""

_progress: Any = None  # in a worker: its units of work until now, shared with the others


def in_processes(
    work: Callable[..., T],
    calls: Mapping[K, tuple[Any, ...]],
    processes: int,
    watch: Callable[[int], object] = lambda units: None,
) -> Iterator[tuple[K, T]]:
    """Yield the name and result of each call as it finishes.

    Parameters
    ----------
    work : callable
        A function of a module; it may call `advance`.
    calls : dict
        Name -> arguments of `work`, which can be pickled.
    processes : int
        Most processes at a time. They end with this generator, and with this process, which alone receives Ctrl-C.
    watch : callable
        Called with the number of units by which all calls advanced since the last time.
    """
    if not calls:
        return
    context = get_context("spawn")
    units, seen = context.Value("q", 0), 0
    before = set(active_children())
    with ProcessPoolExecutor(min(processes, len(calls)), context, initializer=_begin, initargs=(units,)) as pool:
        try:
            with _ctrl_c_later():  # inherited by the workers, which the parent ends
                waiting = {pool.submit(work, *arguments): name for name, arguments in calls.items()}
            while waiting:
                done, _ = wait(waiting, _BETWEEN, FIRST_COMPLETED)
                now = units.value
                watch(now - seen)
                seen = now
                for future in done:
                    yield waiting.pop(future), future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in set(active_children()) - before:  # otherwise they finish their calls first
                worker.terminate()
            raise


def advance(units: int) -> None:
    """Report progress from a call of `in_processes`."""
    with _progress.get_lock():
        _progress.value += units


@contextmanager
def _ctrl_c_later() -> Iterator[None]:
    """Delay a Ctrl-C until the end of the block; processes that start in it never receive one."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(units: Any) -> None:
    """Begin a worker: end it when its parent ends, since a parent that was killed cannot do that."""
    global _progress
    _progress = units
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
