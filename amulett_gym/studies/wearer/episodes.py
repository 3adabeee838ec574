"""Episodes of wearers: drawn scenarios with what the same wearers do without the device, and the playing of a law."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.settings import DEFAULT_STEPS
from amulett_gym.envs.transition import FIRST_READING, FIRST_TERM
from amulett_gym.envs.worn_episodes import WornEpisodes
from amulett_gym.envs.worn_reward import DOFFED_SECONDS, WORN_WEIGHTS
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.envs.worn_transition import FIRST_WORN_METRIC
from amulett_gym.envs.worn_transition import METRICS as WORN_METRICS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.worn import as_actions
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import LANES, LOOPS, RUNNING, Control
from amulett_gym.simulation.random import keys_from_seeds
from amulett_gym.simulation.worn import MOVING
from amulett_gym.tasks.suites import episode_keys
from amulett_gym.tasks.worn_suites import sample_worn

DURATION = DOFFED_SECONDS
"""Length of an episode [s]."""

STEPS = DEFAULT_STEPS
"""Agent steps of an episode at the environment's default agent period, at which baselines and schedules act."""

PAPERS_RANGE = (4.0, 15.0)
"""Tensions of the paper's loop [N]: its controller cannot see lower ones, and `Amulett/Worn-v0` refuses it."""

Values = NDArray[np.float64]
Act = Callable[[NDArray[np.float32]], NDArray[Any]]
Devices = Profile | Sequence[Profile]


@dataclass(frozen=True)
class Scenarios:
    """Drawn scenarios with their wearers.

    Attributes
    ----------
    suite, split : str
    seed : int
        Scenario i of those drawn is the first episode of the environment after a reset with ``seed + i``.
    rows, people : ndarray of SCENARIO and PERSON, shape (N,)
    moving : ndarray of bool, shape (N, STEPS)
        Whether the wearer's intention moves in each agent step: what no device can know.
    doffed : dict of str to ndarray, shape (N,)
        Values of `play` for the same wearers without the device. Its cost is that of muscles and tracking.
    """

    suite: str
    split: str
    seed: int
    rows: NDArray[np.void]
    people: NDArray[np.void]
    moving: NDArray[np.bool_]
    doffed: dict[str, Values]

    def __len__(self) -> int:
        return int(self.rows.size)

    def first(self, count: int) -> Scenarios:
        """Return the first scenarios."""
        doffed = {name: values[:count] for name, values in self.doffed.items()}
        arrays = self.rows[:count], self.people[:count], self.moving[:count]
        return Scenarios(self.suite, self.split, self.seed, *arrays, doffed)

    def repeated(self, times: int) -> Scenarios:
        """Return each scenario so many times, one after the other, with the same noise."""
        doffed = {name: values.repeat(times) for name, values in self.doffed.items()}
        rows, people, moving = self.rows.repeat(times), self.people.repeat(times), self.moving.repeat(times, axis=0)
        return Scenarios(self.suite, self.split, self.seed, rows, people, moving, doffed)


def draw(profile: Profile, suite: str, split: str, count: int, seed: int = 0) -> Scenarios:
    """Return the first scenarios of a suite's split, and play them without the device.

    Guided wearers are relaxed, so that they then do not move.
    """
    keys = keys_from_seeds(np.arange(seed, seed + count).astype(object))
    rows, people = sample_worn(suite, episode_keys(keys, np.zeros(count, dtype=np.uint64), split), profile, split)
    bare = people.copy()
    bare["worn"] = 0.0
    moving = np.zeros((count, STEPS), dtype=bool)

    def look(step: int, episodes: WornEpisodes) -> None:
        moving[:, step] = np.abs(episodes.simulation.read_worn("intention_rate")) > MOVING

    alone = Scenarios(suite, split, seed, rows, bare, moving, {})
    doffed = play(profile, LOOPS[0], alone, Schedule(np.zeros((count, 1)), np.zeros((count, 1))), look)
    doffed["cost"] = doffed["muscle"] + doffed["tracking"]
    return Scenarios(suite, split, seed, rows, people, moving, doffed)


class Schedule:
    """A policy that plays given co-contractions [N] and assistances [1], shapes (N, steps); the last ones stay."""

    def __init__(self, tensions: Values, assistances: Values, tension_range: tuple[float, float] | None = None) -> None:
        self.tensions, self.assistances, self.tension_range = tensions, assistances, tension_range
        self._step = 0

    def reset(self, devices: int) -> None:
        """Begin an episode."""
        self._step = 0

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the step's actions, shape (N, 2)."""
        k = min(self._step, self.tensions.shape[1] - 1)
        self._step += 1
        some = {} if self.tension_range is None else {"tension_range": self.tension_range}
        return as_actions(self.tensions[:, k], self.assistances[:, k], len(observations), **some)


def tension_range_of(control: Control) -> tuple[float, float]:
    """Return the tensions at action -1 and 1 in a loop [N]."""
    return WornSettings().tension_range if control in LOOPS else PAPERS_RANGE


def devices_keyword(profile: Devices) -> dict[str, Any]:
    """Return the environment's keyword for one device or several."""
    return {"profile": profile} if isinstance(profile, Profile) else {"fleet": list(profile)}


def one_each(play_all: Callable[[Scenarios], dict[str, Values]], scenarios: Scenarios) -> dict[str, Values]:
    """Return what each scenario gives on a device of its own, from a function that plays them with as many devices.

    The devices of a block have one profile, so that each scenario fills a block with its copies.
    """
    return {name: values[::LANES] for name, values in play_all(scenarios.repeated(LANES)).items()}


def steps_of(agent_period: float, name: str) -> int:
    """Return the agent steps of an episode; AmulettError, which names the policy, if they are no whole number."""
    steps = max(round(DURATION / agent_period), 1)
    if not math.isclose(steps * agent_period, DURATION, rel_tol=1e-6):
        raise AmulettError(
            f"policy '{name}' acts every {agent_period:g} s, and an episode of the study, {DURATION:g} s, is no whole "
            f"number of such steps; the nearest period that can be compared is {DURATION / steps:.6g} s"
        )
    return steps


def make_episodes(profile: Devices, control: Control, suite: str, count: int) -> WornEpisodes:
    """Return episodes as of `Amulett/Worn-v0`, also in the paper's loop, which the environment refuses."""
    settings = WornSettings(**devices_keyword(profile), suite=suite)
    changes = {"control": control, "tension_range": tension_range_of(control)}
    return WornEpisodes(count, settings.model_copy(update=changes))


def play(
    profile: Devices,
    control: Control,
    scenarios: Scenarios,
    act: Act,
    look: Callable[[int, WornEpisodes], None] | None = None,
    episodes: WornEpisodes | None = None,
) -> dict[str, Values]:
    """Play all scenarios with a policy.

    Parameters
    ----------
    profile : Profile or sequence of Profile
        With its admittance; several: one for each block of `simulation.layout.LANES` scenarios, see `one_each`.
    control : str
        A control loop; also the paper's, which the environment refuses.
    scenarios : Scenarios
    act : callable
        Observations, shape (N, 16) -> actions, shape (N, 2), in [-1, 1], for `tension_range_of` the loop; its method
        ``reset``, if there is one, is called with N before the first step.
    look : callable, optional
        Called with the number of each step and the episodes, before the step.
    episodes : WornEpisodes, optional
        Those of an environment that the policy is for, with its own agent period, instead of new ones of the profile
        and the loop.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        ``cost``, minus the environment's return; its terms ``muscle``, ``tracking``, ``cuff``, ``drives`` and
        ``failure``, as costs; ``failed``, 0 or 1; ``isav`` [deg2/s] of both drives, and the environment's metrics of
        the wearer, see `envs.worn.WornEnv`.
    """
    count = len(scenarios)
    episodes = make_episodes(profile, control, scenarios.suite, count) if episodes is None else episodes
    which = episodes.simulation.which
    which = np.zeros_like(which) if isinstance(profile, Profile) else np.arange(which.size)
    observations = episodes.begin(scenarios.rows, which, scenarios.people)
    if callable(reset := getattr(act, "reset", None)):
        reset(count)
    terms = np.zeros((len(WORN_WEIGHTS) + 1, count))
    running, report = np.ones(count, dtype=bool), np.zeros((count, episodes.report_size))
    for step in range(steps_of(episodes.agent_period, "law")):
        if look is not None:
            look(step, episodes)
        actions = np.ascontiguousarray(act(observations), dtype=np.float64).reshape(-1)
        observations, report = episodes.step(actions)
        terms -= np.where(running, report[:, FIRST_TERM:FIRST_READING].T, 0.0)
        running &= report[:, FIRST_READING] == RUNNING
    drives = episodes.simulation.read("effort_biceps") + episodes.simulation.read("effort_triceps")
    return {
        "cost": terms.sum(axis=0),
        **dict(zip((*WORN_WEIGHTS, "failure"), terms, strict=True)),
        "failed": (~running).astype(np.float64),
        "isav": np.degrees(1.0) ** 2 * drives,
        **dict(zip(WORN_METRICS, report[:, FIRST_WORN_METRIC:].T.copy(), strict=True)),
    }
