"""Calls in processes of this machine."""

from __future__ import annotations

import atexit
import gc
import os
import signal
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any, TypeVar

from amulett_gym.workers.call import MOST_LOST, Call, lost, named
from amulett_gym.workers.report import listening

T = TypeVar("T")

_BETWEEN = 1.0
"""Longest time between two reports of progress [s]."""

_DONE, _KEPT = 0, 1  # places in a worker's counters

_progress: Any = None  # in a worker: its units of work until now, and how many of them are kept, for the parent


@dataclass(frozen=True)
class _Worker:
    """A process and its counters.

    Each is an executor of its own: one that loses its process tells which call that made, and stops no other. And each
    has counters of its own, without a lock, which a process that is killed would keep.
    """

    executor: ProcessPoolExecutor
    counters: Any


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
    made: dict[Future[T], tuple[str, _Worker]] = {}

    def new_worker() -> _Worker:
        counters.append(context.RawArray("q", 2))
        return _Worker(ProcessPoolExecutor(1, context, initializer=_begin, initargs=(counters[-1],)), counters[-1])

    def begin(worker: _Worker) -> None:
        name = todo.pop()
        with _ctrl_c_later():  # inherited by the workers, which the parent ends
            try:
                future = worker.executor.submit(_make, calls[name])
            except BrokenProcessPool:  # it was killed after its last call
                worker.executor.shutdown()
                worker = new_worker()
                future = worker.executor.submit(_make, calls[name])
            made[future] = name, worker

    try:
        for _ in range(min(number, len(calls))):
            begin(new_worker())
        while made:
            done, _ = wait(made, _BETWEEN, FIRST_COMPLETED)
            now = sum(each[_DONE] for each in counters)
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
                    worker.executor.shutdown()
                    worker.counters[_DONE] = worker.counters[_KEPT]  # what is not kept is done again
                    worker = new_worker()
                else:
                    failure = named(error, name) if isinstance(error, Exception) else error
                if todo and failure is None:
                    begin(worker)
                else:
                    worker.executor.shutdown()
            yield from finished
            if failure is not None:
                raise failure
    except BaseException:
        for _, worker in made.values():
            worker.executor.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - before:  # otherwise they finish their calls first
            process.terminate()
        raise


def _make(call: Call[T]) -> T:
    with listening(_add, _keep):
        result = call.make()
    _keep()  # of a finished call nothing is done again
    return result


def _add(units: int) -> None:
    _progress[_DONE] += units


def _keep() -> None:
    _progress[_KEPT] = _progress[_DONE]


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
    atexit.register(gc.freeze)  # its parent waits for its end, which takes a second with a search for garbage
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
