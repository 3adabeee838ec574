"""The last observations of each device, as inputs of a policy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.errors import AmulettError


class History:
    """The last observations of each of an environment's devices, in the order of Stable-Baselines3's `VecFrameStack`.

    The clock of `env`, an AMULETT environment (single or vector), shows where an episode begins: earlier observations
    are dropped then. Repeated calls within an agent step return the same.
    """

    def __init__(self, env: Any, length: int, size: int) -> None:
        self._episodes = env.unwrapped.episodes
        devices = self._episodes.simulation.num_devices
        self._seen = np.zeros((devices, length, size))
        self._steps = np.full(devices, -1)

    def add(self, observations: ArrayLike) -> NDArray[np.float64]:
        """Add the present observations of all devices, shape (N, size), and return the last ones.

        Returns
        -------
        ndarray, shape (N, length * size)
            The newest last; zeros before the first step of an episode.

        Raises
        ------
        AmulettError
            If the shape is not that of all devices.
        """
        steps, batch = self._episodes.steps(), np.asarray(observations)
        check_all_devices(batch.shape, (len(steps), self._seen.shape[2]), "history")
        self._seen[steps == 0] = 0.0
        passed = steps != self._steps
        self._seen[passed, :-1] = self._seen[passed, 1:]
        self._seen[:, -1] = batch
        self._steps = steps
        return self._seen.reshape(len(steps), -1).copy()


def check_all_devices(shape: tuple[int, ...], wanted: tuple[int, ...], kept: str) -> None:
    """Raise an AmulettError if observations for a policy that has `kept` some are not those of all devices."""
    if shape != wanted:
        raise AmulettError(
            f"the observations have shape {shape}; a policy with a {kept} needs those of all devices of its "
            f"environment, {wanted}"
        )
