"""The description of the study as data; the defaults are those of ``configs/wearer.yaml``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, field_validator

from amulett_gym.envs.settings import one_of
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import Group, describe, find_config, merge
from amulett_gym.simulation.layout import CONTROLS, DRIVES, Control
from amulett_gym.simulation.random import derive_keys, keys_from_seeds, uniform
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.studies.wearer.baselines import BASELINES, BY_INTENTION
from amulett_gym.studies.wearer.search import Budget
from amulett_gym.tasks.suites import episode_keys
from amulett_gym.tasks.wearer import between
from amulett_gym.tasks.worn_suites import WORN_SUITES

Count = Annotated[int, Field(ge=1, le=20_000)]
Suite = Annotated[str, one_of("suite", WORN_SUITES)]

_LOOPS = ("equilibrium-point", "co-rotation", "cascade", "torque")


_CABLE_STREAM = 5  # of an episode's key; 0 to 4 are those of `tasks.suites`, `tasks.wearer`, `tasks.worn_suites`


def _check_range(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"{ends[0]:g} to {ends[1]:g}; the first has to be the least")
    return ends


class Search(Group):
    """Size of a search."""

    population: int = Field(default=12, ge=2, le=1000, description="candidates in each iteration")
    iterations: int = Field(default=10, ge=1, le=1000, description="iterations")

    @property
    def budget(self) -> Budget:
        """As the search takes it."""
        return Budget(self.population, self.iterations)


class Tuning(Search):
    """How each baseline is tuned."""

    population: int = Field(default=20, ge=2, le=1000, description="candidates in each iteration")
    iterations: int = Field(default=16, ge=1, le=1000, description="iterations")
    episodes: Count = Field(default=32, description="training scenarios of each candidate")
    validation: Count = Field(default=64, description="validation scenarios, on which one of the searches is chosen")
    starts: int = Field(default=2, ge=1, le=20, description="searches, from the device's admittance and from elsewhere")


class Clairvoyant(Search):
    """Search for each scenario."""

    population: int = Field(default=16, ge=2, le=1000, description="candidates in each iteration")
    iterations: int = Field(default=10, ge=1, le=1000, description="iterations")
    scenarios: Count = Field(default=12, description="held-out scenarios")


class HeadroomPlan(Search):
    """How much there is to gain, per suite and loop."""

    iterations: int = Field(default=6, ge=1, le=1000, description="iterations")
    episodes: Count = Field(default=16, description="training scenarios of each candidate")
    held_out: Count = Field(default=32, description="held-out scenarios")
    clairvoyant: Clairvoyant = Field(default=Clairvoyant(), description="search for each scenario")
    loops: dict[str, list[str]] = Field(
        default={
            suite: [*_LOOPS, *(["decentralized"] if suite == "assembly" else [])]
            for suite in ("assembly", "reaches", "carry", "guided", "tremor")
        },
        description="suite -> control loops",
    )
    least: float = Field(
        default=0.05, ge=0, le=1, description="gain over the best constant below which a suite is without headroom [1]"
    )

    @field_validator("loops")
    @classmethod
    def _check_loops(cls, loops: dict[str, list[str]]) -> dict[str, list[str]]:
        choices = [loop for loop in CONTROLS if loop not in ("position-only", DRIVES)]
        for suite, names in loops.items():
            if suite not in WORN_SUITES:
                raise unknown("suite", suite, WORN_SUITES)
            for name in names:
                if name not in choices:
                    raise unknown("control loop", name, choices)
        return loops


class Bend(Group):
    """Bowden cables of both strings."""

    friction: float = Field(ge=0, le=1, description="mu [1]")
    bend_deg: float = Field(ge=0, le=1440, description="theta, total bend of each sheath [deg]")

    @property
    def name(self) -> str:
        """As tables name it."""
        return f"mu {self.friction:g}, {self.bend_deg:g} deg"


Mu = Annotated[float, Field(ge=0, le=1)]
Theta = Annotated[float, Field(ge=0, le=1440)]  # [deg]


class CableRanges(Group):
    """Ranges from which each held-out wearer has Bowden cables of their own, both strings the same."""

    friction: Annotated[tuple[Mu, Mu], AfterValidator(_check_range)] = Field(
        default=(0.05, 0.2), description="least and most mu [1]"
    )
    bend_deg: Annotated[tuple[Theta, Theta], AfterValidator(_check_range)] = Field(
        default=(90.0, 360.0), description="least and most theta [deg]"
    )

    @property
    def name(self) -> str:
        """As tables name it."""
        return "drawn"

    @property
    def most(self) -> Bend:
        """The cables with the most friction."""
        return Bend(friction=self.friction[1], bend_deg=self.bend_deg[1])

    def draw(self, seed: int, count: int) -> list[Bend]:
        """Return the cables of the first `count` held-out wearers; those of a wearer do not depend on the others."""
        keys = keys_from_seeds(np.arange(seed, seed + count).astype(object))
        keys = derive_keys(episode_keys(keys, np.zeros(count, dtype=np.uint64), "held-out"), _CABLE_STREAM)
        frictions, bends = uniform(keys, 2).T
        drawn = zip(between(frictions, *self.friction, 4), between(bends, *self.bend_deg, 1), strict=True)
        return [Bend(friction=friction, bend_deg=bend) for friction, bend in drawn]


class Description(Group):
    """A study of worn devices."""

    profile: str | dict[str, Any] = Field(default="worn", description="device: name, YAML file, or a mapping")
    suite: Suite = Field(default="assembly", description="suite of the comparison")
    control: str = Field(default="co-rotation", description="control loop of the comparison")
    seed: int = Field(default=0, ge=0, description="of the first scenario of each split")
    held_out: Count = Field(default=128, description="held-out scenarios of the comparison, each with its own wearer")
    tuning: Tuning = Field(default=Tuning(), description="how each baseline is tuned")
    headroom: HeadroomPlan = Field(default=HeadroomPlan(), description="how much there is to gain")
    cables: list[Bend] = Field(
        default=[
            Bend(friction=0.05, bend_deg=90.0),
            Bend(friction=0.1, bend_deg=180.0),
            Bend(friction=0.15, bend_deg=270.0),
            Bend(friction=0.2, bend_deg=360.0),
        ],
        description="Bowden cables with which the comparison is repeated",
    )
    drawn_cables: CableRanges | None = Field(
        default=CableRanges(),
        description="ranges of cables that are drawn for each held-out wearer, as one more repetition; null: none",
    )
    side: Literal["joint", "drive"] = Field(default="joint", description="where the cables are: joint or drive")
    resamples: int = Field(default=4000, ge=10, le=100_000, description="of the bootstrap intervals")

    @field_validator("control")
    @classmethod
    def _check_control(cls, control: str) -> str:
        if control not in CONTROLS[2:]:
            raise unknown("control loop", control, CONTROLS[2:])
        return control

    def device(self) -> Profile:
        """Return the device."""
        return load_profile(self.profile)

    @property
    def repetitions(self) -> list[Bend | CableRanges]:
        """All cables with which the comparison is repeated."""
        return [*self.cables, *([] if self.drawn_cables is None else [self.drawn_cables])]

    def with_cable(self, device: Profile, cable: Bend, name: str | None = None) -> Profile:
        """Return a device with Bowden cables, and perhaps another name."""
        bends = {"bend_biceps_deg": cable.bend_deg, "bend_triceps_deg": cable.bend_deg}
        changes = {"friction": cable.friction, "side": self.side, **bends}
        named = {"name": device.name if name is None else name, "wearer": {"cable": changes}}
        return load_profile(merge(device.model_dump(), named))

    def with_drawn_cables(self, device: Profile, ranges: CableRanges) -> list[Profile]:
        """Return a device for each held-out wearer."""
        cables = ranges.draw(self.seed, self.held_out)
        return [self.with_cable(device, cable, f"{device.name} {k}") for k, cable in enumerate(cables)]


def quick(description: Description) -> Description:
    """Return the study as a test of seconds: one loop, few scenarios, tiny searches."""
    tiny = {"population": 3, "iterations": 1}
    suite, control = description.suite, description.control
    changes = {
        "held_out": 4,
        "tuning": {**tiny, "episodes": 2, "validation": 2, "starts": 1},
        "headroom": {
            **tiny,
            "episodes": 2,
            "held_out": 3,
            "clairvoyant": {**tiny, "scenarios": 2},
            "loops": {suite: [control]},
        },
        "cables": [cable.model_dump() for cable in description.cables[-1:]],
        "resamples": 50,
    }
    return Description.model_validate({**description.model_dump(), **changes})


def load_description(path: str | Path | None) -> Description:
    """Return the study of a YAML file, or with None the default one.

    Raises
    ------
    AmulettError
        If the file cannot be read, or a key or value is not valid.
    """
    content = {} if path is None else read_yaml(find_config(path, "study of wearers"), "study of wearers")
    return parse_description(content, path)


def parse_description(content: Any, path: str | Path | None) -> Description:
    """Return the study that a file at `path` holds, or with None the default one; errors as of `load_description`."""
    try:
        found = Description.model_validate(content)
    except ValidationError as error:
        raise describe(error, Description, "study of wearers" if path is None else f"'{path}'") from error
    device = found.device()
    # Laws act at the environment's default agent period, which has to fit the device.
    WornSettings.read({"profile": device, "split": "held-out"}, f"the device '{device.name}' of the study")
    for cable in (*found.cables, *(each.most for each in found.repetitions if isinstance(each, CableRanges))):
        found.with_cable(device, cable)
    return found


def loops_of(description: Description) -> list[tuple[str, Control]]:
    """Return the pairs of suite and loop whose headroom is measured."""
    return [(suite, loop) for suite, loops in description.headroom.loops.items() for loop in loops]  # type: ignore[misc]


def distinct(policies: list[str]) -> list[str]:
    """Return policies' names without repetitions; refuse one that a baseline has."""
    if taken := [name for name in policies if name in (*BASELINES, *BY_INTENTION)]:
        raise AmulettError(f"a policy is called '{taken[0]}', as a baseline is; a folder of this name is ./{taken[0]}")
    return list(dict.fromkeys(policies))
