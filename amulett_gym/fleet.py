"""A *fleet*: several devices, of which each episode, or each block of a vector environment, has one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError, shorten, unknown
from amulett_gym.profile import Profile, is_shipped, load_profile, parse_profile, physics
from amulett_gym.settings import find_config
from amulett_gym.storage.reading import parse_json, read_text, visible
from amulett_gym.storage.safe_yaml import parse_yaml

MAX_BYTES = 20_000_000
"""Size of the largest file accepted: some thousand profiles."""


_KEYS = ("fleet", "loops_of")
"""Keys of a file with the devices of another fleet and the gains of a profile."""

_MOST_NAMED = 5
"""Most wrong profiles that an error describes."""


def fleet_names() -> tuple[str, ...]:
    """Return the names of the shipped fleets."""
    with resources.as_file(resources.files("amulett_gym") / "fleets") as folder:
        return tuple(path.stem for path in visible(folder, "*.yaml")) if folder.is_dir() else ()


def load_fleet(fleet: str | Path | Sequence[str | Path | Mapping[str, Any] | Profile]) -> tuple[Profile, ...]:
    """Return the validated profiles of a fleet.

    Parameters
    ----------
    fleet : str, Path or sequence
        A shipped fleet's name, a YAML or JSON file with a list of profiles, or such a list: names, files, mappings or
        Profiles (see `profile.load_profile`). A file can also hold the keys ``fleet``, one of these, and ``loops_of``,
        a profile whose group `loops` its devices get: other gains of the loops other than the paper's. Files that a
        file names are relative to its folder.

    Raises
    ------
    AmulettError
        If the name or file is unknown, the list is empty, a profile is wrong, or two have the same name.
    """
    if isinstance(fleet, str | Path):
        return _read(fleet)
    if not isinstance(fleet, Sequence):
        raise AmulettError(f"fleet is {fleet!r}; it has to be a name, a YAML or JSON file, or a list of profiles")
    return _checked(fleet)


def device_of(fleet: Sequence[Profile], name: str) -> Profile:
    """Return the device of a fleet with this name; AmulettError if there is none."""
    for profile in fleet:
        if profile.name == name:
            return profile
    raise unknown("device", name, [profile.name for profile in fleet])


def name_or_contents(fleet: Sequence[Profile]) -> str | list[str | dict[str, Any]]:
    """Return the name of a shipped fleet, or else `names_or_contents`."""
    known = (name for name in fleet_names() if load_fleet(name) == tuple(fleet))
    return next(known, None) or names_or_contents(fleet)


def in_words(fleet: str | Path | Sequence[Any]) -> str:
    """Return a fleet as ``the fleet plausible``, or, of one without a name, ``a fleet of 4 devices``."""
    if isinstance(fleet, str | Path):
        return f"the fleet {fleet}"
    return f"a fleet of {len(fleet)} device{'s' * (len(fleet) > 1)}"


def names_or_contents(fleet: Sequence[Profile]) -> list[str | dict[str, Any]]:
    """Return a fleet as JSON types: shipped profiles by their names, others by their content."""
    return [each.name if is_shipped(each) else each.model_dump(mode="json") for each in fleet]


def ranges(fleet: Sequence[Profile]) -> dict[str, str]:
    """Return the physics of a fleet's devices in words, by the key of `profile.physics`.

    That is a range, ``"0.02 to 0.05"``, a number that all have, or the values, ``"clamp or hold"``.
    """
    known = [physics(each) for each in fleet]
    keys = dict.fromkeys(key for each in known for key in each)
    return {key: _spread([each[key] for each in known if key in each]) for key in keys}


def outside(profile: Profile, fleet: Sequence[Profile]) -> dict[str, str]:
    """Return which physics of a device is outside the ranges of a fleet's devices.

    Returns
    -------
    dict
        Key of `profile.physics` -> the device's value and the fleet's, such as ``"0.1 (0.02 to 0.05)"``.
    """
    known = [physics(each) for each in fleet]
    found = {}
    for key, value in physics(profile).items():
        theirs = [each[key] for each in known if key in each]
        numbers = [each for each in theirs if _is_number(each)]
        margin = 1e-9 * max(map(abs, numbers), default=0.0)
        within = bool(numbers) and _is_number(value) and min(numbers) - margin <= value <= max(numbers) + margin
        if not within and value not in theirs:
            found[key] = f"{_spread([value])} ({_spread(theirs)})"
    return found


def _spread(values: Sequence[Any]) -> str:
    """Return values in words; long ones, such as measured curves, are not shown."""
    numbers = [each for each in values if _is_number(each)]
    words = dict.fromkeys("none" if each is None else shorten(str(each), 20) for each in values if each not in numbers)
    if numbers:
        low, high = min(numbers), max(numbers)
        words = {f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}": None, **words}
    return " or ".join(words) or "none"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _read(fleet: str | Path) -> tuple[Profile, ...]:
    if str(fleet) in fleet_names():
        return _shipped(str(fleet))
    if Path(fleet).suffix.lower() not in (".yaml", ".yml", ".json"):
        raise unknown("fleet", str(fleet), [*fleet_names(), "<file>.yaml", "<file>.json"])
    return _listed(find_config(fleet, "fleet"))


@cache
def _shipped(fleet: str) -> tuple[Profile, ...]:
    with resources.as_file(resources.files("amulett_gym") / "fleets" / f"{fleet}.yaml") as path:
        return _listed(path)


def _listed(path: Path) -> tuple[Profile, ...]:
    return parse_fleet(_file_content(path), path)


def _file_content(path: Path) -> Any:
    parse = parse_json if path.suffix.lower() == ".json" else parse_yaml
    return parse(read_text(path, "fleet", MAX_BYTES), f"fleet '{path}'")


def is_fleet(content: Any) -> bool:
    """Return whether a file's content is a fleet, and not one device or something else."""
    return isinstance(content, list) or (isinstance(content, dict) and "loops_of" in content)


def parse_fleet(content: Any, path: Path) -> tuple[Profile, ...]:
    """Return the profiles of a fleet that a file at `path` holds; errors as of `load_fleet`."""
    what = f"fleet '{path}'"
    if not isinstance(content, list | dict):
        raise AmulettError(
            f"{what} has to hold a list of profiles, or the keys fleet and loops_of, not {type(content).__name__}"
        )
    try:
        return _checked(content, path) if isinstance(content, list) else _with_loops(content, path)
    except AmulettError as error:
        raise AmulettError(f"{what}: {error}") from error


def _with_loops(content: Mapping[str, Any], path: Path) -> tuple[Profile, ...]:
    """Return the fleet that a file names, with the group `loops` of a profile."""
    for key in content:
        if key not in _KEYS:
            raise unknown("key", str(key), _KEYS)
    if missing := [key for key in _KEYS if content.get(key) is None]:
        raise AmulettError(f"{' and '.join(missing)} missing; it needs the keys {' and '.join(_KEYS)}")
    loops = _loaded(content["loops_of"], "loops_of", path).loops
    fleet = content["fleet"]
    if isinstance(fleet, str) and fleet not in fleet_names() and Path(fleet).suffix:
        path = find_config(fleet, "fleet", path.parent)
        if not isinstance(fleet := _file_content(path), list):
            raise AmulettError(f"its fleet '{path}' has to hold a list of profiles, not {type(fleet).__name__}")
    given = _checked(fleet, path) if isinstance(fleet, list) else load_fleet(fleet)
    return tuple(profile.model_copy(update={"loops": loops}) for profile in given)


def _loaded(item: Any, place: str, path: Path | None = None) -> Profile:
    """Return the profile that is given at `place`; files are relative to the folder of `path`, the fleet's file."""
    try:
        if isinstance(item, Mapping) and path is not None:
            return parse_profile(dict(item), path)
        if isinstance(item, str) and Path(item).suffix:
            item = find_config(item, "profile", Path() if path is None else path.parent)
        return load_profile(item)
    except AmulettError as error:
        raise AmulettError(f"{place}: {error}") from error


def _checked(items: Sequence[Any], path: Path | None = None) -> tuple[Profile, ...]:
    """Return the profiles of a list; AmulettError names all that are wrong, up to `_MOST_NAMED`."""
    if not items:
        raise AmulettError("a fleet needs at least one profile; the list is empty")
    profiles, wrong = [], []
    for place, item in enumerate(items):
        try:
            profiles.append(_loaded(item, f"profile {place}", path))
        except AmulettError as error:
            wrong.append(str(error))
    if wrong:
        more = f"; and {len(wrong) - _MOST_NAMED} more" if len(wrong) > _MOST_NAMED else ""
        raise AmulettError(f"{'; '.join(wrong[:_MOST_NAMED])}{more}")
    name, count = Counter(profile.name for profile in profiles).most_common(1)[0]
    if count > 1:
        raise AmulettError(f"{count} profiles of the fleet have the name '{name}'; their names have to differ")
    return tuple(profiles)
