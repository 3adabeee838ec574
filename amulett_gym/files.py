"""Files are written to a temporary name and renamed, so that nobody ever sees half of one."""

from __future__ import annotations

import errno
import json
import os
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""Name of the file by which a command keeps a folder to itself."""

_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` if the block succeeds, delete it if not.

    Parameters
    ----------
    path : str or Path
        The file to write. Missing parent folders are created.

    Raises
    ------
    AmulettError
        If the folder cannot be created or written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise AmulettError(f"cannot write '{path}': {error.strerror or error}") from error
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise AmulettError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def output_folder(path: str | Path, what: str, marks: Sequence[Sequence[str]]) -> Iterator[bool]:
    """Make a command's output folder before any work, and yield whether it holds an earlier output of that kind.

    If the block fails, the folders that were made for it are removed again, unless something is in them. Hidden files
    are no content: file managers leave some behind, and so does a process that was killed.

    Parameters
    ----------
    path : str or Path
        The folder.
    what : str
        What an earlier output is called in an error message, e.g. ``"comparison"``.
    marks : sequence of sequence of str
        An earlier output is recognised by files in it: by all of one of these sets.

    Raises
    ------
    AmulettError
        If the folder or a parent is a file, nothing can be written to it, or it holds something else than an earlier
        output.
    """
    folder = Path(path)
    _check_folder(folder)
    made: list[Path] = []
    try:
        made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        earlier = any(all((folder / name).is_file() for name in mark) for mark in marks)
        if not made and not earlier and any(not place.name.startswith(".") for place in folder.iterdir()):
            raise AmulettError(f"'{path}' is not empty and holds no {what}; choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        _remove_empty(made)
        raise AmulettError(f"cannot write to the folder '{path}': {error.strerror or error}") from error
    try:
        yield earlier
    except BaseException:
        _remove_empty(made)
        raise


@contextmanager
def locked_folder(path: str | Path) -> Iterator[None]:
    """Keep a folder to this process during the block, by a lock on the file ``.lock`` in it.

    The system takes the lock from a process that dies, however it dies, so a file that is left behind locks nobody out.
    Where the file system knows no locks, the owner that the file names is looked for: on this computer, whether the
    process lives; on another one it is taken to.

    Parameters
    ----------
    path : str or Path
        An existing folder.

    Raises
    ------
    AmulettError
        If another process, or this one, has the folder already: with the owner's process id, host and start; or if the
        file cannot be written.
    """
    lock = Path(path) / LOCK
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


def check_writable(path: str | Path) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold.

    Raises
    ------
    AmulettError
        If it is a folder, or its folder cannot be made or written.
    """
    path = Path(path)
    if path.is_dir():
        raise AmulettError(f"'{path}' is a folder; it has to be a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise AmulettError(f"cannot write '{path}': {error.strerror or error}") from error


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` atomically (UTF-8)."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` to `path` atomically as indented JSON; NaN is refused, since JSON has none."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_text(path: str | Path, what: str, limit: int = 4_000_000) -> str:
    """Read a UTF-8 text file.

    Parameters
    ----------
    path : str or Path
        The file.
    what : str
        What the file holds, for the error message.
    limit : int
        Largest size accepted, in bytes.

    Raises
    ------
    AmulettError
        If the file is missing, unreadable, larger than `limit` or not UTF-8.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > limit:
            raise AmulettError(f"{what} '{path}' has {size} bytes; at most {limit} are allowed")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise AmulettError(f"cannot read {what} '{path}': {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise AmulettError(f"{what} '{path}' is not UTF-8 text") from error


def _open_lock(lock: Path) -> int:
    """Return the handle of the lock file, locked and with this process as the owner in it."""
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if _is_owned(handle):
                raise AmulettError(f"'{lock.parent}' is in use by {_owner(handle)}; choose another folder, or wait")
            # Whoever had it may have deleted the file just now: then the next one would lock another file.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), lock.stat()):
                    _write_owner(handle)
                    return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _is_owned(handle: int) -> bool:
    """Lock a lock file, and tell whether somebody else has it."""
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
    if not owner:  # it has locked the file, and not written to it yet
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
        return True
    return True


def between_marks(document: str, path: str | Path, first: str, last: str, text: str) -> str:
    """Return a document with `text` between two of its lines, in the place of what was there.

    Parameters
    ----------
    document : str
        Its content.
    path : str or Path
        Where it is, for the error message.
    first, last : str
        The lines.
    text : str

    Raises
    ------
    AmulettError
        If the document has not both lines once, in their order.
    """
    begin, end = document.find(first), document.find(last)
    if begin < 0 or end < begin or document.count(first) != 1 or document.count(last) != 1:
        raise AmulettError(f"document '{path}' has to hold the line '{first}' once, and after it '{last}' once")
    return f"{document[:begin]}{first}\n\n{text}\n\n{document[end:]}"


def _check_folder(folder: Path) -> None:
    """Refuse a folder that is a file, or that would be in one."""
    try:
        for place in (folder, *folder.parents):
            if place.exists() and not place.is_dir():
                kind = "is a file" if place == folder else f"cannot be a folder: '{place}' is a file"
                raise AmulettError(f"'{folder}' {kind}; choose another folder")
    except OSError as error:
        raise AmulettError(f"cannot write to the folder '{folder}': {error.strerror or error}") from error


def _remove_empty(folders: Sequence[Path]) -> None:
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
