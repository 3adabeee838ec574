"""Laws from a Python file, named ``mylaw.py:function``.

Loading one runs the file. So only files that the user names in a command or in Python are loaded, never one that a
bundle, a recipe or a record names.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
import traceback
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from amulett_gym import ENV_IDS
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.laws.contenders import Own, no_function, python_file


def load_own(name: str) -> Own:
    """Run a Python file and return one of its functions as a contender.

    Parameters
    ----------
    name : str
        ``path/mylaw.py:function``. The function (or any callable object) takes observations, a float32 array of shape
        (N, 13), see `envs.transition.OBSERVATIONS`, and returns N actions in [-1, 1], shape (N,) or (N, 1). Index with
        ``observations[:, 0]``; `N` is 1 for a single arm. An attribute ``reset`` is called with N before an episode. An
        attribute ``env_keywords`` has keywords that the environment needs, such as ``{"agent_period": 0.1}``; an
        attribute ``env_id`` the id of the only one in which it acts: in ``"Amulett/Drives-v0"`` actions have the shape
        (N, 2).

    Raises
    ------
    AmulettError
        If the file cannot be read or run, or it holds no such function of one argument.
    """
    path = python_file(name)
    function_name = name.rpartition(":")[2]
    if path is None or not function_name:
        raise no_function(name)
    module = _run(path)
    functions = {key: value for key, value in vars(module).items() if callable(value) and not key.startswith("_")}
    if function_name not in functions:
        raise unknown(f"function of '{path}'", function_name, functions)
    function = functions[function_name]
    try:
        signature = inspect.signature(function)
        signature.bind(None)
    except TypeError as error:
        raise AmulettError(
            f"'{name}' takes {signature}; it has to take one argument, the observations, and return actions"
        ) from error
    except ValueError:  # some built-in callables have no signature
        pass

    def act(observations: Any) -> Any:
        try:
            return function(observations)
        except Exception as error:
            raise _failed(name, path, error) from error

    if callable(reset := getattr(function, "reset", None)):
        act.reset = reset  # type: ignore[attr-defined]
    env_id = getattr(function, "env_id", None)
    if env_id is not None and env_id not in ENV_IDS:
        raise unknown(f"environment of '{name}'", str(env_id), ENV_IDS)
    return Own(name, dict(getattr(function, "env_keywords", {})), act=act, env_id=env_id)


class _Loader(SourceFileLoader):
    """Runs what a file says now.

    Python's own loader runs the bytecode of before, if an edit within the same second has left the length as it was.
    """

    def get_code(self, fullname: str) -> CodeType:
        """Return the compiled text; called by Python."""
        code: CodeType = self.source_to_code(self.get_data(self.path), self.path)
        return code


def _run(path: Path) -> ModuleType:
    """Run a file as a module of its own; it may import modules of its folder."""
    if not path.is_file():
        raise AmulettError(f"cannot read Python file '{path}': there is no such file")
    name = f"amulett_own_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Loader(name, str(path)))
    if spec is None or spec.loader is None:
        raise AmulettError(f"cannot read Python file '{path}'")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    sys.path.insert(0, str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise _failed(str(path), path, error) from error
    finally:
        sys.path.remove(str(path.resolve().parent))
    return module


def _failed(name: str, path: Path, error: BaseException) -> AmulettError:
    """Return an error that names the exception raised by a file's code, and the line."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    if isinstance(error, SyntaxError) and not lines:
        lines = [error.lineno]
    where = f" in line {lines[-1]}" if lines else ""
    return AmulettError(f"'{name}' raised {type(error).__name__}{where}: {error}")
