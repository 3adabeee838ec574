"""Studies that a user made with `amulett identify`: their files, read and checked against the shipped study."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.identification.parameters import PARAMETERS, devices, same_device
from amulett_gym.profile import Profile, load_profile
from amulett_gym.storage.reading import read_json, read_text
from amulett_gym.storage.writing import write_text
from amulett_gym.studies.paper.reproduction import ALTERNATIVES, Readings
from amulett_gym.studies.paper.study import STUDY_MARKS, shipped
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES

_KINDS: dict[Any, str] = {
    bool: "true or false",
    (int, float): "a number",
    str: "text",
    list: "a list that is not empty",
    dict: "a mapping",
}


@dataclass(frozen=True)
class OwnStudy:
    """A study's folder, its content as `study` returned it, and its devices by `tables.DEVICES`."""

    folder: str
    identification: dict[str, Any]
    profiles: dict[str, Profile]


def read_study(folder: str | Path) -> OwnStudy:
    """Read ``identification.json`` and both profiles from a folder that `amulett identify` wrote.

    Raises AmulettError if there is no study, or one that is not finished, was made under other readings or for other
    parameters, or whose files cannot be read, lack a key or do not belong together.
    """
    path = Path(folder) / "identification.json"
    if not path.is_file():
        if any((Path(folder) / mark).is_file() for mark in STUDY_MARKS):
            raise AmulettError(
                f"the study in '{folder}' is not finished; `amulett identify --out {folder}` continues it"
            )
        raise AmulettError(f"'{folder}' holds no study: '{path}' is missing; `amulett identify` writes one")
    content = read_json(path, "study")
    _check(content, f"study '{path}'")
    profiles = {name: load_profile(Path(folder) / f"{name}.yaml") for name in DEVICES}
    values = {entry["name"]: entry["value"] for entry in content["spread"]}
    expected = devices(values, content["readings"]["spring_end"])
    for name, profile in profiles.items():
        if not same_device(profile, expected[name]):
            raise AmulettError(
                f"'{Path(folder) / f'{name}.yaml'}' does not describe the device of '{path}'; "
                f"`amulett identify --out {folder}` writes both again"
            )
    return OwnStudy(str(folder), content, profiles)


def copy_study(folder: str | Path, place: Path) -> None:
    """Copy the files that `read_study` reads into the folder `place`."""
    place.mkdir(exist_ok=True)
    for name in ("identification.json", *(f"{device}.yaml" for device in DEVICES)):
        write_text(place / name, read_text(Path(folder) / name, "study"))


def _check(found: Any, what: str) -> None:
    """Refuse content that is no study, or one with other readings, parameters or configurations than this version's."""
    _check_kind(found, shipped(), what, "")
    other = [
        f"{name} {found['readings'].get(name)} (not {choice})"
        for name, choice in asdict(Readings()).items()
        if found["readings"].get(name) != choice
    ]
    if other:
        raise AmulettError(f"{what} was made under other readings: {', '.join(other)}; identify again")
    if any(len(entry["bounds"]) != 2 for entry in found["spread"]):
        raise AmulettError(f"{what}: each 'bounds' in 'spread' has to hold two numbers")
    _check_names(f"{what}: 'without'", found["without"], CONFIGURATIONS)
    refitted = [f"{item['reading']} {item['choice']}" for item in found["readings_refitted"]]
    # The shipped study is older than some readings and has no fits under these; its tables leave them empty.
    fitted_there = {f"{item['reading']} {item['choice']}" for item in shipped()["readings_refitted"]}.union(refitted)
    names = [name for name in (f"{name} {choice}" for name, choice in ALTERNATIVES) if name in fitted_there]
    _check_names(f"{what}: 'readings_refitted'", refitted, names)
    fitted = {"spread": {entry["name"]: entry["value"] for entry in found["spread"]}}
    fitted |= {f"without.{name}": parameters for name, parameters in found["without"].items()}
    fitted |= {f"springs.{k}.parameters": spring["parameters"] for k, spring in enumerate(found["springs"])}
    for where, parameters in fitted.items():
        _check_names(f"{what}: '{where}'", parameters, [free.name for free in PARAMETERS])
        for free in PARAMETERS:
            value = parameters[free.name]
            if value < 0.0 or value == 0.0 < free.low:
                raise AmulettError(f"{what}: '{where}.{free.name}' is {value:g}; it has to be greater")


def _check_kind(given: Any, wanted: Any, what: str, where: str) -> None:
    """Refuse content that lacks a key of the shipped study, or has a value of another type there."""
    place = f"{what}: '{where}'" if where else what
    if isinstance(wanted, dict) and isinstance(given, dict):
        if missing := [key for key in wanted if key not in given]:
            raise AmulettError(f"{place} lacks {', '.join(missing)}; identify again with this version")
        for key, item in wanted.items():
            _check_kind(given[key], item, what, f"{where}.{key}".lstrip("."))
    elif isinstance(wanted, list) and isinstance(given, list) and given:
        for k, item in enumerate(given):
            _check_kind(item, wanted[0], what, f"{where}.{k}")
    else:
        kind = next(kind for kind in _KINDS if isinstance(wanted, kind))
        if kind is list or not isinstance(given, kind) or (isinstance(given, bool) and kind is not bool):
            raise AmulettError(f"{place} is {str(given)[:80]!r}; it has to be {_KINDS[kind]}")


def _check_names(where: str, given: Iterable[str], names: Sequence[str]) -> None:
    there = set(given)
    if missing := [name for name in names if name not in there]:
        raise AmulettError(f"{where} lacks {', '.join(missing)}; identify again with this version")
    if unknown := sorted(there.difference(names)):
        raise AmulettError(f"{where} has {', '.join(unknown)}, which this version does not know; identify again")
