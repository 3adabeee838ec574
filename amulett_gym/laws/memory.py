"""What a policy remembers of an episode: running means that tell devices, and loads, apart.

One observation shows the present; the device shows in how commands, tensions and the joint answer each other. Each
quantity below is averaged over the episode so far with two time constants: while less time has passed, the mean is that
of all steps so far, so that it does not depend on a start value. All are computed from what the device measures.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym import WORN_ID
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.laws.history import check_all_devices
from amulett_gym.laws.worn_inputs import TRACES, cuff_quantities, next_traces

Values = NDArray[np.float64]

_ERROR, _, _VELOCITY, _, _TENSION, _COMMAND = (float(scale) for scale in OBSERVATION_SCALES.values())
_KNOWN = len(OBSERVATIONS)

SPANS = (25, 250)
"""Time constants of the means [agent steps]: 0.5 s and 5 s at 20 ms."""


def _quantities(rows: Values, before: Values) -> dict[str, Values]:
    """Return the averaged quantities by name, each of shape (N,), from two observations in turn."""
    now, last = dict(zip(OBSERVATIONS, rows.T, strict=False)), dict(zip(OBSERVATIONS, before.T, strict=False))
    flexes = now["agonist"] > 0.0

    def sides(name: str) -> tuple[Values, Values]:
        biceps, triceps = now[f"{name}_biceps"], now[f"{name}_triceps"]
        return np.where(flexes, biceps, triceps), np.where(flexes, triceps, biceps)

    def changes(name: str, unit: float) -> tuple[Values, Values]:
        parts = [unit * (now[f"{name}_{side}"] - last[f"{name}_{side}"]) for side in ("biceps", "triceps")]
        return np.where(flexes, parts[0], parts[1]), np.where(flexes, parts[1], parts[0])

    error, velocity = math.degrees(_ERROR) * now["position_error"], math.degrees(_VELOCITY) * now["joint_velocity"]
    jolt = velocity - math.degrees(_VELOCITY) * last["joint_velocity"]
    (pulled, followed), (stretched, _) = changes("command", math.degrees(_COMMAND)), sides("spring_deflection")
    (pulling, other), (grows, changed) = sides("estimated_tension"), changes("estimated_tension", _TENSION)
    return {
        # how well the arm is controlled
        "error_size": np.tanh(np.abs(error) / 3.0),
        "agonist_error": now["agonist"] * np.tanh(error / 3.0),
        "speed": np.tanh(np.abs(velocity) / 30.0),
        "jolt": np.tanh(np.abs(jolt) / 30.0),
        # how much the drives move
        "agonist_effort": np.tanh(np.abs(pulled) / 8.0),
        "antagonist_effort": np.tanh(np.abs(followed) / 8.0),
        # noise and answers of the force estimates
        "agonist_tension": pulling,
        "antagonist_tension": other,
        "agonist_tension_change": np.tanh(np.abs(grows) / 0.7),
        "antagonist_tension_change": np.tanh(np.abs(changed) / 0.7),
        "agonist_answer": np.tanh(pulled / 8.0) * np.tanh(grows / 0.7),
        "antagonist_answer": np.tanh(followed / 8.0) * np.tanh(changed / 0.7),
        "acceleration": now["agonist"] * np.tanh(jolt / 15.0) * np.tanh(pulled / 8.0),
        # loads and springs
        "agonist_deflection": stretched,
        "slack": np.where(other * _TENSION < 5.05, 1.0, 0.0),
        "tension_setpoint": now["tension_setpoint"],
    }


NAMES = tuple(_quantities(*np.zeros((2, 1, _KNOWN))))

MEMORY = tuple(f"{name}_{span}" for span in SPANS for name in NAMES)
"""Names of the means, in order; all are in [-1, 1]."""

WORN_NAMES = (*NAMES, *cuff_quantities(np.zeros((1, len(WORN_OBSERVATIONS)))))

WORN_MEMORY = (*(f"{name}_{span}" for span in SPANS for name in WORN_NAMES), *TRACES)
"""Names of the means, and of the traces that follow them, in `Amulett/Worn-v0`."""


class Memory:
    """The running means of a batch of devices; `worn`: of those in `Amulett/Worn-v0`, with `WORN_MEMORY`.

    Attributes
    ----------
    means : ndarray, shape (devices, len(MEMORY))
    last : ndarray, shape (devices, 13)
        The last observation of each device.
    steps : ndarray of int, shape (devices,)
        Observations of its episode so far.
    """

    def __init__(self, devices: int, worn: bool = False) -> None:
        self.means = np.zeros((devices, len(WORN_MEMORY if worn else MEMORY)))
        self.last = np.zeros((devices, len(WORN_OBSERVATIONS) if worn else _KNOWN))
        self.steps = np.zeros(devices, dtype=np.int64)

    def forget(self, devices: NDArray[Any] | slice) -> None:
        """Begin an episode of some devices, by indices or a mask."""
        self.steps[devices] = 0
        self.means[devices] = 0.0  # so that no rounding of an earlier episode is left

    def add(self, observations: ArrayLike, devices: NDArray[np.int64] | slice = slice(None)) -> Values:
        """Add an observation of each of some devices, shape (K, 13) or wider; return their means, (K, len(MEMORY))."""
        rows = np.asarray(observations, dtype=np.float64)[:, : self.last.shape[1]]
        steps = self.steps[devices]
        found = _quantities(rows, np.where(steps[:, None] > 0, self.last[devices], rows))
        cuff = cuff_quantities(rows) if rows.shape[1] > _KNOWN else {}
        values = np.stack([*found.values(), *cuff.values()], axis=1)
        shares = 1.0 / np.minimum(steps[:, None] + 1, SPANS)
        before = self.means[devices]
        averaged = len(SPANS) * values.shape[1]
        means = before[:, :averaged]
        means = means + np.repeat(shares, values.shape[1], axis=1) * (np.tile(values, len(SPANS)) - means)
        if cuff:
            means = np.concatenate([means, next_traces(rows, before[:, averaged:], steps == 0)], axis=1)
        self.means[devices], self.last[devices], self.steps[devices] = means, rows, steps + 1
        return means


class ClockedMemory:
    """The memory of an environment's devices, which forgets when its clock shows that an episode begins.

    Repeated calls within an agent step return the same. `env` is an AMULETT environment, single or vector.
    """

    def __init__(self, env: Any) -> None:
        self._episodes = env.unwrapped.episodes
        devices = self._episodes.simulation.num_devices
        self._memory = Memory(devices, env.unwrapped.env_id == WORN_ID)
        self._steps = np.full(devices, -1)

    def add(self, observations: Values) -> Values:
        """Add the present observations of all devices; return their means, shape (N, len(MEMORY)).

        Raises
        ------
        AmulettError
            If there are not as many rows as devices.
        """
        steps = self._episodes.steps()
        check_all_devices(observations.shape, (len(steps), observations.shape[-1]), "memory")
        passed = np.flatnonzero((steps != self._steps) | (steps == 0))
        self._memory.forget(steps == 0)
        self._memory.add(observations[passed], passed)
        self._steps = steps
        return self._memory.means.copy()
