"""Calls in processes of this machine."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any, TypeVar

from amulett_gym.workers.call import MOST_LOST, Call, lost, named
from amulett_gym.workers.report import listening

T = TypeVar("T")

_BETWEEN = 1.0
"""Longest time between two reports of progress [s]."""

_progress: Any = None  # in a worker: its units of work until now, which the parent reads


def in_processes(
    calls: Mapping[str, Call[T]], number: int, watch: Callable[[int], object] = lambda units: None
) -> Generator[tuple[str, T]]:
    """Yield the name and result of each call as it finishes; see `run.results`.

    Parameters
    ----------
    calls : mapping
    number : int
        Most processes at a time. They end with this generator, and with this process, which alone receives Ctrl-C.
    watch : callable
    """
    context = get_context("spawn")
    before = set(active_children())
    counters, seen = list[Any](), 0
    todo, losses = list(calls)[::-1], Counter[str]()
    made: dict[Future[T], tuple[str, ProcessPoolExecutor]] = {}

    def new_worker() -> ProcessPoolExecutor:
        # Each an executor of its own: one that loses its process tells which call that made, and stops no other. And
        # each a counter of its own, without a lock, which a process that is killed would keep.
        counters.append(context.RawValue("q", 0))
        return ProcessPoolExecutor(1, context, initializer=_begin, initargs=(counters[-1],))

    def begin(worker: ProcessPoolExecutor) -> None:
        name = todo.pop()
        with _ctrl_c_later():  # inherited by the workers, which the parent ends
            made[worker.submit(_make, calls[name])] = name, worker

    try:
        for _ in range(min(number, len(calls))):
            begin(new_worker())
        while made:
            done, _ = wait(made, _BETWEEN, FIRST_COMPLETED)
            now = sum(counter.value for counter in counters)
            watch(now - seen)
            seen = now
            finished: list[tuple[str, T]] = []
            failure: BaseException | None = None
            for future in done:
                name, worker = made.pop(future)
                error = future.exception()
                if error is None:
                    finished.append((name, future.result()))
                elif isinstance(error, (BrokenProcessPool, KeyboardInterrupt)):  # killed, or ended by SIGTERM
                    losses[name] += 1
                    if losses[name] > MOST_LOST:
                        failure = lost(name, "on this machine")
                    todo.append(name)
                    worker.shutdown()
                    worker = new_worker()
                else:
                    failure = named(error, name) if isinstance(error, Exception) else error
                if todo and failure is None:
                    begin(worker)
                else:
                    worker.shutdown()
            yield from finished
            if failure is not None:
                raise failure
    except BaseException:
        for _, worker in made.values():
            worker.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - before:  # otherwise they finish their calls first
            process.terminate()
        raise


def _make(call: Call[T]) -> T:
    with listening(_add):
        return call.make()


def _add(units: int) -> None:
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
