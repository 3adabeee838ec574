"""One episode as plain data: what the setpoint does, what disturbs and loads the arm, how this device was built.

A scenario can be written as JSON or YAML, read back and replayed bit for bit. Packed, times, torques, stiffnesses,
factors and sensor offsets keep 7 digits (see `simulation.layout`).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from amulett_gym.errors import AmulettError
from amulett_gym.profile import MOST_TENSION, Profile
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
    load_arm,
)
from amulett_gym.storage.reading import read_json, read_text, user_path
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.table import parse_columns

MAX_BYTES = 20_000_000
"""Largest scenario file accepted, some hundred thousand samples or moves."""

_MAX_TABLE_BYTES = 40_000_000

_DIGITS = 9  # of angles in degrees: suites sample far coarser, so that packing loses nothing
_PACKING = 1e-6  # more than the share by which packing changes a number


class Move(Group):
    """A move of the position setpoint: a step, or a minimum-jerk reach."""

    time: float = Field(ge=0, le=1e6, description="when it begins [s]; acts from the first control tick at or after it")
    angle_deg: float = Field(ge=-180, le=180, description="where it goes [deg]")
    duration: float = Field(default=0.0, ge=0, le=1e6, description="[s], at least a millisecond; 0: a step")

    @model_validator(mode="after")
    def _check_duration(self) -> Move:
        if 0 < self.duration < 1e-3:
            raise ValueError(f"a duration of {self.duration} s is shorter than a millisecond; 0 stands for a step")
        return self


class Setpoint(Group):
    """A sampled position setpoint instead of moves, such as a logged one; it counts no setpoint steps.

    Before its first sample the arm rests at the initial angle, after its last one there. Two samples of one time are a
    jump. In a scenario file ``{"file": "log.csv", "column": ...}`` reads it from a CSV file (see `SetpointFile`).
    """

    time: list[float] = Field(min_length=1, description="of the samples, rising [s]")
    angle_deg: list[float] = Field(description="at these times [deg], to nine decimals")
    interpolation: Literal["linear", "hold"] = Field(
        default="linear", description="between two samples: straight from one to the next, or the first one until then"
    )

    @model_validator(mode="after")
    def _check_samples(self) -> Setpoint:
        time, angle = np.array(self.time), np.array(self.angle_deg)
        if time.size != angle.size:
            raise ValueError(f"time has {time.size} samples and angle_deg {angle.size}; they have to be as many")
        for name, values, low, high in (("time", time, 0.0, 1e6), ("angle_deg", angle, -180.0, 180.0)):
            wrong = (values < low) | (values > high)
            if wrong.any():
                sample = int(np.argmax(wrong))
                raise ValueError(f"{name} of sample {sample} is {values[sample]}; it has to be {low:g} to {high:g}")
        if (np.diff(time) < 0.0).any():
            sample = int(np.argmax(np.diff(time) < 0.0))
            raise ValueError(f"time falls from {time[sample]} to {time[sample + 1]} s after sample {sample}")
        object.__setattr__(self, "angle_deg", [round(value, _DIGITS) for value in self.angle_deg])
        return self


class SetpointFile(Group):
    """Where a scenario's sampled setpoint is read from."""

    file: str = Field(description="CSV file with a header, relative to the scenario's file")
    column: str = Field(description="of the setpoint")
    unit: Literal["deg", "rad"] = Field(default="deg", description="of that column")
    time_column: str = Field(default="time", description="of the time")
    time_unit: Literal["s", "ms"] = Field(default="s", description="of that column")
    begin: float | None = Field(
        default=None, ge=0, le=1e6, description="when the first sample is played [s]; null: at its own time"
    )
    interpolation: Literal["linear", "hold"] = Field(default="linear", description="as of `Setpoint`")

    def read(self, folder: Path) -> dict[str, Any]:
        """Return the samples: the content of a `Setpoint`."""
        names, path = [self.time_column, self.column], folder / user_path(self.file)
        text = read_text(path, "setpoint", _MAX_TABLE_BYTES)
        time, angle = map(np.array, parse_columns(text, f"setpoint '{path}'", names))
        if not time.size:
            raise AmulettError(f"setpoint '{path}' has no samples")
        time = time * (1e-3 if self.time_unit == "ms" else 1.0)
        if self.begin is not None:
            time = time - time[0] + self.begin
        angle = np.degrees(angle) if self.unit == "rad" else angle
        return {"time": time.tolist(), "angle_deg": angle.tolist(), "interpolation": self.interpolation}


class Wave(Group):
    """A sinusoid or a linear chirp on top of the moves: A sin(2 pi (f + chirp t / 2) t), t from its beginning.

    Rise and settling times are judged by the moves' targets, without it. After whole cycles it ends without a jump.
    """

    amplitude_deg: float = Field(gt=0, le=180, description="A [deg]")
    frequency: float = Field(ge=0, le=50, description="f, at its beginning [Hz]")
    chirp: float = Field(default=0.0, ge=-50, le=50, description="by which the frequency changes a second [Hz/s]")
    time: float = Field(default=0.0, ge=0, le=1e6, description="when it begins [s]")
    duration: float = Field(ge=1e-3, le=1e6, description="[s], at least a millisecond")


class Push(Group):
    """An external torque for a while: at once (a pulse), or with ramps (a slow push)."""

    time: float = Field(ge=0, le=1e6, description="when it begins [s]; acts from the first control tick at or after it")
    duration: float = Field(ge=1e-3, le=1e6, description="ramps included [s], at least a millisecond")
    torque: float = Field(ge=-100, le=100, description="positive in flexion [N m]")
    rise: float = Field(
        default=0.0, ge=0, le=1e6, description="how long it rises, and falls again at its end [s]; 0: a pulse"
    )

    @model_validator(mode="after")
    def _check_ramps(self) -> Push:
        if 0 < self.rise < 1e-3:
            raise ValueError(f"a rise of {self.rise} s is shorter than a millisecond; 0 stands for a pulse")
        if 2 * self.rise > self.duration * (1.0 + _PACKING):
            raise ValueError(f"a push of {self.duration} s has no room to rise and fall for {self.rise} s each")
        return self


class Shake(Group):
    """A random external torque: white noise of the control ticks behind two equal first-order low-passes.

    It begins at rest and has its rms from about one period of the bandwidth on; two scenarios with one `noise_seed`
    are shaken alike.
    """

    rms: float = Field(gt=0, le=100, description="root mean square [N m]")
    bandwidth: float = Field(gt=0, le=100, description="corner frequency of each low-pass [Hz]")
    time: float = Field(default=0.0, ge=0, le=1e6, description="when it begins [s]")
    duration: float = Field(ge=1e-3, le=1e6, description="[s], at least a millisecond")


class Obstacle(Group):
    """Something compliant in the way of the forearm."""

    angle_deg: float = Field(ge=-180, le=180, description="where it begins [deg]")
    blocks: Literal["flexion", "extension"] = Field(default="flexion", description="the motion that meets it")
    stiffness: float = Field(gt=0, le=10_000, description="[N m/rad]")
    damping: float = Field(default=0.0, ge=0, le=100, description="[N m s/rad]")


class Payload(Group):
    """A point mass carried by the forearm."""

    mass: float = Field(ge=0, le=20, description="[kg]")
    arm: float = Field(ge=0, le=1, description="lever arm about the joint [m]")


class Device(Group):
    """How this device differs from its profile, which is all that its microcontroller knows."""

    spring_biceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the spring's force [1]")
    spring_triceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the spring's force [1]")
    pulley_biceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the drive pulley's radius R_1 [1]")
    pulley_triceps: float = Field(default=1.0, ge=0.5, le=2, description="factor of the drive pulley's radius R_1 [1]")
    inertia: float = Field(default=1.0, ge=0.5, le=2, description="factor of J, the payload's share included [1]")
    damping: float = Field(default=1.0, ge=0, le=4, description="factor of delta [1]")
    noise: float = Field(default=1.0, ge=0, le=10, description="factor of the sensors' noise [1]")
    encoder_bias_deg: float = Field(default=0.0, ge=-30, le=30, description="added to the joint angle's reading [deg]")
    slider_bias_biceps: float = Field(default=0.0, ge=-0.01, le=0.01, description="added to the potentiometer's [m]")
    slider_bias_triceps: float = Field(default=0.0, ge=-0.01, le=0.01, description="added to the potentiometer's [m]")
    late_probability: float = Field(
        default=0.0,
        ge=0,
        le=0.9,
        description="probability that a control tick comes too late: its commands are held for one more period [1]",
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


class Scenario(Group):
    """Everything about an episode that is not the profile."""

    initial_angle_deg: float = Field(default=0.0, ge=-180, le=180, description="at rest there at the start [deg]")
    initial_tension: float | None = Field(
        default=None,
        gt=0,
        le=MOST_TENSION,
        description="of the antagonist at the start [N]; null: the profile's nominal tension",
    )
    moves: list[Move] = Field(default=[], description="of the setpoint, in their order")
    setpoint: Setpoint | None = Field(
        default=None, description="samples to follow instead of moves; without an initial angle, the first one is it"
    )
    wave: Wave | None = Field(default=None, description="on top of the moves; null: none")
    pushes: list[Push] = Field(default=[], max_length=MAX_PUSHES, description="from outside")
    shake: Shake | None = Field(default=None, description="a random torque; null: none")
    obstacle: Obstacle | None = Field(default=None, description="in the forearm's way; null: none")
    payload: Payload | None = Field(default=None, description="that the forearm carries; null: none")
    orientation: Orientation = Field(
        default="profile", description="plane in which the forearm swings; gravity acts in the vertical one"
    )
    device: Device = Field(default=Device(), description="how it differs from the profile; without a key: not at all")
    measure_from: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        description="metrics, rewards and setpoint steps count from here [s]; before, the arm settles",
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
                raise ValueError("'moves' and 'setpoint' are both there; give one of them")
            if "initial_angle_deg" not in self.model_fields_set:
                object.__setattr__(self, "initial_angle_deg", self.setpoint.angle_deg[0])
        return self

    @property
    def has_path(self) -> bool:
        """Whether the setpoint takes a path beside the packed record: samples, or more moves than fit into it."""
        return self.setpoint is not None or len(self.moves) > MAX_MOVES


def load_scenario(scenario: str | Path | Mapping[str, Any] | Scenario) -> Scenario:
    """Read and validate a scenario from a JSON or YAML file (by its suffix), a mapping, or as it is.

    Raises
    ------
    AmulettError
        If the file cannot be read or a key or value is wrong.
    """
    if isinstance(scenario, Scenario):
        return scenario
    what, folder, content = "scenario", Path(), scenario
    if isinstance(scenario, str | Path):
        path = find_config(scenario, "scenario")
        what, folder, content = f"scenario '{scenario}'", path.parent, _read(path)
    try:
        setpoint = content.get("setpoint") if isinstance(content, Mapping) else None
        if isinstance(content, Mapping) and isinstance(setpoint, Mapping) and "file" in setpoint:
            content = {**content, "setpoint": _read_samples(setpoint, folder, what)}
        return Scenario.model_validate(content)
    except ValidationError as error:
        raise describe(error, Scenario, what) from error


def _read_samples(setpoint: Mapping[str, Any], folder: Path, what: str) -> dict[str, Any]:
    try:
        return SetpointFile.model_validate(setpoint).read(folder)
    except ValidationError as error:
        raise describe(error, SetpointFile, f"{what}: setpoint") from error


def _read(path: Path) -> Any:
    """Return the content of a scenario file."""
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return read_yaml(path, "scenario")
    if suffix != ".json":
        raise AmulettError(f"scenario '{path}' has to end in .json, .yaml or .yml")
    return read_json(path, "scenario", MAX_BYTES)


def pack(scenario: Scenario, profile: Profile) -> NDArray[np.void]:
    """Turn a scenario into the record that the simulation reads, in SI units and radians; `pack_path` is the rest.

    Returns
    -------
    ndarray of `simulation.layout.SCENARIO`, shape (1,)

    Raises
    ------
    AmulettError
        If the initial angle is beyond the profile's limit, or the obstacle is too stiff for the integration step.
    """
    limit = profile.plant.angle_limit_deg
    if abs(scenario.initial_angle_deg) >= limit:
        raise AmulettError(
            f"scenario: 'initial_angle_deg' is {scenario.initial_angle_deg}; the device's limit is +-{limit} deg"
        )
    row = empty_rows(1, profile)
    row["initial_angle"] = np.radians(scenario.initial_angle_deg)
    if scenario.initial_tension is not None:
        row["initial_tension"] = scenario.initial_tension
    if scenario.payload is not None:
        row["payload_mass"], row["payload_arm"] = scenario.payload.mass, scenario.payload.arm
    row["orientation"] = ORIENTATIONS.index(scenario.orientation)
    _pack_device(scenario.device, row)
    load_arm(row, profile)
    row["move_count"] = ON_PATH if scenario.has_path else len(scenario.moves)
    for k, move in enumerate([] if scenario.has_path else scenario.moves):
        row["move_time"][0, k] = move.time
        row["move_angle"][0, k] = np.radians(move.angle_deg)
        row["move_duration"][0, k] = move.duration
    if scenario.wave is not None:
        row["wave_amplitude"] = np.radians(scenario.wave.amplitude_deg)
        row["wave_frequency"], row["wave_chirp"] = scenario.wave.frequency, scenario.wave.chirp
        row["wave_time"], row["wave_duration"] = scenario.wave.time, scenario.wave.duration
    row["push_count"] = len(scenario.pushes)
    for k, push in enumerate(scenario.pushes):
        row["push_time"][0, k] = push.time
        row["push_duration"][0, k] = push.duration
        row["push_torque"][0, k] = push.torque
        row["push_inverse_rise"][0, k] = 1.0 / push.rise if push.rise > 0.0 else 0.0
    if scenario.shake is not None:
        for key, value in scenario.shake:
            row[f"shake_{key}"] = value
    if scenario.obstacle is not None:
        row["obstacle_angle"] = np.radians(scenario.obstacle.angle_deg)
        row["obstacle_side"] = 1.0 if scenario.obstacle.blocks == "flexion" else -1.0
        row["obstacle_stiffness"] = scenario.obstacle.stiffness
        row["obstacle_damping"] = scenario.obstacle.damping
    row["measure_from"] = scenario.measure_from
    touches: Family | None = "contact" if scenario.obstacle is not None else None
    row["family"] = FAMILIES.index(scenario.family or touches)
    if scenario.noise_seed is not None:
        row["noise_key"] = scenario.noise_seed
    if scenario.obstacle is not None:
        _check_stiffness(scenario.obstacle, float(row["inertia"][0]), profile)
    return row


def pack_path(scenario: Scenario) -> NDArray[np.void]:
    """Return the setpoint's path if the record has no room for it, else an array without elements.

    Returns
    -------
    ndarray of `simulation.layout.PATH`
    """
    if not scenario.has_path:
        return np.zeros(0, dtype=PATH)
    setpoint = scenario.setpoint
    if setpoint is None:
        times, angles = [move.time for move in scenario.moves], [move.angle_deg for move in scenario.moves]
        durations, shape = [move.duration for move in scenario.moves], MINIMUM_JERK
    else:
        times, angles = setpoint.time, setpoint.angle_deg
        durations, shape = [0.0] * len(times), STEPS
        if setpoint.interpolation == "linear":  # a jump to the first sample, a part to each other one, and the end
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
    """Turn a packed record, and the path if it has one, back into a scenario; packing it again gives the same.

    The numbers are those that were packed, as far as they had 7 digits where 7 are kept.

    Raises
    ------
    AmulettError
        If the record has a path and it is not given.
    """
    if row["move_count"] == ON_PATH and (path is None or not path.size):
        raise AmulettError("the scenario's setpoint is a path beside its record; unpack needs both")

    def degrees(angle: Any) -> float:
        return round(float(np.degrees(angle)), _DIGITS)

    def number(name: str, *index: int) -> float:
        return float(str(row[name][index]))  # the shortest decimal that is packed to these bits

    moves = {} if path is None or not path.size else _unpack_path(path)
    if not moves:
        moves["moves"] = [
            Move(
                time=number("move_time", k),
                angle_deg=degrees(row["move_angle"][k]),
                duration=number("move_duration", k),
            )
            for k in range(int(row["move_count"]))
        ]
    obstacle = payload = wave = shake = None
    if row["obstacle_stiffness"] > 0:
        obstacle = Obstacle(
            angle_deg=degrees(row["obstacle_angle"]),
            blocks="flexion" if row["obstacle_side"] > 0 else "extension",
            stiffness=number("obstacle_stiffness"),
            damping=number("obstacle_damping"),
        )
    if row["payload_mass"] > 0:
        payload = Payload(mass=number("payload_mass"), arm=number("payload_arm"))
    if row["wave_amplitude"] > 0:
        wave = Wave(
            amplitude_deg=degrees(row["wave_amplitude"]),
            **{key: number(f"wave_{key}") for key in ("frequency", "chirp", "time", "duration")},
        )
    if row["shake_rms"] > 0:
        shake = Shake(**{key: number(f"shake_{key}") for key in Shake.model_fields})
    return Scenario(
        initial_angle_deg=degrees(row["initial_angle"]),
        initial_tension=number("initial_tension"),
        **moves,
        pushes=[
            Push(
                time=number("push_time", k),
                duration=number("push_duration", k),
                torque=number("push_torque", k),
                rise=_rise(row["push_inverse_rise"][k]),
            )
            for k in range(int(row["push_count"]))
        ],
        wave=wave,
        shake=shake,
        obstacle=obstacle,
        payload=payload,
        orientation=ORIENTATIONS[int(row["orientation"])],
        device=Device(
            **{name: number(f"{name}_factor") for name in DEVICE_FACTORS},
            encoder_bias_deg=degrees(row["encoder_bias"]),
            slider_bias_biceps=number("slider_bias_biceps"),
            slider_bias_triceps=number("slider_bias_triceps"),
            late_probability=number("late_probability"),
        ),
        measure_from=number("measure_from"),
        family=FAMILIES[int(row["family"])],
        noise_seed=int(row["noise_key"]),
    )


def _rise(inverse: np.float32) -> float:
    """Return the ramp's length [s] of the fewest digits that is packed as this inverse [1/s]; 0 for a pulse."""
    if inverse == 0.0:
        return 0.0
    rises = (float(f"{1.0 / float(inverse):.{digits}g}") for digits in range(1, 18))
    return next(rise for rise in rises if np.float32(1.0 / rise) == inverse)


def _pack_device(device: Device, row: NDArray[np.void]) -> None:
    for name in DEVICE_FACTORS:
        row[f"{name}_factor"] = getattr(device, name)
    row["encoder_bias"] = np.radians(device.encoder_bias_deg)
    row["slider_bias_biceps"], row["slider_bias_triceps"] = device.slider_bias_biceps, device.slider_bias_triceps
    row["late_probability"] = device.late_probability


def _check_stiffness(obstacle: Obstacle, inertia: float, profile: Profile) -> None:
    """Refuse an obstacle that the integration step cannot resolve.

    A step may cover half a radian of the swing on the obstacle, and a tenth of the damping's time constant: damping
    makes the torque jump at contact, in the middle of a step.
    """
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
    """Return how stiff an obstacle may be [N m/rad] for an inertia [kg m2]: a step is half a radian of the swing."""
    return 0.25 * inertia / (profile.loop.control_period / profile.loop.substeps) ** 2


def most_damping(inertia: Any, profile: Profile) -> Any:
    """Return how much it may damp [N m s/rad]: a step is a tenth of the damping's time constant."""
    return 0.1 * inertia / (profile.loop.control_period / profile.loop.substeps)


def empty_rows(count: int, profile: Profile) -> NDArray[np.void]:
    """Return `count` packed scenarios in which nothing happens: the bare arm at rest at 0 deg."""
    rows = np.zeros(count, dtype=SCENARIO)
    rows["initial_tension"] = profile.variable_stiffness.nominal_tension
    for name in DEVICE_FACTORS:
        rows[f"{name}_factor"] = 1.0
    load_arm(rows, profile)
    return rows
