"""Episodes of a batch of worn devices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.envs import transition, worn_transition
from amulett_gym.envs.episodes import Drawn, Episodes, Keys, Observations, Report
from amulett_gym.envs.reward import TERM_KEY
from amulett_gym.envs.worn_reward import WORN_TERMS, worn_prices
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.tasks.scenario import Scenario, pack_worn, unpack_worn
from amulett_gym.tasks.worn_suites import WornSampler

_SQUARED_DEGREES = np.degrees(1.0) ** 2
_REWARDED = {"muscle": 1.0, "tracking": _SQUARED_DEGREES, "cuff": 1.0, "drives": _SQUARED_DEGREES}
"""Factors on the state's rewarded costs: rad2 to deg2."""


class WornEpisodes(Episodes):
    """A batch of worn devices, each in its own episode; see `Episodes`.

    An action has two entries, the tension's and the assistance's. All families of a suite have the same prices.
    """

    simulation: WornSimulation
    terms = WORN_TERMS
    entries = dict.fromkeys(
        (
            *map(TERM_KEY.format, WORN_TERMS),
            *transition.READINGS,
            *transition.METRICS,
            *worn_transition.READINGS,
            *worn_transition.METRICS,
        ),
        0.0,
    )
    report_size = worn_transition.REPORT_SIZE
    _compiled_step = staticmethod(worn_transition.step)
    _compiled_shares = staticmethod(worn_transition.step_shares)
    _sampler = WornSampler

    def __init__(self, num_devices: int, settings: WornSettings, threads: int = 1) -> None:
        super().__init__(num_devices, settings, threads)
        self.observation_size, self.action_size = len(worn_transition.OBSERVATIONS), 2

    def begin(
        self, rows: NDArray[np.void], which: NDArray[np.int64], wearers: NDArray[np.void] | None = None
    ) -> Observations:
        """Start packed scenarios, one with each device; see `Episodes.begin`.

        Parameters
        ----------
        rows, which
            As of `Episodes.begin`.
        wearers : ndarray of `simulation.worn_layout.PERSON`, shape (N,)
            One with each device.
        """
        if wearers is None:
            raise AmulettError("worn devices need their wearers: begin(rows, which, wearers)")
        self.simulation.which[...] = which
        self._set_prices(which, self._families)
        self.simulation.reset(rows, wearers=wearers)
        self.started[:] = True
        return self.observe()

    def _make_simulation(self, num_devices: int) -> WornSimulation:
        return WornSimulation(self.profiles, num_devices, self.settings.control, self.settings.tension_law)

    def _find_families(self) -> NDArray[np.int64]:
        return np.zeros(1, dtype=np.int64)

    def _set_prices(self, which: ArrayLike, families: ArrayLike) -> None:
        for own in np.unique(which):
            if np.isnan(self._constants["prices"][own, 0, 0]):
                found = worn_prices(self.profiles[own], self.settings.suite, self.settings.reward_weights)
                self._constants["prices"][own] = found * list(_REWARDED.values())

    def _draw(self, kind: int, keys: Keys) -> Drawn:
        return tuple(self._samplers[kind](keys))

    def _pack(self, scenario: Scenario, profile: Profile) -> Drawn:
        return pack_worn(scenario, profile)

    def _unpack(self, device: int) -> Scenario:
        person = self.simulation.read_wearers(np.array([device]))[0]
        path = self.simulation.read_path(device)
        return unpack_worn(self.scenario(device), person, self.profile_of(device), path)

    def _split(self, actions: NDArray[Any]) -> tuple[NDArray[Any] | None, NDArray[Any]]:
        """Return the actions for the assistances, and those for the tensions."""
        tensions, assistances = actions.reshape(-1, 2).T.copy()
        return assistances, tensions

    def _memory(self) -> tuple[Any, ...]:
        *simulated, _ = super()._memory()  # no hidden state is observed
        return *simulated, self.simulation.worn

    def _costs(self) -> dict[str, NDArray[np.float64]]:
        worn, read = self.simulation.read_worn, self.simulation.read
        drives = read("effort_biceps") + read("effort_triceps")
        costs = worn("effort"), worn("tracking_ise"), worn("moving_cuff_ise"), drives
        return {name: unit * cost for (name, unit), cost in zip(_REWARDED.items(), costs, strict=True)}

    def begin_ramps(self, actions: NDArray[np.float64]) -> None:
        """Let tensions and assistances begin their ramps; see `Episodes.begin_ramps`."""
        _, constants, which, _, states = self._arrays
        _, loop, _, worn = self._memory()
        worn_transition.begin_ramps(constants, which, states, loop, worn, *self._split(actions))

    def end_ramps(self, actions: NDArray[np.float64]) -> None:
        """Set tensions and assistances to where their ramps are; see `Episodes.end_ramps`."""
        _, constants, which, _, states = self._arrays
        _, loop, _, worn = self._memory()
        worn_transition.end_ramps(constants, which, states, loop, worn, *self._split(actions))

    def _observe(self, devices: NDArray[np.int64], observations: Observations) -> None:
        worn_transition.observe_devices(*self._arrays, self.simulation.worn, devices, observations)

    def _report(self, devices: NDArray[np.int64], report: Report) -> None:
        parameters, _, which, scenarios, states = self._arrays
        worn_transition.report_devices(parameters, which, scenarios, states, self.simulation.worn, devices, report)
