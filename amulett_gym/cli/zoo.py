"""Hyper-parameter files of rl_zoo3 (``configs/zoo``): one for each algorithm, with an entry for each environment."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from amulett_gym import ENV_IDS
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.settings import describe

_NAMESPACE = ENV_IDS[0].partition("/")[0] + "/"

_MISSPELT = 0.85
"""Likeness from which a key is a misspelt one. No argument of SB3's and its contrib's algorithms has more than 0.8."""


class Hyperparameters(BaseModel):
    """An entry; keys that are not listed here are arguments of the algorithm, which rl_zoo3 checks."""

    model_config = ConfigDict(extra="allow", frozen=True)

    policy: str = Field(description="policy class of Stable-Baselines3")
    n_timesteps: float = Field(gt=0, le=1e12, description="agent steps of a training [1]")
    n_envs: int = Field(1, ge=1, le=100_000, description="number of environments [1]")
    env_kwargs: dict[str, Any] = Field({}, description="keywords of the environment")


def is_zoo_file(content: Any) -> bool:
    """Return whether the content of a file has an entry for an AMULETT environment, also a misspelt one."""
    return isinstance(content, Mapping) and any(str(key).startswith(_NAMESPACE) for key in content)


def parse_zoo_file(content: Mapping[str, Any], path: Path) -> dict[str, Hyperparameters]:
    """Return the entries of an rl_zoo3 file by environment.

    Raises
    ------
    AmulettError
        If an AMULETT environment of that name does not exist, an entry lacks a key that rl_zoo3 needs or misspells one,
        or a keyword of the environment is wrong.
    """
    found = {}
    for name, entry in content.items():
        where = f"'{name}' in '{path}'"
        if str(name).startswith(_NAMESPACE) and name not in ENV_IDS:
            raise AmulettError(f"'{path}': {unknown('environment', str(name), ENV_IDS)}")
        if not isinstance(entry, Mapping):
            raise AmulettError(f"{where} has to be a mapping of hyper-parameters, not {entry!r}")
        _check_spelling(entry, where)
        try:
            found[str(name)] = Hyperparameters.model_validate(dict(entry))
        except ValidationError as error:
            raise describe(error, Hyperparameters, where) from error
        if name in ENV_IDS:
            _check_keywords(str(name), found[str(name)].env_kwargs, f"{where}: env_kwargs")
    return found


def _check_spelling(entry: Mapping[str, Any], where: str) -> None:
    """Raise an AmulettError for a key that is so near to one of rl_zoo3's that no algorithm has such an argument."""
    known = list(Hyperparameters.model_fields)
    for key in map(str, entry):
        if key not in known and (near := get_close_matches(key.lower(), known, 1, _MISSPELT)):
            raise AmulettError(f"{where}: unknown key '{key}'; did you mean '{near[0]}'?")


def _check_keywords(name: str, keywords: Mapping[str, Any], what: str) -> None:
    """Raise an AmulettError if an environment would refuse its keywords."""
    spec = gym.spec(name)
    assert isinstance(spec.entry_point, str)
    of_gymnasium = ("max_episode_steps", "disable_env_checker")
    settings = getattr(load_env_creator(spec.entry_point), "settings_type")  # noqa: B009  (mypy sees a function)
    settings.read({key: value for key, value in keywords.items() if key not in of_gymnasium}, what)
