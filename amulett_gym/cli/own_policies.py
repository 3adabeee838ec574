"""Policies that are no bundles, for the commands that compare: zips of Stable-Baselines3, if they are trusted."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from amulett_gym.laws.contenders import Contender
    from amulett_gym.profile import Profile


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add the option by which a user vouches for zips."""
    parser.add_argument(
        "--trust-pickle",
        action="store_true",
        help="also open zips of Stable-Baselines3: they are pickles, and can run any code of whoever made them",
    )


def with_zips(names: Sequence[str], profile: Profile, env_id: str, trust_pickle: bool) -> list[str | Contender]:
    """Return the names, with a contender in the place of each that is a zip of Stable-Baselines3.

    Raises
    ------
    AmulettError
        If there is one and it is not trusted, cannot be loaded, or what it needs is not installed.
    """
    zips = {name for name in names if name.endswith(".zip") and not Path(name).is_dir()}
    if not zips:
        return list(names)
    from amulett_gym.learning import load_learning

    load_sb3_zip = load_learning("zips").load_sb3_zip
    return [load_sb3_zip(name, profile, env_id, trust_pickle) if name in zips else name for name in names]
