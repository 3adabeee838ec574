"""Policies as commands name them: laws, bundles, trusted zips of Stable-Baselines3, functions of Python files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from amulett_gym.laws.contenders import Contender
    from amulett_gym.profile import Profile


POLICIES = (
    "laws by name (see: amulett list), folders of policy bundles, functions of your own (mylaw.py:function; the file "
    "is run), zips of Stable-Baselines3 that you trust (--trust-pickle)"
)
"""The names that commands accept, for their help."""


def own_contenders(
    names: Sequence[str],
    profile: Profile,
    env_id: str = "Amulett/Scaling-v0",
    trust_pickle: bool = False,
    places: Mapping[str, str] | None = None,
) -> list[Contender]:
    """Return the contenders of some names; the same one for equal names.

    `places` maps names to those by which the policies are found now, if these are others
    (`laws.copies.kept_policies`); the contenders keep their names.

    Raises
    ------
    AmulettError
        If a name is unknown, a zip is not trusted, or a zip or file cannot be loaded or needs a missing package.
    """
    from dataclasses import replace

    found = {}
    for name in dict.fromkeys(names):
        place = (places or {}).get(name, name)
        found[name] = _own_contender(place, profile, env_id, trust_pickle)
        if place != name:
            found[name] = replace(found[name], name=str(Path(name)) if _is_zip(place) else name)
    return [found[name] for name in names]


def _own_contender(name: str, profile: Profile, env_id: str, trust_pickle: bool) -> Contender:
    from amulett_gym.laws.contenders import in_loop, parse_contender, python_file, split_loop
    from amulett_gym.laws.own import load_own

    loop, law = split_loop(name)
    if loop:
        return in_loop(_own_contender(law, profile, env_id, trust_pickle), loop)
    if python_file(name) is not None:
        return load_own(name)
    if _is_zip(name):
        from amulett_gym.learning import load_learning

        contender: Contender = load_learning("zips").load_sb3_zip(name, profile, env_id, trust_pickle)
        return contender
    return parse_contender(name)


def _is_zip(name: str) -> bool:
    return name.endswith(".zip") and not Path(name).is_dir()


def digests(names: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of each policy that is a file or folder."""
    from amulett_gym.laws.copies import policy_digest

    return {name: digest for name in names if (digest := policy_digest(name))}
