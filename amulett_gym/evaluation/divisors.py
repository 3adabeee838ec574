"""Measure the reward's divisors: eq. 6's mean cost of an episode, by suite, family, profile.

``python -m amulett_gym.evaluation.divisors`` prints them; ``--write`` replaces the frozen file in the package. New
divisors change every reward, so they need a new version of the environments.
"""

from __future__ import annotations

import argparse
import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.profile import load_profile, profile_names
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.storage.writing import write_json
from amulett_gym.tasks.suites import episode_keys, families_of, sample, suite_names

EPISODES = 400
"""Episodes of each family; about as many in a mix."""

DURATION = 10.0  # [s]
NO_CONTACT = 0.1
"""Divisor of the contact term in suites without obstacles: 0.1 N2 m2 s, a tenth of a second at 1 N m."""


def measure() -> dict[str, Any]:
    """Return eq. 6's mean costs: ``divisors``, profile -> suite -> term, and ``divisors_in_mixed``, by family."""
    found = {name: {suite: _measure(name, suite) for suite in suite_names()} for name in profile_names()}
    return {
        "divisors": {name: {suite: costs[None] for suite, costs in suites.items()} for name, suites in found.items()},
        "divisors_in_mixed": {
            name: {family: suites["mixed"][family] for family in families_of("mixed")} for name, suites in found.items()
        },
    }


def _measure(profile_name: str, suite: str) -> dict[str | None, dict[str, float]]:
    """Return the mean costs of each of a suite's families, and under None those of all its scenarios."""
    profile = load_profile(profile_name)
    count = EPISODES * len(families_of(suite))
    keys = episode_keys(np.arange(count, dtype=np.uint64), np.zeros(count, dtype=np.uint64), "train")
    rows = sample(suite, keys, profile)
    simulation = Simulation(profile, count, tension_law="eq6")
    simulation.reset(rows)
    simulation.advance(round(DURATION / simulation.control_period))
    squared_degrees = float(np.degrees(1.0) ** 2)

    def costs(chosen: Any) -> dict[str, float]:
        def mean(*metrics: str) -> float:
            return float(sum(simulation.read(metric)[chosen].mean() for metric in metrics))

        means = {
            "position": mean("position_ise") * squared_degrees,
            "effort": mean("effort_biceps", "effort_triceps") * squared_degrees,
            "tension": mean("tension_ise"),
            "contact": mean("contact_ise") or NO_CONTACT,
            "drive_effort": mean("drive_effort") * squared_degrees,
        }
        return {term: float(f"{cost:.4g}") for term, cost in means.items()}

    chosen: dict[str | None, Any] = {None: slice(None)}
    chosen |= {family: rows["family"] == FAMILIES.index(family) for family in families_of(suite)}
    return {family: costs(rows) for family, rows in chosen.items()}


def main() -> None:
    """Print the divisors; with ``--write``, write them into the package, too."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace the frozen file in the package")
    arguments = parser.parse_args()
    content = {
        "version": 2,
        "units": {
            "position": "deg2 s",
            "effort": "deg2/s",
            "tension": "N2 s",
            "contact": "N2 m2 s",
            "drive_effort": "deg2/s",  # of the full-control cost alone, see `metrics.control_prices`
        },
        **measure(),
    }
    if arguments.write:
        with resources.as_file(resources.files("amulett_gym") / "envs" / "divisors.json") as path:
            write_json(Path(path), content)
    print(json.dumps(content, indent=2))


if __name__ == "__main__":
    main()
