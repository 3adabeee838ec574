"""The first policy of a training run: a constant tension; with the drives at the setpoint, or a constant assistance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_agents.config import EnvSettings
from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.envs.action import tension_to_action
from amulett_gym.envs.settings import DrivesSettings
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS

_SETPOINT = OBSERVATIONS.index("setpoint")


@dataclass(frozen=True)
class FirstPolicy:
    """The law to which a network's output is added.

    Attributes
    ----------
    tension : float
        Action for the tension.
    gain : float, optional
        Action for the mean drive angle, by the setpoint's entry in the observation: the drives turn to where they hold
        an arm without a load at its setpoint. None: there is no such action.
    assistance : float, optional
        Action for the assistance, which follows the tension. None: there is no such action.
    """

    tension: float
    gain: float | None = None
    assistance: float | None = None

    @property
    def constant(self) -> NDArray[np.float32]:
        """The action at the setpoint 0."""
        before, after = [] if self.gain is None else [0.0], [] if self.assistance is None else [self.assistance]
        return np.array([*before, self.tension, *after], dtype=np.float32)

    def __call__(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the first actions, shape (N, 1) or (N, 2), for observations, shape (N, 13) or wider."""
        actions = np.tile(self.constant, (len(observations), 1))
        if self.gain is not None:
            actions[:, 0] = self.gain * observations[:, _SETPOINT]
        return actions


def first_policy(settings: EnvSettings, tension: float | None, assistance: float | None = None) -> FirstPolicy:
    """Return the first policy of a recipe's environment.

    Parameters
    ----------
    settings : EnvSettings
    tension : float, optional
        None: the middle of the range [N].
    assistance : float, optional
        In `Amulett/Worn-v0` only, from 0 to 1; None: 1.
    """
    low, high = settings.tension_range
    action = 0.0 if tension is None else float(tension_to_action(np.array(tension), (low, high)))
    if settings.id == WORN_ID:
        return FirstPolicy(action, assistance=1.0 if assistance is None else 2.0 * assistance - 1.0)
    if settings.id != DRIVES_ID:
        return FirstPolicy(action)
    plants = [device.plant for device in settings.devices]
    turns = sum(plant.joint_pulley_radius / plant.drive_pulley_radius for plant in plants) / len(plants)
    device: dict[str, Any] = {"profile": settings.profile} if settings.fleet is None else {"fleet": settings.fleet}
    mean_angle = DrivesSettings(mean_angle_range=settings.mean_angle_range, **device).mean_angle_deg
    return FirstPolicy(action, OBSERVATION_SCALES["joint_angle"] * turns / float(np.radians(mean_angle)))
