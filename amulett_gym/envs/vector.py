"""The native vector environments: many arms, one compiled call a step, bit for bit the single environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from amulett_gym import ENV_IDS
from amulett_gym.envs.episodes import Episodes, device_seeds
from amulett_gym.envs.reward import TERMS
from amulett_gym.envs.settings import NO_LIMIT, VectorSettings, signature
from amulett_gym.envs.single import frame_rate, spaces_of
from amulett_gym.envs.transition import FIRST_METRIC, FIRST_READING, FIRST_TERM, METRICS, READINGS
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.simulation.layout import FAILURES, RUNNING
from amulett_gym.tasks.scenario import Scenario

RESET_OPTIONS = ("scenario", "reset_mask")
_FAILURES = np.array(FAILURES)


class TensionVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many `Amulett/Tension-v0` at once; see :class:`amulett_gym.envs.single.ScalingEnv` for everything but this.

    Device i, reset with seed s, plays exactly what the single environment plays after ``reset(seed=s + i)``. A device
    whose episode has ended starts the next one in the following `step`, which ignores its action and gives it reward 0
    (autoreset mode NEXT_STEP). ``info`` has the single environment's keys with arrays of length `num_envs`.

    The keywords are those of the single environment, and `num_envs`, `max_episode_steps` (None is the default, 500, and
    -1 no limit, as in `gymnasium.make`) and `threads`: how many step at once, each a part of the devices; the results
    are the same, bit for bit. Threads help where cores are free and devices are many: a thousand or more.
    """

    metadata: dict[str, Any] = {
        "render_modes": list(VectorSettings.render_modes),
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    env_id: ClassVar[str] = ENV_IDS[1]
    acts_by_factor: ClassVar[bool] = False
    __signature__ = signature(VectorSettings)

    def __init__(self, **keywords: Any) -> None:
        self.settings = settings = VectorSettings.read(keywords, self.env_id, self.acts_by_factor)
        self.profile, self.tension_range = settings.profile, settings.tension_range
        self.num_envs, self.max_episode_steps = settings.num_envs, settings.max_episode_steps
        self._limit = math.inf if settings.max_episode_steps == NO_LIMIT else settings.max_episode_steps
        self.render_mode = settings.render_mode
        self.metadata = {**self.metadata, "render_fps": frame_rate(settings)}
        self.episodes = Episodes(self.num_envs, settings, settings.threads)
        self.single_observation_space, self.single_action_space = spaces_of(self.episodes)
        self.observation_space = _batched(self.single_observation_space, self.num_envs)
        self.action_space = _batched(self.single_action_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._renderers: list[Any] = []

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

        Returns
        -------
        observations : ndarray of float32, shape (num_envs, 13), longer if `privileged`
        info : dict

        Raises
        ------
        AmulettError
            If an option is unknown, or the mask, the number of seeds or a scenario is wrong.
        gymnasium.error.Error
            If a seed is no whole number of at least 0.
        """
        for option in options or {}:
            if option not in RESET_OPTIONS:
                raise unknown("reset option", str(option), RESET_OPTIONS)
        mask = self._mask(options)
        devices = np.flatnonzero(mask)
        seeds = device_seeds(seed, self.num_envs)[mask]
        scenarios = (options or {}).get("scenario")
        if scenarios is not None:
            scenarios = list(scenarios) if isinstance(scenarios, list | tuple) else [scenarios] * devices.size
            if len(scenarios) != devices.size:
                raise AmulettError(f"{len(scenarios)} scenarios were given for the {devices.size} devices to reset")
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self.episodes.seed(devices, seeds, self.np_random)
        self._ended[mask] = False
        observations = self.episodes.start(devices, scenarios)
        if devices.size < self.num_envs:
            observations = self.episodes.observe()  # the others', too
        self._clear_renderers(devices)
        return observations, self._info(self.episodes.report())

    def step(
        self, actions: NDArray[np.floating[Any]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold each device's action for one agent period; start the next episode of those whose last one has ended.

        Parameters
        ----------
        actions : ndarray, shape (num_envs, 1)
            In [-1, 1]; values beyond are clipped.

        Raises
        ------
        AmulettError
            If the actions have another shape or one is NaN.
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        if not self.episodes.started.all():
            raise gym.error.ResetNeeded("call reset() before step()")
        actions = np.array(actions, dtype=np.float64, order="C")  # strided or read-only ones would be compiled for anew
        if actions.shape != (self.num_envs, 1):
            raise AmulettError(f"the actions have shape {actions.shape}; it has to be ({self.num_envs}, 1)")
        again = np.flatnonzero(self._ended)
        observations, report = self.episodes.step(actions[:, 0])
        if again.size:
            observations[again], report[again] = self._next_episodes(again)
        terminated = report[:, FIRST_READING] != RUNNING
        truncated = ~terminated & (self.episodes.steps() >= self._limit)
        self._ended = terminated | truncated
        return observations, report[:, 0].copy(), terminated, truncated, self._info(report)

    def next_episodes(self, devices: NDArray[np.int64]) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start the next episode of some devices: a reset by a mask that looks at none of the others.

        Parameters
        ----------
        devices : ndarray of int, shape (K,)
            Indices, at least one and none twice.

        Returns
        -------
        observations : ndarray of float32, shape (K, 13), longer if `privileged`
        info : dict
            Of these K devices.

        Raises
        ------
        AmulettError
            If `devices` is anything else.
        gymnasium.error.ResetNeeded
            If one of them has had no reset yet.
        """
        fits = isinstance(devices, np.ndarray) and devices.dtype.kind == "i" and devices.ndim == 1 and devices.size > 0
        if (
            not fits
            or not 0 <= devices.min() <= devices.max() < self.num_envs
            or np.unique(devices).size < devices.size
        ):
            raise AmulettError(
                f"devices is {devices!r}; it has to be an ndarray of int, indices from 0 to {self.num_envs - 1}, at "
                "least one and none twice. A mask goes to reset(options={'reset_mask': mask})"
            )
        if not self.episodes.started[devices].all():
            raise gym.error.ResetNeeded("call reset() before next_episodes()")
        observations, report = self._next_episodes(devices)
        self._ended[devices] = False
        return observations, self._info(report)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draw every device: a tuple of arrays (height, width, 3)."""
        if self.render_mode is None:
            gym.logger.warn("render() without a render_mode draws nothing; pass render_mode='rgb_array'")
            return None
        from amulett_gym.envs.rendering.frame import frame_of
        from amulett_gym.envs.rendering.window import Renderer

        if not self._renderers:
            self._renderers = [Renderer(self.render_mode, self.metadata["render_fps"]) for _ in range(self.num_envs)]
        return tuple(renderer.draw(frame_of(self.episodes, device)) for device, renderer in enumerate(self._renderers))

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of the renderers and threads."""
        if not hasattr(self, "episodes"):
            return  # its arguments were refused; the oldest Gymnasium we support closes it all the same
        self.episodes.close()
        for renderer in self._renderers:
            renderer.close()
        self._renderers = []

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all episodes and the random generator: a dict that can be pickled.

        From it on, an environment made alike gives the same bits, later episodes included, in any process.
        """
        return {
            "episodes": self.episodes.get_state(),
            "np_random": self.np_random.bit_generator.state,
            "ended": self._ended.copy(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Go back to a snapshot taken by `get_state`; AmulettError if it is one of another number of devices."""
        self.episodes.set_state(state["episodes"])
        self.np_random.bit_generator.state = state["np_random"]
        self._ended = state["ended"].copy()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderers": []}

    def _next_episodes(self, devices: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        self.episodes.next_episode(devices)
        observations = self.episodes.start(devices)
        self._clear_renderers(devices)
        return observations, self.episodes.report(devices)

    def _clear_renderers(self, devices: NDArray[np.int64]) -> None:
        for device in devices if self._renderers else ():
            self._renderers[device].clear()

    def _mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise AmulettError(f"reset_mask has to be an ndarray of bool, shape ({self.num_envs},); it is {mask!r}")
        return mask

    @staticmethod
    def _info(report: NDArray[np.float64]) -> dict[str, Any]:
        info: dict[str, Any] = dict(zip(READINGS, report.T[FIRST_READING:FIRST_METRIC], strict=True))
        failures = info["failure"].astype(np.int64)
        info["failure"] = _FAILURES[failures] if failures.any() else np.zeros(failures.size, dtype=_FAILURES.dtype)
        info["reward_terms"] = dict(zip(TERMS, report.T[FIRST_TERM:FIRST_READING], strict=True))
        info["metrics"] = dict(zip(METRICS, report.T[FIRST_METRIC:], strict=True))
        return info


class ScalingVectorEnv(TensionVectorEnv):
    """Many `Amulett/Scaling-v0` at once; see :class:`TensionVectorEnv` and its single environment."""

    env_id = ENV_IDS[0]
    acts_by_factor = True


def _batched(space: Space[Any], count: int) -> Space[Any]:
    """Return the space of a batch. Its bounds are views of one row: repeated, they would fill 140 bytes a device."""
    batched = batch_space(space, count)
    for name in ("low", "high", "bounded_below", "bounded_above"):
        row = getattr(space, name)
        setattr(batched, name, np.broadcast_to(row, (count, *row.shape)))
    return batched
