"""Make calls with the chosen workers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from typing import TypeVar

from amulett_gym.workers.call import ALONE, Call, Workers, named
from amulett_gym.workers.processes import in_processes
from amulett_gym.workers.report import listening

T = TypeVar("T")


def results(
    calls: Mapping[str, Call[T]], workers: Workers = ALONE, watch: Callable[[int], object] = lambda units: None
) -> Generator[tuple[str, T]]:
    """Yield the name and result of each call as it finishes; the results do not depend on the workers.

    A call whose worker is killed is made again; it continues from what it has kept in its folder. Calls end when the
    generator is closed.

    Parameters
    ----------
    calls : mapping
        Calls by name; errors name it.
    workers : Workers
        With one on this machine, or for one call, calls are made in this process.
    watch : callable
        Called with the number of units by which all calls advanced since the last time. It may be negative after a
        worker is lost: its units since the call's last `report.keep` are done again.

    Raises
    ------
    AmulettError
        If a call raises it, loses its worker too often, or the cluster cannot be used. The other calls are ended.
    Exception
        What else a call raises.
    """
    if workers.ray is not None:
        from amulett_gym.workers.cluster import on_cluster

        return on_cluster(calls, workers, watch)
    if workers.alone or len(calls) < 2:
        return _here(calls, watch)
    return in_processes(calls, workers.number or 1, watch)


def _here(calls: Mapping[str, Call[T]], watch: Callable[[int], object]) -> Generator[tuple[str, T]]:
    for name, call in calls.items():
        with listening(watch):
            try:
                result = call.make()
            except Exception as error:
                named(error, name)
                raise
        yield name, result
