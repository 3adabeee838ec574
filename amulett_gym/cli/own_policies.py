"""Policies as commands name them: laws, bundles, trusted zips of Stable-Baselines3, functions of Python files."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from amulett_gym.laws.contenders import Contender
    from amulett_gym.profile import Profile


POLICIES = (
    "laws by name (see: amulett list), folders of policy bundles, functions of your own (mylaw.py:function; the file "
    "is run), zips of Stable-Baselines3 that you trust (--trust-pickle)"
)
"""The names that commands accept, for their help."""


def own_contenders(
    names: Sequence[str], profile: Profile, env_id: str = "Amulett/Scaling-v0", trust_pickle: bool = False
) -> list[Contender]:
    """Return the contenders of some names; the same one for equal names.

    Raises
    ------
    AmulettError
        If a name is unknown, a zip is not trusted, or a zip or file cannot be loaded or needs a missing package.
    """
    found = {name: _own_contender(name, profile, env_id, trust_pickle) for name in dict.fromkeys(names)}
    return [found[name] for name in names]


def _own_contender(name: str, profile: Profile, env_id: str, trust_pickle: bool) -> Contender:
    from amulett_gym.laws.contenders import parse_contender, python_file
    from amulett_gym.laws.own import load_own

    if python_file(name) is not None:
        return load_own(name)
    if name.endswith(".zip") and not Path(name).is_dir():
        from amulett_gym.learning import load_learning

        contender: Contender = load_learning("zips").load_sb3_zip(name, profile, env_id, trust_pickle)
        return contender
    return parse_contender(name)


def digests(names: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of each policy that is a file or folder."""
    return {name: digest for name in names if (digest := policy_digest(name))}


def policy_digest(name: str) -> str | None:
    """Return the SHA-256 of a bundle's manifest, a zip or a function's Python file; None for a law."""
    from amulett_gym.laws.bundle import MANIFEST
    from amulett_gym.laws.contenders import python_file

    places = (python_file(name) or Path(name), Path(name) / MANIFEST, Path(name) / "best" / MANIFEST)
    try:
        file = next((place for place in places if place.is_file()), None)
        return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise AmulettError(f"cannot read policy '{name[:100]}': {error.strerror or error}") from error
