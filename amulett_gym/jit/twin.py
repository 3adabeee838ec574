"""A twin of each compiled function, without numba's wrapper for calls from Python, for calls from compiled code.

Most functions are only called by other compiled code, but numba makes the wrapper for all of them: a quarter of the
time of a first step. Code without it would crash where Python calls it. So Python keeps calling the function itself,
which is compiled at that call, and compiled code gets the twin.

Nor has a twin machine code of its own (see :mod:`amulett_gym.jit.linked`).
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from numba.core import types
from numba.core.registry import CPUDispatcher
from numba.core.types.misc import unliteral

from amulett_gym.jit.code_cache import keep_code

try:
    from amulett_gym.jit.linked import LinkedCompiler, linking
except (ImportError, AttributeError):  # another numba: then twins have machine code
    _COMPILER: dict[str, Any] = {}
    _CONTEXT: dict[str, Any] = {}
else:
    _COMPILER, _CONTEXT = {"pipeline_class": LinkedCompiler}, {"context": linking}


def with_twin(function: Any) -> Any:
    """Return a function that numba compiles as one with a twin; `function` itself is no longer needed."""
    return _WithTwin(function.py_func, targetoptions=function.targetoptions)


class _WithTwin(CPUDispatcher):  # type: ignore[misc]
    @cached_property
    def twin(self) -> Any:
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        twin = _Twin(self.py_func, targetoptions=options, **_COMPILER)
        keep_code(twin, "-twin", **_CONTEXT)
        return twin

    def compile(self, sig: Any) -> Any:
        """Compile for the types of arguments, or load the code; called by numba, and by `compiled_for`."""
        with _no_collection():
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        """Add compiled code; called by numba, which sets the Python objects that it uses only if the cache had it."""
        super().add_overload(cres)
        for environment in cres._find_referenced_environments():
            cres.library.codegen.set_env(environment.env_name, environment)

    @property
    def _numba_type_(self) -> Any:
        """What compiled code that names this function calls; numba asks for it."""
        return types.Dispatcher(self.twin)


class _Twin(CPUDispatcher):  # type: ignore[misc]
    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return how a call is compiled, one code for all numbers of a type; called by numba.

        numba would compile a function once more for each number that a call has as a literal.
        """
        named = {name: unliteral(own) for name, own in kws.items()}
        return super().get_call_template(tuple(map(unliteral, args)), named)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Have Python look for no reference cycles: a compilation makes many objects, of which most are in use to its end.

    That takes a twelfth of the time of a first step.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
