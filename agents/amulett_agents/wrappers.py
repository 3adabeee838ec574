"""Wrappers that prepare the adapter's data for a learner."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from amulett_agents.adapter import SB3VecEnv, make_sb3_env
from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.settings import NO_LIMIT
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import beyond_setpoint, follow
from amulett_gym.laws.features import FEATURES, WORN_FEATURES, with_features
from amulett_gym.laws.memory import MEMORY, WORN_MEMORY, Memory
from amulett_gym.reporting.progress import Progress


class Staggered(VecEnvWrapper):
    """Starts the devices' episodes at different times.

    Parameters
    ----------
    venv : SB3VecEnv
    action : float or ndarray
        Action of all devices in the first `steps` steps of a run, which are not used for learning.
    steps : int
        Length of an episode [agent steps].
    progress : bool
        Show progress on stderr at a reset.
    """

    def __init__(
        self, venv: SB3VecEnv, action: float | NDArray[np.float32], steps: int, progress: bool = False
    ) -> None:
        super().__init__(venv)
        self._adapter, self._action, self._steps, self._progress = venv, action, steps, progress

    def reset(self) -> Any:
        """Start an episode with all devices, one after the other."""
        self._adapter.reset()
        with Progress(self._steps, "starting the devices", "steps", self._progress) as bar:
            return self._adapter.stagger(self._action, self._steps, bar.update)

    def step_wait(self) -> Any:
        """Take one step with all devices."""
        return self.venv.step_wait()


class ActorView(VecEnvWrapper):
    """The environment from the view of the network of an `amulett_gym.laws.actor.Actor`.

    Parameters
    ----------
    venv : VecEnv
    tension_range : (float, float)
        Tensions at action -1 and +1 [N].
    features : bool
        Whether features are appended to the observations.
    share : float
        Share of the way from the present setpoint to the network's output that an action covers.
    mean_angle_range : float, optional
        Mean drive angle at action +1 [deg], if there is one.
    setpoint_gain : float, optional
        Mean drive angle, as action, by the setpoint's entry; the learner's action is added to it.
    mean_unit : float
        Action for the mean drive angle that the learner's action of 1 stands for: with the same exploration noise in
        both of its entries, that of the mean drive angle is smaller.
    memory : bool
        Whether means over the episode so far are appended, too.
    worn : bool
        Whether the devices are those of `Amulett/Worn-v0`.

    Attributes
    ----------
    seen : ndarray of float32, shape (num_envs, entries)
        The present observations of the network.
    memory : Memory or None
        Of all devices; a run's staggered devices begin with an empty one within their first episodes.
    """

    def __init__(
        self,
        venv: VecEnv,
        tension_range: tuple[float, float],
        features: bool,
        share: float,
        mean_angle_range: float | None = None,
        setpoint_gain: float | None = None,
        mean_unit: float = 1.0,
        memory: bool = False,
        worn: bool = False,
    ) -> None:
        assert venv.observation_space.shape is not None
        assert venv.action_space.shape is not None
        self.memory = Memory(venv.num_envs, worn) if memory else None
        size = venv.observation_space.shape[0] + (len(WORN_FEATURES if worn else FEATURES) if features else 0)
        size += len(WORN_MEMORY if worn else MEMORY) if memory else 0
        shown = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
        bounds = np.ones(venv.action_space.shape, dtype=np.float32)
        if mean_angle_range is not None:
            bounds[0] = 1.0 / mean_unit
        super().__init__(venv, shown, gym.spaces.Box(-bounds, bounds))
        self.worn = worn
        self.tension_range, self.features, self.share = tension_range, features, share
        self.mean_angle_range, self.setpoint_gain, self.mean_unit = mean_angle_range, setpoint_gain, mean_unit
        self.seen: NDArray[np.float32] = np.zeros((venv.num_envs, size), dtype=np.float32)

    def reset(self) -> Any:
        """Start an episode with all devices."""
        if self.memory is not None:
            self.memory.forget(slice(None))
        self.seen = self._show(self.venv.reset())
        return self.seen

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Send the low-pass filtered actions."""
        if self.mean_unit != 1.0:
            actions = actions * np.array([self.mean_unit, 1.0], dtype=np.float32)
        if self.setpoint_gain is not None:
            actions = beyond_setpoint(actions, self.seen, self.setpoint_gain)
        self.venv.step_async(follow(actions, self.seen, self.share, self.mean_angle_range, self.worn))

    def step_wait(self) -> Any:
        """Take one step with all devices."""
        observations, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size:
            last = self._show(np.stack([infos[device]["terminal_observation"] for device in ended]), ended)
            for device, seen in zip(ended, last, strict=True):
                infos[device]["terminal_observation"] = seen
            if self.memory is not None:
                self.memory.forget(ended)
        self.seen = self._show(observations)
        return self.seen, rewards, dones, infos

    def _show(self, observations: Any, devices: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.float32]:
        """Return what the network sees of the present observations of some devices, which are remembered."""
        remembered = None if self.memory is None else self.memory.add(observations, devices)
        return with_features(observations, self.tension_range if self.features else None, remembered, self.worn)


def recipe_view(venv: VecEnv, follow_time: float = 0.05, features: bool = True) -> ActorView:
    """Return an environment as the shipped recipes show it to a network, for a learner of your own.

    The network's output passes a low-pass before it becomes the setpoint: exploration noise costs less effort. Its
    inputs have a finer scale. `save_policy` keeps both in the bundle.

    Parameters
    ----------
    venv : VecEnv
        `Amulett/Scaling-v0`, `Amulett/Tension-v0` or `Amulett/Worn-v0`: of `make_sb3_env`, or SB3's of single ones.
    follow_time : float
        Time constant of the low-pass [s]; 0: none.
    features : bool
        Whether `amulett_gym.laws.features` are appended to the observations.

    Raises
    ------
    AmulettError
        If the environment is another one, or `follow_time` is below 0.
    """
    _refuse_others(venv, "recipe_view")
    env_id, settings = venv.get_attr("env_id")[0], venv.get_attr("settings")[0]
    if env_id == DRIVES_ID:
        raise AmulettError(f"recipe_view is not for {DRIVES_ID}: train with configs/drives.yaml")
    if not follow_time >= 0.0:
        raise AmulettError(f"follow_time is {follow_time} s; it has to be at least 0")
    period = settings.agent_period
    share = period / max(follow_time, period)
    return ActorView(venv, settings.tension_range, features, share, worn=env_id == WORN_ID)


def native_view(venv: VecEnv) -> VecEnv:
    """Return the devices of SB3's vector of single environments as a native one, one compiled call per step.

    For programs that make single environments and let a VecEnv be wrapped, such as rl_zoo3 (``vec_env_wrapper``). The
    devices have the seeds of the single environments, which are closed: their monitors write nothing. Environments
    that draw in a window, which the native one does not, are returned as they are.

    Parameters
    ----------
    venv : VecEnv
        SB3's `DummyVecEnv` or `SubprocVecEnv`, without wrappers that change steps.

    Raises
    ------
    AmulettError
        If its environments are others than AMULETT's.
    """
    _refuse_others(venv, "native_view")
    env_id, settings = venv.get_attr("env_id")[0], venv.get_attr("settings")[0]
    if settings.render_mode == "human":
        return venv
    steps = venv.get_attr("_max_episode_steps")[0] if venv.has_attr("_max_episode_steps") else NO_LIMIT
    devices = make_sb3_env(env_id, venv.num_envs, max_episode_steps=steps, **settings.given)
    devices._seeds = list(venv._seeds)
    venv.close()
    return devices


def _refuse_others(venv: VecEnv, view: str) -> None:
    """Raise an AmulettError that names the environment if a view is not for it."""
    if not isinstance(venv, VecEnv):
        raise AmulettError(
            f"{view} takes a VecEnv of Stable-Baselines3, not a {type(venv).__name__}: make one with make_sb3_env"
        )
    if not venv.has_attr("env_id"):
        spec = venv.get_attr("spec")[0] if venv.has_attr("spec") else None
        name = "an environment without an id" if spec is None else f"'{spec.id}'"
        raise AmulettError(f"{view} is for AMULETT environments such as {ENV_IDS[1]}, not for {name}")


class ScaledRewards(VecEnvWrapper):
    """Multiplies the rewards for the learner by a fixed factor; logged returns stay unscaled."""

    def __init__(self, venv: VecEnv, factor: float) -> None:
        super().__init__(venv)
        self.factor = factor

    def reset(self) -> Any:
        """Start an episode with all devices."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Take one step with all devices."""
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, rewards * np.float32(self.factor), dones, infos
