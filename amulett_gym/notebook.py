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
        shell.display_formatter.formatters["image/png"].for_type(gymnasium.Wrapper, png_of)


def png_of(env: gymnasium.Env[Any, Any]) -> bytes | None:
    """Return the picture of the environment that wrappers hold; None for one that has none."""
    draw = getattr(env.unwrapped, "_repr_png_", None)
    return None if draw is None else draw()
