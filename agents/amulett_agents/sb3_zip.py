"""Policies from Stable-Baselines3's zips, which are pickles: only for those who trust whoever made them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file

from amulett_agents.config import load_train_config
from amulett_gym import ENV_IDS
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import Own
from amulett_gym.profile import Profile
from amulett_gym.storage.reading import user_path

_SHAPES = {"observation": (len(OBSERVATIONS),), "action": (1,)}


def load_sb3_zip(path: str | Path, profile: Profile, env_id: str = ENV_IDS[0], trust_pickle: bool = False) -> Own:
    """Make a contender of a model that Stable-Baselines3 saved; it acts deterministically.

    A zip does not say for how long its actions are held, nor which tensions they mean. If a recipe (``config.yaml``)
    lies beside it, that tells; otherwise they are those of the environment's defaults. What stands between a recipe's
    network and the environment (features, a low-pass, a history) is not in a zip: that of such a run is refused, for
    there is a bundle beside it.

    Parameters
    ----------
    path : str or Path
        The zip of any algorithm whose policy maps 13 observations to 1 action, recurrent ones too.
    profile : Profile
    env_id : str
        Neither changes anything any more: what an action means is kept in N.
    trust_pickle : bool
        Whether whoever made the zip is trusted: to open it means to run what is in it.

    Returns
    -------
    Own

    Raises
    ------
    AmulettError
        If the zip is not trusted, cannot be read, or holds no such policy, or not all of it.
    """
    path = user_path(path)
    if not trust_pickle:
        raise AmulettError(
            f"'{path}' is a zip of Stable-Baselines3: parts of it are pickles, and to open a pickle is to run whatever "
            "code its maker put into it. If you trust whoever made it, say so with --trust-pickle (trust_pickle=True); "
            "policy bundles are data, and need no trust"
        )
    if not path.is_file():
        raise AmulettError(f"cannot read SB3 zip '{path}': there is no such file")
    keywords = _keywords(path.parent / "config.yaml")
    return Own(str(path), keywords, act=_Acting(_load(path)))


class _Acting:
    """A policy that acts; of a recurrent one it keeps the state from step to step."""

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


def _load(path: Path) -> BasePolicy:
    try:
        data, parameters, _ = load_from_zip_file(path, device="cpu")
        if data is None:
            raise ValueError("it has no data")
        keywords: dict[str, Any] = dict(data["policy_kwargs"])
        if issubclass(data["policy_class"], ActorCriticPolicy):  # others have it among their keywords
            keywords["use_sde"] = data["use_sde"]
        policy = data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **keywords)
        policy.load_state_dict(parameters["policy"])
    except Exception as error:  # a pickle may raise anything
        raise AmulettError(f"'{path}' holds no model that this Stable-Baselines3 can load: {error!r}"[:500]) from error
    shapes = {"observation": policy.observation_space.shape, "action": policy.action_space.shape}
    for name, shape in _SHAPES.items():
        if shapes[name] != shape:
            raise AmulettError(f"the {name}s of '{path}' have shape {shapes[name]}; they have to have {shape}")
    policy.set_training_mode(False)
    return policy


def _keywords(recipe: Path) -> dict[str, Any]:
    if not recipe.is_file():
        return {}
    config = load_train_config(recipe)
    env = config.env
    if config.network.features or env.share < 1.0 or env.history > 1 or env.privileged:
        raise AmulettError(
            f"'{recipe}' says that the network sees or does something else than the environment shows and wants "
            "(network.features, env.follow_time, env.history, env.privileged), which its zip does not hold; use the "
            f"bundle '{recipe.parent / 'last'}' instead"
        )
    return {"agent_period": env.agent_period, "tension_range": env.tension_range}
