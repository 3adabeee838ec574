"""Where numbers come from: the command, its resolved configuration, versions, git revision and seeds.

A command that writes a folder describes itself there in ``command.json``, which `amulett rerun` reads.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import amulett_gym
from amulett_gym.errors import AmulettError, other_version
from amulett_gym.settings import describe
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.writing import write_json

COMMAND = "command.json"
"""File that describes the command that wrote a folder."""

FORMAT = 1
"""Version of that file's format."""

PACKAGES = ("amulett-gym", "gymnasium", "numpy", "numba", "scipy", "torch", "stable-baselines3")
"""What results may depend on."""


class Provenance(BaseModel):
    """Content of ``command.json``."""

    model_config = ConfigDict(frozen=True, strict=True)

    version: Literal[1] = Field(default=1, description="of this format")
    kind: str | None = Field(default=None, description="the command's name; null: a training run of an early version")
    command: list[str] | None = Field(description="the words, `amulett` first; null: it was called from Python")
    working_folder: str | None = Field(default=None, description="where relative paths in them begin")
    config: dict[str, Any] = Field(default={}, description="all that was chosen, by words or by default")
    seeds: list[int] = Field(default=[], description="that the results depend on")
    versions: dict[str, str] = Field(description="package -> version")
    git_revision: str | None = Field(description="of the checkout, -dirty if edited; null: installed from a wheel")


def machine() -> str:
    """Return in words what this process runs on: processor, cores, Python and numba."""
    names = [platform.machine()]
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")][:1] or names
    except OSError:
        pass
    return f"{names[0]}, {os.cpu_count()} cores, Python {platform.python_version()}, numba {version('numba')}."


def write_provenance(
    folder: str | Path, kind: str, config: Mapping[str, Any], seeds: Sequence[int], command: Sequence[str] | None = None
) -> None:
    """Write a description of the command that writes a folder into it.

    Parameters
    ----------
    folder : str or Path
    kind : str
        The command's name.
    config : mapping
        All that was chosen, as plain data.
    seeds : sequence of int
    command : sequence of str, optional
        The words of the command, those of the process if it is one of `amulett`.

    Raises
    ------
    AmulettError
        If it cannot be written.
    """
    note = Provenance(
        kind=kind,
        command=None if command is None else list(command),
        working_folder=str(Path.cwd()),
        config=dict(config),
        seeds=list(seeds),
        versions=versions(),
        git_revision=git_revision(),
    )
    write_json(Path(folder) / COMMAND, note.model_dump())


def read_provenance(folder: str | Path) -> Provenance:
    """Read the description of the command that wrote a folder.

    Raises
    ------
    AmulettError
        If there is no ``command.json``, or it is damaged.
    """
    path = user_path(folder) / COMMAND
    if not path.is_file():
        raise AmulettError(f"'{folder}' was not written by a command that can be run again: there is no {COMMAND}")
    content = read_json(path, "note of a command", limit=400_000_000)
    found = content.get("version", FORMAT) if isinstance(content, dict) else FORMAT
    if isinstance(found, int) and found != FORMAT:
        raise other_version(f"'{path}'", found, FORMAT, "give the command that it holds again")
    try:
        return Provenance.model_validate(content)
    except ValidationError as error:
        raise describe(error, Provenance, f"'{path}'") from error


def process_words() -> list[str]:
    """Return the words of the command that this process runs."""
    return ["amulett", *sys.argv[1:]]


def versions() -> dict[str, str]:
    """Return the versions of `PACKAGES`, those that are installed, and of Python."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


@cache
def git_revision() -> str | None:
    """Return the git revision of the checkout that amulett-gym runs from, ``-dirty`` if edited; None from a wheel.

    It is asked once: what this process has imported stays, whatever is edited later.
    """
    root = Path(amulett_gym.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def differences(old: Any, new: Any, name: str = "") -> list[str]:
    """Return in words where two trees of plain data differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(key for key in new if key not in old)]
        pairs = [(str(key), old.get(key), new.get(key)) for key in keys]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = [(str(k), *both) for k, both in enumerate(zip(old, new, strict=True))]
    else:
        return [] if old == new else [f"{name} was {_shown(old)} and is {_shown(new)}"]
    found = [differences(was, now, f"{name}.{key}" if name else key) for key, was, now in pairs]
    return [difference for some in found for difference in some]


def software_changes(note: Provenance) -> list[str]:
    """Return in words what of the software is another one than when a folder was written."""
    return differences(
        {**note.versions, "git revision": note.git_revision}, {**versions(), "git revision": git_revision()}
    )


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]}..."
