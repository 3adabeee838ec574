"""Independent jobs in several processes; each job keeps its result in a file, from which it is read later."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import Any

from amulett_gym.reporting.progress import Progress

Job = Callable[[], Any]


def work_ahead(jobs: Sequence[Job], processes: int, what: str, progress: bool = False) -> None:
    """Call jobs that can be pickled in `processes` processes, and drop what they return; nothing with one worker.

    Raises what a job raises; then, and on Ctrl-C, the processes are ended.
    """
    if processes < 2 or not jobs:
        return
    with Progress(len(jobs), f"{what}, {processes} processes", "jobs", progress) as bar:
        pool = ProcessPoolExecutor(min(processes, len(jobs)), mp_context=get_context("spawn"), initializer=_watch)
        try:
            for finished in as_completed([pool.submit(_call, job) for job in jobs]):
                finished.result()
                bar.update()
        except BaseException:
            for process in active_children():
                process.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _watch() -> None:
    """End this process when its parent has ended: a parent that is killed cannot do it."""
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _call(job: Job) -> None:
    try:
        job()
    except KeyboardInterrupt:
        os._exit(130)  # an executor's process would begin the next job
