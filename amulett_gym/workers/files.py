"""Files of a call's folder on the way between machines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from amulett_gym.storage.reading import visible
from amulett_gym.storage.writing import atomic_path

Stamps = dict[str, tuple[int, int, int]]
"""Name of each file in a folder -> what changes when it is replaced or grows."""


def stamps(folder: Path, names: Iterable[str] = ()) -> Stamps:
    """Return the stamps of the files in a folder, or of those that `names` (files and folders) choose."""
    return {path.relative_to(folder).as_posix(): _stamp(path) for path in _files(folder, names)}


def contents(folder: Path, names: Iterable[str]) -> dict[str, bytes]:
    """Return the contents of files in a folder."""
    return {name: (folder / name).read_bytes() for name in names}


def put(folder: Path, files: Mapping[str, bytes], removed: Iterable[str] = ()) -> None:
    """Write files into a folder, each whole or not at all, and then remove others, and folders that are empty then.

    Raises
    ------
    AmulettError
        If a file cannot be written.
    """
    for name, content in files.items():
        with atomic_path(folder / name) as temporary:
            temporary.write_bytes(content)
    for name in removed:
        path = folder / name
        path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            for parent in path.parents:
                if parent == folder:
                    break
                parent.rmdir()


def _files(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    chosen = list(names)
    places = [folder / name for name in chosen] if chosen else [folder]
    for place in places:
        yield from [place] if place.is_file() else (path for path in visible(place, "**/*") if path.is_file())


def _stamp(path: Path) -> tuple[int, int, int]:
    found = path.stat()
    return found.st_ino, found.st_size, found.st_mtime_ns
