"""What threads tell each other while they run compiled code, without the GIL: numbers, and arrays by their addresses.

A number is the first entry of an int64 array. Whatever a thread wrote before it changed one is seen by those that then
read or change it. Python cannot call these functions, and with ``NUMBA_DISABLE_JIT`` nothing can.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return where the number given to an intrinsic stands in memory."""
    return context.make_array(signature.args[0])(context, builder, arguments[0]).data


@intrinsic
def add(_: Any, number: Any, change: Any) -> Any:
    """Add to a number, in one step; return what it was before."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        by = context.cast(builder, arguments[1], signature.args[1], types.int64)
        return builder.atomic_rmw("add", _place(context, builder, signature, arguments), by, "seq_cst")

    return types.int64(number, change), generate


@intrinsic
def read(_: Any, number: Any) -> Any:
    """Return what a number is now."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_place(context, builder, signature, arguments), "seq_cst", 8)

    return types.int64(number), generate


@intrinsic
def write(_: Any, number: Any, value: Any) -> Any:
    """Set a number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        new = context.cast(builder, arguments[1], signature.args[1], types.int64)
        builder.store_atomic(new, _place(context, builder, signature, arguments), "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(number, value), generate


@intrinsic
def pointer(_: Any, address: Any) -> Any:
    """Return the pointer to an address, as `numba.carray` takes it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate
