"""The *profile*: one validated description of a device with its control loop.

A profile is a YAML file (or a dict) of groups; every key is typed, range-checked and carries its unit. Units are SI,
but angles are in degrees where the key ends in ``_deg``. A profile may name a `base` profile and give only what differs
from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    field_validator,
    model_serializer,
    model_validator,
)

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.fitting import Fitting
from amulett_gym.gains import Loops, group_name
from amulett_gym.settings import Group, Sourced, describe, find_config, merge, to_plain
from amulett_gym.storage.curve import Curve, is_csv, read_curve, read_measurement
from amulett_gym.storage.hysteresis import MEAN
from amulett_gym.storage.reading import user_path, visible
from amulett_gym.storage.safe_yaml import read_yaml

Positive = Annotated[float, Field(gt=0)]
Gain = Annotated[float, Field(ge=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0, le=100)]
Degrees = Annotated[float, Field(ge=0, le=180)]
LEAST_INERTIA = 1e-9
"""Smallest inertia of an arm [kg m2]: a gram at 1 mm."""

MOST_TENSION = 1e6
"""Largest string tension setpoint [N]; without a limit its square, in a metric, could overflow."""

STABLE_STEP = 2.5
"""Time constants, or radians of an oscillation, in an integration step; Runge-Kutta is stable up to 2.78."""


def least_lag(control_period: float, substeps: int) -> float:
    """Return the shortest lag of drives [s] that the integration steps of a control period [s] resolve."""
    return control_period / substeps / STABLE_STEP


class WithOptions(Group):
    """A group with options that came later: null ones are left out of its content, so that older hashes stay."""

    OPTIONS: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _leave_out(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in dump(self).items() if value is not None or key not in self.OPTIONS}


class PointMass(Group):
    """One of the N masses of eqs. 2-3."""

    mass: float = Field(ge=0, le=20, description="m_i [kg]")
    arm: float = Field(ge=0, le=1, description="l_i, lever arm about the joint [m]")


class Plant(Sourced):
    """The arm and its pulleys (eqs. 1-5)."""

    masses: list[PointMass] = Field(min_length=1, max_length=100, description="m_i and l_i of eqs. 2-3")
    orientation: Literal["horizontal", "vertical"] = Field(
        description="plane in which the forearm swings; in the horizontal one gravity does no work"
    )
    drive_pulley_radius: float = Field(ge=1e-4, le=0.2, description="R_1 [m]")
    joint_pulley_radius: float = Field(ge=1e-4, le=0.2, description="R_2 [m]")
    angle_limit_deg: float = Field(gt=0, le=180, description="the device fails beyond +- this joint angle [deg]")
    velocity_limit_deg: float = Field(gt=0, le=100_000, description="the device fails beyond +- this rate [deg/s]")

    @model_validator(mode="after")
    def _check_inertia(self) -> Plant:
        if not any(item.mass * item.arm**2 >= LEAST_INERTIA for item in self.masses):
            raise ValueError(
                f"masses give no inertia; at least one needs mass times arm squared >= {LEAST_INERTIA} kg m2"
            )
        return self


class Spring(WithOptions, Sourced):
    """The non-linear spring assembly in each string (Figure 5a)."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("beyond", "stop_stiffness")

    stiffness: float = Field(ge=1e-3, le=1e7, description="stiffness of each of the two linear springs [N/m]")
    half_width: float = Field(ge=1e-6, le=10, description="distance of each spring's anchor from the string's axis [m]")
    free_length: float = Field(ge=0, le=10, description="length of an unloaded linear spring [m], at most half_width")
    max_deflection: float = Field(
        ge=1e-6, le=10, description="string deflection at which the table ends [m]; see beyond"
    )
    beyond: Literal["continued", "hard-stop"] | None = Field(
        default=None,
        description="the force beyond max_deflection. null, or held: as at the table's end, the string yields; "
        "continued: by the geometric model, or by the last slope of a measured curve; hard-stop: a stop of stiffness "
        "stop_stiffness takes the rest of the deflection",
    )
    stop_stiffness: float | None = Field(
        default=None, ge=1.0, le=1e7, description="stiffness of the stop behind the spring [N/m], for hard-stop"
    )
    measured_curve: Curve | None = Field(
        default=None, description="replaces the geometric model: a CSV file (see `storage.curve`), or its text"
    )

    @model_validator(mode="before")
    @classmethod
    def _name_loss(cls, content: Any) -> Any:
        """Name as the curve's source how much its hysteresis takes: the mean that is kept does not show it."""
        if not isinstance(content, Mapping) or not isinstance(curve := content.get("measured_curve"), str | Path):
            return content
        sources = content.get("sources", {})
        if not isinstance(sources, Mapping) or "measured_curve" in sources:
            return content
        try:
            notes = read_measurement(curve)[1]
        except AmulettError:
            return content  # the field's own validator refuses it by its key
        loops = [note for note in notes if note.startswith(MEAN)]
        return {**content, "sources": {**sources, "measured_curve": f"given: {loops[-1]}"}} if loops else content

    @field_validator("measured_curve", mode="before")
    @classmethod
    def _read_curve(cls, curve: Any) -> Any:
        return read_curve(curve) if isinstance(curve, str) else curve

    @field_validator("beyond", mode="before")
    @classmethod
    def _read_held(cls, beyond: Any) -> Any:
        return None if beyond == "held" else beyond

    @model_validator(mode="after")
    def _check_stop(self) -> Spring:
        if self.beyond == "hard-stop" and self.stop_stiffness is None:
            raise ValueError("beyond is hard-stop, so stop_stiffness is needed: the stiffness of the stop in N/m")
        if self.beyond != "hard-stop" and self.stop_stiffness is not None:
            raise ValueError(
                f"stop_stiffness is {self.stop_stiffness} N/m, but beyond is {self.beyond or 'held'}; only hard-stop "
                "has a stop"
            )
        return self

    @model_validator(mode="after")
    def _check_lengths(self) -> Spring:
        if self.free_length > self.half_width:
            raise ValueError(
                f"free_length is {self.free_length} m; it has to be at most half_width, {self.half_width} m, "
                "or the springs push the string out of its axis"
            )
        if self.half_width > 100 * self.max_deflection:
            raise ValueError(
                f"half_width is {self.half_width} m; it has to be at most 100 times max_deflection, "
                f"{self.max_deflection} m, or the sliders hardly move"
            )
        return self


class Structure(Sourced):
    """The elastic structure between drives and joint, the printed parts, in series with each string's springs."""

    stiffness: float = Field(
        default=8e4,
        ge=100,
        le=1e9,
        description="K_s, force of a string over what the structure gives way along it [N/m]; see "
        "`amulett_gym.model.structure`",
    )


class Damping(Sourced):
    """The preload-dependent decay rate of Figure 3, ``a exp(b (x + c)) + d``, clipped at zero."""

    fit: Literal["shifted", "printed"] = Field(
        description="shifted: a exp(b (x + c)) + d, as Figure 3 shows; printed: a exp(b x + c) + d, as its caption says"
    )
    a: float = Field(ge=-1e6, le=0, description="[1/s]; not positive: friction grows with preload")
    b: float = Field(ge=-10, lt=0, description="[1/N]")
    c: float = Field(ge=-50, le=50, description="[N] if shifted, dimensionless [1] if printed")
    d: float = Field(ge=0, le=1e6, description="decay rate at large preload [1/s]")
    preload: Literal["mean", "smaller"] = Field(description="which of both true string forces is the preload x")
    keeps: Literal["torque", "rate"] = Field(
        description="what a payload leaves unchanged: the damping torque, or the decay rate"
    )


class Drives(WithOptions, Sourced):
    """Both motors."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("stall_torque",)

    lag: Seconds = Field(description="time constant of the motor position [s], 0.4 integration steps or more; 0: none")
    rate_limit_deg: float | None = Field(
        default=None, gt=0, le=1e6, description="largest motor speed [deg/s]; null: none"
    )
    command_limit_deg: float | None = Field(
        default=None, gt=0, le=1e6, description="largest |command| [deg]; null: none"
    )
    stall_torque: float | None = Field(
        default=None,
        ge=1e-4,
        le=1e4,
        description="load at which a drive stalls [N m]; null: none. The rate at which it winds its string falls "
        "linearly with the load, from rate_limit_deg to 0 at stall_torque, and on: a larger load drives it back, at "
        "most at rate_limit_deg. A "
        "drive without lag is at its command, as far as the load allows",
    )

    @model_validator(mode="after")
    def _check_stall(self) -> Drives:
        if self.stall_torque is not None and self.lag > 0.0 and self.rate_limit_deg is None:
            raise ValueError(
                f"stall_torque is {self.stall_torque} N m; with a lag it needs rate_limit_deg, the speed without load"
            )
        return self


class Sensors(Sourced):
    """Joint encoder and the potentiometers on the linear springs."""

    encoder_bits: int = Field(ge=0, le=32, description="resolution of a revolution [bit]; 0: exact")
    encoder_noise_deg: Degrees = Field(description="standard deviation [deg]")
    potentiometer_bits: int = Field(ge=0, le=32, description="resolution of the travel [bit]; 0: exact")
    potentiometer_travel: float = Field(ge=1e-6, le=1, description="travel of the slider [m]")
    potentiometer_noise: float = Field(ge=0, le=1, description="standard deviation [m]")
    force_filter: Seconds = Field(description="time constant of the estimated force's low-pass [s]; 0: none")
    force_floor: float = Field(ge=0, le=1e6, description="smallest force estimate that is trusted [N]; 0: all are")
    below_floor: Literal["clamp", "hold", "ignore"] = Field(
        description="clamp: report the floor; hold: repeat the last trusted value; ignore: report the raw estimate, "
        "with no error for the tension controller"
    )


class Pid(Group):
    """Gains of one PID controller."""

    kp: Gain = Field(description="proportional gain [1], or [deg/N] of tension")
    ki: Gain = Field(description="integral gain [1/s], or [deg/(N s)]")
    kd: Gain = Field(description="derivative gain [s], or [deg s/N]")
    derivative_filter: Seconds = Field(description="time constant of the derivative's filter [s]; 0: none")
    derivative_on: Literal["error", "measurement"] = Field(
        default="error", description="signal that is differentiated; with the measurement, setpoint steps do not kick"
    )


class Loop(Sourced):
    """The decentralised loop of section 2.2."""

    control_period: float = Field(ge=1e-6, le=0.1, description="time between two control ticks [s]")
    substeps: int = Field(ge=1, le=1000, description="integration steps in a control period [1]")
    position: Pid = Field(description="joint position controller")
    tension: Pid = Field(description="string tension controller")
    position_only: Pid = Field(description="joint position controller used without the tension controller")
    offset_deg: float = Field(ge=0, le=180, description="co-contraction of each drive in position-only control [deg]")
    wiring: Literal["sum", "tension_only"] = Field(
        description="controllers that the antagonist follows: position plus tension, or tension alone"
    )
    agonist: Literal["switching", "biceps", "triceps"] = Field(description="switching, or always the same drive")
    switch_filter: Seconds = Field(
        description="time constant of the low-pass over the difference of both springs' deflections [s]; 0: none"
    )
    switch_hysteresis: float = Field(
        ge=0, le=1, description="difference of both springs' deflections above which the agonist switches [m]"
    )
    tie_width: float = Field(ge=0, le=1, description="spring deflections closer than this are equal [m]")
    tie_error_deg: Degrees = Field(
        description="position error from which, at equal deflections, the desired motion decides [deg]"
    )
    velocity_filter: float = Field(ge=1e-6, le=100, description="time constant of the measured joint velocity [s]")

    @model_validator(mode="after")
    def _check_hysteresis(self) -> Loop:
        if self.tie_width > self.switch_hysteresis:
            raise ValueError(
                f"tie_width is {self.tie_width} m; it has to be at most switch_hysteresis, {self.switch_hysteresis} m"
            )
        return self


class VariableStiffness(Sourced):
    """Parameters of eq. 6 (Figure 6)."""

    nominal_tension: float = Field(ge=1e-3, le=MOST_TENSION, description="sigma, desired string tension [N]")
    minimum_tension: float = Field(
        ge=1e-3, le=MOST_TENSION, description="sigma_min, minimum desired string tension [N]"
    )
    error_offset_deg: float = Field(
        ge=1e-3, le=360, description="d_offset, error at which the factor is smallest [deg]"
    )

    @model_validator(mode="after")
    def _check_order(self) -> VariableStiffness:
        if self.minimum_tension > self.nominal_tension:
            raise ValueError(
                f"minimum_tension is {self.minimum_tension} N; it has to be at most nominal_tension, "
                f"{self.nominal_tension} N"
            )
        return self


class Profile(WithOptions):
    """A device with its control loop: everything that the simulation needs in addition to a scenario."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("structure", "wearer")

    name: str = Field(min_length=1, max_length=200, description="name of the device in reports")
    base: str | None = Field(default=None, description="shipped profile whose values apply where none is given")
    description: str = Field(default="", description="one line for `amulett list`")
    divisors_of: str | None = Field(
        default=None,
        description="shipped profile by whose costs of eq. 6 costs are divided, so that devices with other gains of "
        "the paper's loop have the same unit; null: this device's own costs",
    )
    plant: Plant = Field(description="arm and pulleys")
    spring: Spring = Field(description="spring assembly in each string")
    structure: Structure | None = Field(
        default=None, description="elastic parts between drives and joint, in series with the springs; null: rigid"
    )
    damping: Damping = Field(description="decay rate over the preload")
    drives: Drives = Field(description="both motors")
    sensors: Sensors = Field(description="encoder and potentiometers")
    loop: Loop = Field(description="controllers")
    loops: Loops = Field(default=Loops(), description="gains of the other loops of `amulett_gym.control`")
    variable_stiffness: VariableStiffness = Field(description="parameters of eq. 6")
    wearer: Fitting | None = Field(
        default=None, description="how the device is worn, in Amulett/Worn-v0 only; null: the defaults"
    )

    @field_validator("divisors_of")
    @classmethod
    def _check_divisors_of(cls, name: str | None) -> str | None:
        if name is not None and name not in profile_names():
            raise unknown("shipped profile", name, profile_names())
        return name

    @model_validator(mode="after")
    def _check_lag(self) -> Profile:
        loop = self.loop
        step, least = loop.control_period / loop.substeps, least_lag(loop.control_period, loop.substeps)
        if 0 < self.drives.lag < least:
            raise ValueError(
                f"drives.lag is {self.drives.lag} s; with integration steps of {step:g} s (loop.control_period over "
                f"loop.substeps) it has to be 0, or at least {least:g} s"
            )
        return self

    @model_validator(mode="after")
    def _check_cables(self) -> Profile:
        if self.wearer is None or self.wearer.cable.side == "joint" or self.wearer.cable.friction == 0.0:
            return self
        if self.drives.stall_torque is None or self.drives.lag == 0.0:
            raise ValueError(
                f"wearer.cable.side is drive, with a friction of {self.wearer.cable.friction:g}; there it only loads "
                f"the drives, which turn as if without load: drives.stall_torque is {self.drives.stall_torque} N m and "
                f"drives.lag {self.drives.lag:g} s. Give both above 0, or set wearer.cable.side to joint"
            )
        return self

    @property
    def root(self) -> str:
        """Name of the shipped profile that this one derives from, whose tuned laws apply; its own name if none.

        That is the base, unless this profile shares more groups with the shipped profile of its own name: a changed
        copy of the testbed's content derives from the testbed, which itself is based on the simulation. A base that is
        not one of `device_names`, as `worn`, stands for the device that it derives from.
        """
        devices, base = device_names(), self.base
        if base in profile_names() and base not in devices:
            base = load_profile(base).root
        common = {name: self._groups_of(name) for name in devices if name in (base, self.name)}
        if base is not None and common.get(self.name, 0) <= common.get(base, 0):
            return base
        return self.name if self.name not in common or common[self.name] else f"{self.name} (own)"

    def _groups_of(self, shipped: str) -> int:
        """Return how many groups are equal to those of a shipped profile."""
        other = load_profile(shipped)
        return sum(getattr(self, name) == group for name, group in other if isinstance(group, Sourced))


_SENSED = ("force_filter", "force_floor", "below_floor")
"""Choices of the loop among the keys of `sensors`."""

_UNUSED = {
    "decentralized": {"position_only", "offset_deg"},
    "position-only": {"position", "tension", "wiring"},
    "": {"position", "tension", "position_only", "offset_deg", "wiring"},
}
"""Keys of `loop` without effect, by the control loop; "": in any other."""


def loop_configuration(profile: Profile, control: str = "decentralized") -> dict[str, Any]:
    """Return what the owner of a device programs and a policy belongs to, as dotted keys of the profile with values.

    That is the loop (control period, gains, filters, wiring, agonist) with the treatment of the estimated forces,
    without what has no effect in the control loop `control`, and without `loop.substeps`, a choice of the simulation.
    """
    content = profile.model_dump(mode="json", include={"sensors", "loop", "loops"})
    loop, unused = content["loop"], _UNUSED.get(control, _UNUSED[""]) | {"substeps", "sources"}
    found: dict[str, Any] = {
        "sensors": {key: content["sensors"][key] for key in _SENSED},
        "loop": {key: value for key, value in loop.items() if key not in unused},
    }
    if (group := group_name(control)) in content["loops"]:
        found["loops"] = {group: {key: value for key, value in content["loops"][group].items() if key != "sources"}}
    return _flat(found)


def physics(profile: Profile) -> dict[str, Any]:
    """Return what a device is, apart from its loop, as dotted keys of the profile with values.

    ``plant.masses`` is replaced by the ``plant.inertia`` [kg m2] and, where gravity does work, ``plant.moment`` [kg m].
    """
    groups = {"plant", "spring", "structure", "damping", "drives", "sensors"}
    found = {key: dict(value) for key, value in profile.model_dump(mode="json", include=groups).items()}
    masses = found["plant"].pop("masses")
    found["plant"]["inertia"] = sum(item["mass"] * item["arm"] ** 2 for item in masses)
    if profile.plant.orientation == "vertical":
        found["plant"]["moment"] = sum(item["mass"] * item["arm"] for item in masses)
    for key in _SENSED:
        del found["sensors"][key]
    if profile.spring.measured_curve is not None:
        found["spring"]["measured_curve"] = str(found["spring"]["measured_curve"])
        for key in ("stiffness", "half_width", "free_length"):  # of the geometric model
            del found["spring"][key]
    for group in found.values():
        group.pop("sources")
    return _flat(found)


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return found


def is_shipped(profile: Profile) -> bool:
    """Return whether a profile is an unchanged shipped one."""
    return profile.name in profile_names() and profile == load_profile(profile.name)


@cache
def profile_names() -> tuple[str, ...]:
    """Return the names of the shipped profiles."""
    with resources.as_file(resources.files("amulett_gym") / "profiles") as folder:
        return tuple(path.stem for path in visible(folder, "*.yaml"))


@cache
def device_names() -> tuple[str, ...]:
    """Return the names of the shipped profiles whose costs are their own: not `worn`, a variant of the testbed."""
    return tuple(name for name in profile_names() if load_profile(name).divisors_of is None)


def load_profile(profile: str | Path | Mapping[str, Any] | Profile) -> Profile:
    """Return a validated profile.

    Parameters
    ----------
    profile : str, Path, mapping or Profile
        A shipped profile's name (``"simulation"``, ``"testbed"``), a YAML file, or the content of one. A mapping may
        name a ``base`` profile and hold only the keys that differ.

    Raises
    ------
    AmulettError
        If the name or file is unknown, a key is unknown, or a value is out of its range.
    """
    if isinstance(profile, Profile):
        return profile
    if isinstance(profile, Mapping):
        return _validate(to_plain(profile), "profile", "by the caller")
    if not isinstance(profile, str | Path):
        raise AmulettError(f"profile is {profile!r}; it has to be a name, a YAML file or a mapping")
    if str(profile) in profile_names():
        return _shipped(str(profile))
    if Path(profile).suffix.lower() not in (".yaml", ".yml", ".json"):
        raise unknown("profile", str(profile), [*profile_names(), "<file>.yaml"])
    path = find_config(profile, "profile")
    return parse_profile(read_yaml(path, "profile"), path)


def parse_profile(content: dict[str, Any], path: Path) -> Profile:
    """Return the validated profile that a file at `path` holds; errors as of `load_profile`."""
    spring = content.get("spring")
    if isinstance(spring, dict) and isinstance(curve := spring.get("measured_curve"), str) and not is_csv(curve):
        curve = str(path.parent / user_path(curve))  # relative to the file that names it
        content = {**content, "spring": {**spring, "measured_curve": curve}}
    return _validate(content, f"profile '{path}'", f"in {path.name}")


@cache  # reading YAML takes longer than simulating a step response
def _shipped(name: str) -> Profile:
    return _validate(_content(name), f"profile '{name}'")


@cache
def _content(name: str) -> dict[str, Any]:
    with resources.as_file(resources.files("amulett_gym") / "profiles" / f"{name}.yaml") as path:
        return read_yaml(path, "profile")


def _resolve_base(content: Mapping[str, Any], given: str) -> dict[str, Any]:
    base = content.get("base")
    if base is None:
        return dict(content)
    if base not in profile_names():
        raise unknown("base profile", str(base), profile_names())
    below = _resolve_base(_content(base), "")
    merged = merge(below, content)
    for name, changes in content.items():  # a changed value no longer has the base's source
        group, old = merged[name], below.get(name)
        if isinstance(changes, Mapping) and isinstance(old, Mapping) and isinstance(group.get("sources"), Mapping):
            changed = {key for key in old.get("sources", ()) if group.get(key) != old.get(key)}
            changed -= set(changes.get("sources", ()))
            group["sources"] = {**group["sources"], **dict.fromkeys(changed, f"given: {given}")}
    return merged


def _validate(content: Mapping[str, Any], what: str, given: str = "") -> Profile:
    try:
        return Profile.model_validate(_resolve_base(content, given))
    except ValidationError as error:
        raise describe(error, Profile, what) from error
