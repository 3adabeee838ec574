"""Episodes that policies play in one environment, with all that is needed to play them again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.settings import Settings
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.evaluation.runner import Policy, acts_from_outside, agent_steps, load_contender, needed_keywords
from amulett_gym.fleet import name_or_contents
from amulett_gym.laws.contenders import Contender
from amulett_gym.laws.policies import begin_episode
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import CONTROLS, LOOPS

BATCH = 512
"""Most episodes that are played at once, and kept in memory."""

_HELD = {"eq6": "eq6-held", "eq6-printed": "eq6-held-printed"}
"""The policies that are the laws inside the loop, at agent rate."""


@dataclass(frozen=True)
class Random(Contender):
    """Uniformly random actions in all of the action space; an episode's seed draws them."""


@dataclass(frozen=True)
class PlayedEpisode:
    """An episode of T agent steps.

    Attributes
    ----------
    policy : str
    seed : int
        ``reset(seed=seed, options=options)`` of the single environment begins the episode.
    options : dict or None
        Names the device of a fleet.
    observations : ndarray of float32, shape (T + 1, entries)
    actions : ndarray of float32, shape (T, entries)
    rewards : ndarray of float64, shape (T,)
    failed : bool
        Whether the device left its limits, which ended the episode before its time.
    """

    policy: str
    seed: int
    options: dict[str, str] | None
    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    failed: bool


@dataclass(frozen=True)
class Stage:
    """The environment in which all episodes of a data set are played.

    Attributes
    ----------
    spec : EnvSpec
        Makes the single environment, by keywords of JSON types.
    settings : Settings
        The same keywords, checked.
    observation_space, action_space : Space
    """

    spec: EnvSpec
    settings: Settings
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]

    @property
    def steps(self) -> int:
        """Length of an episode [agent steps]."""
        assert self.spec.max_episode_steps is not None
        return self.spec.max_episode_steps

    @property
    def devices(self) -> tuple[Profile | None, ...]:
        """The devices of the fleet, or None for the one profile."""
        return (None,) if self.settings.fleet is None else self.settings.devices


def make_stage(contenders: Sequence[Contender], env_id: str, duration: float, given: Mapping[str, Any]) -> Stage:
    """Return the environment in which all of these policies can act.

    Parameters
    ----------
    contenders : sequence of Contender
    env_id : str
    duration : float
        Length of an episode [s].
    given : mapping
        Further keywords of the environment: the device, suite and split.

    Raises
    ------
    AmulettError
        If a policy's actions have no effect, if it acts in another environment, or if two need different ones.
    """
    if env_id not in ENV_IDS:
        raise unknown("environment", env_id, ENV_IDS)
    if not 0.0 < duration < np.inf:
        raise AmulettError(f"duration is {duration} s; it has to be a positive number of seconds")
    for contender in contenders:
        _check_acts(contender, env_id)
    needed = _shared_keywords(contenders, env_id)
    period = needed.get("agent_period", Settings.model_fields["agent_period"].default)
    steps = agent_steps(duration, period, contenders[0].name)
    made = gym.make(env_id, **needed, **given, failure_horizon=steps, max_episode_steps=steps, disable_env_checker=True)
    with closing(made):
        settings: Settings = made.unwrapped.settings  # type: ignore[attr-defined]
        spec = replace(gym.spec(env_id), kwargs=_complete(settings), max_episode_steps=steps)
        return Stage(spec, settings, made.observation_space, made.action_space)


def play_episodes(stage: Stage, contender: Contender, seed: int, episodes: int) -> Iterator[list[PlayedEpisode]]:
    """Play a policy's episodes, in lists of at most `BATCH`.

    Parameters
    ----------
    stage : Stage
    contender : Contender
    seed : int
        Of the first episode; each has the seed after that of the one before, over all devices.
    episodes : int
        Number of episodes on each device.
    """
    for device in stage.devices:
        for first in range(0, episodes, BATCH):
            yield _play(stage, contender, device, seed + first, min(BATCH, episodes - first))
        seed += episodes


def _play(stage: Stage, contender: Contender, device: Profile | None, seed: int, episodes: int) -> list[PlayedEpisode]:
    """Play episodes with the seeds from `seed` on, all at once."""
    # A fleet of the one device: laws have the parameters of their device, and observations the entries of a fleet.
    own: dict[str, Any] = {} if device is None else {"fleet": [device]}
    keywords = {**stage.spec.kwargs, **own, "num_envs": episodes, "max_episode_steps": stage.steps}
    seeds = range(seed, seed + episodes)
    with closing(gym.make_vec(stage.spec.id, **keywords)) as env:
        policy = _policy(contender, env, seeds, stage)
        return list(_episodes(env, policy, contender.name, seeds, None if device is None else {"device": device.name}))


def _episodes(
    env: Any, policy: Policy, name: str, seeds: range, options: dict[str, str] | None
) -> Iterator[PlayedEpisode]:
    observations, _ = env.reset(seed=seeds[0], options=options)
    begin_episode(policy)
    seen, acted, gained = [observations], [], []
    steps, failed = np.zeros(len(seeds), dtype=np.int64), np.zeros(len(seeds), dtype=bool)
    for step in range(1, env.max_episode_steps + 1):
        actions = np.clip(policy(observations), -1.0, 1.0)  # as the environment does
        observations, rewards, terminated, truncated, _ = env.step(actions)
        seen.append(observations)
        acted.append(actions)
        gained.append(rewards)
        ended = (steps == 0) & (terminated | truncated)
        steps[ended], failed[ended] = step, terminated[ended]
        if steps.all():
            break
    shown, chosen, paid = (np.stack(parts, axis=1) for parts in (seen, acted, gained))
    for k, length in enumerate(steps.tolist()):
        yield PlayedEpisode(
            name, seeds[k], options, shown[k, : length + 1], chosen[k, :length], paid[k, :length], bool(failed[k])
        )


def _policy(contender: Contender, env: Any, seeds: range, stage: Stage) -> Policy:
    """Return a policy for a batch of episodes with these seeds."""
    if not isinstance(contender, Random):
        return load_contender(contender, env)
    shape = (stage.steps, *(stage.action_space.shape or ()))
    drawn = np.stack([np.random.default_rng(seed).uniform(-1.0, 1.0, shape) for seed in seeds], axis=1)
    actions = iter(drawn.astype(np.float32))
    return lambda observations: next(actions)


def _check_acts(contender: Contender, env_id: str) -> None:
    """Raise an AmulettError if a policy's actions have no effect, or it acts in another environment."""
    name = contender.name
    if not isinstance(contender, Random) and not acts_from_outside(contender):
        held = _HELD.get(name)
        instead = f"record '{held}', the same law every 20 ms" if held else "record a policy that acts from outside"
        raise AmulettError(f"'{name}' acts inside the loop, where actions have no effect; {instead}")
    if contender.env_id not in (None, env_id):
        raise AmulettError(f"'{name}' acts in {contender.env_id} alone, and this is {env_id}; choose it with --env-id")


def _shared_keywords(contenders: Sequence[Contender], env_id: str) -> dict[str, Any]:
    """Return the keywords of an environment in which all policies can act, each in its own loop.

    Its tensions reach as far as those of any of them.
    """
    found: dict[str, tuple[str, Any]] = {}
    ranges = []
    for contender in contenders:
        needed = needed_keywords(contender)
        if env_id in (DRIVES_ID, WORN_ID):
            default = FEED_FORWARD_RANGE
        else:
            default = FEED_FORWARD_RANGE if needed.get("control") in LOOPS else TENSION_RANGE
            needed = needed if isinstance(contender, Random) else {"control": CONTROLS[0], **needed}
        ranges.append(needed.pop("tension_range", default))
        for key, value in needed.items():
            other, first = found.setdefault(key, (contender.name, value))
            if first != value:
                raise AmulettError(
                    f"'{other}' needs {key}={first} and '{contender.name}' {key}={value}; the episodes of a data set "
                    "have one environment: record two data sets"
                )
    reach = min(low for low, _ in ranges), max(high for _, high in ranges)
    return {**{key: value for key, (_, value) in found.items()}, "tension_range": reach}


def _complete(settings: Settings) -> dict[str, Any]:
    """Return keywords as JSON types, with what a reader of the data needs even where it is the default."""
    explicit = settings.model_dump(mode="json", include={"suite", "split", "control", "tension_range", "agent_period"})
    found = {**explicit, **settings.keywords()}
    if settings.fleet is not None:
        return {**found, "fleet": name_or_contents(settings.fleet), **_mean_angle(settings)}
    return {"profile": settings.profile.name, **found, **_mean_angle(settings)}


def _mean_angle(settings: Settings) -> dict[str, float]:
    """Return the keyword for the mean drive angle: its default is that of the whole fleet."""
    angle = settings.mean_angle_deg
    return {} if angle is None else {"mean_angle_range": angle}
