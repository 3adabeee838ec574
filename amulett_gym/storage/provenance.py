"""``command.json``, in which a command describes itself in the folder that it writes, for `amulett rerun`."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import amulett_gym
from amulett_gym.errors import AmulettError, other_version, shorten
from amulett_gym.settings import describe
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.writing import write_json

COMMAND = "command.json"
"""File that describes the command that wrote a folder."""

FORMAT = 1
"""Version of that file's format."""

PACKAGES = ("amulett-gym", "gymnasium", "numpy", "numba", "scipy", "torch", "stable-baselines3")
"""Packages that results may depend on."""


class Provenance(BaseModel):
    """Content of ``command.json``."""

    model_config = ConfigDict(frozen=True, strict=True)

    version: Literal[1] = Field(default=1, description="of this format")
    kind: str | None = Field(default=None, description="the command's name; null: a training run of an early version")
    command: list[str] | None = Field(description="its words, `amulett` first; null: called from Python")
    working_folder: str | None = Field(default=None, description="base of relative paths in the command")
    config: dict[str, Any] = Field(default={}, description="all settings, given or by default")
    seeds: list[int] = Field(default=[], description="seeds that the results depend on")
    versions: dict[str, str] = Field(description="package -> version")
    git_revision: str | None = Field(description="of the checkout, -dirty if edited; null: a wheel")


def machine() -> str:
    """Return the processor, its cores and the versions of Python and numba, as a sentence."""
    names = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    name = [*names, platform.machine()][0]
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}, numba {version('numba')}."


def write_provenance(
    folder: str | Path, kind: str, config: Mapping[str, Any], seeds: Sequence[int], command: Sequence[str] | None = None
) -> None:
    """Write ``command.json`` of a command into the folder that it writes; the fields are those of `Provenance`.

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
    """Return the description of the command that wrote a folder.

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
        raise other_version(f"'{path}'", found, FORMAT, "run the command in it again")
    try:
        return Provenance.model_validate(content)
    except ValidationError as error:
        raise describe(error, Provenance, f"'{path}'") from error


def process_words() -> list[str]:
    """Return the words of the `amulett` command that this process runs."""
    return ["amulett", *sys.argv[1:]]


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed ones of `PACKAGES`."""
    return {"python": platform.python_version(), **_installed()}


@cache
def _installed() -> dict[str, str]:
    """Return the versions of the installed ones of `PACKAGES`, which all of the Python path is searched for."""
    found = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


@cache
def git_revision() -> str | None:
    """Return the git revision of the checkout that amulett-gym runs from, ``-dirty`` if edited; None from a wheel.

    Cached: later edits do not change the code that this process has imported.
    """
    root = Path(amulett_gym.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    words = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def differences(old: Any, new: Any, name: str = "") -> list[str]:
    """Return a line ("key was x and is y") for each difference of two trees of plain data."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(key for key in new if key not in old)]
        pairs = [(str(key), old.get(key), new.get(key)) for key in keys]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = [(str(k), *both) for k, both in enumerate(zip(old, new, strict=True))]
    else:
        return [] if old == new else [f"{name} was {shorten(repr(old))} and is {shorten(repr(new))}"]
    return [line for key, was, now in pairs for line in differences(was, now, f"{name}.{key}" if name else key)]


def software_changes(note: Provenance) -> list[str]:
    """Return a line for each difference of the software from that which wrote a folder."""
    return differences(
        {**note.versions, "git revision": note.git_revision}, {**versions(), "git revision": git_revision()}
    )
