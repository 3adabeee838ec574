"""Measure the frozen divisors of the shipped profiles again: eq. 6's mean cost of an episode, by suite and family.

``python -m amulett_gym.evaluation.divisors`` prints them; ``--write`` replaces the frozen file in the package. New
divisors change every reward, so they need a new version of the environments.
"""

from __future__ import annotations

import argparse
import json
from importlib import resources
from pathlib import Path
from typing import Any

from amulett_gym.envs.eq6_costs import Eq6Costs, measure
from amulett_gym.errors import AmulettError
from amulett_gym.profile import device_names, load_profile
from amulett_gym.storage.writing import write_json
from amulett_gym.tasks.suites import suite_names


def measure_shipped() -> dict[str, Any]:
    """Return eq. 6's mean costs: ``divisors``, profile -> suite -> term, and ``divisors_in_mixed``, by family."""
    found = {name: {suite: _measured(name, suite) for suite in suite_names()} for name in device_names()}
    return {
        "divisors": {
            name: {suite: costs.mean.model_dump() for suite, costs in suites.items()} for name, suites in found.items()
        },
        "divisors_in_mixed": {
            name: {family: costs.model_dump() for family, costs in suites["mixed"].families.items()}
            for name, suites in found.items()
        },
    }


def _measured(name: str, suite: str) -> Eq6Costs:
    costs = measure(load_profile(name), suite)
    if costs is None:
        raise AmulettError(f"eq6 cannot play the scenarios of {suite} on the {name}")
    return costs


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
        **measure_shipped(),
    }
    if arguments.write:
        with resources.as_file(resources.files("amulett_gym") / "envs" / "divisors.json") as path:
            write_json(Path(path), content)
    print(json.dumps(content, indent=2))


if __name__ == "__main__":
    main()
