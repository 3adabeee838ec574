"""A network as a policy: its inputs from observations, its output as actions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.laws.bundle import Layers, PolicyDescription, forward
from amulett_gym.laws.features import with_features
from amulett_gym.laws.history import History
from amulett_gym.laws.memory import ClockedMemory
from amulett_gym.laws.worn_inputs import ASSISTANCE

TENSION_SETPOINT = OBSERVATIONS.index("tension_setpoint")
_SETPOINT = OBSERVATIONS.index("setpoint")
_COMMANDS = [OBSERVATIONS.index(f"command_{name}") for name in ("biceps", "triceps")]


class Actor:
    """A network that acts in an environment; with a history or a memory, only for all of its devices at once.

    Observations and actions are scaled by the tension range of `policy`. The clock of `env`, an AMULETT environment
    (single or vector), shows where episodes begin.
    """

    def __init__(self, layers: Layers, policy: PolicyDescription, env: Any) -> None:
        self._layers, self._policy = layers, policy
        self._range = policy.tension_range[0], policy.tension_range[1]
        self._memory = ClockedMemory(env) if policy.memory else None
        self._history = History(env, policy.history, policy.size) if policy.history > 1 else None

    def __call__(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the actions, shape (N, outputs), for a batch of observations, shape (N, 13) or wider."""
        wanted = forward(self._layers, self._policy.network, self.inputs(observations))
        if self._policy.setpoint_gain is not None:
            wanted = beyond_setpoint(wanted, observations, self._policy.setpoint_gain)
        policy = self._policy
        return follow(wanted, observations, policy.follow, policy.mean_angle_range, policy.is_worn)

    def inputs(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the network's inputs, shape (N, inputs)."""
        found = observations[:, : len(self._policy.observations)].astype(np.float64)
        remembered = None if self._memory is None else self._memory.add(found)
        shown = self._range if self._policy.features else None
        found = with_features(found, shown, remembered, self._policy.is_worn)
        return found if self._history is None else self._history.add(found)


def beyond_setpoint(
    actions: NDArray[np.float32], observations: NDArray[np.floating[Any]], gain: float
) -> NDArray[np.float32]:
    """Return actions, shape (N, 2), whose first entry was relative to that for the setpoint, limited to [-1, 1].

    `gain` is the action for the mean drive angle by the setpoint's entry of the observations.
    """
    mean = actions[:, 0].astype(np.float64) + gain * observations[:, _SETPOINT].astype(np.float64)
    return np.stack([np.clip(mean, -1.0, 1.0).astype(np.float32), actions[:, 1]], axis=1)


def follow(
    wanted: NDArray[np.float32],
    observations: NDArray[np.floating[Any]],
    share: float,
    mean_angle_range: float | None = None,
    worn: bool = False,
) -> NDArray[np.float32]:
    """Return the actions, a share of the way from the present setpoints to the wanted ones.

    Parameters
    ----------
    wanted : ndarray, shape (N, 1) or (N, 2)
        Tension; or mean drive angle and tension; or tension and assistance: as actions.
    observations : ndarray, shape (N, 13) or wider
        They hold the present tension setpoint, and the commands, whose mean is the present mean drive angle.
    share : float
        From 0 to 1; 1 returns `wanted`.
    mean_angle_range : float, optional
        Mean drive angle at action +1 [deg], if there is one.
    worn : bool
        Whether the second entry is the assistance, which the observations of `Amulett/Worn-v0` hold.
    """
    if share == 1.0:
        return wanted
    present = observations[:, TENSION_SETPOINT : TENSION_SETPOINT + 1].astype(np.float64)
    if mean_angle_range is not None:
        scale = math.degrees(OBSERVATION_SCALES["command"]) / mean_angle_range
        mean = scale * observations[:, _COMMANDS].astype(np.float64).mean(axis=1, keepdims=True)
        present = np.concatenate([mean, present], axis=1)
    if worn:
        assistance = observations[:, ASSISTANCE : ASSISTANCE + 1].astype(np.float64)
        present = np.concatenate([present, 2.0 * assistance - 1.0], axis=1)
    return (present + share * (wanted - present)).astype(np.float32)
