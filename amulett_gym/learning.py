"""Load the training code by the entry points of the group `amulett_gym.learning`; it needs torch."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import Any

from amulett_gym.errors import AmulettError, install_extra

GROUP = "amulett_gym.learning"

TRAINING = ("torch", "stable_baselines3", "tensorboard")
"""Modules that a training run imports in addition to `amulett_gym`."""

TUNING = (*TRAINING, "optuna")
"""Modules that a search for a recipe's settings imports."""

_NEEDS = {
    "recipes": (),
    "training": TRAINING,
    "cloning": TRAINING,
    "zips": TRAINING,
    "speed": TRAINING,
    "tuning": TUNING,
}


def load_learning(part: str) -> Any:
    """Return the module behind an entry point, a key of `_NEEDS`.

    Raises
    ------
    AmulettError
        If the entry point or a module that it needs is not installed. The error says how to install it.
    """
    check_installed(_NEEDS[part])
    for entry in entry_points(group=GROUP):
        if entry.name == part:
            return entry.load()
    raise AmulettError(f"this installation declares no '{part}' in the entry points {GROUP}: install amulett-gym again")


def check_installed(modules: Iterable[str] = TRAINING) -> None:
    """Raise an AmulettError that says what to install if one of the modules is not installed."""
    if absent := not_installed(modules):
        raise AmulettError(advice(absent))


def not_installed(modules: Iterable[str] = TRAINING) -> list[str]:
    """Return those of the modules that are not installed."""
    return [name for name in modules if find_spec(name) is None]


def advice(absent: Iterable[str]) -> str:
    """Return how to install missing modules."""
    return (
        f"training code needs {', '.join(absent)}, not installed here. Install the CPU build of torch first (the "
        "default build brings gigabytes of CUDA): pip install torch --index-url https://download.pytorch.org/whl/cpu. "
        f"Then the extra 'agents': {install_extra('agents')}"
    )
