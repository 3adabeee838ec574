"""The native vector environments: one compiled call per step, the same bits as the single environment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS
from amulett_gym.envs.arguments import checked_options, device_seeds
from amulett_gym.envs.episodes import Episodes, Report
from amulett_gym.envs.info import final_of, infos_of, of_some
from amulett_gym.envs.settings import NO_LIMIT, DrivesVectorSettings, VectorSettings, signature
from amulett_gym.envs.single import frame_rate, spaces_of
from amulett_gym.envs.transition import FIRST_READING, FIRST_TERM
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import RUNNING
from amulett_gym.tasks.scenario import Scenario

RESET_OPTIONS = ("scenario", "device", "reset_mask")


class TensionVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many devices of `Amulett/Tension-v0`, specified by :class:`amulett_gym.envs.single.ScalingEnv`.

    Device i, reset with seed s, plays the same episodes as the single environment after ``reset(seed=s + i)``. A device
    whose episode has ended starts the next one in the following `step`, which ignores its action and gives it reward 0:
    Gymnasium's mode NEXT_STEP. With ``autoreset_mode="SameStep"`` it does so in the step that ends the episode; the
    last observation and info are then in ``info["final_obs"]`` and ``info["final_info"]``. With ``"Disabled"`` it does
    so at a reset whose `reset_mask` names it, and a step before raises an error. ``info`` has the single environment's
    keys with arrays of length `num_envs`, and for each a mask ``_key``, as Gymnasium's own vector environments.

    With a `fleet`, devices 0 to 7, 8 to 15, ... are blocks, and all devices of a block are one of the fleet in all
    episodes: each of the fleet has as many blocks, give or take one, which are neighbours. ``reset(seed=s)`` of all
    devices begins with number s of the fleet, counted round; the option `device` chooses them. The single environment
    plays the same episodes on the same device, which its option `device` has to name.

    Keywords: those of the single environment, `num_envs`, `autoreset_mode`, `max_episode_steps` (None is the default,
    500, and -1 no limit, as in `gymnasium.make`) and `threads`, which share the devices: the number changes no bit of
    the results. Threads help with free cores and a thousand devices or more.
    """

    metadata: dict[str, Any] = {
        "render_modes": list(VectorSettings.render_modes),
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    env_id: ClassVar[str] = ENV_IDS[1]
    acts_by_factor: ClassVar[bool] = False
    settings_type: ClassVar[type[VectorSettings]] = VectorSettings
    __signature__ = signature(VectorSettings)
    _spec: EnvSpec | None = None

    def __init__(self, **keywords: Any) -> None:
        self.settings = settings = self.settings_type.read(keywords, self.env_id, self.acts_by_factor)
        self.tension_range = settings.tension_range
        self.num_envs, self.max_episode_steps = settings.num_envs, settings.max_episode_steps
        self._limit = math.inf if settings.max_episode_steps == NO_LIMIT else settings.max_episode_steps
        self.render_mode = settings.render_mode
        self.autoreset_mode = settings.autoreset_mode
        own = {"render_fps": frame_rate(settings), "autoreset_mode": settings.autoreset_mode}
        self.metadata = {**self.metadata, **own}
        self.episodes = self._make_episodes(settings)
        self.single_observation_space, self.single_action_space = spaces_of(self.episodes)
        self.observation_space = _batched(self.single_observation_space, self.num_envs)
        self.action_space = _batched(self.single_action_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._renderers: list[Any] = []
        self._collects = settings.render_mode == "rgb_array_list"
        self._frames: list[list[NDArray[np.uint8]]] = self._no_frames()

    @property
    def spec(self) -> EnvSpec | None:
        """Return how the environment was made, as Gymnasium's `make_vec` sets it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and "autoreset_mode" in spec.kwargs:  # as a word: an enum cannot be written as JSON
            spec.kwargs["autoreset_mode"] = self.autoreset_mode.value
        self._spec = spec

    def _make_episodes(self, settings: VectorSettings) -> Episodes:
        return Episodes(settings.num_envs, settings, settings.threads)

    @property
    def profile(self) -> Profile:
        """The device; AmulettError with a fleet of several, see `devices`."""
        return self.episodes.simulation.profile

    @property
    def devices(self) -> tuple[Profile, ...]:
        """The fleet, in which ``info["device"]`` has indices, or the one device."""
        return self.settings.devices

    @property
    def scenarios(self) -> list[Scenario]:
        """The present episodes' scenarios."""
        return [self.episodes.unpacked(device) for device in range(self.num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode with all devices, or with those of a mask.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Device i is seeded with ``seed + i``, or with ``seed[i]`` unless that is None.
        options : dict, optional
            ``"reset_mask"``: ndarray of bool, shape (num_envs,), the devices to reset.
            ``"scenario"``: one scenario for all devices that are reset, or a list with one for each of them.
            ``"device"``: name of the fleet's device that all of them have, or a list of names; all of a block of eight
            have the same. Without it, a block keeps its device, unless all are reset with a seed.

        Raises
        ------
        AmulettError
            If an option is unknown, or the mask, the number of seeds, a scenario or a device is wrong.
        gymnasium.error.Error
            If a seed is no whole number of at least 0.
        """
        options = checked_options(options, RESET_OPTIONS)
        mask = self._mask(options.get("reset_mask"))
        devices, seeds = np.flatnonzero(mask), device_seeds(seed, self.num_envs)[mask]
        scenarios, names = (_for_each(options.get(key), key, devices.size) for key in RESET_OPTIONS[:2])
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self.episodes.seed(devices, seeds, self.np_random)
        self._ended[mask] = False
        all_seeded = devices.size == self.num_envs and seeds[0] is not None
        which = self.episodes.dealt(seeds[0]) if all_seeded else None
        observations = self.episodes.start(devices, scenarios, which, names)
        if devices.size < self.num_envs:
            observations = self.episodes.observe()  # of all devices
        self._begin_pictures(devices)
        self._collect(devices)
        info = infos_of(self.episodes, self.episodes.report(devices), devices)
        return observations, info if devices.size == self.num_envs else of_some(info, devices, self.num_envs)

    def step(
        self, actions: NDArray[np.floating[Any]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold actions of the space's shape for one agent period; values beyond [-1, 1] are clipped.

        In the mode NEXT_STEP, devices whose episode has ended start the next one instead.

        Raises
        ------
        AmulettError
            If the actions have another shape or one is NaN or no number.
        gymnasium.error.ResetNeeded
            If there was no reset yet; in the mode DISABLED, if a device's episode has ended.
        """
        observations, report, terminated, truncated, final = self.step_report(actions)
        return observations, report[:, 0].copy(), terminated, truncated, infos_of(self.episodes, report) | final

    def next_episodes(self, devices: NDArray[np.int64]) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start the next episode of some devices; unlike a reset by a mask, this ignores all others.

        Parameters
        ----------
        devices : ndarray of int, shape (K,)
            Indices, at least one, all different.

        Returns
        -------
        observations : ndarray of float32, shape (K, 13), longer if `privileged`
        info : dict
            Of these K devices.

        Raises
        ------
        AmulettError
            If `devices` is wrong.
        gymnasium.error.ResetNeeded
            If a device has had no reset yet.
        """
        fits = isinstance(devices, np.ndarray) and devices.dtype.kind == "i" and devices.ndim == 1 and devices.size > 0
        inside = fits and 0 <= devices.min() <= devices.max() < self.num_envs
        if not inside or np.unique(devices).size < devices.size:
            raise AmulettError(
                f"devices is {devices!r}; it has to be an ndarray of int, indices from 0 to {self.num_envs - 1}, at "
                "least one, all different. For a mask, use reset(options={'reset_mask': mask})"
            )
        if not self.episodes.started[devices].all():
            raise gym.error.ResetNeeded("call reset() before next_episodes()")
        observations, report = self.next_report(devices)
        return observations, infos_of(self.episodes, report, devices)

    def step_report(
        self, actions: NDArray[np.floating[Any]], brief: bool = False
    ) -> tuple[NDArray[np.float32], Report, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Take a step as :meth:`step` does; return the report (see `envs.transition`) instead of rewards and info.

        For callers that need the infos of a few devices only: with `brief`, a report ends with `failure`, and
        `Episodes.whole` completes it, with the device's own readings and metrics. A subclass that changes what a step
        returns overrides this, and `next_report` for how episodes begin: `step`, `next_episodes` and the adapter for
        Stable-Baselines3, which asks for brief ones, build on them. In the mode SAME_STEP, a report holds the reward of
        an episode that has ended, and all else of the next one; the last value is what that mode adds to the info.
        """
        if not self.episodes.started.all():
            raise gym.error.ResetNeeded("call reset() before step()")
        actions = np.asarray(actions)
        wanted = self.num_envs, self.episodes.action_size
        if actions.shape != wanted:
            raise AmulettError(f"the actions have shape {actions.shape}; it has to be {wanted}")
        again = np.flatnonzero(self._ended)
        if again.size and self.autoreset_mode is AutoresetMode.DISABLED:
            raise gym.error.ResetNeeded(
                f"autoreset_mode is 'Disabled', and the episode of device {again[0]} has ended ({again.size} in all): "
                "call reset(options={'reset_mask': terminated | truncated}) before step()"
            )
        observations, report = self.episodes.step(actions.reshape(-1), brief)
        if again.size:
            observations[again], following = self.next_report(again)
            report[again] = following[:, : report.shape[1]]
        terminated = report[:, FIRST_READING] != RUNNING
        truncated = self.episodes.have_steps(self._limit)  # both in a failure's last step, as by Gymnasium's TimeLimit
        self._ended = terminated | truncated
        final = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any():
            again = np.flatnonzero(self._ended)
            whole = self.episodes.whole(report[again], again)
            final = final_of(infos_of(self.episodes, whole, again), observations, again)
            observations[again], following = self.next_report(again)
            # The reward stays that of the last step
            report[again, FIRST_TERM:] = following[:, FIRST_TERM : report.shape[1]]
        self._collect(range(self.num_envs))
        return observations, report, terminated, truncated, final

    def next_report(self, devices: NDArray[np.int64]) -> tuple[NDArray[np.float32], Report]:
        """Start the next episode of some devices as :meth:`next_episodes` does; return observations and report.

        Nothing checks the indices.
        """
        self.episodes.next_episode(devices)
        observations = self.episodes.start(devices)
        self._ended[devices] = False
        self._begin_pictures(devices)
        return observations, self.episodes.report(devices)

    def render(self) -> tuple[Any, ...] | None:
        """Draw every device: a tuple of arrays (height, width, 3).

        In the mode ``"rgb_array_list"``, a tuple of lists of them: of each step since the last call, or since the
        device's episode began, if that is later.
        """
        if self.render_mode is None:
            gym.logger.warn("render() without a render_mode draws nothing; pass render_mode='rgb_array'")
            return None
        if not self._collects:
            return tuple(map(self._draw, range(self.num_envs)))
        frames, self._frames = tuple(self._frames), self._no_frames()
        return frames

    def close_extras(self, **kwargs: Any) -> None:
        """Close the renderers; end the threads."""
        if not hasattr(self, "episodes"):
            return  # wrong arguments; the oldest Gymnasium that we support closes the environment nevertheless
        self.episodes.close()
        for renderer in self._renderers:
            renderer.close()
        self._renderers = []

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all episodes and the random generator; see the single environment's `get_state`."""
        generator = self.np_random.bit_generator.state
        return {"episodes": self.episodes.get_state(), "np_random": generator, "ended": self._ended.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot taken by `get_state`; AmulettError if its number of devices differs."""
        self.episodes.set_state(state["episodes"])
        self.np_random.bit_generator.state = state["np_random"]
        self._ended = state["ended"].copy()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderers": []}

    def _draw(self, device: int) -> NDArray[np.uint8]:
        from amulett_gym.envs.rendering.frame import frame_of
        from amulett_gym.envs.rendering.window import Renderer

        if not self._renderers:
            self._renderers = [Renderer("rgb_array", self.metadata["render_fps"]) for _ in range(self.num_envs)]
        picture: NDArray[np.uint8] = self._renderers[device].draw(frame_of(self.episodes, device))
        return picture

    def _no_frames(self) -> list[list[NDArray[np.uint8]]]:
        return [[] for _ in range(self.num_envs if self._collects else 0)]

    def _begin_pictures(self, devices: NDArray[np.int64]) -> None:
        """Drop the curves and the frames of devices that begin an episode."""
        for pictures in (self._renderers, self._frames):
            for device in devices if pictures else ():
                pictures[device].clear()

    def _collect(self, devices: Iterable[int]) -> None:
        """In the mode ``"rgb_array_list"``, draw devices for the next `render`."""
        for device in devices if self._collects else ():
            self._frames[device].append(self._draw(device))

    def _mask(self, mask: Any) -> NDArray[np.bool_]:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise AmulettError(f"reset_mask is {mask!r}; it has to be an ndarray of bool, shape ({self.num_envs},)")
        return mask


class ScalingVectorEnv(TensionVectorEnv, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many devices of `Amulett/Scaling-v0`; see :class:`TensionVectorEnv`."""

    # `VectorEnv` is a base of each class itself: skrl's `wrap_env` looks at the direct ones.

    env_id = ENV_IDS[0]
    acts_by_factor = True


class DrivesVectorEnv(TensionVectorEnv, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many devices of `Amulett/Drives-v0`, specified by :class:`amulett_gym.envs.single.DrivesEnv`.

    All else is as in :class:`TensionVectorEnv`.
    """

    env_id = DRIVES_ID
    settings: DrivesVectorSettings
    settings_type = DrivesVectorSettings
    __signature__ = signature(DrivesVectorSettings)

    @property
    def mean_angle_range(self) -> float:
        """Mean drive angle at action +1 [deg]."""
        return self.settings.mean_angle_deg


def _for_each(option: Any, what: str, count: int) -> list[Any] | None:
    """Return a reset's option for each of the devices to reset; None without it."""
    if option is None:
        return None
    found = list(option) if isinstance(option, list | tuple) else [option] * count
    if len(found) != count:
        raise AmulettError(f"{len(found)} {what}s were given for the {count} devices to reset")
    return found


def _batched(space: Space[Any], count: int) -> Space[Any]:
    """Return the space of a batch, whose bounds are views of one row: copies would take 140 bytes per device."""
    batched = batch_space(space, count)
    for name in ("low", "high", "bounded_below", "bounded_above"):
        row = getattr(space, name)
        setattr(batched, name, np.broadcast_to(row, (count, *row.shape)))
    return batched
