"""Tuned baselines, guards and learned policies on the same held-out wearers, with and without Bowden cables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym import WORN_ID
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import MANIFEST, read_bundle
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.laws.policies import begin_episode, named_policy
from amulett_gym.laws.worn import Constant, WornLaw
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import Control
from amulett_gym.storage.kept import digest
from amulett_gym.storage.reading import read_text
from amulett_gym.studies.wearer.baselines import Tuned, device_of
from amulett_gym.studies.wearer.episodes import Scenarios, draw, play, tension_range_of

Values = NDArray[np.float64]
Change = Callable[[Profile], Profile]

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


@dataclass(frozen=True)
class Learned:
    """A learned policy with the device and loop that it was trained with.

    Attributes
    ----------
    name : str
        Its folder, or a shipped policy's name.
    device : Profile
    control : str
    digest : str
        Of its bundle's manifest.
    """

    name: str
    device: Profile
    control: Control
    digest: str

    def play(self, suite: str, count: int, seed: int, change: Change = lambda device: device) -> dict[str, Values]:
        """Play held-out scenarios on its device, after a change, in its loop; see `episodes.play`."""
        scenarios = draw(self.device, suite, "held-out", count, seed)
        changed, ends = change(self.device), tension_range_of(self.control)
        keywords: dict[str, Any] = {"profile": changed, "suite": suite, "control": self.control, "tension_range": ends}
        env: Any = gym.make_vec(WORN_ID, num_envs=count, **keywords)
        try:
            policy = named_policy(self.name, env)

            class Act:
                """The policy, which begins an episode without arguments."""

                def reset(self, devices: int) -> None:
                    begin_episode(policy)

                def __call__(self, observations: NDArray[np.float32]) -> Any:
                    return policy(observations)

            return play(changed, self.control, scenarios, Act(), episodes=env.unwrapped.episodes)
        finally:
            env.close()


def load_learned(name: str) -> Learned:
    """Return a learned policy.

    Raises
    ------
    AmulettError
        If there is no such bundle, or it was trained in another environment.
    """
    folder = bundle_folder(name)
    env = read_bundle(folder).env
    if env.id != WORN_ID:
        raise AmulettError(f"policy '{name}' was trained in {env.id}; it has to be one of {WORN_ID}")
    device, control = load_profile(env.keywords.get("profile", "worn")), env.keywords.get("control", _default_loop())
    return Learned(name, device, control, digest(read_text(folder / MANIFEST, "manifest")))


def _default_loop() -> Control:
    from amulett_gym.envs.worn_settings import WornSettings

    control: Control = WornSettings().control
    return control
