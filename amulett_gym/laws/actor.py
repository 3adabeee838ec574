"""A network as a policy: what it is shown of an observation, and what its output means."""

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
    """Lets a network act in an environment; for all of the environment's devices if it remembers.

    Parameters
    ----------
    layers : list of (weight, bias)
    policy : PolicyDescription
        Its action range is that of the observations and actions here.
    env : gymnasium.Env or VectorEnv
        An AMULETT environment, by whose clock a network with a history knows where episodes begin.
    """

    def __init__(self, layers: Layers, policy: PolicyDescription, env: Any) -> None:
        self._layers, self._policy = layers, policy
        low, high = policy.tension_range
        self._range = (low, high)
        self._history = History(env, policy.history, policy.size) if policy.history > 1 else None

    def __call__(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the actions, shape (N, 1), for a batch of observations, shape (N, 13) or wider."""
        wanted = forward(self._layers, self._policy.network, self.see(observations))
        return follow(wanted, observations, self._policy.follow)

    def see(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return what the network is shown, shape (N, inputs)."""
        seen = observations[:, : len(self._policy.observations)].astype(np.float64)
        if self._policy.features:
            seen = with_features(seen, self._range)
        return seen if self._history is None else self._history.add(seen)


def follow(wanted: NDArray[np.float32], observations: NDArray[np.floating[Any]], share: float) -> NDArray[np.float32]:
    """Return the actions, shape (N, 1), that go a share of the way from the present setpoint to the wanted one."""
    if share == 1.0:
        return wanted
    present = observations[:, TENSION_SETPOINT : TENSION_SETPOINT + 1].astype(np.float64)
    return (present + share * (wanted - present)).astype(np.float32)
