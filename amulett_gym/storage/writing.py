"""Files are written to a temporary name and renamed, so that a file is always whole."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import user_path, visible


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
    path = user_path(path)
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
    """Yield an empty folder for files; once all are written, move them to `folder`, where they replace `names`.

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
    folder = user_path(folder)
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
def after_results(files: str) -> Iterator[None]:
    """Let errors in a block that only draws say that the results are already written, to `files`."""
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
    folder = user_path(path)
    _check_folder(folder)
    made: list[Path] = []
    try:
        made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        earlier = any(all((folder / name).is_file() for name in mark) for mark in marks)
        if not made and not earlier and visible(folder):
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


def check_writable(path: str | Path) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold.

    Raises
    ------
    AmulettError
        If it is a folder, or its folder cannot be made or written.
    """
    path = user_path(path)
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
