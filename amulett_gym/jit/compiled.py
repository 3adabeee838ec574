"""How the equations are compiled: strict IEEE float64, cached on disk, the same bits on every call.

No fast math and no contraction, so that a result depends neither on the batch size nor on the position in the batch.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

# Intel's vector library, if numba finds it, rounds an exp in a SIMD lane otherwise than one alone.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

import numba
import numpy as np

from amulett_gym.jit.notice import watch_compilation

try:
    from amulett_gym.jit.code_cache import keep_code
except (ImportError, AttributeError):  # numba has rearranged its cache: then its own has to do

    def keep_code(function: Any, suffix: str = "", context: Callable[[Any], Any] | None = None) -> None:
        """Keep the code where numba does, if that has a place for it."""
        with suppress(RuntimeError):
            function.enable_caching()


try:
    from amulett_gym.jit.twin import with_twin
except (ImportError, AttributeError):  # another numba: then all of it takes longer to compile

    def with_twin(function: Any) -> Any:
        """Return the function as it is."""
        return function


try:
    from numba._dispatcher import compute_fingerprint
except (ImportError, AttributeError):  # another numba: then the types of arguments are found anew each time

    def compute_fingerprint(arguments: Any, /) -> bytes:  # type: ignore[misc]
        """Know no argument's."""
        raise NotImplementedError


watch_compilation()

F = TypeVar("F", bound=Callable[..., Any])


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


def record(fields: Sequence[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return the aligned dtype of records with these fields.

    Compiled code reads a field as ``row.field``. With ``NUMBA_DISABLE_JIT=1``, where Python runs it, records can, too.
    """
    dtype = np.dtype(list(fields), align=True)
    return np.dtype((np.record, dtype)) if numba.config.DISABLE_JIT else dtype


def compiled(function: F) -> F:
    """Compile `function` with numba on first use (strict floating point, division by zero gives inf or NaN).

    Small functions called from a tick are inlined: as calls they cost a tenth of the kernel's time.
    """
    return _compiled(function, forceinline=True)


def compiled_in_place(function: F) -> F:
    """Compile a long function within each of its callers, as if it were written there, and never by itself.

    Whatever is compiled by itself is optimised once more within its caller: on the way from an environment's step to a
    tick, that would be three times.
    """
    return _compiled(function, inline="always")


def compiled_lanes(function: F) -> F:
    """Compile a loop over the lanes of a block, whose arguments never overlap in memory.

    The compiler may then assume no aliasing between lanes, and works on several at once. A numba without that option
    gives the same results, and takes longer.
    """
    return _compiled(function, **_NO_ALIAS)


def compiled_for(function: F, arguments: Sequence[Any]) -> F:
    """Return a compiled function's code for the types of these arguments, as a function that looks at no types.

    numba does in each call, which takes as long as four control ticks of a single device. Later arguments need the same
    types, and arrays the same layout: nothing checks it.
    """
    if numba.config.DISABLE_JIT:
        return function
    dispatcher: Any = function
    code: F = dispatcher.compile(types_of(arguments))
    return code


_types: dict[bytes, tuple[Any, ...]] = {}


def types_of(arguments: Sequence[Any]) -> tuple[Any, ...]:
    """Return numba's types of arguments: those of earlier ones, if numba's calls would not tell the two apart.

    numba takes half a millisecond to find the type of an array of records. By the fingerprint it chooses a call's code.
    """
    try:
        fingerprint = compute_fingerprint(tuple(arguments))
    except NotImplementedError:  # of a kind that has none
        return tuple(map(numba.typeof, arguments))
    if fingerprint not in _types:
        _types[fingerprint] = tuple(map(numba.typeof, arguments))
    return _types[fingerprint]


def _compiled(function: F, **options: bool | str) -> F:
    if numba.config.DISABLE_JIT:  # Python runs it; like compiled code, it does not warn of an overflow
        return np.errstate(all="ignore")(function)
    # The functions are not called from C: without the wrappers for it, all of them compile a little sooner.
    dispatcher = with_twin(numba.njit(error_model="numpy", nogil=True, no_cfunc_wrapper=True, **options)(function))
    keep_code(dispatcher)
    return dispatcher
