"""Results kept in files with their inputs: read back as long as the inputs are the same, else computed again.

A file that is missing, damaged or made from other inputs counts as no result; the new result replaces it whole.
``.json`` holds plain data, ``.npz`` arrays.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from amulett_gym.errors import AmulettError
from amulett_gym.settings import to_plain
from amulett_gym.storage.reading import read_arrays, read_json
from amulett_gym.storage.writing import atomic_path, write_json

T = TypeVar("T")

MAX_BYTES = 400_000_000
"""Size of the largest file that is read back [bytes]."""

_DIGEST = "sha256"  # name of the inputs' digest in an .npz


def digest(*parts: Any) -> str:
    """Return the SHA-256 of inputs, one after the other, as 64 hexadecimal digits.

    Bytes, text and arrays count by their bytes; plain data as JSON with sorted keys, where NumPy's numbers and arrays
    count as Python's, and paths as text.

    Raises
    ------
    TypeError
        If plain data holds an object of another kind.
    """
    content = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            content.update(np.ascontiguousarray(part).tobytes())
        elif isinstance(part, bytes):
            content.update(part)
        else:
            content.update((part if isinstance(part, str) else _text(part)).encode())
    return content.hexdigest()


def kept(
    path: str | Path,
    inputs: Any,
    make: Callable[[], T],
    pack: Callable[[T], Any] = lambda result: result,
    unpack: Callable[[Any], T] = lambda content: content,
) -> T:
    """Return a result from its file, or compute it and keep it there.

    Parameters
    ----------
    path : str or Path
        ``.json`` or ``.npz``. Missing parent folders are created.
    inputs : plain data
        All that the result depends on; long inputs as their `digest`.
    make : callable
        Returns the result.
    pack : callable
        Result -> plain data, or a dict of arrays for an ``.npz``.
    unpack : callable
        The inverse; a KeyError, TypeError or ValueError means that the content cannot be used.

    Raises
    ------
    AmulettError
        If the file cannot be written.
    """
    content = read_kept(path, inputs)
    if content is not None:
        with suppress(KeyError, TypeError, ValueError):
            return unpack(content)
    result = make()
    write_kept(path, inputs, pack(result))
    return result


def read_kept(path: str | Path, inputs: Any) -> Any:
    """Return what `write_kept` wrote for these inputs, or None."""
    try:
        if Path(path).suffix == ".npz":
            arrays = read_arrays(path, "result", MAX_BYTES)
            return arrays if str(arrays.pop(_DIGEST, None)) == _name(inputs) else None
        content = read_json(path, "result", MAX_BYTES)
    except AmulettError:
        return None
    found = isinstance(content, dict) and content.get("inputs") == json.loads(_text(inputs))
    return content.get("result") if found else None


def write_kept(path: str | Path, inputs: Any, content: Any) -> None:
    """Write a result with its inputs, atomically; see :func:`kept`.

    Raises
    ------
    AmulettError
        If the file cannot be written.
    """
    if Path(path).suffix == ".npz":
        arrays: dict[str, Any] = {_DIGEST: np.array(_name(inputs)), **content}
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)
    else:
        write_json(path, {"inputs": json.loads(_text(inputs)), "result": content})


def _name(inputs: Any) -> str:
    return inputs if isinstance(inputs, str) else digest(inputs)


def _text(data: Any) -> str:
    return json.dumps(to_plain(data), sort_keys=True)
