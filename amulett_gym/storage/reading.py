"""Reading of untrusted files, within limits of size, depth, type of file."""

from __future__ import annotations

import io
import json
import math
import os
import stat
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_DEPTH = 32
"""Levels of lists and mappings in a file that is read; no file of ours has more than ten."""

MAX_DIGITS = 100
"""Digits of an integer in such a file."""


def user_path(path: str | Path) -> Path:
    """Return a path with ``~`` expanded to the home folder; unchanged if there is none."""
    return Path(os.path.expanduser(path))  # noqa: PTH111  (a Path's raises where there is no home)


def visible(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the paths in a folder that match a glob pattern, sorted, without hidden files and folders.

    Hidden files are no content: file managers and killed processes leave some behind.
    """
    paths = folder.iterdir() if pattern == "*" else folder.glob(pattern)  # a glob does not report what it cannot read
    return sorted(path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts))


def read_bytes(path: str | Path, what: str, limit: int = 4_000_000, follow: bool = True) -> bytes:
    """Return the content of an ordinary file; a pipe or a device might never end.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file holds, for the error message.
    limit : int
        Largest size accepted [bytes].
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
        path = user_path(path)
        if not follow and path.is_symlink():
            raise AmulettError(f"{what} '{path}' is a symbolic link; it has to be an ordinary file")
        with open(path, "rb", opener=opener) as file:  # a Path opens without an opener
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise AmulettError(f"{what} '{path}' is no ordinary file")
            content = file.read(status.st_size + 1) if status.st_size <= limit else b""  # memory for no more than that
            if len(content) > status.st_size:  # it is growing
                content += file.read(limit + 1 - len(content))
            size = max(status.st_size, len(content))
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
    """Return the text of a UTF-8 file, with or without a byte order mark, line ends normalised.

    Raises
    ------
    AmulettError
        If `read_bytes` refuses the file, or it is not UTF-8.
    """
    text = to_text(read_bytes(path, what, limit), f"{what} '{path}'")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def to_text(content: bytes, what: str) -> str:
    """Return UTF-8 text without its byte order mark.

    Raises
    ------
    AmulettError
        If it is not UTF-8.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise AmulettError(f"{what} is not UTF-8 text") from error


def read_json(path: str | Path, what: str, limit: int = 4_000_000) -> Any:
    """Return the content of a JSON file; errors as of `read_text` and `parse_json`."""
    return parse_json(read_text(path, what, limit), f"{what} '{path}'")


def parse_json(text: str, what: str) -> Any:
    """Return the content of a JSON text.

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
    """Return the arrays of an ``.npz`` file, none of them of Python objects.

    Raises
    ------
    AmulettError
        If the file cannot be read, is larger than `limit` (also unpacked), or is damaged.
    """
    return parse_arrays(read_bytes(path, what, limit), f"{what} '{path}'", limit)


def parse_arrays(content: bytes, what: str, limit: int) -> dict[str, NDArray[Any]]:
    """Return the arrays in an ``.npz`` file's content, which is called `what` in errors; errors as of `read_arrays`."""
    import numpy as np

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
        raise AmulettError(f"{what} is damaged: {str(error)[:200]}") from error


def check_tree(value: Any, finite: bool = True) -> None:
    """Raise ValueError if plain data is nested too deeply, a number too long or not finite, or a text not Unicode."""
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
