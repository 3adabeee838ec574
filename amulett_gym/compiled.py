"""How the equations are compiled: strict IEEE float64, cached on disk, the same bits on every call.

No fast math and no contraction, so that a result depends neither on the batch size nor on the position in the batch.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

# Intel's vector library, if numba finds it, rounds an exp in a SIMD lane otherwise than one alone.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

import numba

F = TypeVar("F", bound=Callable[..., Any])


def _cache_is_writable() -> bool:
    """Tell whether numba will find a folder for its cache: beside the source, the user's, or ``NUMBA_CACHE_DIR``."""
    return any(os.access(folder, os.W_OK) for folder in (Path(__file__).parent, Path.home()))


if not numba.config.CACHE_DIR and not _cache_is_writable():
    # A folder of this process alone: a cache holds code, and a shared place could be filled by someone else.
    numba.config.CACHE_DIR = tempfile.mkdtemp(prefix="amulett-gym-")


def _no_alias() -> dict[str, bool]:
    """Return the option that says that a function's arguments do not overlap, or none if this numba cannot say it.

    numba has the flag, for its own parallel loops, but no option that sets it: this adds one.
    """
    try:
        from numba.core.compiler import Flags
        from numba.core.cpu import CPUTargetOptions

        if "noalias" not in Flags.options:
            return {}
        CPUTargetOptions.noalias = CPUTargetOptions.Mapping("noalias")
    except (ImportError, AttributeError):
        return {}
    return {"noalias": True}


_NO_ALIAS = _no_alias()


if numba.config.USING_SVML:
    warnings.warn(
        "numba was imported before amulett_gym and uses Intel's SVML: the last digits of results may depend on the "
        "batch size; set NUMBA_DISABLE_INTEL_SVML=1 or import amulett_gym first",
        stacklevel=2,
    )


def compiled(function: F) -> F:
    """Compile `function` with numba on first use (strict floating point, division by zero gives inf or NaN).

    Small functions called from a tick are inlined: as calls they cost a tenth of the kernel's time.
    """
    return numba.njit(cache=True, error_model="numpy", forceinline=True)(function)


def compiled_lanes(function: F) -> F:
    """Compile a loop over the lanes of a block, whose arguments never overlap in memory.

    Told so, the compiler need not fear that what it writes for one lane changes what it reads for the next, and works
    on several at once. Where numba cannot be told, all results are the same and take longer.
    """
    return numba.njit(cache=True, error_model="numpy", **_NO_ALIAS)(function)
