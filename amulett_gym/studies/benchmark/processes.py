"""Independent jobs in several processes; each job keeps its result in a file, from which it is read later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from amulett_gym.evaluation.processes import in_processes
from amulett_gym.reporting.progress import Progress

Job = Callable[[], Any]


def work_ahead(jobs: Sequence[Job], processes: int, what: str, progress: bool = False) -> None:
    """Call jobs that can be pickled in `processes` processes, and drop what they return; nothing with one worker.

    Raises what a job raises; then, and on Ctrl-C, the processes are ended.
    """
    if processes < 2 or not jobs:
        return
    calls = {k: (job,) for k, job in enumerate(jobs)}
    with Progress(len(jobs), f"{what}, {processes} processes", "jobs", progress) as bar:
        for _ in in_processes(_call, calls, processes):
            bar.update()


def _call(job: Job) -> None:
    job()
