"""Copies of the policies that a command used, kept in the folder that it fills: ``kept_policies/<number>/``.

Each file or folder that is the source of a policy is kept once, even if several names refer to it. The record of the
copies, for the folder's ``command.json``, maps the policies' names to their copies and their files' SHA-256.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import FILES, MANIFEST, OPTIONAL
from amulett_gym.laws.contenders import CONSTANT, contender_names, python_file, split_loop
from amulett_gym.storage.reading import read_bytes, user_path

FOLDER = "kept_policies"

Files = dict[str, bytes]
"""Path relative to the copy -> content."""

_MOST_BYTES = 400_000_000  # of a file; a bundle has some tens of kB, a zip rarely more than some MB


@dataclass(frozen=True)
class Copies:
    """The content of the policies with sources in files.

    Attributes
    ----------
    record : dict
        Policy's name -> ``{"copy": number, "sha256": {path in the copy: SHA-256}}``; plain data.
    files : list of dict
        The copies' files, by number.
    """

    record: dict[str, dict[str, Any]] = field(default_factory=dict)
    files: list[Files] = field(default_factory=list)

    def add(self, name: str, files: Files) -> int:
        """Add the files of a policy, or of a firmware; return the copy's number."""
        self.files.append(files)
        self.refer(name, len(self.files) - 1)
        return len(self.files) - 1

    def refer(self, name: str, number: int) -> None:
        """Let a name mean a copy."""
        digests = {path: _digest(content) for path, content in self.files[number].items()}
        self.record[name] = {"copy": number, "sha256": digests}

    def write(self, folder: str | Path) -> None:
        """Write the copies into a result's folder, instead of those of an earlier result.

        Raises
        ------
        AmulettError
            If they cannot be written.
        """
        folder = user_path(folder)
        try:
            with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as temporary:
                for number, files in enumerate(self.files):
                    for name, content in files.items():
                        path = Path(temporary) / FOLDER / str(number) / name
                        path.parent.mkdir(parents=True, exist_ok=True)
                        path.write_bytes(content)
                if (folder / FOLDER).exists():
                    (folder / FOLDER).rename(Path(temporary) / "old")
                if self.files:
                    (Path(temporary) / FOLDER).rename(folder / FOLDER)
        except OSError as error:
            raise AmulettError(f"cannot write to the folder '{folder / FOLDER}': {error}") from error


NO_COPIES = Copies()


def copy_policies(names: Iterable[str], places: Mapping[str, str] | None = None) -> Copies:
    """Return the content of policies by name; laws of this package have none.

    Parameters
    ----------
    names : iterable of str
        As commands name policies: bundles' folders, zips, tuned laws' files, functions of Python files. Of a zip its
        description is copied as well, of a Python file the modules of its folder that it imports.
    places : mapping, optional
        Name -> the name by which it is found now, if that is another (`kept_policies`).

    Raises
    ------
    AmulettError
        If a file cannot be read.
    """
    copies, numbers = Copies(), dict[Path, int]()
    for name in names:
        main = policy_file((places or {}).get(name, name))
        if main is None:
            continue
        main = main.parent.resolve() / main.name
        if main in numbers:
            copies.refer(name, numbers[main])
        else:
            paths = [main, *_companions(main)]
            numbers[main] = copies.add(name, {path.relative_to(main.parent).as_posix(): _read(path) for path in paths})
    return copies


def kept_policies(folder: str | Path, record: Any) -> dict[str, str]:
    """Return policies' names -> the names of their copies in a result's folder, which are as the record says.

    Raises
    ------
    AmulettError
        If a copy is missing or was changed, or `record` is none of `Copies`.
    """
    found = {}
    for name, entry in _checked(record, folder).items():
        place = user_path(folder) / FOLDER / str(entry["copy"])
        for path, digest in entry["sha256"].items():
            what = f"kept copy of policy '{name[:100]}'"
            if _digest(_read(place / path, what)) != digest:
                raise AmulettError(f"the {what}, '{place / path}', was changed: its SHA-256 is not as in command.json")
        loop, law = split_loop(name)
        file = python_file(law)
        if file is not None:
            copy = f"{place / file.name}:{law.rpartition(':')[2]}"
        else:
            copy = str(place if MANIFEST in entry["sha256"] else place / Path(law).name)
        found[name] = f"{loop}/{copy}" if loop else copy
    return found


def policy_file(name: str) -> Path | None:
    """Return a bundle's manifest, a zip, a tuned law's file or a function's Python file; None for a law's name.

    Raises
    ------
    AmulettError
        If the system refuses the name.
    """
    _, name = split_loop(name)
    if name in contender_names() or name.startswith(CONSTANT):
        return None
    path = user_path(name)
    places = (python_file(name) or path, path / MANIFEST, path / "best" / MANIFEST)
    try:
        return next((place for place in places if place.is_file()), None)
    except OSError as error:
        raise AmulettError(f"cannot read policy '{name[:100]}': {error.strerror or error}") from error


def policy_digest(name: str) -> str | None:
    """Return the SHA-256 of a policy's `policy_file`; None for a law."""
    file = policy_file(name)
    return None if file is None else _digest(_read(file))


def _companions(main: Path) -> list[Path]:
    """Return the other files that a policy consists of."""
    if main.name == MANIFEST:
        optional = [main.with_name(name) for name in OPTIONAL]
        return [main.with_name(name) for name in FILES] + [path for path in optional if path.is_file()]
    if main.suffix == ".zip":  # the meaning of its actions (`amulett_agents.load_sb3_zip`)
        return [path for path in (main.with_suffix(".json"), main.with_name("config.yaml")) if path.is_file()][:1]
    return _imported(main) if main.suffix == ".py" else []


def _imported(main: Path) -> list[Path]:
    """Return the Python files in a file's folder that it imports, directly or through another one."""
    finder = ModuleFinder([str(main.parent)])
    with suppress(Exception):  # of code that cannot be compiled, which the loader of the law reports
        finder.run_script(str(main))
    modules: Iterable[Any] = finder.modules.values()
    files = [Path(module.__file__) for module in modules if module.__file__ is not None]
    return sorted(path for path in files if path != main and path.suffix == ".py")


def _checked(record: Any, folder: str | Path) -> dict[str, dict[str, Any]]:
    """Return a record after a check of its types."""
    kinds = {"copy": int, "sha256": dict}
    for entry in record.values() if isinstance(record, dict) else [None]:
        if not isinstance(entry, dict) or {key: type(value) for key, value in entry.items()} != kinds:
            raise AmulettError(f"'{folder}' does not describe its kept policies: 'kept' in command.json is damaged")
    return dict(record)


def _read(path: Path, what: str = "policy") -> bytes:
    return read_bytes(path, what, _MOST_BYTES)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
