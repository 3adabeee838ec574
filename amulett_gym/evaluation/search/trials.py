"""Batches of episodes for searches: each device of a batch has its own scenario, played by its own law.

The cost of an episode is minus its return in the environment, or its full-control cost, bit for bit: search costs equal
evaluated costs. All searches (tuned laws, the clairvoyant reference) use this.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym import __version__
from amulett_gym.envs.action import TENSION_RANGE, tension_to_action
from amulett_gym.envs.arguments import device_seeds
from amulett_gym.envs.episodes import Episodes, Observations, Report
from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import COST_CAP, FULL_CONTROL, SCHEDULE, Track
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import FIRST_METRIC, FIRST_READING, METRICS, READINGS
from amulett_gym.evaluation.metrics import CONTROL_TERMS, control_cost, control_prices, failure_cost
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.laws.contenders import CONSTANT, parse_contender
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import FAMILIES, LANES, RUNNING, Control, pack_loop, pack_parameters
from amulett_gym.simulation.random import derive_keys
from amulett_gym.tasks.suites import families_of

Actions = NDArray[np.float32]
Costs = NDArray[np.float64]
Devices = NDArray[np.int64]

_REDRAWN_STREAM = np.uint64(1_000_000)

Choose = Callable[[int, Observations], Actions]
"""Maps the number of the agent step and the observations, shape (N, 13), to actions in [-1, 1], shape (N,)."""


class Trials:
    """The scenarios of a comparison, which can be played any number of times.

    Parameters
    ----------
    protocol : Protocol
        Scenario i is that of `evaluation.runner.evaluate`; the action range is the default.
    control, tension_law : str
        As in the environments.
    threads : int
        Threads that simulate; they do not change costs.
    track : str
        Whose reward `play` returns, and whose prices are in the `digest`; of `control_costs` it has to be full control.
    fleet : sequence of Profile
        Devices instead of the protocol's profile. The scenarios are dealt to them in turn: scenario i is played on
        device i modulo their number.
    crossed : bool
        Whether each device of the fleet plays each of the scenarios instead: those of the first device come first.

    Attributes
    ----------
    control : str
        As given.
    profiles : tuple of Profile
        The fleet, or the protocol's profile.
    rows : ndarray of `simulation.layout.SCENARIO`, shape (K,)
        The scenarios, with the keys of their sensor noise: those of the protocol, or `crossed` with the devices.
    which : ndarray of int, shape (K,)
        Index into `profiles` of each scenario's device.
    steps : int
        Agent steps of an episode.
    draws : int
        Rows of each scenario, which differ by chance only: 1, but see `redrawn`.
    tension_range : tuple of float
        Tension setpoints at action -1 and 1 [N].

    Raises
    ------
    AmulettError
        If the protocol's duration is not a whole number of agent steps, or a device of the fleet does not fit the loop.
    """

    def __init__(
        self,
        protocol: Protocol,
        control: Control = "decentralized",
        tension_law: str = "agent",
        threads: int = 1,
        track: Track = SCHEDULE,
        fleet: Sequence[Profile] = (),
        crossed: bool = False,
    ) -> None:
        self.protocol = protocol
        self.profiles = tuple(fleet) or (protocol.profile,)
        self._fleet = tuple(fleet) or None
        self._threads = threads
        self.steps: int = protocol.keywords(parse_contender(f"{CONSTANT}10"))["max_episode_steps"]
        self.control = control
        self.track = track
        self._laws: tuple[Control, str] = (control, tension_law)
        self._batches: dict[int, Episodes] = {}
        devices, every = len(self.profiles), np.arange(protocol.episodes)
        seeds = np.tile(every, devices) if crossed else every
        self.which: Devices = np.repeat(np.arange(devices), every.size) if crossed else every % devices
        lanes, played, blocks = _in_blocks(self.which)
        first, each = self._batch(played.size), np.arange(played.size)
        first.seed(each, device_seeds(protocol.seed, protocol.episodes)[seeds[played]], np.random.default_rng(0))
        first.start(each, which=blocks)
        self.rows = first.simulation.read_scenarios(lanes)
        self.draws = 1
        self.tension_range = first.settings.tension_range

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy for another process needs: its batches are made anew."""
        return {**vars(self), "_batches": {}}

    def redrawn(self, draws: int, first: int = 0) -> Trials:
        """Return the same scenarios with `draws` rows each, which differ by chance, from draw number `first` on.

        Chance is what depends on a scenario's noise key: sensor noise, disturbances of postures, late ticks.
        """
        if draws < 1 or self.draws > 1:
            raise ValueError(
                f"draws is {draws}, of scenarios with {self.draws} each; it has to be at least 1, of 1 each"
            )
        other = copy.copy(self)
        other.draws, other.rows, other.which = draws, np.repeat(self.rows, draws), np.repeat(self.which, draws)
        stream = _REDRAWN_STREAM + np.tile(np.arange(first, first + draws, dtype=np.uint64), len(self.rows))
        other.rows["noise_key"] = derive_keys(other.rows["noise_key"], stream)
        return other

    def balanced(self, count: int) -> Trials:
        """Return `count` of the scenarios, with as many of each family where there are enough.

        Those of a family stay in their order. In a suite of one family these are the first ones. A number of the first
        of them is balanced, too.
        """
        family = self.rows["family"]
        earlier = np.array([np.count_nonzero(family[:index] == own) for index, own in enumerate(family)])
        other = copy.copy(self)
        chosen = np.argsort(earlier, kind="stable")[:count]
        other.rows, other.which = self.rows[chosen], self.which[chosen]
        return other

    def play(self, scenarios: Devices, choose: Choose, gains: Profile | None = None) -> Costs:
        """Play one episode with each device.

        Parameters
        ----------
        scenarios : ndarray of int, shape (N,)
            Index into `rows` of each device's scenario.
        choose : callable
            See `Choose`.
        gains : Profile, optional
            The protocol's profile with other gains of the loop; not with a fleet.

        Returns
        -------
        ndarray, shape (steps, N)
            Cost of each agent step: minus its reward; 0 after a failure, whose cost is in the step of the failure.
        """
        return self._play(scenarios, choose, gains)[0]

    def control_costs(self, scenarios: Devices, choose: Choose, gains: Profile | None = None) -> Costs:
        """Play as in `play`; return the full-control cost of each episode, shape (N,)."""
        report = self._play(scenarios, choose, gains)[1]
        protocol, which, families = self.protocol, self.which[scenarios], self.rows["family"][scenarios]
        readings = dict(zip(READINGS, report.T[FIRST_READING:FIRST_METRIC], strict=True))
        charge = np.zeros(scenarios.size)
        for device in np.flatnonzero(readings["failure"] != RUNNING):
            charge[device] = failure_cost(readings["time"][device], protocol.duration, protocol.agent_period)
        prices = np.empty((scenarios.size, len(CONTROL_TERMS)))
        for own in np.unique(which):
            prices[which == own] = control_prices(self.profiles[own], protocol.suite, families[which == own])
        return control_cost(dict(zip(METRICS, report.T[FIRST_METRIC:], strict=True)), charge, prices)

    def costs(self, scenarios: Devices, choose: Choose, gains: Profile | None = None, track: Track = SCHEDULE) -> Costs:
        """Play as in `play`; return each episode's cost on a track, shape (N,)."""
        if track == FULL_CONTROL:
            return self.control_costs(scenarios, choose, gains)
        return np.asarray(self.play(scenarios, choose, gains).sum(axis=0))

    def _play(self, scenarios: Devices, choose: Choose, gains: Profile | None) -> tuple[Costs, Report]:
        """Play as in `play`; return also the final report of each episode."""
        lanes, played, blocks = _in_blocks(self.which[scenarios])
        episodes = self._batch(played.size)
        if self._fleet is None:  # an earlier call may have left other gains
            simulation, profile = episodes.simulation, gains or self.protocol.profile
            simulation.parameters[...] = pack_parameters(profile, *self._laws)
            if simulation.loop is not None:
                simulation.loop[0][...] = pack_loop(profile, self.control)
        observations = episodes.begin(self.rows[scenarios[played]], blocks)[lanes]
        costs = np.zeros((self.steps, scenarios.size))
        running = np.ones(scenarios.size, dtype=bool)
        for step in range(self.steps):
            actions = np.asarray(choose(step, observations), dtype=np.float32)
            observed, report = episodes.step(actions[played])
            observations, report = observed[lanes], report[lanes]
            np.negative(report[:, 0], out=costs[step], where=running)
            running &= report[:, FIRST_READING] == RUNNING
        return costs, episodes.report(lanes)

    def digest(self, scenarios: Devices | slice = slice(None)) -> str:
        """Return a SHA-256 of all that the track's costs depend on: device, rows, loop, rates, prices."""
        suite = self.protocol.suite
        own = None if self._fleet is None else [FAMILIES.index(family) for family in families_of(suite)]
        costs = [prices(profile, suite, track=self.track, families=own).tolist() for profile in self.profiles]
        loop = [self._laws, self.steps, self.protocol.agent_period, self.tension_range]
        content = hashlib.sha256("".join(profile.model_dump_json() for profile in self.profiles).encode())
        if self._fleet is not None:
            content.update(self.which[scenarios].tobytes())
        for name in self.rows.dtype.names or ():  # not whole records: the padding between fields is undefined
            content.update(np.ascontiguousarray(self.rows[name][scenarios]).tobytes())
        content.update(json.dumps([[*costs, COST_CAP], loop, __version__]).encode())
        return content.hexdigest()

    def _batch(self, devices: int) -> Episodes:
        """Return the batch of this size, made once."""
        if devices not in self._batches:
            control, tension_law = self._laws
            shared = {key: getattr(self.protocol, key) for key in ("suite", "split", "agent_period")}
            shared |= {"profile": self.protocol.profile} if self._fleet is None else {"fleet": self._fleet}
            own = {"control": control, "tension_law": tension_law, "track": self.track, "failure_horizon": self.steps}
            settings = Settings.read({**shared, **own})
            self._batches[devices] = Episodes(devices, settings, self._threads)
        return self._batches[devices]


def held(tensions: ArrayLike, tension_range: tuple[float, float] = TENSION_RANGE) -> Choose:
    """Return constant tension setpoints [N], one for each device, shape (N,)."""
    actions = tension_to_action(np.asarray(tensions, dtype=np.float64), tension_range).astype(np.float32)
    return lambda step, observations: actions


def scheduled(actions: Actions) -> Choose:
    """Return schedules of actions, one for each device, shape (N, steps)."""
    by_step = np.ascontiguousarray(actions.T)
    return lambda step, observations: by_step[step]


def _in_blocks(which: Devices) -> tuple[Devices, Devices, Devices]:
    """Return how episodes on the devices `which`, shape (N,), fill blocks of `LANES`, each of one device.

    Returns
    -------
    lanes : ndarray of int, shape (N,)
        Place of each episode in the batch.
    played : ndarray of int, shape (size of the batch,)
        The episode at each place; a block that is not full repeats its last one.
    blocks : ndarray of int, shape (blocks,)
        The device of each block.
    """
    order, counts = np.argsort(which, kind="stable"), np.bincount(which)
    blocks = np.repeat(np.arange(counts.size), -(-counts // LANES))
    starts = LANES * np.searchsorted(blocks, np.arange(counts.size))
    lanes = np.empty_like(order)
    lanes[order] = starts[which[order]] + np.arange(which.size) - (np.cumsum(counts) - counts)[which[order]]
    last = np.zeros(lanes.max() + 1, dtype=np.int64)
    last[lanes] = lanes
    played = np.empty_like(last)
    played[lanes] = np.arange(which.size)
    return lanes, played[np.maximum.accumulate(last)], blocks
