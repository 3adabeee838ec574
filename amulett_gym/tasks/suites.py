"""Suites: families of scenarios, sampled for many devices at once from one 64-bit key each.

Angles are within 0 to 90 deg, the elbow's comfortable workspace, around the paper's step of 45 deg. External torques
are scaled by the spare torque, which the drives have left at the nominal tension: (f_max - sigma) R_2 minus the
weight's torque, 0.467 N m on simulation and testbed. With more than that every law fails by winding up its integrators.

The split `shifted` draws from outside the ranges of the other three. The draws are versioned: see `tasks.hashes`.

In the first half second nothing happens and metrics do not count: an arm starts at the nominal tension, and a law with
another tension has time to reach it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import unknown
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.plant import GRAVITY, static_torque
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import FAMILIES, MAX_MOVES, MAX_PUSHES, ORIENTATIONS, load_arm
from amulett_gym.simulation.random import derive_keys, uniform
from amulett_gym.tasks.scenario import empty_rows, most_damping, most_stiffness

SPLITS = {"train": 1, "validation": 2, "held-out": 3, "shifted": 4}
"""Disjoint sets of seeds: for training, for the choice of a policy, for reports, and for reports outside the ranges."""

SUITES = {
    "paper-step": "One setpoint step from 0 to 45 deg at 0.5 s, from rest (the paper's protocol).",
    "steps": "Random setpoint steps of 10 to 60 deg in flexion and extension, every 1 to 2.5 s.",
    "reach": "Minimum-jerk reaches of 10 to 60 deg in 0.5 to 1.5 s, with 0.3 to 1 s between them.",
    "track": "Sinusoids and chirps of 10 to 25 deg at 0.1 to 0.5 Hz about a posture of 30 to 60 deg.",
    "pick-place": "A repeated assembly cycle: reach, hold against a slow push, reach back, dwell.",
    "contact": "Reaches out and back through the place of a compliant obstacle, which is there in 3 of 4 episodes.",
    "hold-push": "Hold a posture of 15 to 75 deg against torque pulses, slow pushes and, in half the episodes, shakes.",
    "payload": "Reaches with an unknown payload, in the horizontal or the vertical plane.",
    "mixed": "Each of the above but the paper's step equally often, on devices that all differ from the profile.",
}
"""Name and one line of each suite; its function documents ranges and reasons."""

WORKSPACE_DEG = (0.0, 90.0)

START = 0.5
"""Begin of task and metrics [s]."""

CONTACT_SUITES = ("contact", "mixed")
"""Suites with obstacles."""

_SCENARIO_STREAM, _NOISE_STREAM, _FLEET_STREAM = 0, 1, 2
_PAPER_STEP, _STEPS, _REACH, _TRACK, _PICK_PLACE, _CONTACT, _HOLD_PUSH, _PAYLOAD, _MIXED = range(len(SUITES))
_FIRST_FAMILY = FAMILIES.index("paper-step")
_HORIZONTAL, _VERTICAL = (ORIENTATIONS.index(plane) for plane in ("horizontal", "vertical"))

# Index of each draw: single ones, then four of each move or push, then the device.
_ANGLE, _FAMILY, _WHICH, _HOW_MUCH, _REPEATED = 0, 1, 2, 3, 4
_DEVICE = _REPEATED + 4 * max(MAX_MOVES, MAX_PUSHES)
_DRAWS = _DEVICE + 16

_VERTICAL_TOP_DEG = 60.0
_LASTS = 60.0  # [s]; longer than an episode
_STRONGEST = 1.14  # largest factor by which `_vary_device` makes springs stronger, times that of the pulley's radius

Rows = NDArray[np.void]


class Sampler:
    """Draws the scenarios of a suite, with what :func:`sample` needs of a profile made once.

    Parameters
    ----------
    suite, profile, split
        As of `sample`.
    max_force : float, optional
        Force at the end of the springs' table [N], if already known: its calculation takes most of the time. Drives
        that stall allow less.

    Raises
    ------
    AmulettError
        If the suite's or the split's name is unknown.
    """

    def __init__(self, suite: str, profile: Profile, split: str = "train", max_force: float | None = None) -> None:
        check_names(suite, split)
        masses = profile.plant.masses
        self._profile, self._family, self._shifted = profile, list(SUITES).index(suite), split == "shifted"
        self._has_obstacles = suite in CONTACT_SUITES
        self._max_force = reachable_force(profile, max_force, _STRONGEST)
        self._weight = static_torque([item.mass for item in masses], [item.arm for item in masses])
        self._blank = empty_rows(1, profile)
        self._blank["measure_from"] = START

    def __call__(self, keys: NDArray[np.uint64]) -> Rows:
        """Return one scenario for each key, as `sample` does."""
        profile, family = self._profile, self._family
        radius = profile.plant.joint_pulley_radius
        rows = np.repeat(self._blank, keys.size)
        draws = uniform(derive_keys(keys, _SCENARIO_STREAM), _DRAWS)
        if family in (_PAPER_STEP, _STEPS, _REACH):
            _fill_moves(rows, draws, family, self._shifted)
        else:
            _fill(rows, draws, family, self._shifted, self._max_force, radius, self._weight)
        if family in (_PAYLOAD, _MIXED):
            load_arm(rows, profile)
        make_room_for_weight(rows, self._max_force, radius)
        if self._has_obstacles:
            stiffness, damping = (most(rows["inertia"], profile) for most in (most_stiffness, most_damping))
            rows["obstacle_stiffness"] = np.minimum(rows["obstacle_stiffness"], stiffness)
            rows["obstacle_damping"] = np.minimum(rows["obstacle_damping"], damping)
        rows["noise_key"] = derive_keys(keys, _NOISE_STREAM)
        return rows


def sample(suite: str, keys: NDArray[np.uint64], profile: Profile, split: str = "train") -> Rows:
    """Return one scenario for each key.

    Parameters
    ----------
    suite : str
        A name from `SUITES`.
    keys : ndarray of uint64, shape (N,)
        The episodes' keys (`episode_keys`); the same key gives the same scenario in any batch.
    profile : Profile
        Scales external torques and gives the nominal tension and inertia.
    split : str
        ``"shifted"`` draws from outside the ranges that all other splits share.

    Returns
    -------
    ndarray of `simulation.layout.SCENARIO`, shape (N,)

    Raises
    ------
    AmulettError
        If the suite's or the split's name is unknown.
    """
    return Sampler(suite, profile, split)(keys)


def reachable_force(profile: Profile, max_force: float | None, largest_factor: float = 1.0) -> float:
    """Return the largest string force [N] that springs and drives allow.

    Parameters
    ----------
    profile : Profile
    max_force : float or None
        Force at the end of the springs' table [N]; None: it is calculated.
    largest_factor : float
        Of a device's springs and drive pulleys, by which drives stall at less.
    """
    if max_force is None:
        max_force = build_tables(profile.spring).max_force
    if profile.drives.stall_torque is None:
        return max_force
    return min(max_force, profile.drives.stall_torque / (profile.plant.drive_pulley_radius * largest_factor))


def check_names(suite: str, split: str) -> None:
    """Raise an AmulettError if the name of the suite or split is unknown."""
    if suite not in SUITES:
        raise unknown("suite", suite, SUITES)
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)


def episode_keys(device_keys: NDArray[np.uint64], episodes: NDArray[np.uint64], split: str) -> NDArray[np.uint64]:
    """Return the keys of the devices' episodes in a split.

    Raises
    ------
    AmulettError
        If the split's name is unknown.
    """
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)
    return derive_keys(derive_keys(device_keys, SPLITS[split]), episodes)


def draw_devices(keys: NDArray[np.uint64], count: int) -> NDArray[np.int64]:
    """Return the index of each episode's device in a fleet of `count` devices, drawn uniformly by the keys."""
    return (uniform(derive_keys(keys, _FLEET_STREAM), 1)[:, 0] * count).astype(np.int64)


def suite_names() -> list[str]:
    """Return the names of all suites."""
    return list(SUITES)


def families_of(suite: str) -> list[str]:
    """Return the families that a suite draws from: itself, or those of the mixed suite."""
    return list(SUITES)[_STEPS:_MIXED] if suite == "mixed" else [suite]


@compiled
def _fill_moves(rows: Rows, draws: NDArray[np.float64], family: int, shifted: bool) -> None:
    """Do what `_fill` does, for suites of moves alone: all the others take a second to compile."""
    for i in range(rows.size):
        rows[i].family = _FIRST_FAMILY + family
        _moves(rows[i], draws[i], family, shifted)


@compiled
def _fill(
    rows: Rows, draws: NDArray[np.float64], suite: int, shifted: bool, max_force: float, radius: float, weight: float
) -> None:
    for i in range(rows.size):
        row, draw = rows[i], draws[i]
        family = suite
        if suite == _MIXED:
            family = _STEPS + min(int(draw[_FAMILY] * (_MIXED - _STEPS)), _MIXED - _STEPS - 1)
            _vary_device(row, draw[_DEVICE:], shifted)
        row.family = _FIRST_FAMILY + family
        weakest = min(row.spring_biceps_factor, row.spring_triceps_factor)
        spare = max((weakest * max_force - row.initial_tension) * radius, 0.0)
        if family == _TRACK:
            _track(row, draw, shifted)
        elif family == _PICK_PLACE:
            _pick_place(row, draw, shifted, spare)
        elif family == _CONTACT:
            _contact(row, draw, shifted, spare)
        elif family == _HOLD_PUSH:
            _hold_push(row, draw, shifted, spare)
        elif family == _PAYLOAD:
            _payload(row, draw, shifted, spare, weight)
        else:
            _moves(row, draw, family, shifted)


@compiled
def _moves(row: Any, draw: Any, family: int, shifted: bool) -> None:
    """Make the paper's step, steps or reaches."""
    if family == _PAPER_STEP:
        row.move_count = 1
        row.move_time[0] = START
        row.move_angle[0] = np.radians(45.0)
    elif family == _STEPS:
        # The testbed needs 1.1 to 2.4 s for the paper's step (Table 2).
        _random_moves(row, draw, (1.0, 2.5), (0.0, 0.0), shifted, WORKSPACE_DEG[1])
    else:
        _random_moves(row, draw, (0.3, 1.0), (0.5, 1.5), shifted, WORKSPACE_DEG[1])


@compiled
def _random_moves(
    row: Any, draw: Any, dwell: tuple[float, float], duration: tuple[float, float], shifted: bool, high: float
) -> None:
    """Move by 10 to 60 deg, with ranges of pauses and durations [s]: steps, or minimum-jerk reaches.

    Shifted: 3 to 8 deg, or 65 to 85 deg.
    """
    low = WORKSPACE_DEG[0]
    angle = _between(draw[_ANGLE], low, high, 2)
    row.initial_angle = np.radians(angle)
    row.move_count = MAX_MOVES
    time = START
    for k in range(MAX_MOVES):
        size, direction, how_long, pause = _four(draw, k)
        far = _between(size, 10.0, 60.0, 2)
        if shifted:
            far = _between(2.0 * size, 3.0, 8.0, 2) if size < 0.5 else _between(2.0 * size - 1.0, 65.0, 85.0, 2)
        flex = angle + far <= high if direction < 0.5 else angle - far < low
        # A move that would leave the workspace goes the other way, or to an end if it fits neither way.
        angle = _rounded(min(max(angle + far if flex else angle - far, low), high), 2)
        length = _between(how_long, duration[0], duration[1], 3)
        row.move_time[k] = time
        row.move_angle[k] = np.radians(angle)
        row.move_duration[k] = length
        time = _rounded(time + length + _between(pause, dwell[0], dwell[1], 3), 3)


@compiled
def _track(row: Any, draw: Any, shifted: bool) -> None:
    """Sinusoids, and chirps in half the episodes, around the loop's corner frequency.

    With the testbed's gains of Table 1 the integral dominates: K_i R_1 / R_2 is 2.0 1/s, a time constant of 0.5 s or
    0.3 Hz. Shifted: 0.6 to 1 Hz.
    """
    which, how_fast, how_wide, changes = _four(draw, 0)
    row.initial_angle = np.radians(_between(draw[_ANGLE], 30.0, 60.0, 2))
    row.wave_amplitude = np.radians(_between(how_wide, 10.0, 25.0, 2))
    low, high = (0.6, 1.0) if shifted else (0.1, 0.5)
    first = _between(how_fast, low, high, 3)
    last = _between(changes, low, high, 3)
    row.wave_frequency, row.wave_time = first, START
    row.wave_chirp = _rounded((last - first) / 9.5, 4) if which < 0.5 else 0.0
    row.wave_duration = 12.0 if which < 0.5 else _LASTS


@compiled
def _pick_place(row: Any, draw: Any, shifted: bool, spare: float) -> None:
    """Reach out 20 to 60 deg, hold a second against a push of 20 to 50 % of the spare torque, reach back, dwell; again.

    Each element takes 0.5 to 1.2 s, as in predetermined motion times (MTM) of light assembly. The push is slow (ramps
    of 0.2 to 0.4 s): a part that is joined or lifted. Shifted: 60 to 80 %, and reaches of 0.35 to 0.5 s.
    """
    out, way, how_long, hold = _four(draw, 0)
    strength, pause, ramp, against = _four(draw, 1)
    home, far = _ends(draw[_ANGLE], _between(out, 20.0, 60.0, 2), way)
    row.initial_angle = np.radians(home)
    reach = _between(how_long, 0.35, 0.5, 3) if shifted else _between(how_long, 0.6, 1.2, 3)
    holding, dwell = _between(hold, 0.8, 1.4, 3), _between(pause, 0.5, 0.9, 3)
    share = _between(strength, 0.6, 0.8, 4) if shifted else _between(strength, 0.2, 0.5, 4)
    torque = _rounded(share * _spare_at(row, far, spare), 4) * (1.0 if against < 0.5 else -1.0)
    row.move_count, row.push_count = MAX_MOVES, MAX_PUSHES
    time = START
    for k in range(MAX_MOVES // 2):
        row.move_time[2 * k], row.move_angle[2 * k], row.move_duration[2 * k] = time, np.radians(far), reach
        time = _rounded(time + reach, 3)
        if k < MAX_PUSHES:
            row.push_time[k], row.push_duration[k], row.push_torque[k] = time, holding, torque
            row.push_inverse_rise[k] = 1.0 / _between(ramp, 0.2, 0.4, 3)
        time = _rounded(time + holding, 3)
        row.move_time[2 * k + 1], row.move_angle[2 * k + 1] = time, np.radians(home)
        row.move_duration[2 * k + 1] = reach
        time = _rounded(time + reach + dwell, 3)


@compiled
def _contact(row: Any, draw: Any, shifted: bool, spare: float) -> None:
    """Reach 25 to 60 deg out in 0.4 to 1 s and back, with an obstacle at 50 to 95 % of the way.

    It yields by 1.5 to 10 deg under the spare torque (2.7 to 17.8 N m/rad on simulation and testbed: at a hand's
    distance of 0.25 m 43 to 286 N/m, foam and soft tissue). A quarter of the episodes have none, so that constant
    caution has a cost. The setpoint stays out for 0.3 to 0.7 s, about the loop's time constant: the task is the impact
    and the press that follows, without long integrator windup. Shifted: 0.3 to 0.8 deg.
    """
    out, way, how_long, stay = _four(draw, 0)
    where, softness, viscosity, pause = _four(draw, 1)
    home, far = _ends(draw[_ANGLE], _between(out, 25.0, 60.0, 2), way)
    row.initial_angle = np.radians(home)
    reach = _between(how_long, 0.4, 1.0, 3)
    dwell, rest = _between(stay, 0.3, 0.7, 3), _between(pause, 0.4, 0.9, 3)
    row.move_count = MAX_MOVES
    time = START
    for k in range(MAX_MOVES):
        row.move_time[k] = time
        row.move_angle[k] = np.radians(home if k % 2 else far)
        row.move_duration[k] = reach
        time = _rounded(time + reach + (rest if k % 2 else dwell), 3)
    if draw[_WHICH] < 0.75:
        row.obstacle_angle = np.radians(_rounded(home + _between(where, 0.5, 0.95, 4) * (far - home), 2))
        row.obstacle_side = 1.0 if far > home else -1.0
        yields = _between(softness, 0.3, 0.8, 3) if shifted else _between(softness, 1.5, 10.0, 3)
        row.obstacle_stiffness = _rounded(max(spare, 0.01) / np.radians(yields), 3)
        row.obstacle_damping = _between(viscosity, 0.0, 0.05, 4)


@compiled
def _hold_push(row: Any, draw: Any, shifted: bool, spare: float) -> None:
    """Pulses of 0.1 to 0.5 s and slow pushes of 1 to 1.6 s, of 20 to 70 % of the spare torque, either way; shaking.

    Two of three pushes are pulses; a slow one has ramps of 0.3 to 0.5 s. Shaking has 3 to 12 % rms of the spare torque
    at 0.5 to 4 Hz, as from walking or a tool. Shifted: pushes of 80 to 100 %, shaking of 15 to 25 %.
    """
    posture = _between(draw[_ANGLE], 15.0, 75.0, 2)
    row.initial_angle = np.radians(posture)
    row.push_count = MAX_PUSHES
    left = _spare_at(row, posture, spare)
    low, high = (0.8, 1.0) if shifted else (0.2, 0.7)
    for k in range(MAX_PUSHES):
        when, how_long, how_strong, direction = _four(draw, k)
        kind, slow, ramp, _ = _four(draw, MAX_PUSHES + k)
        begin = START + 2.4 * k
        row.push_time[k] = _between(when, begin, begin + 1.0, 3)
        row.push_duration[k] = _between(how_long, 0.1, 0.5, 3)
        if kind < 1.0 / 3.0:
            row.push_duration[k] = _between(slow, 1.0, 1.6, 3)
            row.push_inverse_rise[k] = 1.0 / _between(ramp, 0.3, 0.5, 3)
        torque = _between(how_strong, low * left, high * left, 4)
        row.push_torque[k] = -torque if direction < 0.5 else torque
    if draw[_WHICH] < 0.5:
        share, how_fast, _, _ = _four(draw, 2 * MAX_PUSHES)
        least, most = (0.15, 0.25) if shifted else (0.03, 0.12)
        row.shake_rms = max(_between(share, least * left, most * left, 4), 1e-4)
        row.shake_bandwidth = _between(how_fast, 0.5, 4.0, 2)
        row.shake_time = START
        row.shake_duration = _LASTS


@compiled
def _payload(row: Any, draw: Any, shifted: bool, spare: float, weight: float) -> None:
    """Reaches with a payload at 0.1 to 0.25 m whose weight needs 10 to 50 % of the spare torque.

    Half the arms swing vertically, in the lower 60 deg: there the arm's own weight needs up to 62 % of the spare
    torque, and the payload is scaled by the rest at the top. Shifted: 60 to 80 %.
    """
    vertical = draw[_WHICH] < 0.5
    row.orientation = _VERTICAL if vertical else _HORIZONTAL
    _random_moves(row, draw, (0.5, 1.2), (0.6, 1.5), False, _VERTICAL_TOP_DEG if vertical else WORKSPACE_DEG[1])
    left = spare
    if vertical:
        left = max(spare - weight * math.sin(math.radians(_VERTICAL_TOP_DEG)), 0.0)
    share = _between(draw[_HOW_MUCH], 0.6, 0.8, 4) if shifted else _between(draw[_HOW_MUCH], 0.1, 0.5, 4)
    row.payload_arm = _between(draw[_DEVICE + 15], 0.1, 0.25, 3)
    row.payload_mass = max(_rounded(share * left / (GRAVITY * row.payload_arm), 4), 1e-4)


@compiled
def _vary_device(row: Any, draw: Any, shifted: bool) -> None:
    """Vary a device within manufacturing tolerances of its profile, with an initial tension of 8 to 12 N.

    Assumed: springs differ by 10 % in rate, a usual tolerance of catalogue springs, and the two of a device by 3 %;
    pulleys of 28 mm by 2 % (0.3 mm of printing and the string's thickness); damping by 30 %; the inertia of motor, cuff
    and cable by 10 %. The encoder's magnet is off by up to 0.3 deg, the sliders by 0.05 mm, two to three bits; noise is
    0.5 to 1.5 times the profile's, and a busy microcontroller misses up to a tenth of its ticks. Shifted: springs of 75
    to 85 %, and larger deviations of everything else.
    """
    low, high = (0.75, 0.85) if shifted else (0.9, 1.1)
    spring = _between(draw[0], low, high, 3)
    row.spring_biceps_factor = _rounded(spring * _between(draw[1], 0.985, 1.015, 4), 4)
    row.spring_triceps_factor = _rounded(spring * _between(draw[2], 0.985, 1.015, 4), 4)
    row.pulley_biceps_factor = _rounded(1.0 + _around(draw[3], 0.02, 0.04, shifted, 4), 4)
    row.pulley_triceps_factor = _rounded(1.0 + _around(draw[4], 0.02, 0.04, shifted, 4), 4)
    row.damping_factor = _rounded(1.0 + _around(draw[5], 0.3, 0.5, shifted, 3), 3)
    row.inertia_factor = _rounded(1.0 + _around(draw[6], 0.1, 0.2, shifted, 3), 3)
    row.noise_factor = _between(draw[7], 1.6, 2.5, 3) if shifted else _between(draw[7], 0.5, 1.5, 3)
    row.encoder_bias = np.radians(_around(draw[8], 0.3, 0.6, shifted, 3))
    row.slider_bias_biceps = _around(draw[9], 5e-5, 1e-4, shifted, 7)
    row.slider_bias_triceps = _around(draw[10], 5e-5, 1e-4, shifted, 7)
    row.late_probability = _between(draw[11], 0.1, 0.2, 3) if shifted else _between(draw[11], 0.0, 0.1, 3)
    row.initial_tension = _between(draw[12], 8.0, 12.0, 2)


@compiled
def _four(draw: Any, k: int) -> tuple[float, float, float, float]:
    """Return the four draws of a move or push."""
    first = _REPEATED + 4 * k
    return draw[first], draw[first + 1], draw[first + 2], draw[first + 3]


@compiled
def _ends(draw: float, far: float, way: float) -> tuple[float, float]:
    """Return begin and end of a move of `far` [deg], anywhere in the workspace, either way."""
    low = _between(draw, WORKSPACE_DEG[0], WORKSPACE_DEG[1] - far, 2)
    high = _rounded(low + far, 2)
    return (low, high) if way < 0.5 else (high, low)


@compiled
def _spare_at(row: Any, angle: float, spare: float) -> float:
    """Return the spare torque minus the weight's [N m] at a posture [deg]."""
    return max(spare - abs(row.static_torque * math.sin(math.radians(angle))), 0.0)


@compiled
def _around(draw: float, near: float, far: float, shifted: bool, digits: int) -> float:
    """Return a deviation of up to `near`; if shifted, of `near` to `far`, either way."""
    if not shifted:
        return _between(draw, -near, near, digits)
    size = _between(abs(2.0 * draw - 1.0), near, far, digits)
    return size if draw < 0.5 else -size


def make_room_for_weight(rows: Rows, max_force: float, joint_radius: float) -> None:
    """Lower the initial tension where the agonist needs its force for the weight (0.5 N below saturation)."""
    load = np.abs(rows["static_torque"] * np.sin(rows["initial_angle"])) / joint_radius
    weakest = np.minimum(rows["spring_biceps_factor"], rows["spring_triceps_factor"]).astype(float)
    room = max_force * weakest - load - 0.5
    rows["initial_tension"] = np.where(room > 0, np.minimum(rows["initial_tension"], room), rows["initial_tension"])


@compiled
def _between(draw: float, low: float, high: float, digits: int) -> float:
    """Return a uniform draw scaled to [low, high] and rounded, so that scenarios are readable and replay exactly."""
    return _rounded(low + draw * (high - low), digits)


@compiled
def _rounded(number: float, digits: int) -> float:
    scale = 10.0**digits
    return np.rint(number * scale) / scale
