"""Reading of a data set for learning: its environment, and the episodes of its policies."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from amulett_gym import ENV_IDS
from amulett_gym.datasets.files import open_dataset
from amulett_gym.envs.settings import NO_LIMIT, Settings
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.fleet import name_or_contents
from amulett_gym.laws.bundle import TrainingEnv
from amulett_gym.settings import describe


@dataclass(frozen=True)
class Demonstrations:
    """Episodes of a data set, to be imitated.

    Attributes
    ----------
    name : str
        Of the data set.
    env : TrainingEnv
        The environment, as bundles describe it.
    settings : Settings
        Its keywords, checked.
    policies : dict of str to int
        Policy -> number of its episodes; of episodes of other programs, which do not name it, that is "unknown".
    observations, actions : list of ndarray of float32, shapes (T, entries)
        Of each episode, without the last observation; actions within [-1, 1], to which the environment clips them.
    mean_return : float
        Of these episodes.
    """

    name: str
    env: TrainingEnv
    settings: Settings
    policies: dict[str, int]
    observations: list[NDArray[np.float32]]
    actions: list[NDArray[np.float32]]
    mean_return: float


def read_demonstrations(name: str, policy: str | None = None, root: str | Path | None = None) -> Demonstrations:
    """Return the episodes of a data set.

    Only the environments of this package are made, and no file that the data set might name is read.

    Parameters
    ----------
    name : str
        Of the data set, or its folder.
    policy : str, optional
        Only the episodes of this policy.
    root : str or Path, optional
        Folder of all data sets; None: what MINARI_DATASETS_PATH names, or else Minari's own.

    Raises
    ------
    AmulettError
        If Minari is not installed, there is no such data set or no such policy in it, it cannot be read, or its actions
        are not those of an environment of this package.
    """
    dataset = open_dataset(name, root)
    env, settings, size = _environment(dataset, name)
    try:
        about = list(dataset.storage.get_episode_metadata(dataset.episode_indices))
        names = [str(each.get("policy", "unknown")) for each in about]
        if not names:
            raise AmulettError(f"the data set '{name}' has no episodes; record some, or choose another")
        chosen = [index for index, own in enumerate(names) if policy in (None, own)]
        if not chosen:
            raise unknown(f"policy of the data set '{name}'", str(policy), {*names})
        played = list(dataset.iterate_episodes(dataset.episode_indices[chosen]))
    except (OSError, KeyError, ValueError) as error:
        if isinstance(error, AmulettError):
            raise
        raise AmulettError(f"cannot read the data set '{name}': {error}") from error
    for episode in played:
        steps = len(episode.rewards)
        found = np.shape(episode.observations), np.shape(episode.actions)
        if steps == 0 or found != ((steps + 1, size[0]), (steps, size[1])):
            raise AmulettError(
                f"episode {episode.id} of the data set '{name}' has observations and actions of the shapes {found}; "
                f"{env.id} has {(steps + 1, size[0])} and {(steps, size[1])}, and an episode at least 1 step"
            )
        values = [np.asarray(each) for each in (episode.observations, episode.actions, episode.rewards)]
        if not all(each.dtype.kind in "fiu" and np.isfinite(each).all() for each in values):
            raise AmulettError(f"episode {episode.id} of the data set '{name}' holds what is no finite number")
    return Demonstrations(
        name=str(dataset.id),
        env=env,
        settings=settings,
        policies={own: names.count(own) for own in dict.fromkeys(names[index] for index in chosen)},
        observations=[np.asarray(each.observations[:-1], dtype=np.float32) for each in played],
        actions=[np.clip(each.actions, -1.0, 1.0).astype(np.float32) for each in played],
        mean_return=float(np.mean([each.rewards.sum() for each in played])),
    )


def _environment(dataset: Any, name: str) -> tuple[TrainingEnv, Settings, tuple[int, int]]:
    """Return a data set's environment, its checked keywords, and the sizes of observations and actions."""
    spec = dataset.env_spec
    if spec is None or spec.id not in ENV_IDS:
        found = "no environment" if spec is None else f"the environment {spec.id}"
        raise AmulettError(f"the data set '{name}' names {found}; it has to be one of {', '.join(ENV_IDS)}")
    steps = NO_LIMIT if spec.max_episode_steps is None else spec.max_episode_steps
    try:  # refuses names that would have a file read
        TrainingEnv(id=spec.id, keywords=spec.kwargs, max_episode_steps=steps)
    except ValidationError as error:
        raise describe(error, TrainingEnv, f"the data set '{name}'") from error
    try:
        made = gym.make(spec.id, **spec.kwargs, disable_env_checker=True)
    except AmulettError as error:  # it names the environment and the keyword
        raise AmulettError(f"the environment of the data set '{name}' cannot be made: {error}") from error
    with closing(made) as env:
        own: Any = env.unwrapped
        settings: Settings = own.settings
        if settings.tension_law != "agent" or settings.control == "position-only":
            raise AmulettError(
                f"the actions of the data set '{name}' had no effect: its tension_law is '{settings.tension_law}', its "
                f"loop '{settings.control}'"
            )
        keywords = settings.keywords()
        if settings.fleet is not None:
            keywords["fleet"] = name_or_contents(settings.fleet)
        keywords.pop("privileged", None)  # what learns from it sees what a device measures
        size = own.episodes.observation_size, own.episodes.action_size
        return TrainingEnv(id=spec.id, keywords=keywords, max_episode_steps=steps), settings, size
