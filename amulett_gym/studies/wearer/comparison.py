"""Tuned baselines, guards and learned policies on the same held-out wearers, with and without Bowden cables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym import WORN_ID
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import MANIFEST, read_bundle
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.laws.policies import begin_episode, named_policy
from amulett_gym.laws.worn import Constant, WornLaw
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import Control
from amulett_gym.storage.kept import digest
from amulett_gym.storage.reading import read_text
from amulett_gym.studies.wearer.baselines import Tuned, device_of
from amulett_gym.studies.wearer.episodes import Devices, Scenarios, devices_keyword, play, steps_of

Values = NDArray[np.float64]

DOFFED = "doffed"

GUARDS = {
    "slack": "no co-contraction, full assistance",
    "slack, no assistance": "no co-contraction, no assistance",
    "held still": "15 N of co-contraction, no assistance",
}
"""What must not be rewarded: an arm that does nothing, and one that holds the wearer."""

_LEVELS = {"slack": (0.0, 1.0), "slack, no assistance": (0.0, 0.0), "held still": (15.0, 0.0)}


def play_guard(name: str, constant: Tuned, profile: Profile, scenarios: Scenarios) -> dict[str, Values]:
    """Play one of `GUARDS` with the admittance of the best constant."""
    tension, assistance = _LEVELS[name]
    act = WornLaw(Constant(co_contraction=tension, assistance=assistance))
    return play(device_of(profile, constant.values), constant.control, scenarios, act)


_ACTING = ("control", "tension_law", "action_delay", "observation_noise")
"""Keywords of a bundle's environment that change what its policy sees and does; two more are in its own description."""


@dataclass(frozen=True)
class Learned:
    """A learned policy with the keywords of the environment that it was trained in.

    Attributes
    ----------
    name : str
        Its folder, or a shipped policy's name.
    settings : WornSettings
        Device, control loop, agent period, tension range, what delays its actions and disturbs its observations. The
        rest is the study's.
    digest : str
        Of its bundle's manifest.
    """

    name: str
    settings: WornSettings
    digest: str

    @property
    def device(self) -> Profile:
        """The device."""
        return self.settings.profile

    @property
    def control(self) -> Control:
        """The control loop."""
        return self.settings.control

    def play(self, profile: Devices, scenarios: Scenarios) -> dict[str, Values]:
        """Play scenarios on a device or several, such as its own with cables, in its loop; see `episodes.play`."""
        steps = steps_of(self.settings.agent_period, self.name)
        acting = {key: value for key, value in self.settings.given.items() if key != "profile"}
        own = {**devices_keyword(profile), "suite": scenarios.suite, "failure_horizon": steps}
        env: Any = gym.make_vec(WORN_ID, num_envs=len(scenarios), **acting | own)
        try:
            policy = named_policy(self.name, env)

            class Act:
                """The policy, which begins an episode without arguments."""

                def reset(self, devices: int) -> None:
                    begin_episode(policy)

                def __call__(self, observations: NDArray[np.float32]) -> Any:
                    return policy(observations)

            return play(profile, self.control, scenarios, Act(), episodes=env.unwrapped.episodes)
        finally:
            env.close()


def load_learned(name: str, device: Profile) -> Learned:
    """Return a learned policy.

    Parameters
    ----------
    name : str
        Its bundle's folder, that of its training run, or a shipped policy's name.
    device : Profile
        On which a policy plays that was trained on a fleet; others play on their own device.

    Raises
    ------
    AmulettError
        If there is no such bundle, it was trained in another environment, or an episode of the study is no whole number
        of its steps.
    """
    folder = bundle_folder(name)
    bundle = read_bundle(folder)
    if bundle.env.id != WORN_ID:
        raise AmulettError(f"policy '{name}' was trained in {bundle.env.id}; it has to be one of {WORN_ID}")
    trained, policy = bundle.env.keywords, bundle.policy
    keywords = {key: trained[key] for key in _ACTING if key in trained}
    keywords |= {"agent_period": policy.agent_period, "tension_range": policy.tension_range}
    keywords["profile"] = device if trained.get("fleet") is not None else trained.get("profile", "worn")
    settings = WornSettings.read(keywords, f"policy '{name}'")
    steps_of(settings.agent_period, name)
    return Learned(name, settings, digest(read_text(folder / MANIFEST, "manifest")))
