"""The description of a benchmark over devices as data; the defaults are those of ``configs/devices.yaml``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, ValidationError, model_serializer, model_validator

from amulett_gym.envs.eq6_costs import device_digest
from amulett_gym.envs.reward import SCHEDULE
from amulett_gym.envs.settings import ControlLoop, CostTrack
from amulett_gym.envs.settings import Suite as SuiteName
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.evaluation.runner import MOST_EPISODES, YARDSTICK
from amulett_gym.fleet import fleet_names, load_fleet, names_or_contents
from amulett_gym.laws.parametric import BEST_CONSTANT, LAWS
from amulett_gym.profile import Positive, Profile, load_profile, profile_names
from amulett_gym.settings import Group, describe, find_config
from amulett_gym.studies.benchmark.description import PAPERS, QUICK_SEEDS, QUICK_STEPS, Bootstrap, Learned

Fleet = str | list[str | dict[str, Any]]

CONSTANT, OWN_CONSTANT = "best-constant", "own-constant"
"""Entries: the constant tuned on the training devices; the best constant of each judged device."""

EQ6_WITH_GAINS = "eq6-with-gains"
"""Entry: eq. 6 with the gains of a profile, `DevicesBenchmark.eq6_gains`; in the unit of the devices' own eq. 6."""

SPECIALIST, ADAPTED = "specialist", "adapted"
"""Entries: policies trained, or trained further, on the very device that they are judged on."""

QUICK_DEVICES, QUICK_EPISODES, QUICK_BUDGET, QUICK_SECONDS = (4, 2, 4), 6, 15_000, 3.0


LEAST_BUDGET = 160_000
"""Least number of simulated episodes of a tuning if the description names none.

It is that of `amulett tune-law` without a budget: with 30,000, the richer law's cost was 2 % higher.
"""


class Fleets(Group):
    """The devices, of which none is in two of the fleets."""

    train: Fleet = Field(default="plausible", description="to train and to tune on: a fleet's name, a file or a list")
    choose: Fleet = Field(default="plausible-choose", description="to choose policies and tuned laws by")
    judge: Fleet = Field(default="plausible-held-out", description="to judge by")


class Specialists(Group):
    """Trainings of the recipe on single devices, the first ones to judge by."""

    devices: int = Field(default=4, ge=0, le=1000, description="number of devices [1]")
    seeds: list[int] = Field(default=[0], min_length=1, description="training seeds for each device")
    set: list[str] = Field(default=["total_steps=5_000_000"], description="changes of the recipe")


class Adaptation(Group):
    """Further trainings of the learned policy on single devices, as `amulett train --start` does."""

    devices: int = Field(default=8, ge=0, le=1000, description="number of the first devices to judge by [1]")
    set: list[str] = Field(default=[], description="changes of the recipe of an adaptation")


class DevicesBenchmark(Group):
    """A benchmark over devices."""

    fleets: Fleets = Field(default=Fleets(), description="devices")
    track: CostTrack = Field(default=SCHEDULE, description="whose cost is compared: schedule, or full-control")
    loop: ControlLoop = Field(default=PAPERS, description="control loop in which laws are tuned and policies trained")
    suite: SuiteName = Field(default="mixed", description="suite of the scenarios")
    episodes: int = Field(
        default=100, ge=2, le=MOST_EPISODES, description="held-out scenarios, the same on each device [scenarios]"
    )
    seed: int = Field(default=20_000, ge=0, lt=2**63, description="seed of the first scenario [1]")
    duration: Positive = Field(default=10.0, le=1000, description="duration of an episode [s]")
    contenders: list[str] = Field(default=[], description="further laws or policy bundles to compare")
    eq6_gains: str | None = Field(
        default=None,
        description="profile with whose gains of the paper's loop eq. 6 also plays, a name or a file; costs are still "
        "divided by those with each device's gains; null: it does not",
    )
    laws: list[str] = Field(
        default=["constant", "eq6-tuned", "parametric"], description="laws that are tuned on the training devices"
    )
    budget: int | None = Field(
        default=None,
        ge=1,
        le=10**9,
        description="simulated episodes of each law's tuning; null: of one training, at least 160,000 [episodes]",
    )
    constant_scenarios: int = Field(
        default=40, ge=1, le=1000, description="training scenarios for the best constant of each judged device [1]"
    )
    learned: dict[str, Learned] = Field(
        default={"robust": Learned(recipe="robust.yaml", seeds=list(range(10)))},
        description="name of a learned entry -> its training runs on the training devices",
    )
    best_learned: str = Field(default="robust", description="the entry that the claims are about")
    specialists: Specialists = Field(default=Specialists(), description="its recipe on single devices")
    adaptation: Adaptation = Field(default=Adaptation(), description="its best policy, adapted to single devices")
    bootstrap: Bootstrap = Field(default=Bootstrap(), description="bootstrap of the intervals")

    @model_validator(mode="after")
    def _check(self) -> DevicesBenchmark:
        for law in self.laws:
            if law not in LAWS:
                raise unknown("law that can be tuned", law, LAWS)
        taken = [YARDSTICK, *map(entry_name, self.laws), *self.contenders, *self.learned]
        taken += [OWN_CONSTANT, EQ6_WITH_GAINS, SPECIALIST, ADAPTED]
        for name in taken:
            if taken.count(name) > 1:
                raise ValueError(
                    f"two contenders would be called '{name}'; a law with the shipped parameters is <law>:<suite>"
                )
        if self.best_learned not in self.learned:
            raise unknown("learned entry", self.best_learned, self.learned)
        for name, entry in self.learned.items():
            if entry.loops or entry.best_loop_seeds or entry.reference:
                raise ValueError(f"learned.{name}: loops, best_loop_seeds and reference are not for devices")
        return self

    @model_serializer(mode="wrap")
    def _leave_out(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out an option that came later, so that folders of older descriptions stay valid."""
        return {key: value for key, value in dump(self).items() if value is not None or key != "eq6_gains"}


def entry_name(law: str) -> str:
    """Return the name of the entry of a law that is tuned here."""
    return CONSTANT if law == BEST_CONSTANT.name else law


def quick(description: DevicesBenchmark, folder: Path) -> DevicesBenchmark:
    """Return a small benchmark of the same parts, as a test of the installation; claims are not judged by it.

    A few devices of each fleet, of which files are relative to `folder`, few scenarios, two seeds of short training of
    the entry that the claims are about, short tuning, one specialist, one adaptation.
    """
    best = description.learned[description.best_learned]
    short = [f"total_steps={QUICK_STEPS}", f"validation.every_steps={QUICK_STEPS // 2}", "ppo.critic_steps=null"]
    fleets = {
        key: names_or_contents(load(getattr(description.fleets, key), folder)[:count])
        for key, count in zip(("train", "choose", "judge"), QUICK_DEVICES, strict=True)
    }
    learned = best.model_copy(update={"seeds": best.seeds[:QUICK_SEEDS], "set": [*best.set, *short]})
    few, adapted = description.specialists, description.adaptation
    more = {
        "fleets": fleets,
        "episodes": min(description.episodes, QUICK_EPISODES),
        "budget": min(description.budget or QUICK_BUDGET, QUICK_BUDGET),
        "constant_scenarios": min(description.constant_scenarios, QUICK_EPISODES),
        "learned": {description.best_learned: learned.model_dump()},
        "specialists": {"devices": min(few.devices, 1), "seeds": few.seeds[:1], "set": [*few.set, *short]},
        "adaptation": {"devices": min(adapted.devices, 1), "set": [*adapted.set, f"max_seconds={QUICK_SECONDS}"]},
        "bootstrap": {"resamples": min(description.bootstrap.resamples, 1000)},
    }
    return DevicesBenchmark.model_validate({**description.model_dump(), **more})


def parse_devices_benchmark(content: Mapping[str, Any], path: str | Path) -> DevicesBenchmark:
    """Return the description that a file at `path` holds; AmulettError if a key is unknown or a value is wrong."""
    try:
        return DevicesBenchmark.model_validate(content)
    except ValidationError as error:
        raise describe(error, DevicesBenchmark, f"benchmark '{path}'") from error


def load(fleet: Fleet, folder: Path) -> tuple[Profile, ...]:
    """Return the devices of a fleet of the description, whose files are relative to its `folder`."""
    return load_fleet(find_config(str(fleet), "fleet", folder) if _is_file(fleet) else fleet)


def load_fleets(description: DevicesBenchmark, folder: Path) -> dict[str, tuple[Profile, ...]]:
    """Return the devices by the key in `fleets`.

    Raises
    ------
    AmulettError
        If a fleet cannot be read, or a device is in two of them, also by another name.
    """
    found = {key: load(getattr(description.fleets, key), folder) for key in Fleets.model_fields}
    seen: dict[str, tuple[str, str]] = {}
    for key, fleet in found.items():
        for profile in fleet:
            for mark in (device_digest(profile), profile.name):
                other, name = seen.setdefault(mark, (key, profile.name))
                if other != key:
                    raise AmulettError(
                        f"'{profile.name}' of fleets.{key} is the device '{name}' of fleets.{other}, or has its name; "
                        "no device may be in two fleets"
                    )
    return found


def eq6_gains(description: DevicesBenchmark, folder: Path) -> Profile | None:
    """Return the profile with whose gains eq. 6 also plays; files are relative to the description's `folder`."""
    given = description.eq6_gains
    if given is None or given in profile_names():
        return None if given is None else load_profile(given)
    return load_profile(find_config(given, "profile", folder))


def as_override(fleet: Fleet, folder: Path) -> str:
    """Return a fleet as a value in a recipe's overrides."""
    if _is_file(fleet):
        return json.dumps(str(find_config(str(fleet), "fleet", folder).resolve()))
    return json.dumps(fleet)


def _is_file(fleet: Fleet) -> bool:
    return isinstance(fleet, str) and fleet not in fleet_names() and bool(Path(fleet).suffix)
