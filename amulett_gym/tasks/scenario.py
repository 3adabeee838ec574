"""A scenario: one episode as plain data.

A scenario can be written as JSON or YAML, read back and replayed bit for bit. Packed, times, torques, stiffnesses,
factors and sensor offsets keep 7 digits (see `simulation.layout`).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, model_validator

from amulett_gym.errors import AmulettError
from amulett_gym.profile import MOST_TENSION, Profile, WithOptions
from amulett_gym.settings import Group, describe, find_config
from amulett_gym.simulation.layout import (
    DEVICE_FACTORS,
    FAMILIES,
    LINEAR,
    MAX_MOVES,
    MAX_PUSHES,
    MINIMUM_JERK,
    ON_PATH,
    ORIENTATIONS,
    PATH,
    SCENARIO,
    STEPS,
    Family,
    Orientation,
    is_vertical,
    load_arm,
)
from amulett_gym.storage.reading import read_json, read_text, user_path
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.table import parse_columns
from amulett_gym.tasks.wearer import Wearer, pack_wearer, unpack_wearer

P = TypeVar("P", bound=Group)

MAX_BYTES = 20_000_000
"""Size of the largest scenario file accepted: some hundred thousand samples or moves."""
_MAX_TABLE_BYTES = 40_000_000

_DEFAULT_WEARER = Wearer()
_DIGITS = 9  # of angles in degrees: suites sample far coarser, so that packing loses nothing
_FIELDS = frozenset(SCENARIO.names or ())
_PACKING = 1e-6  # bound of the relative rounding error of packing
_NO_OBSTACLE = (
    "'obstacle' and 'wearer' are both given; an obstacle touches the forearm of a device that is not worn. Delete one, "
    "or let a tool push the wearer's hand by 'pushes'"
)


class Move(Group):
    """A move of the position setpoint: a step, or a minimum-jerk reach."""

    time: float = Field(ge=0, le=1e6, description="begin [s]; acts from the first control tick at or after it")
    angle_deg: float = Field(ge=-180, le=180, description="target [deg]")
    duration: float = Field(default=0.0, ge=0, le=1e6, description="[s], at least a millisecond; 0: a step")

    @model_validator(mode="after")
    def _check_duration(self) -> Move:
        if 0 < self.duration < 1e-3:
            raise ValueError(f"a duration of {self.duration} s is shorter than a millisecond; 0 is a step")
        return self


class Setpoint(Group):
    """A sampled position setpoint instead of moves, such as a logged one; it counts no setpoint steps.

    Before its first sample the setpoint is the initial angle, after its last one that sample. Two samples of one time
    are a jump. In a scenario file ``{"file": "log.csv", "column": ...}`` reads it from a CSV file (`SetpointFile`).
    """

    time: list[float] = Field(min_length=1, description="rising times of the samples [s]")
    angle_deg: list[float] = Field(description="samples [deg], to nine decimals")
    interpolation: Literal["linear", "hold"] = Field(
        default="linear", description="between two samples: a straight line, or the first one"
    )

    @model_validator(mode="after")
    def _check_samples(self, info: ValidationInfo) -> Setpoint:
        rows: list[int] | None = info.context and info.context.get("rows")

        def place(k: int) -> str:
            return f"sample {k}" if rows is None else f"row {rows[k]}"

        time, angle = np.array(self.time), np.array(self.angle_deg)
        if time.size != angle.size:
            raise ValueError(f"time has {time.size} samples and angle_deg {angle.size}; they have to be equally many")
        for name, values, low, high in (("time", time, 0.0, 1e6), ("angle_deg", angle, -180.0, 180.0)):
            wrong = (values < low) | (values > high)
            if wrong.any():
                sample = int(np.argmax(wrong))
                raise ValueError(f"{name} of {place(sample)} is {values[sample]}; it has to be {low:g} to {high:g}")
        if (np.diff(time) < 0.0).any():
            sample = int(np.argmax(np.diff(time) < 0.0))
            raise ValueError(f"time falls from {time[sample]} to {time[sample + 1]} s after {place(sample)}")
        object.__setattr__(self, "angle_deg", [round(value, _DIGITS) for value in self.angle_deg])
        return self


class SetpointFile(Group):
    """A CSV file with a scenario's sampled setpoint."""

    file: str = Field(description="CSV file with a header, relative to the scenario's file")
    column: str = Field(description="column of the setpoint")
    unit: Literal["deg", "rad"] = Field(default="deg", description="unit of that column")
    time_column: str = Field(default="time", description="column of the time")
    time_unit: Literal["s", "ms"] = Field(default="s", description="unit of that column")
    begin: float | None = Field(default=None, ge=0, le=1e6, description="time of the first sample [s]; null: its own")
    interpolation: Literal["linear", "hold"] = Field(default="linear", description="as of `Setpoint`")

    def read(self, folder: Path) -> tuple[dict[str, Any], list[int]]:
        """Return the samples, which are the content of a `Setpoint`, and their rows in the file."""
        names, path = [self.time_column, self.column], folder / user_path(self.file)
        text = read_text(path, "setpoint", _MAX_TABLE_BYTES)
        columns, rows = parse_columns(text, f"setpoint '{path}'", names)
        time, angle = map(np.array, columns)
        if not time.size:
            raise AmulettError(f"setpoint '{path}' has no samples")
        time = time * (1e-3 if self.time_unit == "ms" else 1.0)
        if self.begin is not None:
            time = time - time[0] + self.begin
        angle = np.degrees(angle) if self.unit == "rad" else angle
        return {"time": time.tolist(), "angle_deg": angle.tolist(), "interpolation": self.interpolation}, rows


class Wave(Group):
    """A sinusoid or a linear chirp added to the moves: A sin(2 pi (f + chirp t / 2) t), t from its begin.

    Rise and settling times refer to the moves' targets, without it. After whole cycles it ends without a jump.
    """

    amplitude_deg: float = Field(gt=0, le=180, description="A [deg]")
    frequency: float = Field(ge=0, le=50, description="f, frequency at the begin [Hz]")
    chirp: float = Field(default=0.0, ge=-50, le=50, description="rate of change of the frequency [Hz/s]")
    time: float = Field(default=0.0, ge=0, le=1e6, description="begin [s]")
    duration: float = Field(ge=1e-3, le=1e6, description="[s], at least a millisecond")


class Push(Group):
    """An external torque of limited duration: a pulse, or with ramps (a slow push)."""

    time: float = Field(ge=0, le=1e6, description="begin [s]; acts from the first control tick at or after it")
    duration: float = Field(ge=1e-3, le=1e6, description="[s], ramps included, at least a millisecond")
    torque: float = Field(ge=-100, le=100, description="positive in flexion [N m]")
    rise: float = Field(default=0.0, ge=0, le=1e6, description="duration of each ramp, up and down [s]; 0: a pulse")

    @model_validator(mode="after")
    def _check_ramps(self) -> Push:
        if 0 < self.rise < 1e-3:
            raise ValueError(f"a rise of {self.rise} s is shorter than a millisecond; 0 is a pulse")
        if 2 * self.rise > self.duration * (1.0 + _PACKING):
            raise ValueError(f"a push of {self.duration} s has no room to rise and fall for {self.rise} s each")
        return self


class Shake(Group):
    """A random external torque: white noise per control tick through two equal first-order low-passes.

    It begins at zero and has its rms after about one period of the bandwidth; scenarios with the same `noise_seed` have
    the same torque.
    """

    rms: float = Field(gt=0, le=100, description="root mean square [N m]")
    bandwidth: float = Field(gt=0, le=100, description="corner frequency of each low-pass [Hz]")
    time: float = Field(default=0.0, ge=0, le=1e6, description="begin [s]")
    duration: float = Field(ge=1e-3, le=1e6, description="[s], at least a millisecond")


class Obstacle(Group):
    """A compliant obstacle in the path of the forearm."""

    angle_deg: float = Field(ge=-180, le=180, description="joint angle of its surface [deg]")
    blocks: Literal["flexion", "extension"] = Field(default="flexion", description="motion that it blocks")
    stiffness: float = Field(gt=0, le=10_000, description="[N m/rad]")
    damping: float = Field(default=0.0, ge=0, le=100, description="[N m s/rad]")


class Payload(Group):
    """A point mass carried by the forearm."""

    mass: float = Field(ge=0, le=20, description="[kg]")
    arm: float = Field(ge=0, le=1, description="lever arm about the joint [m]")


class Device(Group):
    """Deviations of this device from its profile; its microcontroller knows the profile only."""

    name: str | None = Field(
        default=None, min_length=1, max_length=200, description="profile, one of a fleet; null: the environment's"
    )
    spring_biceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the spring's force [1]")
    spring_triceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the spring's force [1]")
    pulley_biceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the drive pulley's radius R_1 [1]")
    pulley_triceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the drive pulley's radius R_1 [1]")
    inertia: float = Field(default=1.0, ge=0.5, le=2, description="factor of J, the payload's share included [1]")
    damping: float = Field(default=1.0, ge=0, le=4, description="factor of delta [1]")
    noise: float = Field(default=1.0, ge=0, le=10, description="factor of the sensors' noise [1]")
    encoder_bias_deg: float = Field(default=0.0, ge=-30, le=30, description="error of the joint angle's reading [deg]")
    slider_bias_biceps: float = Field(default=0.0, ge=-0.01, le=0.01, description="error of the potentiometer [m]")
    slider_bias_triceps: float = Field(default=0.0, ge=-0.01, le=0.01, description="error of the potentiometer [m]")
    late_probability: float = Field(
        default=0.0, ge=0, le=0.9, description="probability that a control tick is missed: commands are held [1]"
    )

    @model_validator(mode="before")
    @classmethod
    def _accept_old_name(cls, content: Any) -> Any:
        if not isinstance(content, Mapping) or "jitter" not in content:
            return content
        if "late_probability" in content:
            raise ValueError("'jitter' is the old name of 'late_probability'; give one of them")
        warnings.warn("the scenario key 'device.jitter' is now 'late_probability'", DeprecationWarning, stacklevel=2)
        return {"late_probability" if key == "jitter" else key: value for key, value in content.items()}

    @property
    def jitter(self) -> float:
        """Deprecated name of `late_probability`."""
        warnings.warn("Device.jitter is now late_probability", DeprecationWarning, stacklevel=2)
        return self.late_probability


class Scenario(WithOptions):
    """Everything about an episode except for the profile."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("wearer",)

    initial_angle_deg: float = Field(default=0.0, ge=-180, le=180, description="initial angle, at rest [deg]")
    initial_tension: float | None = Field(
        default=None, gt=0, le=MOST_TENSION, description="of the antagonist [N]; null: the profile's nominal tension"
    )
    moves: list[Move] = Field(default=[], description="moves of the setpoint, in their order")
    setpoint: Setpoint | None = Field(
        default=None,
        description="samples to follow instead of moves; the first one is the initial angle if none is given",
    )
    wave: Wave | None = Field(default=None, description="added to the moves; null: none")
    pushes: list[Push] = Field(default=[], max_length=MAX_PUSHES, description="external torques")
    shake: Shake | None = Field(default=None, description="random external torque; null: none")
    obstacle: Obstacle | None = Field(default=None, description="obstacle in the forearm's path; null: none")
    payload: Payload | None = Field(default=None, description="carried by the forearm; null: none")
    orientation: Orientation = Field(
        default="profile", description="plane in which the forearm swings; gravity acts in the vertical one"
    )
    wearer: Wearer | None = Field(
        default=None,
        description="who wears the device, in Amulett/Worn-v0 only: what the moves say is then intended by the wearer, "
        "and pushes act on the hand, in which the payload is; null: the environment's choice",
    )
    device: Device = Field(default=Device(), description="deviations from the profile; without a key: none")
    measure_from: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        description="begin of metrics, rewards and setpoint steps [s]; before, the arm settles",
    )
    family: Family | None = Field(
        default=None,
        description="suite by whose weights and divisors the reward is scaled; null: contact if there is an obstacle, "
        "else that of the environment",
    )
    noise_seed: int | None = Field(
        default=None, ge=0, lt=2**64, description="key of the sensor noise [1]; null: drawn by the environment"
    )

    @model_validator(mode="after")
    def _check_order(self) -> Scenario:
        for before, after in zip(self.moves, self.moves[1:], strict=False):
            if after.time < (before.time + before.duration) * (1.0 - _PACKING):
                raise ValueError(
                    f"the move at {after.time} s begins before the one at {before.time} s has ended, "
                    f"{before.time + before.duration} s"
                )
        if self.setpoint is not None:
            if self.moves:
                raise ValueError("'moves' and 'setpoint' are both given; give one of them")
            if "initial_angle_deg" not in self.model_fields_set:
                object.__setattr__(self, "initial_angle_deg", self.setpoint.angle_deg[0])
        if self.wearer is not None and self.obstacle is not None:
            raise ValueError(_NO_OBSTACLE)
        return self

    @property
    def has_path(self) -> bool:
        """Whether the setpoint needs a path outside the packed record: it has samples, or too many moves."""
        return self.setpoint is not None or len(self.moves) > MAX_MOVES


def load_scenario(scenario: str | Path | Mapping[str, Any] | Scenario) -> Scenario:
    """Return a validated scenario from a JSON or YAML file (by its suffix), a mapping or a scenario.

    Raises
    ------
    AmulettError
        If the file cannot be read or a key or value is wrong.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if isinstance(scenario, str | Path):
        path = find_config(scenario, "scenario")
        return parse_scenario(_read(path), path.parent, f"scenario '{scenario}'")
    return parse_scenario(scenario, Path(), "scenario")


def parse_scenario(content: Any, folder: Path, what: str) -> Scenario:
    """Return the validated scenario in a mapping; errors as of `load_scenario`.

    `what` names it in errors; the path of a setpoint's file is relative to `folder`.
    """
    rows = None
    try:
        setpoint = content.get("setpoint") if isinstance(content, Mapping) else None
        if isinstance(content, Mapping) and isinstance(setpoint, Mapping) and "file" in setpoint:
            samples, rows = _read_samples(setpoint, folder, what)
            content = {**content, "setpoint": samples}
        return Scenario.model_validate(content, context={"rows": rows})
    except ValidationError as error:
        raise describe(error, Scenario, what) from error


def _read_samples(setpoint: Mapping[str, Any], folder: Path, what: str) -> tuple[dict[str, Any], list[int]]:
    try:
        return SetpointFile.model_validate(setpoint).read(folder)
    except ValidationError as error:
        raise describe(error, SetpointFile, f"{what}: setpoint") from error


def _read(path: Path) -> Any:
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return read_yaml(path, "scenario")
    if suffix != ".json":
        raise AmulettError(f"scenario '{path}' has to end in .json, .yaml or .yml")
    return read_json(path, "scenario", MAX_BYTES)


def pack(scenario: Scenario, profile: Profile) -> NDArray[np.void]:
    """Return a scenario as the record that the simulation reads, in SI units and radians; see also `pack_path`.

    Returns
    -------
    ndarray of `simulation.layout.SCENARIO`, shape (1,)

    Raises
    ------
    AmulettError
        If the initial angle is beyond the profile's limit, the obstacle is too stiff for the integration step, the
        scenario names another profile, or it has a wearer (`pack_worn`).
    """
    if scenario.wearer is not None:
        raise AmulettError(
            "scenario: 'wearer' is given, and this device is not worn. Play the scenario in 'Amulett/Worn-v0', or "
            "delete the wearer"
        )
    if scenario.device.name not in (None, profile.name):
        raise AmulettError(
            f"scenario: 'device.name' is '{scenario.device.name}'; this device is '{profile.name}'. Delete the name to "
            "play it on another device, or make an environment with a fleet"
        )
    limit = profile.plant.angle_limit_deg
    if abs(scenario.initial_angle_deg) >= limit:
        raise AmulettError(
            f"scenario: 'initial_angle_deg' is {scenario.initial_angle_deg}; the device's limit is +-{limit} deg"
        )
    row = empty_rows(1, profile)
    row["initial_angle"], row["measure_from"] = np.radians(scenario.initial_angle_deg), scenario.measure_from
    if scenario.initial_tension is not None:
        row["initial_tension"] = scenario.initial_tension
    if scenario.noise_seed is not None:
        row["noise_key"] = scenario.noise_seed
    row["orientation"] = ORIENTATIONS.index(scenario.orientation)
    row["family"] = FAMILIES.index(scenario.family or ("contact" if scenario.obstacle is not None else None))
    for prefix in ("wave", "shake", "obstacle", "payload"):
        if (part := getattr(scenario, prefix)) is not None:
            _put(row, f"{prefix}_", part)
    _put(row, "", scenario.device)
    load_arm(row, profile)
    row["move_count"] = ON_PATH if scenario.has_path else len(scenario.moves)
    for k, move in enumerate([] if scenario.has_path else scenario.moves):
        _put(row, "move_", move, k)
    row["push_count"] = len(scenario.pushes)
    for k, push in enumerate(scenario.pushes):
        _put(row, "push_", push, k)
        row["push_inverse_rise"][0, k] = 1.0 / push.rise if push.rise > 0.0 else 0.0
    if scenario.obstacle is not None:
        row["obstacle_side"] = 1.0 if scenario.obstacle.blocks == "flexion" else -1.0
        _check_stiffness(scenario.obstacle, float(row["inertia"][0]), profile)
    return row


def pack_worn(
    scenario: Scenario, profile: Profile, wearer: Wearer = _DEFAULT_WEARER
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return a scenario and its wearer as the records that `simulation.worn_batch.WornSimulation` reads.

    Parameters
    ----------
    scenario : Scenario
    profile : Profile
    wearer : Wearer
        Who wears the device if the scenario names no wearer.

    Returns
    -------
    row : ndarray of `simulation.layout.SCENARIO`, shape (1,)
        As of `pack`, but its payload does not load the device: it is in the wearer's hand.
    person : ndarray of `simulation.worn_layout.PERSON`, shape (1,)

    Raises
    ------
    AmulettError
        As of `pack`, if there is an obstacle, or the wearer's delay has too many control ticks.
    """
    if scenario.obstacle is not None:
        raise AmulettError(f"scenario: {_NO_OBSTACLE}")
    row = pack(scenario.model_copy(update={"wearer": None, "payload": None}), profile)
    payload = scenario.payload or Payload(mass=0.0, arm=0.0)
    _put(row, "payload_", payload)
    person = pack_wearer(
        scenario.wearer or wearer,
        profile.loop.control_period,
        bool(is_vertical(row, profile)[0]),
        payload.mass,
        payload.arm,
    )
    return row, person


def unpack_worn(
    row: NDArray[np.void] | np.void,
    person: NDArray[np.void] | np.void,
    profile: Profile,
    path: NDArray[np.void] | None = None,
) -> Scenario:
    """Return the scenario of `pack_worn`'s records; packing it again gives the same bits. Errors as of `unpack`."""
    return unpack(row, path).model_copy(update={"wearer": unpack_wearer(person, profile.loop.control_period)})


def pack_path(scenario: Scenario) -> NDArray[np.void]:
    """Return the setpoint's path (records of `simulation.layout.PATH`), empty if it fits into the packed record."""
    if not scenario.has_path:
        return np.zeros(0, dtype=PATH)
    setpoint = scenario.setpoint
    if setpoint is None:
        times, angles = [move.time for move in scenario.moves], [move.angle_deg for move in scenario.moves]
        durations, shape = [move.duration for move in scenario.moves], MINIMUM_JERK
    else:
        times, angles = setpoint.time, setpoint.angle_deg
        durations, shape = [0.0] * len(times), STEPS
        if setpoint.interpolation == "linear":  # a jump to the first sample, a part to each other one, a last one
            durations, shape = [0.0, *np.diff(times), 0.0], LINEAR
            times, angles = [times[0], *times], [*angles, angles[-1]]
    path = np.zeros(len(times), dtype=PATH)
    path["time"], path["angle"], path["duration"], path["shape"] = times, np.radians(angles), durations, shape
    path["start"] = np.append(np.radians(scenario.initial_angle_deg), path["angle"][:-1])
    return path


def _unpack_path(path: NDArray[np.void]) -> dict[str, Any]:
    angles = [round(angle, _DIGITS) for angle in np.degrees(path["angle"]).tolist()]
    if path["shape"][0] == MINIMUM_JERK:
        columns = (path["time"].tolist(), angles, path["duration"].tolist())
        return {"moves": [Move(time=t, angle_deg=a, duration=d) for t, a, d in zip(*columns, strict=True)]}
    if path["shape"][0] == LINEAR:
        return {"setpoint": Setpoint(time=path["time"][1:].tolist(), angle_deg=angles[:-1])}
    return {"setpoint": Setpoint(time=path["time"].tolist(), angle_deg=angles, interpolation="hold")}


def unpack(row: NDArray[np.void] | np.void, path: NDArray[np.void] | None = None) -> Scenario:
    """Return the scenario of a packed record and its path, if it has one; packing it again gives the same bits.

    Raises
    ------
    AmulettError
        If the record has a path and it is not given.
    """
    if row["move_count"] == ON_PATH and (path is None or not path.size):
        raise AmulettError("the scenario's setpoint is a path outside its record; unpack needs both")

    path_or_moves = {} if path is None or not path.size else _unpack_path(path)
    moves = [_take(row, "move_", Move, k) for k in range(int(row["move_count"]))]
    pushes = [
        _take(row, "push_", Push, k, rise=_rise(row["push_inverse_rise"][k])) for k in range(int(row["push_count"]))
    ]
    blocks = "flexion" if row["obstacle_side"] > 0 else "extension"
    return _take(
        row,
        "",
        Scenario,
        **(path_or_moves or {"moves": moves}),
        pushes=pushes,
        wave=_take(row, "wave_", Wave) if row["wave_amplitude"] > 0 else None,
        shake=_take(row, "shake_", Shake) if row["shake_rms"] > 0 else None,
        obstacle=_take(row, "obstacle_", Obstacle, blocks=blocks) if row["obstacle_stiffness"] > 0 else None,
        payload=_take(row, "payload_", Payload) if row["payload_mass"] > 0 else None,
        orientation=ORIENTATIONS[int(row["orientation"])],
        device=_take(row, "", Device),
        family=FAMILIES[int(row["family"])],
        noise_seed=int(row["noise_key"]),
    )


def _field(prefix: str, key: str) -> str:
    """Return the packed record's field of a key of a scenario's part; not every key has one."""
    return f"{key}_factor" if key in DEVICE_FACTORS and not prefix else prefix + key.removesuffix("_deg")


def _put(row: NDArray[np.void], prefix: str, part: Group, *index: int) -> None:
    """Pack the keys of a part that have a field."""
    for key, value in part:
        if (field := _field(prefix, key)) in _FIELDS:
            row[field][0, *index] = np.radians(value) if key.endswith("_deg") else value


def _take(row: NDArray[np.void] | np.void, prefix: str, part: type[P], *index: int, **others: Any) -> P:
    """Return a part of a packed scenario, with those of its keys that the record does not hold as they are."""
    for key in part.model_fields:
        if key not in others and (field := _field(prefix, key)) in _FIELDS:
            value = row[field][index]
            # The shortest decimal that is packed to the same bits.
            others[key] = round(float(np.degrees(value)), _DIGITS) if key.endswith("_deg") else float(str(value))
    return part(**others)


def _rise(inverse: np.float32) -> float:
    """Return the ramp's duration [s] with the fewest digits that is packed as this inverse [1/s]; 0: a pulse."""
    if inverse == 0.0:
        return 0.0
    rises = (float(f"{1.0 / float(inverse):.{digits}g}") for digits in range(1, 18))
    return next(rise for rise in rises if np.float32(1.0 / rise) == inverse)


def _check_stiffness(obstacle: Obstacle, inertia: float, profile: Profile) -> None:
    """Refuse an obstacle that the integration step cannot resolve."""
    for key, value, most in (
        ("stiffness", obstacle.stiffness, most_stiffness(inertia, profile)),
        ("damping", obstacle.damping, most_damping(inertia, profile)),
    ):
        if value > most * (1.0 + _PACKING):
            step = profile.loop.control_period / profile.loop.substeps
            raise AmulettError(
                f"scenario: 'obstacle.{key}' is {value}; with an inertia of {inertia:.4g} kg m2 and {step:g} s steps "
                f"at most {most:.4g} is possible (more loop.substeps allow more)"
            )


def most_stiffness(inertia: Any, profile: Profile) -> Any:
    """Return the largest stiffness of an obstacle [N m/rad] for an inertia [kg m2].

    An integration step then covers half a radian of the oscillation on the obstacle.
    """
    return 0.25 * inertia / (profile.loop.control_period / profile.loop.substeps) ** 2


def most_damping(inertia: Any, profile: Profile) -> Any:
    """Return the largest damping of an obstacle [N m s/rad] for an inertia [kg m2].

    An integration step is then a tenth of its time constant: damping makes the torque jump at contact, within a step.
    """
    return 0.1 * inertia / (profile.loop.control_period / profile.loop.substeps)


def empty_rows(count: int, profile: Profile) -> NDArray[np.void]:
    """Return `count` packed scenarios without events: the bare arm at rest at 0 deg."""
    rows = np.zeros(count, dtype=SCENARIO)
    rows["initial_tension"] = profile.variable_stiffness.nominal_tension
    for name in DEVICE_FACTORS:
        rows[f"{name}_factor"] = 1.0
    load_arm(rows, profile)
    return rows
