"""Contenders: pairs of environment keywords and a policy, by name.

Some contenders live in the loop (eq. 6 at control rate, position control alone) and are chosen by a keyword of the
environment; the others act from outside, through :func:`amulett_gym.laws.policies.load_policy`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.laws.bundle import MANIFEST, read_bundle
from amulett_gym.laws.parametric import is_tuned, is_tuned_file, read_tuned, tuned_names
from amulett_gym.storage.reading import user_path

CONSTANT = "constant:"

PRETRAINED = {"pretrained": "scaling", "pretrained:tension": "tension"}
"""Folders in `amulett_gym/policies`, by name; each holds a bundle and its model card."""

IN_THE_LOOP: dict[str, dict[str, Any]] = {
    "eq6": {"tension_law": "eq6"},
    "eq6-printed": {"tension_law": "eq6-printed"},
    "position-only": {"control": "position-only"},
}
"""Contenders that act within the loop: the environment's keywords."""

_DESCRIPTIONS = {
    "eq6": "eq. 6 as the text describes it, inside the loop at control rate",
    "eq6-printed": "eq. 6 exactly as printed, inside the loop at control rate",
    "position-only": "position control alone: a fixed co-contraction, no tension loop",
    "eq6-held": "eq. 6 as the text describes it, from outside at agent rate",
    "eq6-held-printed": "eq. 6 exactly as printed, from outside at agent rate",
    "pretrained": "the best learned policy that comes with the package (PPO on mixed, Amulett/Scaling-v0)",
    "pretrained:tension": "the same, trained in Amulett/Tension-v0",
    "constant:<N>": "a constant tension setpoint in newtons, for example constant:10",
    "<folder>": "a policy bundle, or the folder of a training run (its best policy)",
    "<file.json>": "a law that `python -m amulett_gym.evaluation.search.laws` has tuned",
    "<file.py:function>": "a function of your own that maps observations to actions; the file is run",
}


@dataclass(frozen=True)
class Contender:
    """One entry of a comparison.

    Attributes
    ----------
    name : str
        As it was given.
    env_keywords : dict
        Keywords of the environment that this contender needs.
    policy_name : str or None
        What `load_policy` loads; None where the environment's loop decides and any action will do.
    """

    name: str
    env_keywords: dict[str, Any] = field(default_factory=dict)
    policy_name: str | None = None


@dataclass(frozen=True)
class Own(Contender):
    """A contender of your own: any callable that chooses actions.

    ``Own("mine", {"agent_period": 0.1}, act=function)`` runs with the environment's keywords that it needs.

    Attributes
    ----------
    act : callable
        Maps observations, a float32 array of shape (N, 13), see `envs.transition.OBSERVATIONS`, to actions, shape
        (N, 1) or (N,), in [-1, 1]. It is called once an agent step with all scenarios, from the first step on; if it
        has a method ``reset``, that is called before with N.
    """

    act: Callable[[NDArray[np.float32]], Any] | None = None


def contender_names() -> dict[str, str]:
    """Return the contenders' names (four of them patterns), each with a one-line description."""
    entries = list(_DESCRIPTIONS.items())
    return dict([*entries[:-4], *tuned_names().items(), *entries[-4:]])


def parse_contender(name: str) -> Contender:
    """Turn a name into a contender.

    Parameters
    ----------
    name : str
        A name of `contender_names`, ``constant:<N>``, a tuned law's JSON file, or a folder that holds a policy bundle.

    Returns
    -------
    Contender

    Raises
    ------
    AmulettError
        If the name is unknown, a tension is not a positive number, or a folder holds no valid policy bundle.
    """
    if name in IN_THE_LOOP:
        return Contender(name, dict(IN_THE_LOOP[name]))
    if is_tuned_file(name):
        read_tuned(name)
    if name in ("eq6-held", "eq6-held-printed") or is_tuned(name):
        return Contender(name, policy_name=name)
    if name.startswith(CONSTANT):
        constant_tension(name)
        return Contender(name, policy_name=name)
    folder = bundle_folder(name)
    policy = read_bundle(folder).policy
    sight = {"privileged": True} if policy.is_privileged else {}
    return Contender(name, {"agent_period": policy.agent_period, **sight}, str(folder))


def python_file(name: str) -> Path | None:
    """Return the file in a name like ``mylaw.py:function``; None if the name is not of that form."""
    path, _, _ = name.rpartition(":")
    return Path(path) if path.endswith(".py") else None


def constant_tension(name: str) -> float:
    """Return the tension setpoint [N] in a name like ``constant:10``.

    Raises
    ------
    AmulettError
        If it is no positive, finite number.
    """
    text = name.removeprefix(CONSTANT)
    try:
        tension = float(text)
    except ValueError:
        tension = math.nan
    if not 0 < tension < math.inf:
        raise AmulettError(f"'{name}' has to name a positive tension in N, for example constant:10; it has '{text}'")
    return tension


def bundle_folder(name: str) -> Path:
    """Return the folder of a policy bundle: a shipped one, `name` itself, or its ``best`` if it is a training run's.

    Raises
    ------
    AmulettError
        If `name` is neither a known name nor such a folder.
    """
    if not name:
        raise unknown("policy", name, contender_names())
    if name in PRETRAINED:
        return Path(str(resources.files("amulett_gym") / "policies" / PRETRAINED[name]))
    folder = user_path(name)
    try:
        for candidate in (folder, folder / "best"):
            if (candidate / MANIFEST).is_file():
                return candidate
    except OSError as error:
        raise AmulettError(f"cannot read policy bundle '{name[:100]}': {error.strerror or error}") from error
    if python_file(name) is not None:
        raise AmulettError(
            f"'{name}' is code, which evaluate, simulate and play run, and amulett_gym.laws.own.load_own"
        )
    if folder.is_dir():
        raise AmulettError(f"'{name}' holds no policy bundle: neither manifest.json nor best/manifest.json is there")
    if folder.exists():
        hint = "; a zip of Stable-Baselines3 is loaded by amulett_agents.load_sb3_zip" if name.endswith(".zip") else ""
        raise AmulettError(f"'{name}' is a file; a policy bundle is a folder that holds manifest.json{hint}")
    if os.sep in name:
        raise AmulettError(f"there is no policy bundle '{name}': the folder does not exist")
    raise unknown("policy", name, contender_names())
