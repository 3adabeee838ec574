"""Temporary folders of calls, which do not stay when a call is killed."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

from amulett_gym.errors import AmulettError
from amulett_gym.storage.lock import locked_folder

_PREFIX = "amulett-call-"

_NEW = 60.0
"""Age below which a folder may be one whose owner has not locked it yet [s]."""


@contextmanager
def call_folder() -> Iterator[Path]:
    """Yield an empty folder that is removed at the end of the block, or else by a later call on this machine.

    Raises
    ------
    AmulettError
        If it cannot be locked.
    """
    _remove_left()
    with TemporaryDirectory(prefix=_PREFIX) as place, locked_folder(place):
        folder = Path(place) / "files"
        folder.mkdir()
        yield folder


def _remove_left() -> None:
    """Remove the folders of calls that were killed: those that no process has locked."""
    for path in Path(gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError, AmulettError):  # another user's, in use, or just removed by another process
            if time.time() - path.stat().st_mtime > _NEW:
                with locked_folder(path):
                    shutil.rmtree(path)
