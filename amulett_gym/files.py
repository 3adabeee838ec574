"""Files are written to a temporary name and renamed, so that nobody ever sees half of one.

Files that are read may come from strangers: how large and how deeply nested they may be is limited, and nothing but
ordinary files is opened.
"""

from __future__ import annotations

import errno
import io
import json
import math
import os
import socket
import stat
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from numpy.typing import NDArray

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""Name of the file by which a command keeps a folder to itself."""

MAX_DEPTH = 32
"""Levels of lists and mappings in a file that is read; no file of ours has more than ten."""

MAX_DIGITS = 100
"""Digits of an integer in such a file."""

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
def files_together(folder: str | Path, names: Sequence[str]) -> Iterator[Path]:
    """Yield an empty folder for files; once all are written, move them to `folder`, in the place of its `names`.

    If the block fails, for example because the disk is full, what is in `folder` stays as it is.

    Parameters
    ----------
    folder : str or Path
        Made if it does not exist.
    names : sequence of str
        Files of `folder` that go, whether or not there are new ones of that name.

    Raises
    ------
    AmulettError
        If the folder cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as temporary:
            yield Path(temporary)
            new = {path.name: path for path in Path(temporary).iterdir()}
            for name in names:
                if name not in new:
                    (folder / name).unlink(missing_ok=True)
            for name, path in new.items():
                path.replace(folder / name)
    except OSError as error:
        raise AmulettError(f"cannot write to the folder '{folder}': {error.strerror or error}") from error


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
    write_text(path, to_json(value))


def to_json(value: Any) -> str:
    """Return `value` as :func:`write_json` writes it."""
    return json.dumps(value, indent=2, allow_nan=False) + "\n"


def read_bytes(path: str | Path, what: str, limit: int = 4_000_000, follow: bool = True) -> bytes:
    """Read an ordinary file; a pipe or a device might never end.

    Parameters
    ----------
    path : str or Path
        The file.
    what : str
        What the file holds, for the error message.
    limit : int
        Largest size accepted, in bytes.
    follow : bool
        Whether `path` may be a symbolic link.

    Raises
    ------
    AmulettError
        If the file is missing, unreadable, no ordinary one or larger than `limit`.
    """

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0) | (0 if follow else getattr(os, "O_NOFOLLOW", 0)))

    try:
        if not follow and Path(path).is_symlink():
            raise AmulettError(f"{what} '{path}' is a symbolic link; it has to be an ordinary file")
        with open(path, "rb", opener=opener) as file:  # a Path opens without an opener
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise AmulettError(f"{what} '{path}' is no ordinary file")
            content = file.read(limit + 1) if status.st_size <= limit else b""
            size = max(status.st_size, len(content))  # it may be growing
    except OSError as error:
        raise AmulettError(f"cannot read {what} '{path}': {error.strerror or error}") from error
    except ValueError as error:
        if isinstance(error, AmulettError):
            raise
        raise AmulettError(f"cannot read {what} {str(path)!r}: {error}") from error  # a zero byte in the name
    if size > limit:
        raise AmulettError(f"{what} '{path}' has {size} bytes; at most {limit} are allowed")
    return content


def read_text(path: str | Path, what: str, limit: int = 4_000_000) -> str:
    """Read a UTF-8 text file; see :func:`read_bytes` for the parameters.

    Raises
    ------
    AmulettError
        If the file is missing, unreadable, no ordinary one, larger than `limit` or not UTF-8.
    """
    try:
        text = read_bytes(path, what, limit).decode("utf-8")
    except UnicodeDecodeError as error:
        raise AmulettError(f"{what} '{path}' is not UTF-8 text") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: str | Path, what: str, limit: int = 4_000_000) -> Any:
    """Read a JSON file; see :func:`read_bytes` for the parameters.

    Raises
    ------
    AmulettError
        If the file cannot be read or :func:`parse_json` refuses its text.
    """
    return parse_json(read_text(path, what, limit), f"{what} '{path}'")


def parse_json(text: str, what: str) -> Any:
    """Return what a JSON text stands for.

    Raises
    ------
    AmulettError
        If it is no valid JSON, nested more than `MAX_DEPTH` deep, holds a key twice or a number that is not finite or
        has more than `MAX_DIGITS` digits.
    """
    try:
        value = json.loads(text, object_pairs_hook=_object, parse_constant=_no_constant)
        check_tree(value)
    except (ValueError, RecursionError) as error:
        message = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise AmulettError(f"{what} is not valid JSON: {message}") from error
    return value


def read_arrays(path: str | Path, what: str, limit: int = 400_000_000) -> dict[str, NDArray[Any]]:
    """Read the arrays of an ``.npz`` file, none of them of Python objects; see :func:`read_bytes` for the parameters.

    Raises
    ------
    AmulettError
        If the file cannot be read, is larger than `limit`, packed or unpacked, or is damaged.
    """
    import numpy as np

    content = read_bytes(path, what, limit)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > limit:
            raise ValueError(f"it has {size} bytes unpacked; at most {limit} are allowed")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        if not all(isinstance(array, np.ndarray) for array in found.values()):
            raise ValueError("a part of it is no array")
        return found
    except Exception as error:  # zipfile, zlib and numpy do not say what they raise for damaged files
        raise AmulettError(f"{what} '{path}' is damaged: {str(error)[:200]}") from error


def check_tree(value: Any, finite: bool = True) -> None:
    """Raise ValueError if plain data is nested too deeply, or a number is too long or not finite, or a text is none."""
    waiting = [(value, 1)]
    while waiting:
        item, depth = waiting.pop()
        if isinstance(item, dict | list):
            if depth > MAX_DEPTH:
                raise ValueError(f"it is nested more than {MAX_DEPTH} levels deep")
            below = [*item.keys(), *item.values()] if isinstance(item, dict) else item
            waiting += [(part, depth + 1) for part in below]
        elif isinstance(item, str):
            item.encode("utf-8")  # half of a surrogate pair is no text
        elif isinstance(item, float):
            if finite and not math.isfinite(item):
                raise ValueError("it holds a number that is not finite")
        elif isinstance(item, int) and abs(item) >= 10**MAX_DIGITS:
            raise ValueError(f"it holds an integer of more than {MAX_DIGITS} digits")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)[:100]!r} is there twice")
    return content


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number in JSON")


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
