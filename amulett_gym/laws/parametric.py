"""Laws with tunable parameters.

A law maps an observation to a tension setpoint. All laws act from outside the loop, at agent rate, on observations of
shape (N, 13). Each row can have its own parameters: tuning tries many at once.

``constant`` is one tension. ``eq6-tuned`` is the paper's eq. 6 with its exponent (4) as a fourth parameter.

``parametric`` is a sum, limited smoothly to the range of tensions (see `_squash`) and low-pass filtered, with one time
constant for a rising tension and another for a falling one::

    base + g1 E + g2 d + g3 S + g4 V + g5 d v + g6 L + g7 L E + g8 T + g9 d t + g10 a + g11 L d

    E = 1 - exp(-(e / error_width)^2)      size of the position error
    d = tanh(e / error_width)              direction to the setpoint
    S = max(-agonist d, 0)                 whether the agonist has to switch
    V = 1 - exp(-(rate / speed_width)^2)   size of the joint rate
    v = tanh(rate / speed_width)           direction of motion; d v: to the setpoint or away from it
    L = exp(-time / early_time)            how recently the setpoint began to move
    T = 1 - exp(-(torque / torque_width)^2), t = tanh(torque / torque_width)
                                           size and direction of the external torque; d t: to the setpoint or away
    a = joint angle / 90 deg

The external torque is the remainder of eq. 1 at constant speed: friction minus the strings' torque by both force
estimates. The estimates are slow and never below their floor, and gravity is part of the remainder; the device has no
better signal.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE, compiled_tension_of
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.fleet import fleet_names, in_words, load_fleet
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.damping import decay_rate
from amulett_gym.model.plant import inertia
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.reading import read_json

RANGE = TENSION_RANGE
"""Range of the shipped laws' tension setpoints [N]: that of the environments' default actions."""

DEFAULT_SUITE = "mixed"
"""Suite on which a law was tuned if its name does not contain one."""

FORMAT = "amulett-tuned-law"

TUNED = ("laws", "tuned")
"""Folder of the tuned parameters in the package: ``<profile or fleet>/<law>-<suite>.json``."""

_ERROR, _ANGLE, _RATE, _TIME, _FORCE, _ = OBSERVATION_SCALES.values()
_ERROR_AT, _ANGLE_AT, _RATE_AT, _TIME_AT, _BICEPS_AT, _TRICEPS_AT, _AGONIST_AT, _SETPOINT_AT = map(
    OBSERVATIONS.index,
    (
        "position_error",
        "joint_angle",
        "joint_velocity",
        "time_since_move",
        "estimated_tension_biceps",
        "estimated_tension_triceps",
        "agonist",
        "tension_setpoint",
    ),
)

Values = NDArray[np.float64]
Tensions = Callable[..., None]


@dataclass(frozen=True)
class Parameter:
    """A tunable parameter, searched from `low` to `high`, first at `start`; `logarithmic`: by its logarithm.

    `beyond`: it is a tension, searched over the law's range and this much more at both ends [N].
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    meaning: str
    logarithmic: bool = False
    beyond: float | None = None


@dataclass(frozen=True)
class Space:
    """A set of tunable parameters, as vectors and as points of the unit cube."""

    name: str
    description: str
    parameters: tuple[Parameter, ...]

    def vector(self, values: Mapping[str, float]) -> Values:
        """Return named values as the vector that `tensions` takes.

        Raises
        ------
        AmulettError
            If one is missing, unknown, or outside its range.
        """
        names = [parameter.name for parameter in self.parameters]
        for name in values:
            if name not in names:
                raise unknown(f"parameter of {self.name}", name, names)
        for parameter in self.parameters:
            value = values.get(parameter.name, math.nan)
            if not parameter.low <= value <= parameter.high:
                raise AmulettError(
                    f"{self.name}: '{parameter.name}' is {value} {parameter.unit}; it has to be from {parameter.low:g} "
                    f"to {parameter.high:g}"
                )
        return np.array([values[name] for name in names])

    def start(self) -> Values:
        """Return the vector of start values for a search."""
        return np.array([parameter.start for parameter in self.parameters])

    def from_unit(self, points: Values) -> Values:
        """Return parameters by points of the unit cube, shape (..., parameters)."""
        low, high, logarithmic = self._bounds()
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(logarithmic, high / low, 1.0)
        return np.clip(np.where(logarithmic, low * ratio**points, low + points * (high - low)), low, high)

    def to_unit(self, vectors: Values) -> Values:
        """Return points of the unit cube by parameters, shape (..., parameters)."""
        low, high, logarithmic = self._bounds()
        with np.errstate(divide="ignore", invalid="ignore"):
            by_logarithm = np.log(vectors / low) / np.log(high / low)
        return np.where(logarithmic, by_logarithm, (vectors - low) / (high - low))

    def _bounds(self) -> tuple[Values, Values, NDArray[np.bool_]]:
        low, high, logarithmic = zip(*((p.low, p.high, p.logarithmic) for p in self.parameters), strict=True)
        return np.array(low), np.array(high), np.array(logarithmic)


@dataclass(frozen=True)
class Law(Space):
    """A law with its parameters and its range of tensions [N]; the compiled `fill` computes those of a batch."""

    fill: Tensions
    range: tuple[float, float] = RANGE

    def over(self, tension_range: tuple[float, float]) -> Law:
        """Return this law over another range of tensions [N]."""
        low, high = tension_range
        parameters = tuple(
            parameter
            if parameter.beyond is None
            else replace(parameter, low=low - parameter.beyond, high=high + parameter.beyond)
            for parameter in self.parameters
        )
        return self if tension_range == self.range else replace(self, parameters=parameters, range=tension_range)

    def tensions(
        self, observations: NDArray[Any], vectors: Values, device: Device, setpoint_range: tuple[float, float]
    ) -> Values:
        """Return the tension setpoints of a batch [N], shape (N,), within the law's range.

        Parameters
        ----------
        observations : ndarray, shape (N, 13)
        vectors : ndarray, shape (N, parameters) or (1, parameters)
            Each row's own parameters, or those of all rows.
        device : Device
        setpoint_range : tuple of float
            Tension setpoints at -1 and 1 in the observation [N].
        """
        tensions = np.empty(len(observations))
        rows = np.asarray(observations, dtype=np.float64)
        constants, period = np.atleast_2d(device.constants), device.agent_period
        self.fill(rows, np.ascontiguousarray(vectors), constants, period, *setpoint_range, *self.range, tensions)
        return tensions


@dataclass(frozen=True)
class Device:
    """The nominal device, without a payload, as a law's constants, with the agent period [s].

    The constants, of shape (6,) or, one device for each observation, (N, 6), are R_2 [m], J [kg m2], and a [1/s],
    b [1/N], c and d [1/s] of the decay rate (`model.damping.decay_rate`).
    """

    constants: Values
    agent_period: float

    @classmethod
    def of(cls, profile: Profile, agent_period: float) -> Device:
        """Return the nominal device of a profile."""
        masses, damping = profile.plant.masses, profile.damping
        c = damping.b * damping.c if damping.fit == "shifted" else damping.c
        nominal = inertia([item.mass for item in masses], [item.arm for item in masses])
        constants = (profile.plant.joint_pulley_radius, nominal, damping.a, damping.b, c, damping.d)
        return cls(np.array(constants), agent_period)

    @classmethod
    def of_each(cls, profiles: Sequence[Profile], which: NDArray[np.int64], agent_period: float) -> Device:
        """Return the nominal devices of observations, of which each has one of the profiles, by their indices."""
        constants = np.array([cls.of(profile, agent_period).constants for profile in profiles])
        return cls(constants[which], agent_period)


@compiled
def _fill_constant(rows, vectors, device, period, low, high, least, most, tensions):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[0]):
        tensions[k] = vectors[k if vectors.shape[0] > 1 else 0, 0]


@compiled
def _fill_eq6(rows, vectors, device, period, low, high, least, most, tensions):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[0]):
        nominal, minimum, offset, exponent = vectors[k if vectors.shape[0] > 1 else 0]
        error = abs(rows[k, _ERROR_AT]) * _ERROR * 180.0 / math.pi
        tensions[k] = minimum + (nominal - minimum) * max(1.0 - error / offset, 0.0) ** exponent


@compiled
def _fill_parametric(rows, vectors, device, period, low, high, least, most, tensions):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[0]):
        p = vectors[k if vectors.shape[0] > 1 else 0]
        row = rows[k]
        error = row[_ERROR_AT] * _ERROR * 180.0 / math.pi
        rate = row[_RATE_AT] * _RATE
        own = device[k if device.shape[0] > 1 else 0]
        torque = _external_torque(own, row[_BICEPS_AT] * _FORCE, row[_TRICEPS_AT] * _FORCE, rate)
        far, way = _size(error / p[12]), math.tanh(error / p[12])
        rate_deg = rate * 180.0 / math.pi
        early = math.exp(-max(row[_TIME_AT], 0.0) * _TIME / p[14])
        wanted = (
            p[0]
            + p[1] * far
            + p[2] * way
            + p[3] * max(-row[_AGONIST_AT] * way, 0.0)
            + p[4] * _size(rate_deg / p[13])
            + p[5] * way * math.tanh(rate_deg / p[13])
            + p[6] * early
            + p[7] * early * far
            + p[8] * _size(torque / p[15])
            + p[9] * way * math.tanh(torque / p[15])
            + p[10] * row[_ANGLE_AT] * _ANGLE / (0.5 * math.pi)
            + p[11] * early * way
        )
        last = compiled_tension_of(row[_SETPOINT_AT], low, high)
        tensions[k] = _follow(last, _squash(wanted, least, most), p[16], p[17], period, least, most)


@compiled
def _size(x: float) -> float:
    """Return a smooth measure of a number's size, from 0 to 1."""
    return 1.0 - math.exp(-x * x)


@compiled
def _squash(wanted: float, least: float, most: float) -> float:
    """Limit a tension [N] smoothly to a range; in the middle 80 % of `RANGE` it changes by less than 0.1 N.

    It is ``m + h x / (1 + x^8)^(1/8)``, where m and h are the range's middle and half width.
    """
    middle, half = 0.5 * (least + most), 0.5 * (most - least)
    x = (wanted - middle) / half
    return middle + half * x / (1.0 + x**8) ** 0.125


@compiled
def _follow(
    last: float, wanted: float, rise_time: float, fall_time: float, period: float, least: float, most: float
) -> float:
    """Return the next tension [N] on the way from the last to the wanted one: a low-pass with two time constants."""
    last = min(max(last, least), most)
    time_constant = rise_time if wanted > last else fall_time
    return last + (wanted - last) * period / (time_constant + period)


@compiled
def _external_torque(device, biceps, triceps, rate):  # type: ignore[no-untyped-def]
    """Return the external torque [N m] by eq. 1 at constant speed, from force estimates [N] and rate [rad/s]."""
    radius, moment, a, b, c, d = device
    return 2.0 * decay_rate(0.5 * (biceps + triceps), a, b, c, d) * moment * rate - (biceps - triceps) * radius


def _gain(name: str, meaning: str) -> Parameter:
    return Parameter(name, "N", -11.0, 11.0, 0.0, meaning)


BEST_CONSTANT = Law(
    "constant",
    "a constant tension",
    (Parameter("tension", "N", *RANGE, 10.0, "the constant tension setpoint", beyond=0.0),),
    _fill_constant,
)

EQ6_TUNED = Law(
    "eq6-tuned",
    "eq. 6 with tuned parameters, from outside at agent rate",
    (
        Parameter("nominal_tension", "N", *RANGE, 10.0, "tension at no error; sigma", beyond=0.0),
        Parameter("minimum_tension", "N", *RANGE, 4.0, "tension from the offset on; sigma_min", beyond=0.0),
        Parameter(
            "error_offset", "deg", 2.0, 90.0, 30.0, "error from which the tension is the minimum; d_offset", True
        ),
        Parameter("exponent", "1", 0.5, 12.0, 4.0, "how the tension goes from one to the other; 4 in the paper", True),
    ),
    _fill_eq6,
)

PARAMETRIC = Law(
    "parametric",
    "a tuned law of error, velocity, direction, time since the setpoint moved and external torque",
    (
        Parameter(
            *("base", "N", 2.0, 17.0, 8.0, "tension of a resting arm on its setpoint, but for the torque's share"),
            beyond=2.0,
        ),
        _gain("error_gain", "g1, far from the setpoint"),
        _gain("direction_gain", "g2, in flexion; minus that in extension"),
        _gain("switch_gain", "g3, when the other drive will have to take over"),
        _gain("speed_gain", "g4, when moving"),
        _gain("approach_gain", "g5, when moving to the setpoint; minus that when moving away"),
        _gain("early_gain", "g6, when the setpoint has just begun to move"),
        _gain("early_error_gain", "g7, when it has and is far away"),
        _gain("torque_gain", "g8, under an external torque"),
        _gain("help_gain", "g9, when the torque pushes to the setpoint; minus that when it pushes away"),
        _gain("angle_gain", "g10, at 90 deg"),
        _gain("early_direction_gain", "g11, when the setpoint has just begun to move in flexion"),
        Parameter("error_width", "deg", 0.5, 60.0, 15.0, "error that counts as far", True),
        Parameter("speed_width", "deg/s", 3.0, 300.0, 60.0, "rate that counts as fast", True),
        Parameter("early_time", "s", 0.03, 2.0, 0.3, "time for which a move counts as recent", True),
        Parameter("torque_width", "N m", 0.01, 0.5, 0.1, "torque that counts as large", True),
        Parameter("rise_time", "s", 0.002, 2.0, 0.05, "time constant of a rising tension", True),
        Parameter("fall_time", "s", 0.002, 2.0, 0.05, "time constant of a falling tension", True),
    ),
    _fill_parametric,
)

LAWS = {law.name: law for law in (BEST_CONSTANT, EQ6_TUNED, PARAMETRIC)}


def tuned_names() -> dict[str, str]:
    """Return the tuned laws by name, each with a one-line description.

    ``<law>:<suite>`` has the parameters tuned on that suite, on the shipped device that the present one derives from;
    the law's name alone has those tuned on `DEFAULT_SUITE`. ``<law>:<fleet>`` has those tuned over a shipped fleet, on
    `DEFAULT_SUITE`, for any device.
    """
    fleets = fleet_names()
    on_devices = [(law, suite) for owner, law, suite in _shipped() if owner not in fleets]
    shipped = {law: LAWS[law].description for law, suite in on_devices if suite == DEFAULT_SUITE}
    names = {law: f"{description}; as {law}:{DEFAULT_SUITE}" for law, description in shipped.items()}
    names |= {f"{law}:{suite}": f"{law}, tuned on {suite}" for law, suite in on_devices}
    over = [(owner, law) for owner, law, _ in _shipped() if owner in fleets]
    return names | {f"{law}:{fleet}": f"{law}, tuned on {DEFAULT_SUITE} over the fleet {fleet}" for fleet, law in over}


def tuned_over(name: str) -> str:
    """Return the fleet over which a shipped law, by its name, was tuned; an empty string if on one device."""
    fleet = name.partition(":")[2]
    return fleet if name in tuned_names() and fleet in fleet_names() else ""


def is_tuned(name: str) -> bool:
    """Return whether a name is one of `tuned_names` or a JSON file, as a search writes it."""
    return is_tuned_file(name) or name in tuned_names()


def is_tuned_file(name: str) -> bool:
    """Return whether a name is that of a JSON file."""
    return name.lower().endswith(".json")


def tuned_vector(name: str, profile: Profile) -> tuple[Law, Values]:
    """Return a tuned law with its parameters, by a name of `tuned_names` or by a file (`read_tuned`)."""
    if is_tuned_file(name):
        return read_tuned(name)
    law_name, _, suite = name.partition(":")
    content = tuned_content(law_name, profile, suite or DEFAULT_SUITE)
    law = LAWS[law_name]
    return law, law.vector({key: entry["value"] for key, entry in content["parameters"].items()})


def read_tuned(path: str) -> tuple[Law, Values]:
    """Return a law with its parameters from a file of `amulett tune-law`; they can be used on any profile.

    Raises
    ------
    AmulettError
        If it cannot be read or is not such a file.
    """
    content = _tuned_file(path)
    if "co_contraction" in content.get("parameters", {}):
        raise AmulettError(f"'{path}' holds gains of a control loop, not a law; use the profile.yaml in its folder")
    try:
        law = LAWS[content["recipe"]["law"]]
        if content["recipe"].get("control") in LOOPS:
            law = law.over(FEED_FORWARD_RANGE)
        values = {key: float(entry["value"]) for key, entry in content["parameters"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise AmulettError(f"tuned law '{path}' is damaged: {type(error).__name__} {error}") from error
    return law, law.vector(values)


def tuned_loop(path: str) -> str:
    """Return the control loop in which a file's law was tuned.

    Raises
    ------
    AmulettError
        If it cannot be read or is not such a file.
    """
    recipe = _tuned_file(path).get("recipe")
    return str((recipe if isinstance(recipe, dict) else {}).get("control", "decentralized"))


def tuning_differs(path: str, profile: Profile, loop: str = "") -> str:
    """Return in which other loop, and on which other device or fleet, a file's law was tuned, as the end of a sentence.

    It is an empty string if the law was tuned in `loop`, on this device or over a fleet with it; an empty `loop` is
    that of the tuning.
    """
    recipe, in_loop = _tuned_file(path).get("recipe"), tuned_loop(path)
    device = _tuned_elsewhere(recipe if isinstance(recipe, dict) else {}, profile)
    differences = [device, f"in {in_loop}, not in {loop}" if loop not in ("", in_loop) else ""]
    return f"was tuned {', '.join(filter(None, differences))}" if any(differences) else ""


def _tuned_elsewhere(recipe: Mapping[str, Any], profile: Profile) -> str:
    """Return on which other device, or over which fleet without this one, a law was tuned."""
    there, fleet = recipe.get("profile"), recipe.get("fleet")
    try:
        if isinstance(fleet, str | list):
            return "" if profile in load_fleet(fleet) else f"over {in_words(fleet)}, not on the {profile.name}"
        tuned = load_profile(there if isinstance(there, str | dict) else "")
    except AmulettError:
        return f"on a device that cannot be read, not on the {profile.name}"
    other = "another version of the " if tuned.name == profile.name else "the "
    return "" if tuned == profile else f"on {other}{tuned.name}, not on the {profile.name}"


def _tuned_file(path: str) -> dict[str, Any]:
    content = read_json(path, "tuned law")
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise AmulettError(f"'{path}' is not a tuned law: its 'format' is not '{FORMAT}'")
    return content


def tuned_content(law: str, profile: Profile, suite: str) -> dict[str, Any]:
    """Return the shipped file of a tuned law: its parameters, and on what and how they were tuned.

    A profile that is based on a shipped one uses that one's parameters. The name of a fleet instead of a suite's stands
    for `DEFAULT_SUITE` over that fleet.

    Raises
    ------
    AmulettError
        If the law was not tuned for that device and suite.
    """
    shipped = _shipped()
    key = (suite, law, DEFAULT_SUITE) if suite in fleet_names() else (profile.root, law, suite)
    if key not in shipped:
        there = sorted(f"{law}:{there}" for device, of, there in shipped if (device, of) == (profile.root, law))
        raise AmulettError(
            f"{law} was not tuned on the suite '{suite}' of the device '{profile.root}'; "
            + (f"on this device there is {', '.join(there)}" if there else "on this device it was not tuned at all")
        )
    content: dict[str, Any] = json.loads(resources.files("amulett_gym").joinpath(*shipped[key]).read_text("utf-8"))
    return content


@cache
def _shipped() -> dict[tuple[str, str, str], tuple[str, ...]]:
    """Return the paths of the tuned laws in the package: (profile or fleet, law, suite) -> path."""
    found: dict[tuple[str, str, str], tuple[str, ...]] = {}
    folder = resources.files("amulett_gym").joinpath(*TUNED)
    for law in LAWS:
        for device in sorted(entry.name for entry in folder.iterdir() if entry.is_dir()) if folder.is_dir() else []:
            for file in sorted(entry.name for entry in folder.joinpath(device).iterdir()):
                if file.startswith(f"{law}-") and file.endswith(".json"):
                    suite = file.removeprefix(f"{law}-").removesuffix(".json")
                    found[device, law, suite] = (*TUNED, device, file)
    return found
