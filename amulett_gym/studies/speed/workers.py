"""Measure what workers gain and cost, and where one driver ends: tasks, bytes of results and kept files per second.

::

    python -m amulett_gym.studies.speed.workers
    python -m amulett_gym.studies.speed.workers --ray 127.0.0.1:6379
    python -m amulett_gym.studies.speed.workers --turns 5 --json workers.json

The gain of two workers is measured on searches of `amulett tune-law`, the overhead on tasks of a second. One and two
workers take turns, so that a busy machine slows both alike; but both need cores that are free, so the command also
prints how much of two cores it got.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.laws import tune_all
from amulett_gym.storage.kept import write_kept
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.speed.command import command
from amulett_gym.workers.call import Call, Workers, check_ray
from amulett_gym.workers.run import results

TURNS = 3

SEARCH = Recipe("parametric", suite="mixed", seeds=(1, 2)).within(100_000)
"""What is searched: about 40 s from each of two starts on a free core; the start of a worker, 1 s, counts little."""

TASK = 1.0
"""Length of a task whose overhead is measured [s]."""

LIMITS = {"gain": 1.8, "overhead": 0.05}
"""Least gain of two workers, and largest overhead as a part of the task."""

SIZES = {1_000: 2_000, 100_000: 500, 10_000_000: 20}
"""Sizes of results [bytes] -> how many of them."""


def measure(two: Workers, turns: int) -> dict[str, Any]:
    """Return all that is measured; `two` are two workers.

    Parameters
    ----------
    two : Workers
    turns : int
        Repetitions of each measurement; medians count.
    """
    one = Workers(1, two.ray)
    gains, got, overheads = [], [], []
    with tempfile.TemporaryDirectory(prefix="amulett-workers-") as folder:
        _search(Path(folder) / "first", two)  # compiles, if need be
        for turn in range(turns):
            alone = _search(Path(folder) / f"one-{turn}", one)
            gains.append(alone / _search(Path(folder) / f"two-{turn}", two))
            got.append(_free_cores())
            overheads.append(_overhead(one))
        rates = {f"tasks of 0 s, {two.words()}": _rate(two, 0, 500)}
        for size, count in SIZES.items():
            rates[f"results of {size:,} bytes"] = _rate(two, size, count)
        files = _files(Path(folder) / "files", 1000)
    return {
        "workers": two.words(),
        "cores": os.cpu_count(),
        "gain": gains,
        "free_cores": got,
        "overhead": overheads,
        "tasks_per_second": rates,
        "files_per_second": files,
    }


def text(found: dict[str, Any]) -> str:
    """Return what was measured as text, with the limits."""
    gain, part = statistics.median(found["gain"]), statistics.median(found["overhead"])
    free = statistics.median(found["free_cores"])
    lines = [
        f"{found['workers']} on {found['cores']} cores, of which {free:.2f} of 2 were free",
        f"two workers are {gain:.2f} times as fast as one ({min(found['gain']):.2f} to {max(found['gain']):.2f}; "
        f"wanted: {LIMITS['gain']}){'' if gain >= LIMITS['gain'] else '  MISSED'}",
        f"overhead of a task of {TASK:g} s: {100 * part:.1f} % (wanted: below {100 * LIMITS['overhead']:g} %)"
        f"{'' if part < LIMITS['overhead'] else '  MISSED'}",
    ]
    for name, rate in found["tasks_per_second"].items():
        lines.append(f"{name:40} {rate:10,.0f} per second")
    lines += [f"{name:40} {rate:10,.0f} per second" for name, rate in found["files_per_second"].items()]
    return "\n".join(lines)


def _search(folder: Path, workers: Workers) -> float:
    """Return the time of a search [s]."""
    return _seconds(lambda: tune_all(folder, [SEARCH], workers=workers))


def _seconds(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def _overhead(one: Workers, count: int = 10) -> float:
    """Return the time that a task costs beyond its own, as a part of it; the start of a worker is not counted."""
    begun = 0.0
    spent = []
    for _, own in results({f"task {k}": Call(_wait) for k in range(count + 1)}, Workers(1, one.ray)):
        if begun == 0.0:  # the worker is there
            begun = time.perf_counter()
        else:
            spent.append(own)
    return (time.perf_counter() - begun - sum(spent)) / sum(spent)


def _wait() -> float:
    """Wait for `TASK`, and return for how long exactly."""
    begun = time.perf_counter()
    time.sleep(TASK)
    return time.perf_counter() - begun


def _rate(workers: Workers, size: int, count: int) -> float:
    """Return how many tasks with a result of a size are finished per second; the first ones start workers."""
    begun, first = 0.0, count // 10
    for number, _ in enumerate(results({f"task {k}": Call(bytes, (size,)) for k in range(count)}, workers), 1):
        if number == first:
            begun = time.perf_counter()
    return (count - first) / (time.perf_counter() - begun)


def _files(folder: Path, count: int) -> dict[str, float]:
    """Return how many kept files are written per second."""
    kinds: dict[str, Any] = {"json": {"cost": 1.0}, "npz": {"values": np.zeros((20, 200))}}
    rates = {}
    for kind, content in kinds.items():

        def write(kind: str = kind, content: Any = content) -> None:
            for k in range(count):
                write_kept(folder / f"{k}.{kind}", "inputs", content)

        rates[f"kept files (.{kind})"] = count / _seconds(write)
    return rates


def _free_cores(seconds: float = 1.0) -> float:
    """Return the cores that two processes get just now, from 0 to 2."""
    shares = dict(results({"a": Call(_share, (seconds,)), "b": Call(_share, (seconds,))}, Workers(2)))
    return sum(shares.values())


def _share(seconds: float) -> float:
    """Compute for a time, and return the part of it in which this process had a core."""
    end, before = time.perf_counter() + seconds, time.process_time()
    while time.perf_counter() < end:
        pass
    return (time.process_time() - before) / seconds


def main() -> int:
    """Run the command; return 1 if a limit is missed."""
    parser = command(__doc__, "workers", TURNS)
    parser.add_argument("--ray", metavar="ADDRESS", help="measure a Ray cluster with two free cores")
    arguments = parser.parse_args()
    if arguments.turns < 1:
        parser.error("at least one turn is needed")
    if arguments.ray is not None:
        check_ray(arguments.ray)
    found = measure(Workers(2, arguments.ray), arguments.turns)
    print(text(found))
    if arguments.json:
        write_json(arguments.json, found)
    return int(
        statistics.median(found["gain"]) < LIMITS["gain"] or statistics.median(found["overhead"]) >= LIMITS["overhead"]
    )


if __name__ == "__main__":
    sys.exit(main())
