"""A lock on a folder, which the system releases when the process ends."""

from __future__ import annotations

import errno
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import user_path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


LOCK = ".lock"
"""Name of the file by which a command reserves a folder."""

_PATIENCE = 2.0  # [s]; for the lock of a dead process
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


@contextmanager
def locked_folder(path: str | Path) -> Iterator[None]:
    """Reserve an existing folder for this process during the block, by a lock on the file ``.lock`` in it.

    The system releases the lock when a process ends, however it ends, so a file that is left behind blocks no process.
    Where the file system has no locks, the owner named in the file counts: on this computer as long as its process
    lives, on another one always.

    Raises
    ------
    AmulettError
        If another process, or this one, has locked the folder (the error names its process id, host and start), or the
        file cannot be written.
    """
    lock = user_path(path) / LOCK
    try:
        handle = _open_lock(lock)
    except OSError as error:
        raise AmulettError(f"cannot lock the folder '{path}': {error.strerror or error}") from error
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(handle)


def _open_lock(lock: Path) -> int:
    """Return the handle of the lock file, locked, with this process written to it as the owner."""
    end = time.monotonic() + _PATIENCE
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if _is_owned(handle):
                if not _is_released_soon(handle) or time.monotonic() > end:
                    raise AmulettError(f"'{lock.parent}' is in use by {_owner(handle)}; choose another folder, or wait")
                time.sleep(0.01)
            else:
                # If its last owner has just deleted the file, the next process would lock another one: try again.
                with suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(handle), lock.stat()):
                        _write_owner(handle)
                        return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _is_owned(handle: int) -> bool:
    """Lock a lock file; return whether another process has it."""
    try:
        if fcntl is None:
            raise OSError(errno.ENOSYS, "no locks")
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        owner = _read_owner(handle)
        return bool(owner) and (owner.get("host") != socket.gethostname() or _is_alive(owner.get("pid")))
    return False


def _is_released_soon(handle: int) -> bool:
    """Return whether the owner is dead: a child that it was about to start has its lock until it runs its program."""
    owner = _read_owner(handle)
    return owner.get("host") == socket.gethostname() and not _is_alive(owner.get("pid"))


def _write_owner(handle: int) -> None:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "started": now}).encode())


def _read_owner(handle: int) -> dict[str, Any]:
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        owner = json.loads(os.read(handle, 1000))
    except ValueError:
        return {}
    return owner if isinstance(owner, dict) else {}


def _owner(handle: int) -> str:
    owner = _read_owner(handle)
    if not owner:  # it has not written to the file yet
        return "another process"
    return f"process {owner.get('pid')} on {owner.get('host')}, since {owner.get('started')}"


def _is_alive(pid: Any) -> bool:
    if not isinstance(pid, int) or pid <= 0:
        return False
    if os.name == "nt":  # there, signal 0 is Ctrl-C
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
