"""Suites of a device that is worn: what a person intends, and what happens to the hand.

Each scenario has a person of its own (`tasks.wearer.POPULATION`). Moves are what the person does: end and duration of
each differ at random from what is meant, by shares that belong to the person, and are drawn into the scenario, so that
it replays. Postures are meant within 20 to 70 deg, in the vertical plane within 0 to 45 deg; workspace: 0 to 90 deg.

The split `shifted` draws persons from outside the ranges of the other splits, and their movements are 1.25 to 1.6 times
slower. The first half second is as in `tasks.suites`. The draws are versioned: see `tasks.hashes`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import unknown
from amulett_gym.model.wearer import ACTIVE_SHARE, DAMPING, OFF_TIME, ON_TIME, PASSIVE_DAMPING, STIFFNESS, forearm
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import MAX_MOVES, MAX_PUSHES, ORIENTATIONS, is_vertical, load_arm
from amulett_gym.simulation.random import derive_keys, normal, uniform
from amulett_gym.tasks.scenario import empty_rows
from amulett_gym.tasks.suites import SPLITS, START, Rows, make_room_for_weight, reachable_force
from amulett_gym.tasks.wearer import between, draw_wearers, pack_wearers, rounded

WORN_SUITES = {
    "reaches": "Voluntary reaches of 10 to 45 deg in 0.5 to 1.2 s, with 0.4 to 1 s between them.",
    "assembly": "Assembly cycle: reach out, hold against a tool's push on the hand, reach back, dwell.",
    "carry": "Reaches, and a payload of 0.1 to 0.4 kg that is put into the hand, horizontally or vertically.",
    "guided": "The device leads a relaxed arm by slow sinusoids or moves of 10 to 40 deg; half the arms are spastic.",
    "tremor": "Slow reaches and long holds with a pathological tremor at 4 to 6 or 8 to 12 Hz.",
}
"""Name and one line of each suite; its function documents ranges and reasons."""

_SCENARIO_STREAM, _NOISE_STREAM, _VARIATION_STREAM = 0, 1, 4  # of an episode's key; 3 is the person's
_HORIZONTAL, _VERTICAL = (ORIENTATIONS.index(plane) for plane in ("horizontal", "vertical"))
_POSTURES_DEG, _VERTICAL_POSTURES_DEG = (20.0, 70.0), (0.0, 45.0)
_WORKSPACE_DEG = (0.0, 90.0)
_CYCLES = MAX_PUSHES
_LASTS = 60.0  # [s]; longer than an episode
_GRIP_SHARE = 0.2
"""Distance of the grip from the elbow over the body height: a forearm of 0.146 and half a hand of 0.108 (Winter, 2009,
Figure 4.1)."""
_GUIDABLE = 0.6  # share of the device's torque that a relaxed arm may need

# Index of each draw: single ones, then four of each move.
_ANGLE, _WHICH, _HOW_MUCH, _WHEN, _HOW_FAST, _TEMPO, _REPEATED = range(7)
_DRAWS = _REPEATED + 4 * (MAX_MOVES + 1)

Numbers = NDArray[np.float64]
People = dict[str, Numbers]


class WornSampler:
    """Draws the scenarios of a suite with their wearers, with what :func:`sample_worn` needs of a profile made once.

    Parameters
    ----------
    suite, profile, split
        As of `sample_worn`.
    max_force : float, optional
        Force at the end of the springs' table [N], if already known.

    Raises
    ------
    AmulettError
        If the suite's or the split's name is unknown.
    """

    def __init__(self, suite: str, profile: Profile, split: str = "train", max_force: float | None = None) -> None:
        if suite not in WORN_SUITES:
            raise unknown("suite", suite, WORN_SUITES)
        if split not in SPLITS:
            raise unknown("split", split, SPLITS)
        self._suite, self._profile, self._shifted = suite, profile, split == "shifted"
        self._max_force = reachable_force(profile, max_force)
        self._blank = empty_rows(1, profile)
        self._blank["measure_from"], self._blank["orientation"] = START, _HORIZONTAL

    def __call__(self, keys: NDArray[np.uint64]) -> tuple[Rows, Rows]:
        """Return one scenario and its wearer for each key, as `sample_worn` does."""
        suite, profile, shifted = self._suite, self._profile, self._shifted
        radius = profile.plant.joint_pulley_radius
        rows = np.repeat(self._blank, keys.size)
        rows["noise_key"] = derive_keys(keys, _NOISE_STREAM)
        people = draw_wearers(keys, shifted)
        draws = uniform(derive_keys(keys, _SCENARIO_STREAM), _DRAWS).T
        meant = _Movements(rows, draws, people, derive_keys(keys, _VARIATION_STREAM), shifted)
        if suite == "reaches":
            meant.wander((10.0, 45.0), (0.5, 1.2), (0.4, 1.0))
        elif suite == "assembly":
            _assembly(meant)
        elif suite == "carry":
            _carry(meant)
        elif suite == "guided":
            _guided(meant, _GUIDABLE * self._max_force * radius)
        else:
            _tremor(meant)
        load_arm(rows, profile)
        make_room_for_weight(rows, self._max_force, radius)
        mass, arm = _payload(meant) if suite == "carry" else (0.0, 0.0)
        rows["payload_mass"], rows["payload_arm"] = mass, arm
        period = profile.loop.control_period
        return rows, pack_wearers(people, period, is_vertical(rows, profile), mass, arm)


def sample_worn(suite: str, keys: NDArray[np.uint64], profile: Profile, split: str = "train") -> tuple[Rows, Rows]:
    """Return one scenario and its wearer for each key.

    Parameters
    ----------
    suite : str
        A name from `WORN_SUITES`.
    keys : ndarray of uint64, shape (N,)
        The episodes' keys (`suites.episode_keys`), which differ between splits; the same key gives the same scenario
        and wearer in any batch.
    profile : Profile
        Gives the nominal tension, the control period, and the torque by which the device guides.
    split : str
        ``"shifted"`` draws from outside the ranges that all other splits share.

    Returns
    -------
    rows : ndarray of `simulation.layout.SCENARIO`, shape (N,)
        As of `scenario.pack_worn`.
    wearers : ndarray of `simulation.worn_layout.PERSON`, shape (N,)

    Raises
    ------
    AmulettError
        If the suite's or the split's name is unknown.
    """
    return WornSampler(suite, profile, split)(keys)


class _Movements:
    """The movements of many people, added one by one to their scenarios.

    Attributes
    ----------
    rows : ndarray of SCENARIO, shape (N,)
    draws : ndarray, shape (draws, N)
        Uniform in [0, 1).
    people : dict of str to ndarray, shape (N,)
    errors : ndarray, shape (2 MAX_MOVES + 2 MAX_PUSHES, N)
        What differs from what is meant, with a standard deviation of 1.
    tempo : ndarray, shape (N,)
        Factor of all durations.
    lowest, highest, angle, time : ndarray, shape (N,)
        Range of the postures [deg]; the posture that is meant now [deg], and the end of what has been added [s].
    count : int
        Movements added.
    """

    def __init__(
        self, rows: Rows, draws: Numbers, people: People, error_keys: NDArray[np.uint64], shifted: bool
    ) -> None:
        self.rows, self.draws, self.people, self.shifted = rows, draws, people, shifted
        zeros = np.zeros_like(error_keys)
        self.errors = normal(error_keys, zeros, 2 * MAX_MOVES + 2 * MAX_PUSHES).T
        self.tempo = between(draws[_TEMPO], 1.25, 1.6, 3) if shifted else np.ones(rows.size)
        self.lowest, self.highest = (np.full(rows.size, end) for end in _POSTURES_DEG)
        self.angle, self.time, self.count = np.zeros(rows.size), np.full(rows.size, START), 0

    def start(self, angle: Numbers) -> None:
        """Begin in a posture [deg]."""
        self.angle = angle
        self.rows["initial_angle"] = np.radians(angle)

    def four(self, k: int) -> Numbers:
        """Return the four draws of a move."""
        return self.draws[_REPEATED + 4 * k : _REPEATED + 4 * k + 4]

    def varied(self, numbers: Any, error: Numbers, spread: Any, digits: int = 3) -> Numbers:
        """Return durations or torques with an error of a relative spread."""
        return rounded(numbers * (1.0 + spread * error), digits)

    def move(self, target: Numbers, duration: Numbers, pause: Numbers) -> Numbers:
        """Add a movement to a posture [deg] in a duration [s], and then a pause [s]; return when it ends [s]."""
        rows, k = self.rows, self.count
        ends, lengths = self.errors[2 * k], self.errors[2 * k + 1]
        far = self.people["endpoint_spread"] * np.abs(target - self.angle)
        end = np.clip(rounded(target + far * ends, 2), *_WORKSPACE_DEG)
        length = self.varied(self.tempo * duration, lengths, self.people["timing_spread"])
        rows["move_time"][:, k], rows["move_duration"][:, k] = self.time, length
        rows["move_angle"][:, k] = np.radians(end)
        arrival = rounded(self.time + length, 3)
        self.angle, self.time, self.count = target, rounded(arrival + pause, 3), k + 1
        rows["move_count"] = self.count
        return arrival

    def push(self, k: int, time: Numbers, duration: Numbers, torque: Numbers, rise: Numbers) -> None:
        """Add a push on the hand [s, s, N m, s]."""
        rows = self.rows
        rows["push_time"][:, k], rows["push_duration"][:, k], rows["push_torque"][:, k] = time, duration, torque
        rows["push_inverse_rise"][:, k] = 1.0 / rise
        rows["push_count"] = k + 1

    def wander(
        self, far: tuple[float, Any], duration: tuple[float, float], pause: tuple[float, float], moves: int = MAX_MOVES
    ) -> None:
        """Move from posture to posture, with ranges of the way [deg], duration and pause [s].

        A way that leaves the range of postures goes in the other direction, or to the farther end if it fits nowhere.
        """
        self.start(between(self.draws[_ANGLE], self.lowest, self.highest, 2))
        for k in range(moves):
            size, direction, how_long, wait = self.four(k)
            way = between(size, *far, 2)
            up, down = self.angle + way <= self.highest, self.angle - way >= self.lowest
            roomier = self.highest - self.angle > self.angle - self.lowest
            flex = np.where(up & down, direction < 0.5, np.where(up | down, up, roomier))
            target = np.clip(rounded(np.where(flex, self.angle + way, self.angle - way), 2), self.lowest, self.highest)
            self.move(target, between(how_long, *duration, 3), between(wait, *pause, 3))


def _assembly(meant: _Movements) -> None:
    """Four cycles: reach 20 to 40 deg in 0.8 to 1.4 s, hold 2 to 3 s, reach back, dwell 0.4 to 0.7 s; two fit in 10 s.

    Where the hand has arrived, up to 0.15 s later, a tool pushes it with 0.6 to 1.6 N m and ramps of 0.2 to 0.4 s, as
    long as it holds, always in one direction. At 0.35 m from the elbow this is 1.7 to 4.6 N, as of a light screwdriver
    or of parts that are joined (assumed). Torque (5 %) and times vary from cycle to cycle. Elements take as long as in
    predetermined motion times (MTM) of light assembly.
    """
    draws, errors = meant.draws, meant.errors
    out, way, how_long, hold = meant.four(0)
    strong, pause, ramp, against = meant.four(1)
    size = between(out, 20.0, 40.0, 2)
    low = between(draws[_ANGLE], meant.lowest, meant.highest - size, 2)
    home, far = (np.where((way < 0.5) == (side == 0), low, rounded(low + size, 2)) for side in (0, 1))
    reach, holding = between(how_long, 0.8, 1.4, 3), between(hold, 2.0, 3.0, 3)
    dwell, rise = between(pause, 0.4, 0.7, 3), between(ramp, 0.2, 0.4, 3)
    torque = between(strong, 0.6, 1.6, 3) * np.where(against < 0.5, 1.0, -1.0)
    meant.start(home)
    for k in range(_CYCLES):
        late, length, rest = meant.four(2 + k)[:3]
        stays = rounded(holding * between(length, 0.9, 1.1, 3), 3)
        arrival = meant.move(far, reach, stays)
        delay = between(late, 0.0, 0.15, 3)
        lasts = rounded(stays - delay, 3)
        pushes = meant.varied(torque, errors[2 * MAX_MOVES + k], 0.05)
        meant.push(k, rounded(arrival + delay, 3), lasts, pushes, np.minimum(rise, np.floor(500.0 * lasts) / 1000.0))
        meant.move(home, reach, rounded(dwell * between(rest, 0.9, 1.1, 3), 3))


def _carry(meant: _Movements) -> None:
    """Reaches of 10 to 40 deg in 0.6 to 1.2 s; half the arms swing vertically, where the wearer carries their weight.

    At 2 to 5 s, in movement or at rest, 0.1 to 0.4 kg are put into the hand and stay there: up to 1.1 N m at 45 deg.
    """
    vertical = meant.draws[_WHICH] < 0.5
    meant.rows["orientation"] = np.where(vertical, _VERTICAL, _HORIZONTAL)
    meant.lowest, meant.highest = (
        np.where(vertical, *ends) for ends in zip(_VERTICAL_POSTURES_DEG, _POSTURES_DEG, strict=True)
    )
    meant.wander((10.0, 40.0), (0.6, 1.2), (0.5, 1.2))
    meant.people["payload_time"] = between(meant.draws[_WHEN], 2.0, 5.0, 2)


def _payload(meant: _Movements) -> tuple[Numbers, Numbers]:
    """Return mass [kg] and lever arm [m] of what is put into the hand."""
    return between(meant.draws[_HOW_MUCH], 0.1, 0.4, 3), rounded(_GRIP_SHARE * meant.people["height"], 3)


def _guided(meant: _Movements, torque: float) -> None:
    """To and fro by 10 to 40 deg about the rest: sinusoids of 0.1 to 0.4 Hz, or moves of 1 to 2.5 s with pauses.

    As in passive mobilisation. Half the people are relaxed, with at most 2 % of activation; the others have 5 to 20 %
    of co-contraction that they cannot leave (spasticity-like, assumed; shifted: 25 to 40 %). The way is at most what
    `torque` [N m] moves against their muscles' stiffness, but at least 10 deg. The device does not vary what it does.
    """
    rows, draws, people = meant.rows, meant.draws, meant.people
    least, most = (0.25, 0.4) if meant.shifted else (0.05, 0.2)
    habit = draws[_HOW_MUCH]
    people["co_contraction"] = np.where(
        draws[_WHICH] < 0.5, between(habit, least, most, 3), between(habit, 0.0, 0.02, 3)
    )
    people["guided"] = np.ones(rows.size)
    people["endpoint_spread"] = people["timing_spread"] = np.zeros(rows.size)
    farthest = np.clip(np.floor(np.degrees(2.0 * torque / _impedance(people)[0])), 10.0, 40.0)
    how_far, side, kind, _ = meant.four(0)
    way = between(how_far, 10.0, farthest, 1)
    middle = np.clip(people["rest_angle_deg"], meant.lowest + 0.5 * way, meant.highest - 0.5 * way)
    middle, half = rounded(middle, 2), rounded(0.5 * way, 2)
    waves = kind < 0.5
    side = np.where(side < 0.5, -1.0, 1.0)
    meant.start(rounded(np.where(waves, middle, middle + side * half), 2))
    for k in range(MAX_MOVES):
        how_long, wait = meant.four(1 + k)[:2]
        side = -side
        meant.move(rounded(middle + side * half, 2), between(how_long, 1.0, 2.5, 3), between(wait, 0.4, 1.0, 3))
    rows["move_count"] = np.where(waves, 0, MAX_MOVES)
    for name in ("move_time", "move_angle", "move_duration"):
        rows[name][waves] = 0.0
    rows["wave_amplitude"] = np.where(waves, np.radians(half), 0.0)
    rows["wave_frequency"] = np.where(waves, rounded(between(draws[_HOW_FAST], 0.1, 0.4, 3) / meant.tempo, 3), 0.0)
    rows["wave_time"], rows["wave_duration"] = np.where(waves, [[START], [_LASTS]], 0.0)


def _tremor(meant: _Movements) -> None:
    """Reaches of 10 to 30 deg in 1.2 to 2.5 s, with holds of 1.2 to 3 s between them, under a pathological tremor.

    Half the people shake at 4 to 6 Hz, as with Parkinson's disease, by 0.3 to 3 deg; the others at 8 to 12 Hz, as with
    a strong physiological or an essential tremor, by 0.3 to 1 deg: from memory, assumed (shifted: 3.3 to 5 and 1.1 to
    1.6 deg). That is from peak to peak, as an oscillation of this standard deviation has it, without the exoskeleton;
    the torque follows from the arm's impedance at the frequency (see `shake_deg`).
    """
    draws, people = meant.draws, meant.people
    fast = draws[_WHICH] < 0.5
    slow_range, fast_range = ((3.3, 5.0), (1.1, 1.6)) if meant.shifted else ((0.3, 3.0), (0.3, 1.0))
    shake = np.where(fast, between(draws[_HOW_MUCH], *fast_range, 3), between(draws[_HOW_MUCH], *slow_range, 3))
    pitch = draws[_HOW_FAST]
    people["tremor_frequency"] = np.where(fast, between(pitch, 8.0, 12.0, 2), between(pitch, 4.0, 6.0, 2))
    people["tremor_torque"] = rounded(shake / shake_deg(people | {"tremor_torque": np.ones(shake.size)}), 3)
    meant.wander((10.0, 30.0), (1.2, 2.5), (1.2, 3.0))


def shake_deg(people: People) -> Numbers:
    """Return by how much tremors shake arms outside the exoskeleton, from peak to peak [deg].

    The torque's standard deviation, times 2 sqrt(2), over the impedance at the tremor's frequency: of inertia, muscles
    and passive elbow, and of the reflex with its delay and the muscles' lag. What the tremor's torque has at lower
    frequencies moves the arm besides, more slowly.
    """
    stiffness, damping, inertia = _impedance(people)
    speed = 2.0 * math.pi * people["tremor_frequency"]
    lag = 1.0 + 0.5j * (ON_TIME + OFF_TIME) * speed
    reflex = people["feedback_stiffness"] + 1j * speed * people["feedback_damping"]
    answer = reflex * np.exp(-1j * speed * people["reflex_delay"]) / lag
    impedance = np.abs(stiffness - inertia * speed * speed + 1j * damping * speed + answer)
    return np.asarray(np.degrees(2.0 * math.sqrt(2.0) * people["tremor_torque"] / impedance))


def _impedance(people: People) -> tuple[Numbers, Numbers, Numbers]:
    """Return stiffness [N m/rad], damping [N m s/rad] and inertia [kg m2] of elbows with habitual co-contraction.

    As `model.wearer.muscle_stiffness` and `muscle_damping`, of many people.
    """
    active = 2.0 * people["tone"] + people["strength"] * ACTIVE_SHARE * 2.0 * people["co_contraction"]
    _, _, inertia = forearm(people["mass"], people["height"])
    return STIFFNESS * active, DAMPING * active + PASSIVE_DAMPING, inertia
