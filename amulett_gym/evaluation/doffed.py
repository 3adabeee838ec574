"""Measure the frozen costs of wearers without the device again: means over 400 training episodes of 10 s, by suite.

``python -m amulett_gym.evaluation.doffed`` prints them; ``--write`` replaces the frozen file in the package. New costs
change every reward of Amulett/Worn-v0, so they need a new version of it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.envs.worn_reward import DOFFED, DOFFED_SECONDS
from amulett_gym.errors import AmulettError
from amulett_gym.model.wearer import muscle_torque
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import RUNNING
from amulett_gym.simulation.worn import MOVING
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.storage.writing import write_json
from amulett_gym.tasks.suites import episode_keys
from amulett_gym.tasks.worn_suites import WORN_SUITES, sample_worn

EPISODES = 400
PROFILE = "worn"
"""Its control period is that of the wearers' reflexes, and its torque limits how far ``guided`` leads an arm; all else
of it has no influence."""

_SQUARED_DEGREES = np.degrees(1.0) ** 2
_torques: Callable[..., Any] = getattr(muscle_torque, "py_func", muscle_torque)
"""The muscles' torque for arrays."""


def measure(suite: str, episodes: int = EPISODES) -> dict[str, float]:
    """Return the mean costs of an episode of a suite as in `worn_reward.doffed_costs`, rounded to 4 digits.

    The arms are outside the device; those of a guided suite are relaxed and do not move: the torque of their muscles is
    that which would move them.

    Raises
    ------
    AmulettError
        If the suite's name is unknown, or an arm's state is not finite.
    """
    profile = load_profile(PROFILE)
    keys = episode_keys(np.arange(episodes, dtype=np.uint64), np.zeros(episodes, dtype=np.uint64), "train")
    rows, wearers = sample_worn(suite, keys, profile, "train")
    wearers["worn"] = 0.0
    simulation = WornSimulation(profile, episodes, "equilibrium-point")
    simulation.reset(rows, wearers=wearers)
    period, read = simulation.control_period, simulation.read_worn
    cuff, motion = np.zeros(episodes), np.zeros(episodes)
    for _ in range(round(DOFFED_SECONDS / period)):
        simulation.advance(1)
        rate, posture = read("intention_rate"), read("elbow") - read("intention")
        activations = read("flexor"), read("extensor")
        torque = _torques(*activations, posture, read("elbow_rate"), wearers["tone"], wearers["strength"])
        cuff += np.where(np.abs(rate) > MOVING, period * torque * torque, 0.0)  # nothing moves before it counts
        motion += period * rate * rate
    if (simulation.read("failure") != RUNNING).any():
        raise AmulettError(f"an arm without the device fails in the suite {suite}")
    costs = {
        "muscle": read("effort"),
        "tracking": _SQUARED_DEGREES * read("tracking_ise"),
        "cuff": cuff,
        "intention": _SQUARED_DEGREES * motion,
    }
    return {name: float(f"{values.mean():.4g}") for name, values in costs.items()}


def main() -> None:
    """Print the costs; with ``--write``, write them into the package, too."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace the frozen file in the package")
    arguments = parser.parse_args()
    content = {
        "version": 1,
        "units": {"muscle": "s", "tracking": "deg2 s", "cuff": "N2 m2 s", "intention": "deg2/s"},
        "suites": {suite: measure(suite) for suite in WORN_SUITES},
    }
    if arguments.write:
        with resources.as_file(resources.files("amulett_gym") / "envs" / DOFFED) as path:
            write_json(Path(path), content)
    print(json.dumps(content, indent=2))


if __name__ == "__main__":
    main()
