"""A twin of each compiled function, without numba's wrapper for calls from Python, for calls from compiled code.

Most functions are only called by other compiled code, but numba makes the wrapper for all of them: a quarter of the
time of a first step. Code without it would crash where Python calls it. So Python keeps calling the function itself,
which is compiled at that call, and compiled code gets the twin.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

from numba.core import types
from numba.core.registry import CPUDispatcher

from amulett_gym.jit.code_cache import keep_code


def with_twin(function: Any) -> Any:
    """Return a function that numba compiles as one with a twin; `function` itself is no longer needed."""
    return _WithTwin(function.py_func, targetoptions=function.targetoptions)


class _WithTwin(CPUDispatcher):  # type: ignore[misc]
    @cached_property
    def twin(self) -> Any:
        twin = CPUDispatcher(self.py_func, targetoptions={**self.targetoptions, "no_cpython_wrapper": True})
        keep_code(twin, "-twin")
        return twin

    @property
    def _numba_type_(self) -> Any:
        """What compiled code that names this function calls; numba asks for it."""
        return types.Dispatcher(self.twin)
