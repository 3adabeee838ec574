"""What learns: the modules behind the entry points of the group `amulett_gym.learning`, loaded on demand.

They need torch and more, which are not installed with the environment. Nothing else in `amulett_gym` imports them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError, install_extra

GROUP = "amulett_gym.learning"

TRAINING = ("torch", "stable_baselines3", "tensorboard")
"""Modules that a training run imports beside `amulett_gym`."""

TUNING = (*TRAINING, "optuna")
"""The same of a search for a recipe's settings."""

_NEEDS = {"recipes": (), "training": TRAINING, "zips": TRAINING, "speed": TRAINING, "tuning": TUNING}


def load_learning(part: str) -> Any:
    """Import a module of what learns.

    Parameters
    ----------
    part : str
        Name of the entry point: ``recipes``, ``training``, ``tuning``, ``zips`` or ``speed``.

    Returns
    -------
    module

    Raises
    ------
    AmulettError
        If what it needs, or the entry point itself, is not installed. The error says how to install it.
    """
    check_installed(_NEEDS[part])
    found = next((entry for entry in _declared() if entry.name == part), None)
    if found is None:
        raise AmulettError(
            f"this installation of amulett-gym declares no '{part}' in the entry points {GROUP}: install it again"
        )
    return found.load()


def check_installed(modules: Iterable[str] = TRAINING) -> None:
    """Raise an AmulettError that says what to install if one of the modules is not installed."""
    if absent := not_installed(modules):
        raise AmulettError(advice(absent))


def not_installed(modules: Iterable[str] = TRAINING) -> list[str]:
    """Return the modules that are not installed."""
    return [name for name in modules if find_spec(name) is None]


def advice(absent: Iterable[str]) -> str:
    """Return what to do about modules that are not installed."""
    names = ", ".join(absent)
    return (
        f"what learns needs {names}, not installed here. Install the CPU build of torch first (the default build "
        "brings gigabytes of CUDA): pip install torch --index-url https://download.pytorch.org/whl/cpu. Then the extra "
        f"'agents': {install_extra('agents')}"
    )


def _declared() -> Iterable[EntryPoint]:
    """Return the entry points of the group; those of a checkout's own pyproject.toml if its metadata are older."""
    installed = entry_points(group=GROUP)
    project = Path(__file__).parent.parent / "pyproject.toml"
    if installed or not project.is_file():
        return installed
    declared = tomllib.loads(project.read_text(encoding="utf-8"))["project"].get("entry-points", {}).get(GROUP, {})
    return [EntryPoint(name, value, GROUP) for name, value in declared.items()]
