"""A study that a user made with `amulett identify`, read back from its folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import describe
from amulett_gym.storage.reading import read_json
from amulett_gym.studies.paper.identification import PARAMETERS, devices
from amulett_gym.studies.paper.reproduction import ALTERNATIVES, Readings
from amulett_gym.studies.paper.study import STUDY_MARKS, same_device
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES


@dataclass(frozen=True)
class OwnStudy:
    """A study and its devices.

    Attributes
    ----------
    folder : str
        As it was given.
    identification : dict
        As `study.study` returned it.
    profiles : dict of str to Profile
        By `tables.DEVICES`.
    """

    folder: str
    identification: dict[str, Any]
    profiles: dict[str, Profile]


def read_study(folder: str | Path) -> OwnStudy:
    """Read ``identification.json`` and both profiles from a folder that `amulett identify` wrote.

    Raises
    ------
    AmulettError
        If there is no study, or one that is not finished, was made under other readings or for other parameters, or
        whose files cannot be read, lack a key or do not belong together.
    """
    path = Path(folder) / "identification.json"
    if not path.is_file():
        if any((Path(folder) / mark).is_file() for mark in STUDY_MARKS):
            raise AmulettError(f"the study in '{folder}' is not finished; `amulett identify --out {folder}` goes on")
        raise AmulettError(f"'{folder}' holds no study: '{path}' is missing; `amulett identify` writes one")
    content = read_json(path, "study")
    try:
        found = _Study.model_validate(content)
    except ValidationError as error:
        raise describe(error, _Study, f"study '{path}'") from error
    _check(found, f"study '{path}'")
    profiles = {name: load_profile(Path(folder) / f"{name}.yaml") for name in DEVICES}
    expected = devices({entry.name: entry.value for entry in found.spread})
    for name, profile in profiles.items():
        if not same_device(profile, expected[name]):
            raise AmulettError(
                f"'{Path(folder) / f'{name}.yaml'}' does not describe the device of '{path}'; "
                f"`amulett identify --out {folder}` writes both anew"
            )
    return OwnStudy(str(folder), content, profiles)


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


_NonNegative = Annotated[float, Field(ge=0)]


class _Entry(_Part):
    name: str
    unit: str
    value: _NonNegative
    low: float
    high: float
    bounds: Annotated[list[float], Field(min_length=2, max_length=2)]
    determined: bool
    source: str


class _Start(_Part):
    seed: int
    cost: float


class _Spring(_Part):
    law: str
    length_ratio: float
    cost: float
    met: int
    of: int
    stiffening: float


class _Reading(_Part):
    reading: str
    choice: str
    cost: float
    explained: int


class _Recipe(_Part):
    seeds: list[int]


class _Ensemble(_Part):
    least_cost: float
    equal_cost: float


class _Study(_Part):
    """What is read of ``identification.json``."""

    recipe: _Recipe
    readings: dict[str, str]
    cost: float
    explained: int
    of: int
    spread: list[_Entry]
    ensemble: _Ensemble
    starts: Annotated[list[_Start], Field(min_length=1)]
    springs: list[_Spring]
    readings_refitted: list[_Reading]
    without: dict[str, dict[str, _NonNegative]]


def _check(found: _Study, what: str) -> None:
    """Refuse a study of other readings, parameters or configurations than those of this version."""
    other = [
        f"{name} {found.readings.get(name)} (not {choice})"
        for name, choice in asdict(Readings()).items()
        if found.readings.get(name) != choice
    ]
    if other:
        raise AmulettError(f"{what} was made under other readings: {', '.join(other)}; identify anew")
    parameters = [free.name for free in PARAMETERS]
    _same(f"{what}: 'without'", found.without, CONFIGURATIONS)
    chosen = {entry.name: entry.value for entry in found.spread}
    for where, fitted in {
        "spread": chosen,
        **{f"without.{name}": found.without[name] for name in CONFIGURATIONS},
    }.items():
        _same(f"{what}: '{where}'", fitted, parameters)
        for free in PARAMETERS:
            if fitted[free.name] == 0.0 < free.low:
                raise AmulettError(f"{what}: '{where}.{free.name}' is 0; it has to be greater")
    refitted = [f"{item.reading} {item.choice}" for item in found.readings_refitted]
    _same(f"{what}: 'readings_refitted'", refitted, [f"{name} {choice}" for name, choice in ALTERNATIVES])


def _same(where: str, given: Iterable[str], names: Iterable[str]) -> None:
    there, wanted = set(given), set(names)
    if missing := [name for name in names if name not in there]:
        raise AmulettError(f"{where} lacks {', '.join(missing)}; identify anew with this version")
    if unknown := sorted(there - wanted):
        raise AmulettError(f"{where} has {', '.join(unknown)}, which this version does not know; identify anew")
