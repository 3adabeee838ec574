"""Many laws in many scenarios at once: each device of a batch meets a scenario of its own under a law of its own.

What an episode costs here is minus its return in the environment, bit for bit: a law that is found here is what it
seemed to be. All that searches (tuned laws, the clairvoyant reference) stands on this.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym import __version__
from amulett_gym.envs.action import TENSION_RANGE, tension_to_action
from amulett_gym.envs.episodes import Episodes, Observations, device_seeds
from amulett_gym.envs.reward import COST_CAP, prices
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import FIRST_READING
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.laws.contenders import CONSTANT, parse_contender
from amulett_gym.simulation.layout import RUNNING, Control
from amulett_gym.simulation.random import derive_keys

Actions = NDArray[np.float32]
Costs = NDArray[np.float64]
Devices = NDArray[np.int64]

_REDRAWN_STREAM = np.uint64(1_000_000)

Choose = Callable[[int, Observations], Actions]
"""Maps the number of the agent step and the observations, shape (N, 13), to actions in [-1, 1], shape (N,)."""


class Trials:
    """The scenarios of a comparison, to be met as often as one likes.

    Parameters
    ----------
    protocol : Protocol
        Scenario i is the one that `evaluation.runner.evaluate` would play with it; the action's range is the default.
    control, tension_law : str
        As of the environments.
    threads : int
        How many step at once; what an episode costs is the same.

    Attributes
    ----------
    rows : ndarray of `simulation.layout.SCENARIO`, shape (protocol.episodes,)
        The scenarios, with the keys of their sensor noise.
    steps : int
        Agent steps of an episode.
    draws : int
        Rows of each scenario, which differ by chance alone: 1, but see `redrawn`.

    Raises
    ------
    AmulettError
        If the protocol's duration is no whole number of agent steps.
    """

    def __init__(
        self, protocol: Protocol, control: Control = "decentralized", tension_law: str = "agent", threads: int = 1
    ) -> None:
        self.protocol = protocol
        self._threads = threads
        self.steps: int = protocol.keywords(parse_contender(f"{CONSTANT}10"))["max_episode_steps"]
        self._laws: tuple[Control, str] = (control, tension_law)
        self._batches: dict[int, Episodes] = {}
        first, every = self._batch(protocol.episodes), np.arange(protocol.episodes)
        first.seed(every, device_seeds(protocol.seed, protocol.episodes), np.random.default_rng(0))
        first.start(every)
        self.rows = first.simulation.read_scenarios(every)
        self.draws = 1

    def redrawn(self, draws: int, first: int = 0) -> Trials:
        """Return the same scenarios, each several times, one row after the other, with chance drawn anew.

        Chance is what follows from a scenario's noise key: its sensors' noise, how a posture is shaken, late ticks.

        Parameters
        ----------
        draws : int
            At least 1.
        first : int
            Number of the first draw; another number gives another draw.
        """
        if draws < 1 or self.draws > 1:
            raise ValueError(
                f"{draws} draws of {self.draws} each; at least 1 is needed, of what was not redrawn before"
            )
        other = copy.copy(self)
        other.draws, other.rows = draws, np.repeat(self.rows, draws)
        stream = _REDRAWN_STREAM + np.tile(np.arange(first, first + draws, dtype=np.uint64), len(self.rows))
        other.rows["noise_key"] = derive_keys(other.rows["noise_key"], stream)
        return other

    def play(self, scenarios: Devices, choose: Choose) -> Costs:
        """Let every device meet its scenario once.

        Parameters
        ----------
        scenarios : ndarray of int, shape (N,)
            Which of `rows` each device meets.
        choose : callable
            Agent step and observations, shape (N, 13) -> actions, shape (N,), in [-1, 1].

        Returns
        -------
        ndarray, shape (steps, N)
            What each agent step cost, minus its reward; 0 once the episode has ended in a failure, whose charge the
            step before holds.
        """
        episodes = self._batch(scenarios.size)
        devices = np.arange(scenarios.size)
        episodes.simulation.reset(self.rows[scenarios], devices)
        episodes.started[:] = True
        observations = episodes.observe()
        costs = np.zeros((self.steps, scenarios.size))
        running = np.ones(scenarios.size, dtype=bool)
        for step in range(self.steps):
            actions = np.asarray(choose(step, observations), dtype=np.float32)
            observations, report = episodes.step(actions.astype(np.float64))
            np.negative(report[:, 0], out=costs[step], where=running)
            running &= report[:, FIRST_READING] == RUNNING
        return costs

    def digest(self, scenarios: Devices | slice = slice(None)) -> str:
        """Return a SHA-256 of all that the scenarios' costs hang on: device, rows, loop, rates, prices."""
        profile, suite = self.protocol.profile, self.protocol.suite
        costs = [prices(profile, suite).tolist(), COST_CAP]
        loop = [self._laws, self.steps, self.protocol.agent_period, TENSION_RANGE]
        content = hashlib.sha256(profile.model_dump_json().encode())
        for name in self.rows.dtype.names or ():  # not the whole records: what is in their gaps is chance
            content.update(np.ascontiguousarray(self.rows[name][scenarios]).tobytes())
        content.update(json.dumps([costs, loop, __version__]).encode())
        return content.hexdigest()

    def _batch(self, devices: int) -> Episodes:
        """Return a batch of that size; one that was made is kept."""
        if devices not in self._batches:
            control, tension_law = self._laws
            settings = Settings.read(
                {
                    "profile": self.protocol.profile,
                    "suite": self.protocol.suite,
                    "split": self.protocol.split,
                    "control": control,
                    "tension_law": tension_law,
                    "tension_range": TENSION_RANGE,
                    "agent_period": self.protocol.agent_period,
                    "failure_horizon": self.steps,
                }
            )
            self._batches[devices] = Episodes(devices, settings, self._threads)
        return self._batches[devices]


def held(tensions: ArrayLike) -> Choose:
    """Let each device hold a constant tension setpoint [N], shape (N,)."""
    actions = tension_to_action(np.asarray(tensions, dtype=np.float64), TENSION_RANGE).astype(np.float32)
    return lambda step, observations: actions


def scheduled(actions: Actions) -> Choose:
    """Let each device follow a schedule of its own; `actions` has the shape (N, steps)."""
    by_step = np.ascontiguousarray(actions.T)
    return lambda step, observations: by_step[step]
