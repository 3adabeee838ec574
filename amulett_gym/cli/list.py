"""`amulett list`: every name that another command or keyword takes."""

from __future__ import annotations

import argparse
import json

HELP = "list environments, suites, splits, laws and profiles"
EXAMPLES = """  amulett list
  amulett list --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Print the names."""
    from amulett_gym import ENV_IDS
    from amulett_gym.laws.contenders import contender_names
    from amulett_gym.profile import load_profile, profile_names
    from amulett_gym.tasks.suites import SPLITS, describe_suite, suite_names

    names = {
        "environments": {
            ENV_IDS[0]: "choose the factor by which eq. 6 scales the tension",
            ENV_IDS[1]: "choose the tension setpoint in N",
        },
        "suites": {suite: describe_suite(suite) for suite in suite_names()},
        "splits": dict(
            zip(
                SPLITS,
                (
                    "to train on",
                    "to choose a policy by",
                    "to report; the default of evaluate",
                    "to report: outside the ranges of the others",
                ),
                strict=True,
            )
        ),
        "laws": contender_names(),
        "profiles": {name: load_profile(name).description for name in profile_names()},
    }
    if arguments.json:
        print(json.dumps(names, indent=2))
        return 0
    for heading, entries in names.items():
        print(heading)
        width = max(map(len, entries))
        for name, description in entries.items():
            print(f"  {name:{width}}  {description}")
    return 0
