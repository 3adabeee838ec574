"""A network as a policy: its inputs from observations, its output as actions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.laws.bundle import Layers, PolicyDescription, forward
from amulett_gym.laws.features import with_features
from amulett_gym.laws.history import History

TENSION_SETPOINT = OBSERVATIONS.index("tension_setpoint")


class Actor:
    """A network that acts in an environment; with a history, only for all of its devices at once.

    Observations and actions are scaled by the tension range of `policy`. The clock of `env`, an AMULETT environment
    (single or vector), shows where episodes begin.
    """

    def __init__(self, layers: Layers, policy: PolicyDescription, env: Any) -> None:
        self._layers, self._policy = layers, policy
        self._range = policy.tension_range[0], policy.tension_range[1]
        self._history = History(env, policy.history, policy.size) if policy.history > 1 else None

    def __call__(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the actions, shape (N, 1), for a batch of observations, shape (N, 13) or wider."""
        wanted = forward(self._layers, self._policy.network, self.inputs(observations))
        return follow(wanted, observations, self._policy.follow)

    def inputs(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the network's inputs, shape (N, inputs)."""
        found = observations[:, : len(self._policy.observations)].astype(np.float64)
        if self._policy.features:
            found = with_features(found, self._range)
        return found if self._history is None else self._history.add(found)


def follow(wanted: NDArray[np.float32], observations: NDArray[np.floating[Any]], share: float) -> NDArray[np.float32]:
    """Return the actions, shape (N, 1), a share of the way from the present setpoint to the wanted one."""
    if share == 1.0:
        return wanted
    present = observations[:, TENSION_SETPOINT : TENSION_SETPOINT + 1].astype(np.float64)
    return (present + share * (wanted - present)).astype(np.float32)
