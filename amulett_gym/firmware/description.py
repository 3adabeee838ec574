"""What a firmware folder is: its law, loop and device, as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amulett_gym.envs.settings import Settings
from amulett_gym.errors import AmulettError
from amulett_gym.laws.copies import FOLDER, Files, kept_policies
from amulett_gym.storage.reading import read_bytes, read_json, user_path, visible

MANIFEST = "manifest.json"
"""File of a firmware folder that describes it."""

KEYS = ("profile", "control", "tension_law", "tension_range", "agent_period", "action_delay")
"""Keywords of the environments that a firmware fixes."""

_MOST = 1_000_000  # bytes
_SOURCES = (".c", ".h", ".ino", ".json", ".md")


@dataclass(frozen=True)
class Description:
    """A firmware folder's content.

    Attributes
    ----------
    folder : Path
    law : str
        Name of the contender that the folder was exported from.
    contender : str
        The same contender's name if it is a policy of which the folder has a copy: that of the copy.
    keywords : dict
        The environment's, in which the law acts: `KEYS`.
    """

    folder: Path
    law: str
    contender: str
    keywords: dict[str, Any]


def read_description(folder: str | Path) -> Description:
    """Read a folder's ``manifest.json``.

    Raises
    ------
    AmulettError
        If there is none, or its content is wrong.
    """
    path = user_path(folder) / MANIFEST
    if not path.exists():
        raise AmulettError(f"'{folder}' is no firmware: it has no {MANIFEST}; make one with 'amulett export'")
    content = read_json(path, "firmware's description", _MOST)
    wanted = {"law": str, "control": str, "keywords": dict, "profile": dict}
    if not isinstance(content, dict) or not all(isinstance(content.get(key), wanted[key]) for key in wanted):
        raise AmulettError(f"'{path}' has to have the keys {', '.join(wanted)}; make it anew with 'amulett export'")
    given = {key: content["keywords"][key] for key in KEYS if key in content["keywords"]}
    given |= {"control": content["control"], "profile": content["profile"]}
    settings = Settings.read(given, str(path))
    law = str(content["law"])
    contender = kept_policies(folder, content.get("kept", {})).get(law, law)
    return Description(user_path(folder), law, contender, {key: getattr(settings, key) for key in KEYS})


def firmware_content(folder: str | Path) -> Files:
    """Return the files of a firmware folder by their relative paths, without what a compiler has made of them.

    Raises
    ------
    AmulettError
        If it is no firmware, or a file cannot be read.
    """
    place = read_description(folder).folder
    paths = [path for path in visible(place) if path.name == "Makefile" or path.suffix in _SOURCES]
    paths += [path for path in visible(place, f"{FOLDER}/**/*") if path.is_file()]
    return {path.relative_to(place).as_posix(): read_bytes(path, "file of a firmware") for path in paths}
