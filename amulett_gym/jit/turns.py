"""Whole numbers that threads count together while they run compiled code: the first entries of int64 arrays."""

from __future__ import annotations

from threading import Lock
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled

Number = NDArray[np.int64]

if numba.config.DISABLE_JIT:  # Python runs it
    _lock = Lock()

    def count(number: Number) -> int:
        """Add one to a number; return what it was before, which no other thread gets."""
        with _lock:
            number.flat[0] += 1
            return int(number.flat[0]) - 1

    def read(number: Number) -> int:
        """Return what a number is now; all that a thread wrote before it counted can be seen then."""
        return int(number.flat[0])

else:

    def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Return where the number given to an intrinsic stands in memory."""
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    @intrinsic
    def count(_: Any, number: Any) -> Any:
        """Add one to a number; return what it was before, which no other thread gets."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = _place(context, builder, signature, arguments)
            return builder.atomic_rmw("add", place, context.get_constant(types.int64, 1), "seq_cst")

        return types.int64(number), generate

    @intrinsic
    def read(_: Any, number: Any) -> Any:
        """Return what a number is now; all that a thread wrote before it counted can be seen then."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.load_atomic(_place(context, builder, signature, arguments), "seq_cst", 8)

        return types.int64(number), generate


@compiled
def count_once(number: Number) -> int:
    """Add one to a number, from Python."""
    return count(number)


@compiled
def reaches(number: Number, goal: int, looks: int) -> bool:
    """Return whether a number reaches `goal` within so many looks, without the GIL."""
    while looks > 0 and read(number) < goal:
        looks -= 1
    return looks > 0


def new_number() -> Number:
    """Return a number that is 0."""
    return np.zeros(1, dtype=np.int64)
