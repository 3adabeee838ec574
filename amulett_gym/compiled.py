"""How the equations are compiled: strict IEEE float64, cached on disk, the same bits on every call.

No fast math and no contraction, so that a result depends neither on the batch size nor on the position in the batch.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def _cache_is_writable() -> bool:
    """Tell whether numba will find a folder for its cache: beside the source, the user's, or ``NUMBA_CACHE_DIR``."""
    return any(os.access(folder, os.W_OK) for folder in (Path(__file__).parent, Path.home()))


if not numba.config.CACHE_DIR and not _cache_is_writable():
    # A folder of this process alone: a cache holds code, and a shared place could be filled by someone else.
    numba.config.CACHE_DIR = tempfile.mkdtemp(prefix="amulett-gym-")


def compiled(function: F) -> F:
    """Compile `function` with numba on first use (strict floating point, division by zero gives inf or NaN).

    Small functions called from a tick are inlined: as calls they cost a tenth of the kernel's time.
    """
    return numba.njit(cache=True, error_model="numpy", forceinline=True)(function)
