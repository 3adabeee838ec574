"""What a policy remembers that sees more than the present: the last observations of each device."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.errors import AmulettError


class History:
    """The last observations of each of an environment's devices, as Stable-Baselines3's `VecFrameStack` has them.

    The environment's own clock says when an episode begins; the observations of the one before are dropped then.
    Repeated calls within an agent step return the same.

    Parameters
    ----------
    env : gymnasium.Env or VectorEnv
        An AMULETT environment, wrapped or not.
    length : int
        How many observations, at least 1.
    size : int
        Entries of each.
    """

    def __init__(self, env: Any, length: int, size: int) -> None:
        self._episodes = env.unwrapped.episodes
        devices = self._episodes.simulation.num_devices
        self._seen = np.zeros((devices, length, size))
        self._steps = np.full(devices, -1)

    def add(self, observations: ArrayLike) -> NDArray[np.float64]:
        """Take in what the devices see now.

        Parameters
        ----------
        observations : array_like, shape (N, size)
            Of all devices.

        Returns
        -------
        ndarray, shape (N, length * size)
            The newest last; zeros where an episode has not been going on for so long.

        Raises
        ------
        AmulettError
            If they are not as many as the devices.
        """
        steps, batch = self._episodes.steps(), np.asarray(observations)
        if batch.shape != (len(steps), self._seen.shape[2]):
            raise AmulettError(
                f"the observations have shape {batch.shape}; a policy that remembers needs those of all devices of its "
                f"environment, ({len(steps)}, {self._seen.shape[2]})"
            )
        self._seen[steps == 0] = 0.0
        passed = steps != self._steps
        self._seen[passed, :-1] = self._seen[passed, 1:]
        self._seen[:, -1] = batch
        self._steps = steps
        return self._seen.reshape(len(steps), -1).copy()
