"""Atomic writing of files: to a temporary name that is renamed."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import user_path, visible


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`; rename it to `path` if the block succeeds, delete it if not.

    Missing parent folders are created.

    Raises
    ------
    AmulettError
        If the folder cannot be created or written.
    """
    path = user_path(path)
    with _refusing(f"cannot write '{path}'"):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def files_together(folder: str | Path, names: Sequence[str]) -> Iterator[Path]:
    """Yield an empty folder for new files; at the end of the block, move them to `folder` (made if it is missing).

    If the block fails, for example because the disk is full, `folder` keeps its content. Files of `folder` listed in
    `names` are replaced, or deleted if there is no new one of that name.

    Raises
    ------
    AmulettError
        If the folder cannot be written.
    """
    folder = user_path(folder)
    with _refusing(f"cannot write to the folder '{folder}'"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as temporary:
            yield Path(temporary)
            new = {path.name: path for path in Path(temporary).iterdir()}
            for name in {*names} - {*new}:
                (folder / name).unlink(missing_ok=True)
            for name, path in new.items():
                path.replace(folder / name)


def replace_folder(new: Path, folder: Path, old: Path) -> None:
    """Rename `new` to `folder`; an existing folder is moved to `old` and deleted, or moved back if that fails."""
    replaces = folder.exists()
    if replaces:
        folder.rename(old)
    try:
        new.rename(folder)
    except BaseException:  # Ctrl-C, too
        if replaces:
            old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def after_results(files: str) -> Iterator[None]:
    """Add to errors in a block that draws figures that the results are already written, to `files`."""
    note = f"only the figures are missing: the results are in {files}"
    try:
        yield
    except AmulettError as error:
        raise AmulettError(f"{error}; {note}") from error
    except Exception as error:
        error.add_note(f"amulett: {note}")
        raise


@contextmanager
def output_folder(path: str | Path, what: str, marks: Sequence[Sequence[str]]) -> Iterator[bool]:
    """Make a command's output folder before any work, and yield whether it holds an earlier output of the same kind.

    If the block fails, the folders that were made for it are removed again if they are empty.

    Parameters
    ----------
    path : str or Path
        The folder.
    what : str
        The kind of output in an error message, e.g. ``"comparison"``.
    marks : sequence of sequence of str
        A folder that has all files of one of these sets holds an earlier output.

    Raises
    ------
    AmulettError
        If the folder or a parent is a file, the folder cannot be written, or it holds something else than an earlier
        output.
    """
    folder, made = user_path(path), list[Path]()
    try:
        with _refusing(f"cannot write to the folder '{path}'"):
            _check_folder(folder)
            made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
            earlier = any(all((folder / name).is_file() for name in mark) for mark in marks)
            if not made and not earlier and visible(folder):
                raise AmulettError(f"'{path}' is not empty and holds no {what}; choose another folder")
            _try_to_write(folder)
        yield earlier
    except BaseException:
        with suppress(OSError):
            for parent in made:
                parent.rmdir()
        raise


def check_writable(path: str | Path) -> None:
    """Refuse a file that cannot be written, before the work whose result it will hold.

    Raises
    ------
    AmulettError
        If it is a folder, or its folder cannot be made or written.
    """
    path = user_path(path)
    if path.is_dir():
        raise AmulettError(f"'{path}' is a folder; it has to be a file")
    with _refusing(f"cannot write '{path}'"):
        _try_to_write(path.parent)


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


def _check_folder(folder: Path) -> None:
    """Refuse a folder that is a file, or below one."""
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            kind = "is a file" if place == folder else f"cannot be a folder: '{place}' is a file"
            raise AmulettError(f"'{folder}' {kind}; choose another folder")


def _try_to_write(folder: Path) -> None:
    """Make a folder if it is missing; raise OSError if no file can be made in it."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass


@contextmanager
def _refusing(problem: str) -> Iterator[None]:
    """Turn an OSError of the block into an AmulettError."""
    try:
        yield
    except OSError as error:
        raise AmulettError(f"{problem}: {error.strerror or error}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
