"""Loading of policies from trusted zips of Stable-Baselines3; they contain pickles, which can run code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file

from amulett_agents.config import load_train_config
from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.settings import ControlLoop, MeanAngle
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.laws.contenders import Own, own_loop
from amulett_gym.profile import Profile
from amulett_gym.settings import Group, describe
from amulett_gym.storage.reading import read_json, user_path


class About(Group):
    """Meaning of a policy's observations and actions, which its zip does not hold: content of ``<zip's name>.json``."""

    env_id: str = Field(description="environment that it was trained in; its version is that of the observations")
    agent_period: float = Field(gt=0, le=100, description="time an action is held [s]")
    tension_range: list[float] = Field(min_length=2, max_length=2, description="tension at action -1 and +1 [N]")
    mean_angle_range: MeanAngle | None = Field(
        default=None, description="mean drive angle at action +1, in Amulett/Drives-v0 only [deg]"
    )
    control: ControlLoop = Field(default="decentralized", description="control loop that it was trained in")

    @field_validator("env_id")
    @classmethod
    def _check_id(cls, name: str) -> str:
        if name not in ENV_IDS:
            raise unknown("environment", name, ENV_IDS)
        return name


def load_sb3_zip(
    path: str | Path,
    profile: Profile,
    env_id: str = ENV_IDS[0],
    trust_pickle: bool = False,
    about: Mapping[str, Any] | None = None,
) -> Own:
    """Return a model that Stable-Baselines3 saved as a contender, which acts deterministically.

    A zip holds neither the time between actions nor the tensions that they mean. Give them by `about`, by a file of the
    same name that ends in ``.json`` (:class:`About`), or by the recipe (``config.yaml``) of our own training in the
    same folder. The zip of a run with features, a low-pass or a history, which it does not hold, is refused: use the
    run's bundle.

    Parameters
    ----------
    path : str or Path
        Zip of any algorithm, also recurrent, whose policy maps 13 observations (in `Amulett/Worn-v0` 16) to the
        environment's actions.
    profile : Profile
        Unused, as `env_id`: the meaning of an action is stored in N.
    env_id : str
    trust_pickle : bool
        Whether the zip's author is trusted: loading a zip can run any code in it.
    about : mapping, optional
        ``env_id``, ``agent_period`` [s], ``tension_range`` [N], ``mean_angle_range`` [deg] and ``control`` of the
        training.

    Raises
    ------
    AmulettError
        If the zip is not trusted, cannot be read, holds no complete policy of this kind, or its actions' meaning is
        not given.
    """
    path = user_path(path)
    if not trust_pickle:
        raise AmulettError(
            f"'{path}' is a zip of Stable-Baselines3: parts of it are pickles, and opening a pickle runs any code in "
            "it. If you trust its author, use --trust-pickle (trust_pickle=True); policy bundles need no trust"
        )
    if not path.is_file():
        raise AmulettError(f"cannot read SB3 zip '{path}': there is no such file")
    found = _about(path, about)
    keywords = found.model_dump(exclude={"env_id", "control"}, exclude_none=True) | own_loop(found.control)
    only = found.env_id if found.env_id in (DRIVES_ID, WORN_ID) else None
    seen = len(WORN_OBSERVATIONS if only == WORN_ID else OBSERVATIONS)
    return Own(str(path), keywords, act=_Acting(_load(path, seen, 1 if only is None else 2)), env_id=only)


class _Acting:
    """A deterministic policy with the state of its recurrent layers."""

    def __init__(self, policy: BasePolicy) -> None:
        self._policy = policy
        self.reset(1)

    def reset(self, count: int) -> None:
        self._state: tuple[NDArray[Any], ...] | None = None
        self._starting = np.ones(count, dtype=bool)

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        actions, self._state = self._policy.predict(
            observations, state=self._state, episode_start=self._starting, deterministic=True
        )
        self._starting = np.zeros(len(observations), dtype=bool)
        return actions


def _load(path: Path, observations: int, actions: int) -> BasePolicy:
    try:
        data, parameters, _ = load_from_zip_file(path, device="cpu")
        if data is None:
            raise ValueError("it has no data")
        keywords: dict[str, Any] = dict(data["policy_kwargs"])
        if issubclass(data["policy_class"], ActorCriticPolicy):  # others hold it in their keywords
            keywords["use_sde"] = data["use_sde"]
        policy = data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **keywords)
        policy.load_state_dict(parameters["policy"])
    except Exception as error:  # a pickle may raise anything
        raise AmulettError(f"'{path}' holds no model that this Stable-Baselines3 can load: {error!r}"[:500]) from error
    for name, found, shape in (
        ("observation", policy.observation_space.shape, (observations,)),
        ("action", policy.action_space.shape, (actions,)),
    ):
        if found != shape:
            raise AmulettError(f"the {name}s of '{path}' have shape {found}; it has to be {shape}")
    policy.set_training_mode(False)
    return policy


def _about(path: Path, about: Mapping[str, Any] | None) -> About:
    """Return the meaning of a zip's actions."""
    description, recipe = path.with_suffix(".json"), path.with_name("config.yaml")
    if about is None and not description.is_file():
        if recipe.is_file():
            return _about_of(recipe)
        example = {"env_id": ENV_IDS[0], "agent_period": 0.02, "tension_range": [4.0, 15.0]}
        raise AmulettError(
            f"'{path}' holds neither the time between actions nor the tensions that they mean. Write the training's "
            f"into '{description}', for example {json.dumps(example)}; or use a bundle, which holds them "
            "(amulett_agents.save_policy)"
        )
    content = read_json(description, "description of a zip") if about is None else dict(about)
    try:
        return About.model_validate(content)
    except ValidationError as error:
        raise describe(error, About, f"'{description}'" if about is None else "about") from error


def _about_of(recipe: Path) -> About:
    config = load_train_config(recipe)
    env = config.env
    sees_more = config.network.features or config.network.memory or env.history > 1 or env.privileged
    if env.id == DRIVES_ID or env.share < 1.0 or sees_more:
        raise AmulettError(
            f"'{recipe}' sets network.features, network.memory, env.follow_time, env.history or env.privileged, or "
            f"trains in {DRIVES_ID}, which its zip does not hold; use the bundle '{recipe.parent / 'last'}' instead"
        )
    return About(**env.model_dump(include=set(About.model_fields) - {"env_id"}), env_id=env.id)
