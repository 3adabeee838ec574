"""Typed keywords of the environments with a wearer."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from amulett_gym.envs.action import FEED_FORWARD_RANGE
from amulett_gym.envs.reward import SCHEDULE
from amulett_gym.envs.settings import AnyProfile, CostTrack, Settings, TensionRange, VectorSettings, one_of
from amulett_gym.envs.worn_reward import check_worn_weights
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.simulation.layout import CONTROLS, LOOPS, Control
from amulett_gym.simulation.worn_layout import DELAY
from amulett_gym.tasks.wearer import POPULATION, reflex_ticks
from amulett_gym.tasks.worn_suites import WORN_SUITES


def _check_control(name: Any) -> Any:
    if name in CONTROLS and name not in LOOPS:
        raise AmulettError(
            f"Amulett/Worn-v0 feeds the co-contraction forward, which '{name}' does not; choose from "
            f"{', '.join(sorted(LOOPS))}"
        )
    if not isinstance(name, str) or name not in LOOPS:
        raise unknown("control", str(name), LOOPS)
    return name


def _check_track(name: Any) -> Any:
    if name != SCHEDULE:
        raise AmulettError("the reward of Amulett/Worn-v0 is that of the wearer; leave track out")
    return name


def _check_privileged(privileged: bool) -> bool:
    if privileged:
        raise AmulettError("Amulett/Worn-v0 does not show its hidden state; leave privileged out")
    return privileged


class WornSettings(Settings):
    """Keywords of `Amulett/Worn-v0`."""

    profile: AnyProfile = Field(
        default="worn",
        validate_default=True,
        description="device: a shipped profile's name, a YAML file, a mapping or a Profile; without its group wearer, "
        "it is worn with the defaults of `amulett_gym.fitting.Fitting`",
    )
    suite: Annotated[str, one_of("suite", WORN_SUITES)] = Field(
        default="assembly", description="suite that scenarios and wearers are drawn from; see `tasks.worn_suites`"
    )
    control: Annotated[Control, BeforeValidator(_check_control)] = Field(
        default="equilibrium-point", description="control loop, one of those that feed the co-contraction forward"
    )
    track: Annotated[CostTrack, BeforeValidator(_check_track)] = Field(
        default=SCHEDULE, description="no other: the reward is that of the wearer"
    )
    reward_weights: Annotated[dict[str, float], AfterValidator(check_worn_weights)] | None = Field(
        default=None, description="reward term -> weight [1], instead of the default"
    )
    tension_range: TensionRange = Field(
        default=FEED_FORWARD_RANGE, description="co-contraction at action -1 and +1, as tension of both strings [N]"
    )
    privileged: Annotated[bool, AfterValidator(_check_privileged)] = Field(
        default=False, description="no other: the hidden state is not described"
    )

    @model_validator(mode="after")
    def _check_reflexes(self) -> Self:
        """Refuse devices whose control period is too short for the line of a reflex (`worn_layout.DELAY`)."""
        quantity = POPULATION["reflex_delay"]
        longest = quantity.shifted[1] if self.split == "shifted" else quantity.high
        for device in self.devices:
            if (ticks := reflex_ticks(longest, period := device.loop.control_period)) >= DELAY:
                raise AmulettError(
                    f"the device '{device.name}' has a loop.control_period of {period:g} s; the longest reflex delay "
                    f"of wearers in the split '{self.split}', {longest:g} s, takes {ticks:.0f} control ticks, and at "
                    f"most {DELAY - 1} are possible: the period has to be at least {longest / (DELAY - 1):.2g} s"
                )
        return self


class WornVectorSettings(WornSettings, VectorSettings):
    """Keywords of the vector version of `Amulett/Worn-v0`."""
