"""Adapter from the native vector environment to Stable-Baselines3's `VecEnv`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

import amulett_gym
from amulett_gym.envs.arguments import checked_options
from amulett_gym.envs.info import info_of
from amulett_gym.envs.single import RESET_OPTIONS
from amulett_gym.envs.transition import FIRST_TERM
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.errors import AmulettError, unknown

Indices = None | int | Iterable[int]

_OF_VECTORS = ("num_envs", "threads", "vectorization_mode", "autoreset_mode")
"""Keywords that only the vector environments have."""


def make_sb3_env(
    env_id: str = "Amulett/Scaling-v0", num_envs: int = 1, seed: int | None = None, **keywords: Any
) -> SB3VecEnv:
    """Make the native vector environment for Stable-Baselines3.

    Returns and lengths of episodes are logged (``rollout/ep_rew_mean``) without SB3's ``VecMonitor``, which is needed
    only for writing them to a file, and warns that it replaces them.

    Parameters
    ----------
    env_id : str
        An id of `amulett_gym.ENV_IDS`, with or without the prefix ``amulett_gym:``.
    num_envs : int
        Number of devices.
    seed : int, optional
        As of SB3's `make_vec_env`: device i's first reset has the seed ``seed + i``, and samples of the action space
        are seeded. A learner's own seed replaces it.
    **keywords
        Keywords of the environment, ``max_episode_steps`` included; set ``failure_horizon`` with it.

    Raises
    ------
    AmulettError
        If the id, the number of devices or a keyword is wrong.
    """
    name = env_id.removeprefix("amulett_gym:")
    if name not in amulett_gym.ENV_IDS:
        raise unknown("environment", env_id, amulett_gym.ENV_IDS)
    env = SB3VecEnv(cast(TensionVectorEnv, gym.make_vec(name, num_envs=num_envs, **keywords)))
    if seed is not None:
        env.seed(seed)
        env.action_space.seed(seed)
    return env


class SB3VecEnv(VecEnv):
    """SB3's `VecEnv` over a native vector environment (autoreset mode NEXT_STEP), with the bits of SB3's `DummyVecEnv`.

    SB3 expects the first observation of the next episode in the step that ends one. So finished devices are reset at
    once, and their info keeps their last observation.

    ``infos`` are empty except for devices whose episode has just ended; empty ones are reused in the next step unless
    they were written to. The others hold the single environment's info, ``terminal_observation``,
    ``TimeLimit.truncated``, ``episode_terms`` (the reward's terms summed over the episode) and, as from SB3's monitors,
    ``episode``: return ``r``, length ``l``, seconds ``t`` since the adapter was made.

    Parameters
    ----------
    venv : TensionVectorEnv
        A native one, as `gym.make_vec` returns it.

    Raises
    ------
    AmulettError
        If it is wrapped: the wrappers would miss the reset of finished devices; if its class overrides `step` or
        `next_episodes` instead of what these build on; or if it has another autoreset mode.
    """

    def __init__(self, venv: TensionVectorEnv) -> None:
        if venv is not venv.unwrapped:
            raise AmulettError(f"{venv} is wrapped; give SB3VecEnv the native environment, and wrap the SB3VecEnv")
        if venv.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise AmulettError(
                f"autoreset_mode is '{venv.autoreset_mode.value}'; SB3VecEnv resets finished devices itself: leave it "
                "out, or choose 'NextStep'"
            )
        for passed_over, used in (("step", "step_report"), ("next_episodes", "next_report")):
            if getattr(type(venv), passed_over) is not getattr(TensionVectorEnv, passed_over):
                raise AmulettError(
                    f"{type(venv).__name__} overrides '{passed_over}', which SB3VecEnv does not call: override '{used}'"
                )
        self.venv = venv
        self._actions: NDArray[np.float32] = np.zeros(venv.action_space.shape or (), dtype=np.float32)
        # Sums over the episodes so far, in the order of a report: the reward, then its terms
        self._sums = np.zeros((1 + len(venv.episodes.terms), venv.num_envs))
        self._lengths = np.zeros(venv.num_envs, dtype=np.int64)
        self._begun = False
        self._empty_infos: list[dict[str, Any]] = [{} for _ in range(venv.num_envs)]
        self._started = time.monotonic()
        super().__init__(venv.num_envs, venv.single_observation_space, venv.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Start an episode with all devices; return the observations, shape (num_envs, 13)."""
        seeds = None if self._seeds[0] is None else [int(seed) for seed in self._seeds if seed is not None]
        observations, _ = self.venv.reset(seed=seeds, options=self._common_options())
        self._sums[:], self._lengths[:], self._begun = 0.0, 0, True
        self.reset_infos = self._infos(np.arange(self.num_envs), self.venv.episodes.report())
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Take one step with all devices; see :class:`SB3VecEnv` for the infos.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there was no `reset` of the adapter itself yet.
        """
        if not self._begun:
            raise gym.error.ResetNeeded("call reset() before step()")
        observations, report, terminated, truncated, _ = self.venv.step_report(self._actions, brief=True)
        self._sums += report.T[: len(self._sums)]
        self._lengths += 1
        dones = terminated | truncated
        if any(self._empty_infos):  # a dict that a caller wrote to is left to the caller
            self._empty_infos = [{} for _ in range(self.num_envs)]
        infos = self._empty_infos.copy()  # reused: making thousands of dicts would take most of the time
        finished = np.flatnonzero(dones)
        if finished.size:
            for device, ending in zip(finished.tolist(), self._endings(finished, report), strict=True):
                ending["terminal_observation"] = observations[device].copy()
                ending["TimeLimit.truncated"] = bool(truncated[device] and not terminated[device])
                infos[device] = ending
            observations[finished] = self._begin(finished)
        return observations, report[:, 0].astype(np.float32), dones, infos

    def stagger(
        self, action: float | NDArray[np.float32], steps: int, watch: Callable[[], object] = int
    ) -> NDArray[np.float32]:
        """Start the devices' next episodes one after the other; return the observations, shape (num_envs, 13).

        Episodes that start together stay synchronous: a short rollout would then hold the same part of all of them.

        Parameters
        ----------
        action : float or ndarray
            Held by all devices for all `steps`: a number for all its entries, or one for each.
        steps : int
            Agent steps over which the starts are spread evenly: the length of an episode.
        watch : callable
            Called after each step, to show progress.
        """
        actions = np.full_like(self._actions, action)
        begins = np.arange(self.num_envs) * steps // self.num_envs
        observations = np.zeros((0, 0), dtype=np.float32)
        for step in range(steps):
            self.step_async(actions)
            observations, _, dones, _ = self.step_wait()
            due = np.flatnonzero((begins == step) & ~dones)
            if due.size:
                observations[due] = self._begin(due)
            watch()
        return observations

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all episodes with the sums for their infos; AmulettError if there was no reset yet."""
        if not self._begun:
            raise AmulettError("call reset() before get_state(): there is no episode yet")
        returns, *terms = self._sums.copy()
        return {
            "venv": self.venv.get_state(),
            "returns": returns,
            "lengths": self._lengths.copy(),
            "terms": dict(zip(self.venv.episodes.terms, terms, strict=True)),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot taken by `get_state` from an adapter of the same environment."""
        self.venv.set_state(state["venv"])
        terms = (state["terms"][name] for name in self.venv.episodes.terms)
        self._sums[:], self._lengths[:], self._begun = [state["returns"], *terms], state["lengths"], True

    def close(self) -> None:
        """Close the environment."""
        self.venv.close()

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """Draw every device."""
        frames = self.venv.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of each device, with the value of its single environment."""
        devices = list(self._get_indices(indices))
        if attr_name == "scenario":
            return [self.venv.episodes.unpacked(device) for device in devices]
        if attr_name in ("observation_space", "action_space"):
            value = getattr(self.venv, f"single_{attr_name}")
        elif attr_name == "metadata":
            value = {key: entry for key, entry in self.venv.metadata.items() if key != "autoreset_mode"}
        elif attr_name == "spec":
            value = _single_spec(self.venv.spec)
        else:
            value = getattr(self.venv, attr_name)
        return [value] * len(devices)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment, which all devices share; AmulettError for some of them only."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise AmulettError(f"'{attr_name}' belongs to all {self.num_envs} devices; it cannot be set for some")
        setattr(self.venv, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call ``get_wrapper_attr``; AmulettError for others: devices of a native environment have no methods."""
        if method_name == "get_wrapper_attr":
            return self.get_attr(str(args[0]), indices)
        raise AmulettError(
            f"'{method_name}' cannot be called on single devices of a native vector environment; "
            "call it on `.venv`, or use SB3's DummyVecEnv of single environments"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Return for each device whether the class is SB3's `Monitor`, whose statistics are in ``infos``."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _begin(self, devices: NDArray[np.int64]) -> NDArray[np.float32]:
        """Start the next episode of some devices; return their observations."""
        self._sums[:, devices], self._lengths[devices] = 0.0, 0
        observations, report = self.venv.next_report(devices)
        for device, beginning in zip(devices.tolist(), self._infos(devices, report), strict=True):
            self.reset_infos[device] = beginning
        return observations

    def _endings(self, finished: NDArray[np.int64], report: NDArray[np.float64]) -> list[dict[str, Any]]:
        """Return the infos of finished devices, from the brief report of all."""
        seconds = round(time.monotonic() - self._started, 6)
        infos = self._infos(finished, self.venv.episodes.whole(report[finished], finished))
        sums, lengths = self._sums[:, finished].T.tolist(), self._lengths[finished].tolist()
        for info, (total, *terms), length in zip(infos, sums, lengths, strict=True):
            info["episode"] = {"r": total, "l": length, "t": seconds}
            info["episode_terms"] = dict(zip(self.venv.episodes.terms, terms, strict=True))
        return infos

    def _infos(self, devices: NDArray[np.int64], report: NDArray[np.float64]) -> list[dict[str, Any]]:
        """Return the single environment's info of some devices, from their report."""
        rows = zip(devices.tolist(), report[:, FIRST_TERM:].tolist(), strict=True)
        return [info_of(self.venv.episodes, row, device) for device, row in rows]

    def _common_options(self) -> dict[str, Any] | None:
        """Return the options given by SB3's `set_options`, in the vector environment's form."""
        given = [checked_options(options, RESET_OPTIONS) for options in self._options if options]
        if not given:
            return None
        if len(given) != self.num_envs:
            raise AmulettError(f"set_options gave a scenario to {len(given)} of {self.num_envs} devices; allowed: all")
        return {"scenario": [options["scenario"] for options in given]}


def _single_spec(spec: EnvSpec | None) -> EnvSpec | None:
    """Return the spec of the single environment of a vector environment."""
    if spec is None:
        return None
    kwargs = {key: value for key, value in spec.kwargs.items() if key not in _OF_VECTORS}
    steps = kwargs.pop("max_episode_steps", spec.max_episode_steps)
    return replace(gym.spec(spec.id), kwargs=kwargs, max_episode_steps=steps)
