"""Where compiled code is kept from one process to the next: a folder for each state of the sources.

numba's own cache lies beside the sources, where a reinstall deletes it, and a function's code counts as fresh as long
as the function's own file is: after an edit of what it calls in another file, the old code stays. Here a folder is
named after the *content* of all files that compiled code can come from, so that

- the same sources find the same code, wherever and whenever they were installed;
- any edit starts a new folder, so old code is never used. The folders used last are kept, the others deleted;
- it can be anywhere: in ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache folder, else, where the home is
  read-only, in a temporary folder of this user alone. One that is there already need not be writable.

What happens to the files never stops a run: code that cannot be read is compiled again, code that cannot be written is
gone with the process. The rest is numba's: it replaces files whole and distinguishes processors and versions.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import llvmlite
import numba
import platformdirs
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.runtime.nrt import rtsys

PACKAGE = Path(__file__).parent.parent
NAME = "amulett-gym"

SOURCES = (
    *("errors.py", "fitting.py", "fleet.py", "gains.py", "profile.py", "settings.py"),
    *("jit/*.py", "storage/*.py", "control/*.py", "model/*.py"),
    *(f"simulation/{name}.py" for name in ("batch", "commands", "dynamics", "equilibrium", "kernel", "layout")),
    *(f"simulation/{name}.py" for name in ("loops", "metrics", "random", "replay", "sensors", "setpoint")),
    *("simulation/worn.py", "simulation/worn_layout.py"),
    *(
        f"envs/{name}.py"
        for name in ("action", "eq6_costs", "privileged", "reward", "settings", "shares", "transition")
    ),
    *(f"envs/worn_{name}.py" for name in ("reward", "settings", "transition")),
    *("tasks/*.py", "laws/*.py", "firmware/lock_step.py"),
)
"""The files with compiled functions, and all of ours that these import: constants are compiled in."""

SETTINGS = ("BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "OPT", "SLP_VECTORIZE", "USING_SVML")
"""Settings of numba that change the code, and that its cache does not distinguish."""

KEPT_FOLDERS = 8
"""A full one takes about 5 MB."""


@cache
def sources() -> frozenset[Path]:
    """Return the files that compiled code can come from."""
    return frozenset(path for pattern in SOURCES for path in PACKAGE.glob(pattern))


def fingerprint() -> str:
    """Return a name for all that compiled code depends on: the sources' content, the compiler and its settings."""
    settings = [getattr(numba.config, name, None) for name in SETTINGS]
    compiler = (sys.implementation.cache_tag, numba.__version__, llvmlite.__version__, settings)
    digest = hashlib.sha256(repr(compiler).encode())
    for path in sorted(sources()):
        content = path.read_bytes()
        digest.update(f"\n{path.relative_to(PACKAGE).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Return this process's folder, made if need be; None if there is no place for one."""
    name = fingerprint()
    return next((place / name for place in _places() if _take(place / name)), None)


def keep_code(function: Any, suffix: str = "", context: Callable[[Any], Any] | None = None) -> None:
    """Let a function that numba compiles keep its code; one of a file not in `SOURCES` is compiled in each process.

    `suffix` distinguishes the files of the same function, compiled with other options. `context` returns, of numba's
    target context, the one into which the code is loaded.
    """
    if cache_folder() is not None and Path(function.py_func.__code__.co_filename) in sources():
        function._cache = CodeCache(function.py_func, suffix, context)


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Says to numba where a function's code is, and that all of it is up to date."""

    def __init__(self, folder: Path, function: Callable[..., Any], file: str) -> None:
        self._folder, self._function = folder, function
        self._py_file = file  # numba names it when it warns

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator | None:
        folder = cache_folder()
        return None if folder is None else cls(folder, py_func, py_file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:
        return f"{self._function.__module__}-{self._function.__code__.co_firstlineno}"


class _Files(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)

    def __init__(self, function: Callable[..., Any], suffix: str, context: Callable[[Any], Any] | None) -> None:
        super().__init__(function)
        self._filename_base += suffix
        self._context = context

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Return the code from what a file holds."""
        return super().rebuild(self._context(target_context) if self._context else target_context, payload)


class CodeCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, in our folder and forgiving."""

    _load = FunctionCache._load_overload

    def __init__(
        self, function: Callable[..., Any], suffix: str = "", context: Callable[[Any], Any] | None = None
    ) -> None:
        self._impl_class = partial(_Files, suffix=suffix, context=context)
        super().__init__(function)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; None if there is none to be used.

        Compiled code needs numba's run time only. numba would first import all that it can compile, and look up its
        types: a quarter of a second, which is left to the first compilation.
        """
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                code = self._load(sig, target_context)
        except Exception:  # a damaged file raises anything; without its index it is written anew
            with suppress(OSError):
                self.flush()
            return None
        # numba numbers files: two processes at a time may have given one number to two signatures.
        return code if code is None or code.signature.args == tuple(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature, if it can be written."""
        with suppress(OSError):
            super().save_overload(sig, data)


def _places() -> Iterator[Path]:
    if numba.config.CACHE_DIR:
        yield Path(numba.config.CACHE_DIR).absolute() / NAME
    with suppress(RuntimeError):  # a user without a home; older versions give a relative path
        user_cache = platformdirs.user_cache_path(NAME, appauthor=False, opinion=False)
        if user_cache.is_absolute():
            yield user_cache
    with suppress(OSError):
        yield _temporary_folder()


def _temporary_folder() -> Path:
    """Make a folder of this user alone: who can write to it could have us run their code."""
    parent = Path(tempfile.gettempdir())
    if sys.platform == "win32":  # lies in the user's own folder
        return parent / NAME
    folder = parent / f"{NAME}-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f"others can write to '{folder}'")
    return folder


def _take(folder: Path) -> bool:
    """Make a folder if it is not there, mark it as used; return whether it can be read."""
    try:
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            _delete_unused(folder.parent)
        with suppress(OSError):  # a read-only one
            os.utime(folder)
        return os.access(folder, os.R_OK | os.X_OK)
    except OSError:
        return False


def _delete_unused(place: Path) -> None:
    """Delete the folders beyond those used last; a process that runs their code has it in memory."""
    with suppress(OSError):
        folders = sorted(place.iterdir(), key=lambda folder: folder.stat().st_mtime, reverse=True)
        for folder in folders[KEPT_FOLDERS:]:
            shutil.rmtree(folder, ignore_errors=True)
