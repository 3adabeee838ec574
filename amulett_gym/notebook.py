"""Pictures of environments in notebooks."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium


def register() -> None:
    """Let a notebook show a picture of an environment where it is a cell's last line, as ``gym.make(...)``.

    `gym.make` returns wrappers, which do not pass on how their environment is shown, so IPython is told. Without a
    running IPython, nothing happens.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None:
        formatter = shell.display_formatter.formatters["image/png"]
        try:
            formatter.lookup_by_type(gymnasium.Wrapper)  # a user's own way to show environments stays
        except KeyError:
            formatter.for_type(gymnasium.Wrapper, png_of)


def png_of(env: gymnasium.Env[Any, Any]) -> bytes | None:
    """Return the picture of the outermost wrapper that has one, or else of the environment; None if none has."""
    while not hasattr(type(env), "_repr_png_") and isinstance(env, gymnasium.Wrapper):
        env = env.env
    draw = getattr(env, "_repr_png_", None)
    return None if draw is None else draw()
