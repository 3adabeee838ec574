"""Typed keywords of the environments, with ranges, units, defaults."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Self, TypeVar

from gymnasium.vector import AutoresetMode
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, field_validator, model_validator

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE, TRACKS, RewardFunction, Track, check_weights
from amulett_gym.errors import AmulettError, UnexpectedKeyword, nearest, shorten, unknown, warn_deprecated
from amulett_gym.fleet import load_fleet, names_or_contents
from amulett_gym.model.structure import string_tables
from amulett_gym.profile import MOST_TENSION, STABLE_STEP, Profile, is_shipped, load_profile
from amulett_gym.settings import Group, describe
from amulett_gym.simulation.layout import CONTROLS, DRIVES, LOOPS, TENSION_LAWS, Control, pack_loop
from amulett_gym.tasks.names import check_suite
from amulett_gym.tasks.scenario import empty_rows
from amulett_gym.tasks.suites import SPLITS

DEFAULT_STEPS = 500
"""Agent steps in an episode, 10 s at the default agent period."""

NO_LIMIT = -1
"""`max_episode_steps` of episodes without a time limit, as in `gymnasium.make`."""

_ONLY_NATIVE = (
    "; only the native vector environments take it, from gym.make_vec without vectorization_mode; Gymnasium's own take "
    "theirs in vector_kwargs"
)

Bounds = TypeVar("Bounds", bound=Sequence[float])


def one_of(kind: str, choices: Iterable[str]) -> BeforeValidator:
    """Return the check that a value is one of the names of a kind."""

    def check(name: Any) -> Any:
        if not isinstance(name, str) or name not in choices:
            raise unknown(kind, str(name), choices)
        return name

    return BeforeValidator(check)


def _check_control(name: Any) -> Any:
    if name == DRIVES:
        raise AmulettError(
            f"'{DRIVES}' is the loop of Amulett/Drives-v0 alone, whose action also has a mean drive angle; choose from "
            f"{', '.join(sorted(CONTROLS))}, or make Amulett/Drives-v0"
        )
    if not isinstance(name, str) or name not in CONTROLS:
        raise unknown("control", str(name), CONTROLS)
    return name


def _check_drives(name: Any) -> Any:
    if name != DRIVES:
        raise AmulettError(
            f"the only loop of Amulett/Drives-v0 is '{DRIVES}'; the others are for Amulett/Scaling-v0 and "
            "Amulett/Tension-v0"
        )
    return name


def _check_range(tension_range: Bounds) -> Bounds:
    low, high = tension_range
    if not 0 <= low < high <= MOST_TENSION:
        raise ValueError(f"{low:g} to {high:g} N; it has to be 0 <= low < high, at most {MOST_TENSION:,.0f} N")
    return tension_range


def _check_steps(steps: int) -> int:
    if steps < 1 and steps != NO_LIMIT:
        raise ValueError(f"it has to be at least 1 agent step, or {NO_LIMIT} for no limit")
    return steps


def _read_autoreset(mode: Any) -> Any:
    for known in AutoresetMode:
        if mode in (known, known.value, known.name):
            return known
    raise unknown("autoreset_mode", str(mode), [known.value for known in AutoresetMode])


# Types of keywords, shared with recipes and bundles.
AnyProfile = Annotated[Profile, BeforeValidator(load_profile)]
AnyFleet = Annotated[
    tuple[Profile, ...] | None, BeforeValidator(lambda fleet: None if fleet is None else load_fleet(fleet))
]
Suite = Annotated[str, BeforeValidator(check_suite)]
Split = Annotated[str, one_of("split", SPLITS)]
ControlLoop = Annotated[Control, BeforeValidator(_check_control)]
CostTrack = Annotated[Track, one_of("track", TRACKS)]
TensionRange = Annotated[tuple[float, float], AfterValidator(_check_range)]
TensionList = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_check_range)]  # of JSON files
MeanAngle = Annotated[float, Field(gt=0, le=36_000)]  # [deg]
AgentPeriod = Annotated[float, Field(gt=0, le=100)]
Weights = Annotated[dict[str, float], AfterValidator(lambda weights: check_weights(weights))]
ActionDelay = Annotated[int, Field(ge=0, le=10**6)]
Noise = Annotated[float, Field(ge=0)]
Threads = Annotated[int, Field(ge=1)]
Steps = Annotated[int, AfterValidator(_check_steps)]
Autoreset = Annotated[AutoresetMode, BeforeValidator(_read_autoreset)]


class Settings(Group):
    """Keywords of `Amulett/Scaling-v0` and `Amulett/Tension-v0`."""

    render_modes: ClassVar[tuple[str, ...]] = ("rgb_array", "human")

    profile: AnyProfile = Field(
        default="testbed",
        validate_default=True,
        description="device: a shipped profile's name, a YAML file, a mapping or a Profile",
    )
    fleet: AnyFleet = Field(
        default=None,
        description="devices instead of one profile, of which each episode has one: a name, a file or a list",
    )
    suite: Suite = Field(default="steps", description="suite that scenarios are drawn from; see `tasks.suites`")
    split: Split = Field(
        default="train", description="part of the suite: disjoint scenarios, or shifted beyond their ranges"
    )
    control: ControlLoop = Field(
        default="decentralized",
        description="control loop: the paper's with the tension loop, or without (position-only), or one of the others",
    )
    tension_law: Annotated[str, one_of("tension law", TENSION_LAWS)] = Field(
        default="agent", description="what sets the tension: the agent, or eq. 6 in each control tick"
    )
    track: CostTrack = Field(
        default=SCHEDULE,
        description="cost in the reward: schedule, within one loop; full-control, to compare loops (see `envs.reward`)",
    )
    reward_weights: Weights | None = Field(
        default=None, description="reward term -> weight [1], instead of each family's default"
    )
    reward_fn: RewardFunction | None = Field(
        default=None, exclude=True, description="function of a step's costs and terms, replaces the reward"
    )
    tension_range: TensionRange = Field(
        default=TENSION_RANGE,
        description="tension at action -1 and +1 [N]; by default from 0 N where the co-contraction is fed forward",
    )
    agent_period: AgentPeriod = Field(
        default=0.02, description="time between two actions [s], a multiple of the control period"
    )
    action_delay: ActionDelay = Field(
        default=0,
        description="control ticks from an agent step's begin to that of its action's ramp: what a microcontroller "
        "takes to compute the action",
    )
    observation_noise: Noise = Field(
        default=0.0, description="standard deviation added to each entry of an observation, in its scaled unit [1]"
    )
    failure_horizon: int = Field(
        default=DEFAULT_STEPS, ge=1, le=10**9, description="episode length for the cost of a failure [agent steps]"
    )
    render_mode: str | None = Field(default=None, description="rgb_array or human")
    privileged: bool = Field(default=False, description="append the hidden state to the observations")

    @field_validator("render_mode")
    @classmethod
    def _check_render_mode(cls, mode: str | None) -> str | None:
        if mode is not None and mode not in cls.render_modes:
            raise unknown("render_mode", mode, cls.render_modes)
        return mode

    @model_validator(mode="before")
    @classmethod
    def _choose_range(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and given.get("control") in LOOPS and "tension_range" not in given:
            return {**given, "tension_range": FEED_FORWARD_RANGE}
        return given

    @model_validator(mode="after")
    def _check_slack(self) -> Self:
        if self.control not in (*LOOPS, DRIVES) and self.tension_range[0] == 0.0:
            raise AmulettError(
                f"tension_range is {self.tension_range} N; the loop '{self.control}' needs a range above 0 N; slack "
                "strings need a loop that feeds the co-contraction forward"
            )
        return self

    @model_validator(mode="after")
    def _check_weights_of_track(self) -> Self:
        tension = (self.reward_weights or {}).get("tension", 0.0)
        if self.track == FULL_CONTROL and tension > 0.0:
            raise AmulettError(
                f"reward_weights gives the tension {tension:g}; the track full-control has no such term: it has to be 0"
            )
        return self

    @model_validator(mode="after")
    def _check_action(self) -> Self:
        law, loop = self.tension_law, self.control
        if self.action_delay and (law != "agent" or loop == "position-only"):
            raise AmulettError(
                f"action_delay is {self.action_delay}; with tension_law='{law}' in the loop '{loop}', actions have no "
                "effect that could be late: it has to be 0"
            )
        return self

    @model_validator(mode="after")
    def _check_devices(self) -> Self:
        if self.fleet is not None and "profile" in self.model_fields_set:
            raise AmulettError("profile and fleet are both given; give one of them")
        for device in self.devices:
            try:
                _check_step(device)
                self._check_delay(self.ticks(device))
                if self.fleet is not None and self.control in (*LOOPS, DRIVES):
                    pack_loop(device, self.control)
            except AmulettError as error:
                raise error if self.fleet is None else AmulettError(f"'{device.name}' of the fleet: {error}") from error
        return self

    @property
    def devices(self) -> tuple[Profile, ...]:
        """The fleet, or the one profile."""
        return (self.profile,) if self.fleet is None else self.fleet

    def ticks(self, profile: Profile) -> int:
        """Return the number of a device's control ticks in an agent step."""
        return _ticks(self.agent_period, profile.loop.control_period)

    def _check_delay(self, ticks: int) -> None:
        if self.action_delay >= ticks:
            raise AmulettError(
                f"action_delay is {self.action_delay} control ticks; an agent period of {self.agent_period:g} s has "
                f"{ticks}: it has to be from 0 to {ticks - 1}"
            )

    @property
    def mean_angle_deg(self) -> float | None:
        """Mean drive angle at action +1 [deg]; None where the action has no such entry."""
        return None

    @classmethod
    def read(cls, keywords: Mapping[str, Any], what: str = "environment", by_factor: bool = False) -> Self:
        """Return checked keywords.

        Parameters
        ----------
        keywords : mapping
            The deprecated ``action_range`` is read as `tension_range`.
        what : str
            Beginning of the error's message.
        by_factor : bool
            Whether ``action_range`` is in factors of the profile's nominal tension instead of N.

        Raises
        ------
        UnexpectedKeyword
            If a keyword is unknown.
        AmulettError
            If its value is wrong.
        """
        given = dict(keywords)
        if "action_range" in given:
            _replace_action_range(given, by_factor)
        try:
            return cls(**given)
        except ValidationError as error:
            for key in [key for key in given if key not in cls.model_fields]:
                hint = _ONLY_NATIVE if key in VectorSettings.model_fields else nearest(key, cls.model_fields)
                raise UnexpectedKeyword(
                    f"{what} got an unexpected keyword argument '{shorten(key)}'{hint} "
                    f"(allowed: {', '.join(cls.model_fields)})"
                ) from error
            raise describe(error, cls, what) from error

    @property
    def given(self) -> dict[str, Any]:
        """The given keywords as they were read, for another environment that differs in some of them."""
        return {key: getattr(self, key) for key in self.model_fields_set}

    def keywords(self) -> dict[str, Any]:
        """Return the given keywords as JSON types, for making the environment again.

        A shipped profile is a name, another one a mapping; so are those of a fleet. Left out are keywords that do not
        change an episode (`render_mode` and those of `VectorSettings`) and `reward_fn`, which is code.
        """
        others = VectorSettings.model_fields.keys() - Settings.model_fields.keys()
        given = self.model_fields_set - others - {"render_mode"}
        found = self.model_dump(mode="json", include=given)
        if "profile" in found and is_shipped(self.profile):
            found["profile"] = self.profile.name
        if self.fleet is not None:
            found["fleet"] = names_or_contents(self.fleet)
        return found


class VectorSettings(Settings):
    """Keywords of the vector environments."""

    render_modes: ClassVar[tuple[str, ...]] = ("rgb_array", "rgb_array_list")

    num_envs: int = Field(default=1, ge=1, description="number of devices")
    max_episode_steps: Steps = Field(
        default=DEFAULT_STEPS,
        description="steps after which an episode is truncated [agent steps]; None: the default, -1: never",
    )
    threads: Threads = Field(
        default=1, description="threads that share the devices; the number changes no bit of the results"
    )

    autoreset_mode: Autoreset = Field(
        default=AutoresetMode.NEXT_STEP,
        description="when a device whose episode has ended starts the next one: NextStep, SameStep, or Disabled (at a "
        "reset with its reset_mask)",
    )

    @field_validator("max_episode_steps", mode="before")
    @classmethod
    def _default_steps(cls, steps: Any) -> Any:
        return DEFAULT_STEPS if steps is None else steps


class DrivesSettings(Settings):
    """Keywords of `Amulett/Drives-v0`."""

    control: Annotated[Control, BeforeValidator(_check_drives)] = Field(
        default=DRIVES, description="control loop: commands of both drives, no other"
    )
    tension_range: TensionRange = Field(
        default=FEED_FORWARD_RANGE, description="co-contraction at action -1 and +1, as tension of both strings [N]"
    )
    mean_angle_range: MeanAngle | None = Field(
        default=None,
        description="mean drive angle at action +1, its negative at -1 [deg], at most the profile's command limit; "
        "None: that of a joint angle of 90 deg, rounded",
    )

    @model_validator(mode="after")
    def _check_mean_angle(self) -> Self:
        limit = self._command_limit_deg
        if self.mean_angle_range is not None and self.mean_angle_range > limit:
            raise AmulettError(
                f"mean_angle_range is {self.mean_angle_range:g} deg; the profile's command_limit_deg is {limit:g}"
            )
        return self

    @property
    def _command_limit_deg(self) -> float:
        """The smallest limit of the devices [deg]."""
        return min(device.drives.command_limit_deg or math.inf for device in self.devices)

    @property
    def mean_angle_deg(self) -> float:
        """Mean drive angle at action +1 [deg]; in a fleet that of the device whose drives turn the farthest."""
        if self.mean_angle_range is not None:
            return self.mean_angle_range
        plants = [device.plant for device in self.devices]
        ratio = max(plant.joint_pulley_radius / plant.drive_pulley_radius for plant in plants)
        return float(min(max(round(90.0 * ratio), 1), self._command_limit_deg))


class DrivesVectorSettings(DrivesSettings, VectorSettings):
    """Keywords of the vector version of `Amulett/Drives-v0`."""


def signature(settings: type[Settings]) -> inspect.Signature:
    """Return the signature of an environment that takes these settings as keywords."""
    parameters = inspect.signature(settings).parameters.values()
    return inspect.Signature([parameter.replace(annotation=inspect.Parameter.empty) for parameter in parameters])


def _replace_action_range(given: dict[str, Any], by_factor: bool) -> None:
    warn_deprecated("action_range is deprecated; use tension_range=(low, high), in N")
    action_range = given.pop("action_range")
    if action_range is None:
        return
    if "tension_range" in given:
        raise AmulettError("action_range and tension_range are the same; give tension_range only")
    if given.get("fleet") is not None:
        raise AmulettError("action_range is not for a fleet; use tension_range=(low, high), in N")
    given["profile"] = load_profile(given.get("profile", "testbed"))
    unit = given["profile"].variable_stiffness.nominal_tension if by_factor else 1.0
    try:
        low, high = (float(bound) * unit for bound in action_range)
    except (TypeError, ValueError) as error:
        raise AmulettError(f"action_range is {action_range!r}; it has to be a pair (low, high)") from error
    given["tension_range"] = low, high


def _check_step(profile: Profile) -> None:
    """Raise an AmulettError for a device whose oscillation, damping or drives are too fast for its integration step.

    Checked at the largest stiffness of both strings; a device that differs from its profile may still fail. A drive
    beyond its stall torque gives way at a rate that is proportional to its string's deflection: a time constant.
    """
    step = profile.loop.control_period / profile.loop.substeps
    stiffness, plant, drives = string_tables(profile).max_stiffness, profile.plant, profile.drives
    joint_stiffness, inertia = 2.0 * stiffness * plant.joint_pulley_radius**2, empty_rows(1, profile)["inertia"][0]
    swing, slowing = step * math.sqrt(joint_stiffness / float(inertia)), 2.0 * step * profile.damping.d
    found = {f"oscillates by {swing:.3g} rad": swing, f"is damped by {slowing:.3g} time constants": slowing}
    if drives.stall_torque is not None and drives.lag > 0.0 and drives.rate_limit_deg is not None:
        speed = math.radians(drives.rate_limit_deg)
        yielding = step * stiffness * plant.drive_pulley_radius**2 * speed / drives.stall_torque
        found[f"has drives that give way by {yielding:.3g} time constants"] = yielding
    what, most = max(found.items(), key=lambda item: item[1])
    if most > STABLE_STEP:
        least = math.ceil(profile.loop.substeps * most / STABLE_STEP)
        raise AmulettError(
            f"the device '{profile.name}' {what} in an integration step of {step:g} s; at most {STABLE_STEP} can be "
            f"computed: loop.substeps has to be at least {least}"
        )


def _ticks(agent_period: float, control_period: float) -> int:
    ticks = max(round(agent_period / control_period), 1)
    if not math.isclose(agent_period, ticks * control_period, rel_tol=1e-6):  # a float32 is a number, too
        raise AmulettError(
            f"agent_period is {agent_period} s; it has to be a multiple of the profile's control period, "
            f"{control_period} s; the nearest is {ticks * control_period:g} s"
        )
    return ticks
