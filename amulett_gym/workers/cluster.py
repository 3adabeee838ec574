"""Calls on a Ray cluster that is already there; no file system is shared with it.

A call is a Ray task of one processor. Its files go with it, and come back while it is made (`report.keep`) and with its
result, so that this process alone writes. Lost tasks are submitted again from here with the files of that moment, which
Ray's own retries do not know.
"""

from __future__ import annotations

import os
import pickle
import re
import socket
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, Generic, TypeVar

from amulett_gym.errors import AmulettError, shorten
from amulett_gym.jit.code_cache import fingerprint
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, versions
from amulett_gym.storage.temporary import call_folder
from amulett_gym.workers.call import MOST_LOST, Call, Workers, check_ray, lost, named
from amulett_gym.workers.files import Stamps, contents, put, stamps
from amulett_gym.workers.report import listening

T = TypeVar("T")

_BETWEEN = 1.0
"""Time between two reports of progress, between two copies of a call's files, and between two readings [s]."""

_AHEAD = 2
"""Tasks submitted for each processor of the cluster: the next one waits where the one before it ends."""

_LOOK = 10.0
"""Time between two looks at the size of the cluster [s]."""

_KNOCK = 10.0
"""Longest time until a cluster answers [s]."""

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
"""Begin of a connection of HTTP/2 (RFC 9113, section 3.4) with empty settings. The answer begins with settings, too."""

_SETTINGS = 4
"""Type of a frame with settings."""

_PATIENCE = 10.0
"""Time without a processor for any call after which a note says so [s]."""

_SHARE = 10
"""Least time between two copies of a call's files, in multiples of the time that one takes."""

_Kept = tuple[dict[str, bytes], list[str]]
"""Contents of new or changed files, and names of those that are gone."""

_runs = count()  # numbers of `_make_all` in this process


@dataclass(frozen=True)
class _Done(Generic[T]):
    """What a task returns: the result or the error of its call, its last files, and all its units."""

    result: T | None
    error: Exception | None
    host: str
    kept: _Kept
    units: int


@dataclass
class _Task:
    """A submitted call; `number` tells its reports from those of an earlier task of the same call."""

    name: str
    number: int
    lock: ExitStack
    units: int = 0
    """Units that are reported."""
    kept: int = 0
    """Units that are kept; the others are done again if the task is lost."""


def on_cluster(
    calls: Mapping[str, Call[T]], workers: Workers, watch: Callable[[int], object] = lambda units: None
) -> Generator[tuple[str, T]]:
    """Yield the name and result of each call as it finishes; see `run.results`."""
    if calls:
        yield from _make_all(_connected(workers.ray or "auto"), calls, workers.number, watch)


_ours: str | None = None  # address of the connection that this module has made


def _connected(address: str) -> Any:
    """Return Ray, connected to the cluster until this process ends: its workers stay for the next calls.

    A connection that this process has made itself is used whatever the address is.
    """
    global _ours
    check_ray(address)
    import ray

    if ray.is_initialized() and _ours not in (None, address):
        ray.shutdown()
    if ray.is_initialized():
        return ray
    try:
        _knock(address)
        ray.init(address, log_to_driver=False, logging_level="warning")
    except (OSError, RuntimeError, ValueError, ImportError, ray.exceptions.RayError) as error:
        ray.shutdown()  # of a client that is half connected
        raise AmulettError(
            f"no Ray cluster can be used at '{address}': {_short(error)}. Start one with 'ray start --head', and see "
            "docs/scale.md"
        ) from error
    _ours = address
    return ray


def _short(error: BaseException) -> str:
    return shorten(" ".join(str(error).split()) or type(error).__name__, 400).rstrip(".")


def _knock(address: str) -> None:
    """Raise OSError if nothing listens at the address, or something else than gRPC: Ray would try for minutes."""
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=_KNOCK) as connection:
        if os.environ.get("RAY_USE_TLS", "0") in ("0", ""):  # else there is a handshake first
            connection.sendall(_PREFACE)
            try:
                frame = connection.recv(9)
            except (TimeoutError, ConnectionError):
                frame = b""
            if len(frame) < 9 or frame[3] != _SETTINGS:
                raise OSError("a program that is not Ray listens there")


@cache
def _mailbox(ray: Any, job: str, node: str) -> Any:
    """Return the actor that holds reports until this process reads them: one for each connection, on its node."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    class Mailbox:  # in this function, so that Ray sends its code, and its process imports nothing else
        def __init__(self) -> None:
            self.reports: dict[int, list[Any]] = {}

        def put(self, run: int, report: Any) -> None:
            self.reports.setdefault(run, []).append(report)

        def take(self, run: int) -> list[Any]:
            return self.reports.pop(run, [])

    place = NodeAffinitySchedulingStrategy(node, soft=False)
    return ray.remote(num_cpus=0, scheduling_strategy=place)(Mailbox).remote()


def _make_all(
    ray: Any, calls: Mapping[str, Call[T]], number: int | None, watch: Callable[[int], object]
) -> Generator[tuple[str, T]]:
    here, run = ray.get_runtime_context(), next(_runs)
    mailbox = _mailbox(ray, here.get_job_id(), here.get_node_id())
    task = ray.remote(num_cpus=1, max_retries=0)(_make)
    wanted = _software()
    todo, losses, submitted = list(calls)[::-1], Counter[str](), 0
    made: dict[Any, _Task] = {}
    limit, looked, read = 0, -float("inf"), time.monotonic()
    waits_since: float | None = time.monotonic()  # None: a call has begun
    failure: Exception | None = None
    lost_cluster = (ray.exceptions.RayError, ConnectionError)

    def submit() -> None:
        nonlocal submitted
        submitted += 1
        name = todo.pop()
        call, files, lock = calls[name], dict[str, bytes](), ExitStack()
        if call.folder is not None:
            if not call.files:
                call.folder.mkdir(parents=True, exist_ok=True)
                lock.enter_context(locked_folder(call.folder))
            files = contents(call.folder, stamps(call.folder, call.files))
        try:
            options = task.options(name=f"amulett: {name}")
            ref = options.remote(call, submitted, files, (mailbox, run), wanted, waits_since is not None)
        except Exception as error:  # arguments that cannot be pickled
            lock.close()
            raise named(error, name) from error
        made[ref] = _Task(name, submitted, lock)

    def submit_more() -> None:
        nonlocal limit, looked
        if time.monotonic() - looked > _LOOK:  # nodes come and go
            limit, looked = number or _AHEAD * max(int(ray.cluster_resources().get("CPU", 1)), 1), time.monotonic()
        while todo and len(made) < limit:
            submit()

    def read_reports() -> None:
        nonlocal read, waits_since
        read = time.monotonic()
        running = {task.number: task for task in made.values()}
        for source, units, kept in ray.get(mailbox.take.remote(run)):
            waits_since = None
            if (task := running.get(source)) is None:  # ended
                continue
            watch(units - task.units)
            task.units = units
            if kept is not None:
                task.kept = units
                if any(kept):
                    _write(calls[task.name], *kept)
                    losses[task.name] = 0

    def end(ref: Any) -> list[tuple[str, T]]:
        """Keep what a task returned; return its call's name and result, nothing if it is lost or its call failed."""
        nonlocal failure
        ended = made.pop(ref)
        with ended.lock:
            outcome = _outcome(ray, ref, ended.name)
            if isinstance(outcome, str):
                watch(ended.kept - ended.units)
                losses[ended.name] += 1
                todo.append(ended.name)
                if losses[ended.name] > MOST_LOST:
                    failure = lost(ended.name, outcome)
                return []
            _write(calls[ended.name], *outcome.kept)
        watch(outcome.units - ended.units)
        if outcome.error is not None:
            failure = named(outcome.error, f"{ended.name}, on {outcome.host}")
            return []
        return [(ended.name, outcome.result)]  # type: ignore[list-item]

    try:
        submit_more()
        while made:
            done, _ = ray.wait(list(made), num_returns=1, timeout=_BETWEEN)
            if done:
                waits_since = None
                done, _ = ray.wait(list(made), num_returns=len(made), timeout=0)
            if time.monotonic() - read > _BETWEEN or any(calls[made[ref].name].folder for ref in done):
                read_reports()  # of a call that ends: what it has kept comes before its last files
            if waits_since is not None and time.monotonic() - waits_since > _PATIENCE:
                waits_since = None if _says_that_it_waits(ray) else time.monotonic()
            finished: list[tuple[str, T]] = []
            for ref in done:
                try:
                    finished += end(ref)
                except lost_cluster:
                    raise
                except (AmulettError, OSError) as error:  # raised after the results of calls that ended with this one
                    failure = error
            try:
                if failure is None:
                    submit_more()  # first: the workers go on while these results are used
            finally:
                yield from finished
            if failure is not None:
                raise failure
    except lost_cluster as error:
        if error is failure:  # a call's own
            raise
        _mailbox.cache_clear()
        raise AmulettError(
            f"the Ray cluster was lost: {_short(error)}. What is finished is kept: run the same command again when the "
            "cluster is back"
        ) from error
    finally:
        for running in made.values():
            running.lock.close()
        with suppress(*lost_cluster):
            for ref in made:
                ray.cancel(ref, force=True)
            mailbox.take.remote(run)  # nothing reads it any more


def _says_that_it_waits(ray: Any) -> bool:
    """Say that no call has begun if no processor is free, and return whether; else a worker is starting."""
    free, most = (int(found().get("CPU", 0)) for found in (ray.available_resources, ray.cluster_resources))
    if free:
        return False
    print(
        f"amulett: note: no call has begun for {_PATIENCE:.0f} s. Each needs a processor of the cluster, which has "
        f"{most}, none of them free. The command waits for one; 'ray status' shows more",
        file=sys.stderr,
        flush=True,
    )
    return True


def _outcome(ray: Any, ref: Any, name: str) -> _Done[Any] | str:
    """Return what a task returned, or why it is lost."""
    errors = ray.exceptions
    try:
        done: _Done[Any] = ray.get(ref)
        return done
    except errors.RayTaskError as error:
        cause = error.cause
        if isinstance(cause, (KeyboardInterrupt, SystemExit)):
            return "its process was ended"
        host = re.search(r"\bip=([^,)\s]+)", str(error))
        place = f"{name}, on {host.group(1)}" if host else name
        raise AmulettError(
            f"{place}: the worker cannot make the call: {_short(cause or error)}. Install the same amulett-gym and "
            "packages on every node"
        ) from error
    except errors.TaskCancelledError:
        return "it was cancelled"
    except errors.RaySystemError as error:
        raise AmulettError(f"{name}: its result cannot be read here: {_short(error)}") from error
    except errors.RayError as error:  # its process or its node, or the node that holds its result
        return type(error).__name__


def _write(call: Call[Any], files: Mapping[str, bytes], removed: list[str]) -> None:
    if call.folder is not None:
        put(call.folder, files, removed)


@cache
def _software() -> dict[str, str]:
    """Return what has to be the same on all machines for the same results; Ray compares the versions of Python."""
    packages = {name: found for name, found in versions().items() if name != "python"}
    return {**packages, "compiled code": fingerprint()}


def _make(
    call: Call[T], number: int, files: dict[str, bytes], reader: tuple[Any, int], wanted: dict[str, str], first: bool
) -> _Done[T]:
    """Make a call on a worker; its files are in a temporary folder. The first calls report that they have begun."""
    with nullcontext() if call.folder is None else call_folder() as folder:
        messenger = _Messenger(number, folder, call.files, reader)
        result, failure = None, None
        if first:
            messenger.send(None)
        try:
            messenger.receive(files)
            if other := differences(wanted, _software()):
                raise AmulettError(f"other software than that of the command: {'; '.join(other)}; install the same")
            with listening(messenger.advance, messenger.keep):
                result = call.make(folder)
        except Exception as error:
            failure = _portable(error)
        return _Done(result, failure, socket.gethostname(), messenger.changes(), messenger.units)


class _Messenger:
    """Sends a task's reports: progress once a second, files not more often and at most for a part of the time."""

    def __init__(self, number: int, folder: Path | None, names: tuple[str, ...], reader: tuple[Any, int]) -> None:
        self._number, self._folder, self._names, self._reader = number, folder, names, reader
        self._sent, self._next_copy = time.monotonic(), 0.0
        self.units = 0
        self._known: Stamps = {}

    def receive(self, files: Mapping[str, bytes]) -> None:
        """Put files into the folder."""
        if self._folder is not None:
            put(self._folder, files)
            self._known = stamps(self._folder, self._names)

    def advance(self, units: int) -> None:
        self.units += units
        if time.monotonic() - self._sent >= _BETWEEN:
            self.send(None)

    def keep(self) -> None:
        begun = time.monotonic()
        if self._folder is not None and begun >= self._next_copy:
            self.send(self.changes())
            now = time.monotonic()
            self._next_copy = now + max(_BETWEEN, _SHARE * (now - begun))

    def changes(self) -> _Kept:
        """Return the contents of the files that are new or changed since the last time, and those that are gone."""
        if self._folder is None:
            return {}, []
        now, before = stamps(self._folder, self._names), self._known
        self._known = now
        new = [name for name, stamp in now.items() if before.get(name) != stamp]
        return contents(self._folder, new), [name for name in before if name not in now]

    def send(self, kept: _Kept | None) -> None:
        """Send all units until now, and files if the call has kept them; return when the mailbox has both."""
        import ray

        mailbox, run = self._reader
        ray.get(mailbox.put.remote(run, (self._number, self.units, kept)))
        self._sent = time.monotonic()


def _portable(error: Exception) -> Exception:
    """Return an error with its traceback in a note; of one that cannot be pickled, its text."""
    trace = "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    if not isinstance(error, AmulettError):
        error.add_note(trace)
    return error
