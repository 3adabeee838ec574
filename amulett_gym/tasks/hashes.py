"""SHA-256 hashes of the suites' scenarios, so that no suite changes unnoticed.

``python -m amulett_gym.tasks.hashes`` prints the hashes; ``--write`` replaces the frozen file in the package. A changed
suite needs a new version.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.profile import Profile, load_profile
from amulett_gym.storage.writing import write_json
from amulett_gym.tasks.suites import SPLITS, episode_keys, sample, suite_names
from amulett_gym.tasks.worn_suites import WORN_SUITES, sample_worn

VERSION = 3
"""Version of the suites' draws and of their packing."""

WORN_VERSION = 1
"""Version of the draws of `worn_suites` and `wearer.POPULATION`, and of their packing."""

PROFILE = "testbed"
SCENARIOS = 1000


def suite_hash(suite: str, split: str, profile: Profile) -> str:
    """Return the SHA-256 of the packed scenarios that a suite draws for seeds 0 to 999, in hexadecimal."""
    return hashlib.sha256(sample(suite, _keys(split), profile, split=split).tobytes()).hexdigest()


def worn_hash(suite: str, split: str, profile: Profile) -> str:
    """Return the SHA-256 of the packed scenarios and then the wearers of a suite of `worn_suites`, in hexadecimal."""
    rows, wearers = sample_worn(suite, _keys(split), profile, split)
    return hashlib.sha256(rows.tobytes() + wearers.tobytes()).hexdigest()


def _keys(split: str) -> NDArray[np.uint64]:
    seeds = np.arange(SCENARIOS, dtype=np.uint64)
    return episode_keys(seeds, np.zeros_like(seeds), split)


def measure() -> dict[str, dict[str, str]]:
    """Return all hashes on the shipped testbed: suite -> split -> hash."""
    profile = load_profile(PROFILE)
    return {suite: {split: suite_hash(suite, split, profile) for split in SPLITS} for suite in suite_names()}


def measure_worn() -> dict[str, dict[str, str]]:
    """Return all hashes of the suites of a worn device, as `measure`."""
    profile = load_profile(PROFILE)
    return {suite: {split: worn_hash(suite, split, profile) for split in SPLITS} for suite in WORN_SUITES}


def frozen() -> dict[str, Any]:
    """Return the package's file: ``version``, ``profile``, ``scenarios``, ``hashes``, and ``worn`` with its own two."""
    content: dict[str, Any] = json.loads((resources.files("amulett_gym") / "tasks" / "hashes.json").read_text())
    return content


def main() -> None:
    """Print the hashes, or write them into the package."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace the frozen file in the package")
    arguments = parser.parse_args()
    content = {"version": VERSION, "profile": PROFILE, "scenarios": SCENARIOS, "hashes": measure()}
    content["worn"] = {"version": WORN_VERSION, "hashes": measure_worn()}
    if arguments.write:
        with resources.as_file(resources.files("amulett_gym") / "tasks" / "hashes.json") as path:
            write_json(Path(path), content)
    print(json.dumps(content, indent=2))


if __name__ == "__main__":
    main()
