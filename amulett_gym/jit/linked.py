"""Code that is only linked into that of its callers, and never called by itself: no machine code is made of it.

numba makes and loads the machine code of each function as soon as it is compiled, although the callers contain the
function once more: another tenth of the time of a first step.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Any

import llvmlite.binding as llvm
from numba.core import config
from numba.core.codegen import AOTCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler

SLOW_GATHERS = ("znver4",)
"""Processors, as LLVM names them, for which it vectorises with gathers although loads one by one take less time."""

# Another numba that has none of these would not use what is defined below.
_USED = (
    JITCPUCodegen._library_class,
    JITCPUCodegen._add_module,
    JITCPUCodegen._customize_tm_options,
    JITCPUCodegen.set_env,
    AOTCodeLibrary._unserialize,
)


class LinkedCompiler(Compiler):  # type: ignore[misc]
    """numba's compiler, for a function that is only linked."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function into a library of ours; called by numba."""
        self.state.library = _Codegen(self.state.targetctx.codegen()).create_library(func.__qualname__)
        self.state.args = _Types(self.state.args)
        return super().compile_extra(func)


def linking(context: Any) -> Any:
    """Return numba's target context as one that loads code only to link it."""
    return context.subtarget(_internal_codegen=_Codegen(context.codegen()))


class _Types(tuple[Any, ...]):
    """The types of a function's arguments, whose text is made once: numba asks for it in each pass."""

    def __str__(self) -> str:
        return self._text

    @cached_property
    def _text(self) -> str:
        return super().__str__()


class _Library(AOTCodeLibrary):  # type: ignore[misc]
    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of none: what numba says of a function without its wrapper for Python."""
        return 0

    def serialize_using_object_code(self) -> Any:
        """Return what the cache keeps."""
        return self.serialize_using_bitcode()


@cache
def _target(codegen: JITCPUCodegen) -> Any:
    """Return numba's target machine, as one that loads what lanes look up in tables one by one if gathers are slow."""
    options: dict[str, Any] = {"opt": config.OPT}
    codegen._customize_tm_options(options)
    if options["cpu"] not in SLOW_GATHERS:
        return codegen._tm
    options["features"] = ",".join(filter(None, (options["features"], "+prefer-no-gather")))
    return llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(**options)


class _Codegen(JITCPUCodegen):  # type: ignore[misc]
    """One of numba's, except for what concerns machine code and gathers."""

    _library_class = _Library

    def __init__(self, codegen: JITCPUCodegen) -> None:
        self.__dict__.update(vars(codegen))
        self._tm = _target(codegen)

    def _add_module(self, module: Any) -> None:
        pass

    def set_env(self, env_name: str, env: Any) -> None:
        """Set nothing: the constants for Python's objects have their place in the callers' code."""
