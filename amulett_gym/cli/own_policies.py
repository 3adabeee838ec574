"""Policies that are no bundles: zips of Stable-Baselines3, if they are trusted, and functions of Python files."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from amulett_gym.laws.contenders import Contender
    from amulett_gym.profile import Profile


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add the option by which a user vouches for zips."""
    parser.add_argument(
        "--trust-pickle",
        action="store_true",
        help="also open zips of Stable-Baselines3: they are pickles, and can run any code of their makers",
    )


def own_contenders(
    names: Sequence[str], profile: Profile, env_id: str = "Amulett/Scaling-v0", trust_pickle: bool = False
) -> list[str | Contender]:
    """Return the names, with a contender instead of each that is a zip of Stable-Baselines3 or ``mylaw.py:function``.

    Raises
    ------
    AmulettError
        If a zip is not trusted, or a zip or file cannot be loaded, or what it needs is not installed.
    """
    found = {name: _own_contender(name, profile, env_id, trust_pickle) for name in dict.fromkeys(names)}
    return [found[name] for name in names]


def _own_contender(name: str, profile: Profile, env_id: str, trust_pickle: bool) -> str | Contender:
    from amulett_gym.laws.contenders import python_file
    from amulett_gym.laws.own import load_own

    if python_file(name) is not None:
        return load_own(name)
    if name.endswith(".zip") and not Path(name).is_dir():
        from amulett_gym.learning import load_learning

        contender: Contender = load_learning("zips").load_sb3_zip(name, profile, env_id, trust_pickle)
        return contender
    return name


def policy_digest(name: str) -> str | None:
    """Return the SHA-256 of a bundle's manifest, of a zip or of a function's Python file; None for a law's name."""
    from amulett_gym.laws.bundle import MANIFEST
    from amulett_gym.laws.contenders import python_file

    places = (python_file(name) or Path(name), Path(name) / MANIFEST, Path(name) / "best" / MANIFEST)
    try:
        file = next((place for place in places if place.is_file()), None)
        return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise AmulettError(f"cannot read policy '{name[:100]}': {error.strerror or error}") from error
