"""Episodes of a batch of devices, the common core of the environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.envs import transition
from amulett_gym.envs.arguments import NO_SEED, Seeds, as_numbers
from amulett_gym.envs.prices import prices
from amulett_gym.envs.privileged import FLEET_PRIVILEGED, PRIVILEGED, describe_devices, observe_privileged
from amulett_gym.envs.reward import COST_CAP, FULL_CONTROL, TERM_KEY, TERMS, own_reward
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.shared_step import SharedStep
from amulett_gym.envs.shares import turns_of
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.jit.compiled import compiled_for
from amulett_gym.model.plant import inertia
from amulett_gym.profile import Profile
from amulett_gym.simulation.batch import Simulation, max_force
from amulett_gym.simulation.layout import BY_STIFFNESS, DRIVES, FAMILIES, LANES, MAX_MOVES, RUNNING, Paths
from amulett_gym.simulation.random import keys_from_seeds
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack, pack_path, unpack
from amulett_gym.tasks.suites import Sampler, draw_devices, episode_keys, families_of

Arrays = tuple[NDArray[np.void], NDArray[np.void], NDArray[np.int64], NDArray[np.void], NDArray[np.void]]
"""Parameters and settings of each profile; each block's index into these; blocks of scenarios and states."""

Observations = NDArray[np.float32]
Report = NDArray[np.float64]
Keys = NDArray[np.uint64]
_SQUARED_DEGREES = np.degrees(1.0) ** 2
Drawn = tuple[NDArray[np.void], ...]
_REWARDED = {"position": _SQUARED_DEGREES, "effort": _SQUARED_DEGREES, "tension": 1.0, "contact": 1.0}
"""Factors on the state's rewarded costs: rad2 to deg2."""


class Episodes:
    """A batch of devices, each in its own episode.

    Parameters
    ----------
    num_devices : int
    settings : Settings
    threads : int
        Threads that share the blocks of devices. The number changes no bit of the results.

    Attributes
    ----------
    observation_size : int
        Entries of an observation: 13, or more with the hidden state (see `envs.privileged`).
    action_size : int
        Entries of an action: 2 in the loop `drives`, else 1.
    started : ndarray of bool, shape (N,)
        Devices that have started an episode.
    profiles : tuple of Profile
        The fleet, or the one profile of all devices.
    described : ndarray of float32, shape (profiles, entries)
        The entries `privileged.FLEET_PRIVILEGED` of each profile; a fleet with the hidden state observes them.
    terms : tuple of str
        Names of the reward's terms, in order.
    entries : dict
        Names in ``info`` of a report's entries after the reward (terms, readings, metrics), each with 0.
    report_size : int
        Entries of a report.
    """

    terms: ClassVar[tuple[str, ...]] = TERMS
    entries: ClassVar[dict[str, Any]] = dict.fromkeys(
        (*map(TERM_KEY.format, TERMS), *transition.READINGS, *transition.METRICS), 0.0
    )
    report_size: ClassVar[int] = transition.REPORT_SIZE
    _compiled_step: ClassVar[Callable[..., int]] = staticmethod(transition.step)
    _compiled_shares: ClassVar[Callable[..., None]] = staticmethod(transition.step_shares)
    _sampler: ClassVar[Callable[..., Any]] = Sampler

    def __init__(self, num_devices: int, settings: Settings, threads: int = 1) -> None:
        self.settings, self.profiles, self.privileged = settings, settings.devices, settings.privileged
        self.names = None if settings.fleet is None else np.array([profile.name for profile in settings.fleet])
        more = len(PRIVILEGED) + (0 if settings.fleet is None else len(FLEET_PRIVILEGED))
        self.observation_size = len(transition.OBSERVATIONS) + (more if settings.privileged else 0)
        self.action_size = 2 if settings.control == DRIVES else 1
        self.by_stiffness = settings.control in BY_STIFFNESS
        self.simulation = self._make_simulation(num_devices)
        self._constants = np.zeros(len(self.profiles), dtype=transition.SETTINGS)
        self._constants["ticks"] = [settings.ticks(profile) for profile in self.profiles]
        self._constants["delay"] = settings.action_delay
        self._constants["low"], self._constants["high"] = settings.tension_range
        self._constants["mean_angle"] = np.radians(settings.mean_angle_deg or 0.0)
        self._constants["cost_cap"] = COST_CAP
        self._constants["observation_noise"] = settings.observation_noise
        self._constants["horizon"] = settings.failure_horizon
        self._constants["full_control"] = settings.track == FULL_CONTROL
        self._constants["prices"] = np.nan
        self._families = self._find_families()
        if settings.fleet is None:
            self._set_prices(np.zeros(1, dtype=np.int64), self._families)
        simulation = self.simulation
        if (which := self.dealt(0)) is not None:
            simulation.which[...] = which
        blocks = simulation.which, simulation.scenarios, simulation.states
        self._arrays = simulation.parameters, self._constants, *blocks
        self._keys = np.zeros(num_devices, dtype=np.uint64)
        self._episodes = np.zeros(num_devices, dtype=np.uint64)
        self.started = np.zeros(num_devices, dtype=bool)
        of_profiles = zip(self.profiles, map(max_force, simulation.parameters), strict=True)
        self._samplers = [self._sampler(settings.suite, own, settings.split, force) for own, force in of_profiles]
        masses = [profile.plant.masses for profile in self.profiles]
        bare_inertia = np.array([inertia([m.mass for m in each], [m.arm for m in each]) for each in masses])
        self.described = describe_devices(simulation.parameters, bare_inertia)
        # Copied, it is contiguous as `described` is: the same type, and the same code.
        describing = self.described if settings.fleet is not None else self.described[:, :0].copy()
        self._hidden = (bare_inertia, describing) if settings.privileged else None
        self._threads = min(threads, simulation.states.size)
        self._step: Callable[..., int] | None = None
        self._step_paths: Paths | None = None

    @property
    def agent_period(self) -> float:
        """Time between two actions [s]."""
        return int(self._constants["ticks"][0]) * float(self.simulation.parameters["control_period"][0])

    def profile_of(self, device: int) -> Profile:
        """Return the profile of one device's present episode."""
        return self.simulation.profile_of(device)

    def kinds_of(self, devices: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
        """Return the indices of the given devices' (None: all) profiles in the fleet, shape (len(devices),)."""
        which = self.simulation.which
        if devices is None:
            return np.repeat(which, LANES)[: self.simulation.num_devices]
        return which[devices // LANES]

    def names_of(self, devices: NDArray[np.int64]) -> NDArray[np.str_]:
        """Return the names of the given devices' profiles in the fleet, shape (len(devices),)."""
        assert self.names is not None
        return self.names[self.kinds_of(devices)]

    def drawn(self) -> NDArray[np.int64] | None:
        """Return the index of each block's profile as the key of its first device draws it for the present episode.

        None without a fleet.
        """
        if self.names is None:
            return None
        first = slice(None, None, LANES)
        keys = episode_keys(self._keys[first], self._episodes[first], self.settings.split)
        return draw_devices(keys, len(self.profiles))

    def dealt(self, offset: int) -> NDArray[np.int64] | None:
        """Return the index of each block's profile if each has as many blocks, beginning with profile `offset`.

        The blocks of a profile are neighbours: its tables stay in the processor's cache. None without a fleet.
        """
        if self.names is None:
            return None
        blocks, count = self.simulation.which.size, self.names.size
        return (np.arange(blocks) * count // blocks + offset % count) % count

    def seed(self, devices: NDArray[np.int64], seeds: Seeds, generator: np.random.Generator) -> None:
        """Choose the given devices' next episodes.

        A device's first episode after a seed depends on that seed only, alone or in any batch. Without a seed, as
        `arguments.device_seeds` marks it, it is the next one; a device without any episode is seeded by `generator`.
        """
        seeded = seeds != NO_SEED
        new = ~seeded & ~self.started[devices]
        self._episodes[devices] += np.uint64(1)
        if not (seeded | new).any():
            return
        self._episodes[devices[seeded | new]] = 0
        self._keys[devices[seeded]] = keys_from_seeds(seeds[seeded])
        self._keys[devices[new]] = generator.integers(0, 2**64, size=np.count_nonzero(new), dtype=np.uint64)

    def next_episode(self, devices: NDArray[np.int64]) -> None:
        """Let devices play the next episode of their key."""
        self._episodes[devices] += np.uint64(1)

    def start(
        self,
        devices: NDArray[np.int64],
        scenarios: Sequence[str | Path | Mapping[str, Any] | Scenario] | None = None,
        which: NDArray[np.int64] | None = None,
        names: Sequence[str | None] | None = None,
    ) -> Observations:
        """Start the given devices' episodes; return the observations.

        Parameters
        ----------
        devices : ndarray of int, shape (K,)
        scenarios : sequence, optional
            One for each of them; None: their keys draw them.
        which : ndarray of int, shape (blocks,), optional
            Index of each block's profile in the fleet; None: unchanged.
        names : sequence of str or None, optional
            Profile of each of the devices in the fleet, which comes before `which`; so does that of a scenario.

        Raises
        ------
        AmulettError
            If a scenario is wrong, a name is unknown, or the devices of a block differ.
        """
        loaded = [load_scenario(scenario) for scenario in scenarios or ()]
        before = self.simulation.which.copy()
        try:
            if which is not None:
                self.simulation.which[...] = which
            if self.names is not None:
                self._assign(devices, self._wanted(devices, names, loaded))
                self._set_prices(self.simulation.which[devices // LANES], self._families)
            elif names is not None:
                raise AmulettError(
                    "the option 'device' chooses a device of a fleet; make the environment with fleet=..."
                )
            keys = episode_keys(self._keys[devices], self._episodes[devices], self.settings.split)
            if devices.size:
                self._reset(devices, keys, loaded)
        except AmulettError:
            self.simulation.which[...] = before  # the old episodes are still there
            raise
        self.started[devices] = True
        return self.observe(devices)

    def begin(self, rows: NDArray[np.void], which: NDArray[np.int64]) -> Observations:
        """Start packed scenarios of the suite, one with each device; return the observations.

        Parameters
        ----------
        rows : ndarray of `simulation.layout.SCENARIO`, shape (N,)
        which : ndarray of int, shape (blocks,)
            Index of each block's profile in the fleet; zeros without a fleet.

        Raises
        ------
        AmulettError
            If a device cannot begin its scenario.
        """
        self.simulation.which[...] = which
        self._set_prices(which, self._families)
        self.simulation.reset(rows)
        self.started[:] = True
        return self.observe()

    def _make_simulation(self, num_devices: int) -> Simulation:
        return Simulation(self.profiles, num_devices, self.settings.control, self.settings.tension_law)

    def _find_families(self) -> NDArray[np.int64]:
        """Return the indices of the suite's families."""
        return np.array([FAMILIES.index(family) for family in families_of(self.settings.suite)])

    def _reset(self, devices: NDArray[np.int64], keys: Keys, loaded: Sequence[Scenario]) -> None:
        """Reset devices to the loaded scenarios, or to those that keys draw; keys also draw the noise of the former."""
        drawn, paths = self._sampled(devices, keys), None
        if loaded:
            drawn, paths = self._packed(devices, loaded, drawn[0]["noise_key"])
        rows, *others = drawn
        self.simulation.reset(rows, devices, paths, *others)

    def _sampled(self, devices: NDArray[np.int64], keys: Keys) -> Drawn:
        """Return what the episodes' keys draw, for each device's own profile."""
        if len(self.profiles) == 1:
            return self._draw(0, keys)
        which = self.simulation.which[devices // LANES]
        kinds = np.unique(which)
        if kinds.size == 1:
            return self._draw(int(kinds[0]), keys)
        parts = [(which == kind, self._draw(kind, keys[which == kind])) for kind in kinds.tolist()]
        found = tuple(np.zeros(keys.size, dtype=drawn.dtype) for drawn in parts[0][1])
        for own, drawn in parts:
            for whole, part in zip(found, drawn, strict=True):
                whole[own] = part
        return found

    def _draw(self, kind: int, keys: Keys) -> Drawn:
        """Return the scenarios that keys draw for a profile."""
        return (self._samplers[kind](keys),)

    def _wanted(
        self, devices: NDArray[np.int64], names: Sequence[str | None] | None, scenarios: Sequence[Scenario]
    ) -> dict[int, str]:
        """Return the profile's name of each device for which there is one."""
        wanted = {int(device): name for device, name in zip(devices, names or (), strict=False) if name is not None}
        for device, scenario in zip(devices.tolist(), scenarios, strict=False):
            if (name := scenario.device.name) is not None and wanted.setdefault(device, name) != name:
                raise AmulettError(
                    f"device {device} is to be '{wanted[device]}'; its scenario is of the device '{name}'"
                )
        return wanted

    def _assign(self, devices: NDArray[np.int64], wanted: Mapping[int, str]) -> None:
        """Give the blocks of these devices, which all begin an episode, the profiles wanted."""
        assert self.names is not None
        given: dict[int, tuple[int, str]] = {}
        for device, name in wanted.items():
            if name not in self.names.tolist():
                raise unknown("device", str(name), self.names.tolist())
            first, other = given.setdefault(device // LANES, (device, name))
            if other != name:
                raise AmulettError(
                    f"device {first} is to be '{other}' and device {device} '{name}'; {LANES} devices in turn are one "
                    "block, which has one profile"
                )
        for block, (device, name) in given.items():
            index = self.names.tolist().index(name)
            lanes = np.arange(block * LANES, min((block + 1) * LANES, self.started.size))
            others = np.setdiff1d(lanes[self.started[lanes]], devices)
            if others.size and index != self.simulation.which[block]:
                raise AmulettError(
                    f"device {device} is to be '{name}', and device {others[0]} of the same block of {LANES}, which is "
                    f"not reset, is '{self.names_of(others)[0]}'; reset all of the block"
                )
            self.simulation.assign(block, index)

    def observe(self, devices: NDArray[np.int64] | None = None) -> Observations:
        """Return the given devices' (None: all) present observations, shape (len(devices), observation_size)."""
        devices = np.arange(self.simulation.num_devices) if devices is None else devices
        observations = np.empty((devices.size, self.observation_size), dtype=np.float32)
        self._observe(devices, observations)
        return observations

    def step(self, actions: NDArray[np.floating[Any]], brief: bool = False) -> tuple[Observations, Report]:
        """Take one agent step with all devices.

        Parameters
        ----------
        actions : ndarray, shape (N * action_size,)
            Of one device after the other, in [-1, 1]; values beyond are clipped.
        brief : bool
            Report only reward, terms and `failure`; :meth:`whole` adds the rest.

        Returns
        -------
        observations : ndarray of float32, shape (N, observation_size)
        report : ndarray, shape (N, report_size) or (N, transition.BRIEF_SIZE)
            Reward, terms, readings and metrics; see `envs.transition`.

        Raises
        ------
        AmulettError
            If an action is NaN or no number.
        """
        observations = np.empty((self.started.size, self.observation_size), dtype=np.float32)
        report = np.empty((self.started.size, transition.BRIEF_SIZE if brief else self.report_size))
        self.step_into(as_numbers(actions), observations, report)
        return observations, report

    def step_into(self, actions: NDArray[np.float64], observations: Observations, report: Report) -> None:
        """Take one agent step as :meth:`step` does, into arrays of the caller, which have to be contiguous."""
        given = *self._split(actions), observations, report
        own = self.settings.reward_fn
        before = {} if own is None else self._costs()
        wrong = self._take(*given)
        if wrong >= 0:
            raise AmulettError(f"the action of device {wrong} is NaN; allowed is [-1, 1]")
        if own is not None:
            costs = {name: total - before[name] for name, total in self._costs().items()}
            costs["failure"] = (report[:, transition.FIRST_READING] != RUNNING).astype(np.float64)
            terms = report[:, transition.FIRST_TERM : transition.FIRST_READING].T.copy()  # to be kept
            report[:, 0] = own_reward(own, costs, dict(zip(self.terms, terms, strict=True)))

    def _take(self, *given: Any) -> int:
        """Take one agent step with what `_split` returns, into observations and report.

        Return the first device with an action that is NaN, before any is stepped, or `action.ALL_NUMBERS`.
        """
        if self._step is None or self._step_paths is not self.simulation.paths:
            self._step, self._step_paths = self._prepared(given), self.simulation.paths
        if self._threads == 1:
            return self._step(*given)
        step, paths = self._step, self._step_paths
        self._step = None  # one that begins meanwhile, wrongly, has threads and turns of its own
        try:
            return step(*given)
        finally:
            self._step, self._step_paths = step, paths

    def _prepared(self, given: tuple[Any, ...]) -> Callable[..., int]:
        """Return the compiled step with all that is the same from step to step; a reset may bring new paths."""
        same = *self._arrays, *self._memory()
        if self._threads == 1 or numba.config.DISABLE_JIT:
            return partial(compiled_for(self._compiled_step, (*same, *given)), *same)
        same = *same, None if given[0] is None else given[0][:0].copy()  # only the type matters
        take = partial(compiled_for(self._compiled_shares, (*same, turns_of(1, 1), 0)), *same)
        return SharedStep(take, self.simulation.states.size, self._threads, given)

    def begin_ramps(self, actions: NDArray[np.float64]) -> None:
        """Let tensions and mean drive angles begin their ramps to those of `actions`, as :meth:`step` takes them.

        For callers that advance the simulation themselves: it is due `settings.action_delay` control ticks after an
        agent step's begin, and :meth:`end_ramps` at its end.
        """
        _, constants, which, _, states = self._arrays
        transition.begin_ramps(constants, which, states, self.simulation.loop, *self._split(actions))

    def end_ramps(self, actions: NDArray[np.float64]) -> None:
        """Set tensions and mean drive angles to where their ramps to those of `actions` are at an agent step's end."""
        _, constants, which, _, states = self._arrays
        transition.end_ramps(constants, which, states, self.simulation.loop, *self._split(actions))

    def _split(self, actions: NDArray[Any]) -> tuple[NDArray[Any] | None, NDArray[Any]]:
        """Return the actions for the mean drive angles, None where actions have none, and those for the tensions."""
        if self.action_size == 1:
            return None, actions
        means, tensions = actions.reshape(-1, self.action_size).T.copy()
        return means, tensions

    def _memory(self) -> tuple[Any, ...]:
        """Return what a step needs besides `Arrays`: paths, loop, extended, hidden."""
        simulation = self.simulation
        return simulation.paths, simulation.loop, simulation.extended, self._hidden

    def _costs(self) -> dict[str, NDArray[np.float64]]:
        """Return the episodes' raw costs up to the last step, each of shape (N,)."""
        read = self.simulation.read
        full_control = self.settings.track == FULL_CONTROL
        efforts = read("drive_effort") if full_control else read("effort_biceps") + read("effort_triceps")
        costs = read("position_ise"), efforts, read("tension_ise"), read("contact_ise")
        return {name: unit * cost for (name, unit), cost in zip(_REWARDED.items(), costs, strict=True)}

    def _observe(self, devices: NDArray[np.int64], observations: Observations) -> None:
        """Fill the observations of devices."""
        transition.observe_devices(*self._arrays, devices, observations)
        if self._hidden is not None:  # compiled only if needed
            parameters, _, which, scenarios, states = self._arrays
            observe_privileged(parameters, which, self._hidden, scenarios, states, devices, observations)

    def close(self) -> None:
        """End the threads; a further step starts them again."""
        step, self._step = self._step, None
        if isinstance(step, SharedStep):
            step.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_step": None, "_step_paths": None}

    def report(self, devices: NDArray[np.int64] | None = None) -> Report:
        """Return the report of the given devices' (None: all) present state, one row each, no reward."""
        devices = np.arange(self.simulation.num_devices) if devices is None else devices
        report = np.empty((devices.size, self.report_size))
        self._report(devices, report)
        return report

    def whole(self, report: Report, devices: NDArray[np.int64]) -> Report:
        """Return the whole report of devices' last step, one row each, from a brief one."""
        found = self.report(devices)
        found[:, : report.shape[1]] = report
        return found

    def _report(self, devices: NDArray[np.int64], report: Report) -> None:
        """Fill the reports of devices."""
        parameters, _, which, scenarios, states = self._arrays
        transition.report_devices(parameters, which, scenarios, states, devices, report)

    def scenario(self, device: int) -> NDArray[np.void]:
        """Return the packed scenario of one device's present episode; ResetNeeded if it has started none yet."""
        if not self.started[device]:
            raise gym.error.ResetNeeded("call reset() first: there is no scenario yet")
        return self.simulation.read_scenarios(np.array([device]))[0]

    def unpacked(self, device: int) -> Scenario:
        """Return the scenario of one device's present episode; errors as `scenario`."""
        found = self._unpack(device)
        if self.names is None:
            return found
        name = str(self.names_of(np.array([device]))[0])
        return found.model_copy(update={"device": found.device.model_copy(update={"name": name})})

    def _unpack(self, device: int) -> Scenario:
        return unpack(self.scenario(device), self.simulation.read_path(device))

    def steps(self) -> NDArray[np.int64]:
        """Return the number of agent steps of each device's episode, shape (N,); that of a failure counts."""
        # Rounded up: a device that fails stops in the middle of a step.
        return -(-self.simulation.read("tick") // self._ticks)

    def have_steps(self, count: float) -> NDArray[np.bool_]:
        """Return which devices' episodes have at least `count` :meth:`steps`, shape (N,), without a slow division."""
        return self.simulation.read("tick") > (count - 1) * self._ticks

    @property
    def _ticks(self) -> NDArray[np.int64]:
        """Control ticks in an agent step, shape (1,), or (N,) with a fleet."""
        ticks = self._constants["ticks"]
        return ticks if ticks.size == 1 else np.repeat(ticks[self.simulation.which], LANES)[: self.started.size]

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all episodes."""
        copies = {name: array.copy() for name, array in self._state.items()}
        return {"simulation": self.simulation.get_state(), **copies}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot taken by `get_state`, also in another process; AmulettError if it has other devices."""
        count, here = len(state["keys"]), self.simulation.num_devices
        if count != here:
            raise AmulettError(
                f"a snapshot of {count} device{'s' * (count > 1)} does not fit: this environment has {here}"
            )
        self.simulation.set_state(state["simulation"])
        for block, own in enumerate(self.simulation.which):
            self._set_prices(own, self.simulation.scenarios["family"][block])
        for name, array in self._state.items():
            array[...] = state[name]

    def _set_prices(self, which: ArrayLike, families: ArrayLike) -> None:
        """Set the prices of families in profiles, by their indices, that have none yet.

        What nothing needs is not measured: with a fleet, a device's prices are found when it begins an episode.
        """
        if not np.isnan(self._constants["prices"][:, np.asarray(families), 0]).any():
            return
        settings = self.settings
        for own in np.unique(which):
            table = self._constants["prices"][own]
            missing = np.unique(families)
            missing = missing[np.isnan(table[missing, 0])]
            if missing.size:
                weights, track = settings.reward_weights, settings.track
                found = prices(self.profiles[own], settings.suite, weights, track, missing)
                table[missing] = found * list(_REWARDED.values())

    @property
    def _state(self) -> dict[str, NDArray[Any]]:
        return {"keys": self._keys, "episodes": self._episodes, "started": self.started}

    def _pack(self, scenario: Scenario, profile: Profile) -> Drawn:
        """Return what :meth:`_draw` does, one of each, of a scenario for a profile."""
        return (pack(scenario, profile),)

    def _packed(
        self, devices: NDArray[np.int64], loaded: Sequence[Scenario], noise_keys: Keys
    ) -> tuple[Drawn, list[NDArray[np.void]]]:
        if self.privileged and any(scenario.has_path for scenario in loaded):
            raise AmulettError(
                f"a privileged observation holds at most {MAX_MOVES} moves and no sampled setpoint; "
                "make the environment without privileged=True"
            )
        of_devices = zip(devices.tolist(), loaded, strict=True)
        packed = [self._pack(scenario, self.profile_of(device)) for device, scenario in of_devices]
        found = tuple(np.concatenate(parts) for parts in zip(*packed, strict=True))
        rows, drawn = found[0], np.array([scenario.noise_seed is None for scenario in loaded])
        rows["noise_key"] = np.where(drawn, noise_keys, rows["noise_key"])
        for device, row in zip(devices.tolist(), rows, strict=True):
            self._set_prices(self.simulation.which[device // LANES], row["family"])
        return found, [pack_path(scenario) for scenario in loaded]
