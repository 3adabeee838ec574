"""Files are written to a temporary name and renamed, so that nobody ever sees half of one."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError


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

    If the block fails, the folders that were made for it are removed again, unless something is in them.

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
        if not made and not earlier and any(folder.iterdir()):
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
