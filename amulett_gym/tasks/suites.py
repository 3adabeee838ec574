"""Suites: families of scenarios, sampled for many devices at once from one 64-bit key each.

Angles stay in 0 to 90 deg, the elbow's comfortable workspace, around the paper's step of 45 deg. Pushes are fractions
of the torque that the drives have left at the nominal tension, (f_max - sigma) R_2 less the weight's, so that they can
be resisted.

Nothing happens, and nothing is counted, in the first half second: an arm starts at the nominal tension, and a law that
wants another one must not pay for the start that others are given.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from amulett_gym.compiled import compiled
from amulett_gym.config import Profile
from amulett_gym.errors import unknown
from amulett_gym.model.spring import build_tables
from amulett_gym.simulation.layout import MAX_MOVES, MAX_PUSHES
from amulett_gym.simulation.random import derive_keys, uniform
from amulett_gym.tasks.scenario import empty_rows

SPLITS = {"train": 1, "validation": 2, "held-out": 3}
"""Disjoint families of seeds: to train on, to choose a policy by, and to report."""

WORKSPACE_DEG = (0.0, 90.0)

START = 0.5
"""When the task begins and metrics start to count [s]."""

_SCENARIO_STREAM, _NOISE_STREAM = 0, 1

Rows = NDArray[np.void]
Draws = NDArray[np.float64]


def sample(suite: str, keys: NDArray[np.uint64], profile: Profile, max_force: float | None = None) -> Rows:
    """Draw one scenario for each key.

    Parameters
    ----------
    suite : str
        A name from `suite_names`.
    keys : ndarray of uint64, shape (N,)
        The episodes' keys; the same key gives the same scenario in any batch.
    profile : Profile
        Scales pushes and gives the nominal tension and inertia.
    max_force : float, optional
        Force at which the profile's springs saturate [N], for who knows it already: finding it takes most of the time.

    Returns
    -------
    ndarray of `simulation.layout.SCENARIO`, shape (N,)

    Raises
    ------
    AmulettError
        If the suite's name is unknown.
    """
    if suite not in _SUITES:
        raise unknown("suite", suite, _SUITES)
    if max_force is None:
        max_force = build_tables(profile.spring).max_force
    rows = empty_rows(keys.size, profile)
    rows["measure_from"] = START
    draws = uniform(derive_keys(keys, _SCENARIO_STREAM), 4 * max(MAX_MOVES, MAX_PUSHES) + 4)
    radius = profile.plant.joint_pulley_radius
    spare = (max_force - profile.variable_stiffness.nominal_tension) * radius
    _SUITES[suite](rows, draws, max(spare, 0.0))
    _make_room_for_weight(rows, max_force, radius)
    rows["noise_key"] = derive_keys(keys, _NOISE_STREAM)
    return rows


def episode_keys(device_keys: NDArray[np.uint64], episodes: NDArray[np.uint64], split: str) -> NDArray[np.uint64]:
    """Return the keys of the devices' present episodes in a split.

    Raises
    ------
    AmulettError
        If the split's name is unknown.
    """
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)
    return derive_keys(derive_keys(device_keys, SPLITS[split]), episodes)


def suite_names() -> list[str]:
    """Return the names of all suites."""
    return list(_SUITES)


def describe_suite(suite: str) -> str:
    """Return a suite's one-line description."""
    return (_SUITES[suite].__doc__ or "").split("\n")[0]


def _paper_step(rows: Rows, draws: Draws, spare_torque: float) -> None:
    """One setpoint step from 0 to 45 deg at 0.5 s, from rest (the paper's protocol)."""
    rows["move_count"] = 1
    rows["move_time"][:, 0] = START
    rows["move_angle"][:, 0] = np.radians(45.0)


def _steps(rows: Rows, draws: Draws, spare_torque: float) -> None:
    """Random setpoint steps of 10 to 60 deg in flexion and extension, every 1 to 2.5 s."""
    _random_moves(rows, draws, (1.0, 2.5), (0.0, 0.0))


def _reach(rows: Rows, draws: Draws, spare_torque: float) -> None:
    """Minimum-jerk reaches of 10 to 60 deg in 0.5 to 1.5 s, with 0.3 to 1 s between them."""
    _random_moves(rows, draws, (0.3, 1.0), (0.5, 1.5))


@compiled
def _random_moves(rows: Rows, draws: Draws, dwell: tuple[float, float], duration: tuple[float, float]) -> None:
    low, high = WORKSPACE_DEG
    for i in range(rows.size):
        row, draw = rows[i], draws[i]
        angle = _between(draw[0], low, high, 2)
        row.initial_angle = np.radians(angle)
        row.move_count = MAX_MOVES
        time = START
        for k in range(MAX_MOVES):
            how_far, direction, how_long, pause = draw[4 * k + 4], draw[4 * k + 5], draw[4 * k + 6], draw[4 * k + 7]
            far = _between(how_far, 10.0, 60.0, 2)
            flex = angle + far <= high if direction < 0.5 else angle - far < low
            # A move that would leave the workspace one way goes the other; one that fits neither way goes to an end.
            angle = _rounded(min(max(angle + far if flex else angle - far, low), high), 2)
            length = _between(how_long, duration[0], duration[1], 3)
            row.move_time[k] = time
            row.move_angle[k] = np.radians(angle)
            row.move_duration[k] = length
            time = _rounded(time + length + _between(pause, dwell[0], dwell[1], 3), 3)


@compiled
def _hold_push(rows: Rows, draws: Draws, spare_torque: float) -> None:
    """Hold a posture of 15 to 75 deg against four torque pulses of 0.1 to 0.5 s in either direction."""
    for i in range(rows.size):
        row, draw = rows[i], draws[i]
        row.initial_angle = np.radians(_between(draw[0], 15.0, 75.0, 2))
        row.push_count = MAX_PUSHES
        spare = max(spare_torque - abs(row.static_torque * np.sin(row.initial_angle)), 0.0)
        for k in range(MAX_PUSHES):
            when, how_long, how_strong, direction = draw[4 * k + 4], draw[4 * k + 5], draw[4 * k + 6], draw[4 * k + 7]
            begin = START + 2.4 * k
            row.push_time[k] = _between(when, begin, begin + 1.0, 3)
            row.push_duration[k] = _between(how_long, 0.1, 0.5, 3)
            torque = _between(how_strong, 0.2 * spare, 0.7 * spare, 4)
            row.push_torque[k] = -torque if direction < 0.5 else torque


def _make_room_for_weight(rows: Rows, max_force: float, joint_radius: float) -> None:
    """Start with less tension where the agonist needs its force to hold the arm up (0.5 N below saturation)."""
    load = np.abs(rows["static_torque"] * np.sin(rows["initial_angle"])) / joint_radius
    room = max_force - load - 0.5
    rows["initial_tension"] = np.where(room > 0, np.minimum(rows["initial_tension"], room), rows["initial_tension"])


@compiled
def _between(draw: float, low: float, high: float, digits: int) -> float:
    """Scale a uniform draw to [low, high], rounded: scenarios are data that people read, and replay exactly."""
    return _rounded(low + draw * (high - low), digits)


@compiled
def _rounded(number: float, digits: int) -> float:
    scale = 10.0**digits
    return np.rint(number * scale) / scale


_SUITES: dict[str, Callable[[Rows, Draws, float], None]] = {
    "paper-step": _paper_step,
    "steps": _steps,
    "reach": _reach,
    "hold-push": _hold_push,
}
