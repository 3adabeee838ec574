"""`amulett list`: every name that another command or keyword takes."""

from __future__ import annotations

import argparse

from amulett_gym.cli.options import add_json
from amulett_gym.cli.output import print_json, printer

HELP = "list environments, control loops, suites, splits, laws and profiles"
EXAMPLES = """  amulett list
  amulett list --json
"""

_USES = (
    "for training",
    "for choosing a policy",
    "for reports; the default of evaluate",
    "for reports: outside the ranges of the others",
)
"""Uses of the splits."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_json(parser, "all names with their descriptions")


def run(arguments: argparse.Namespace) -> int:
    """Print the names."""
    from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
    from amulett_gym.laws.contenders import contender_names, loop_names
    from amulett_gym.profile import load_profile, profile_names
    from amulett_gym.reporting.table import Table
    from amulett_gym.tasks.suites import SPLITS, SUITES
    from amulett_gym.tasks.worn_suites import WORN_SUITES

    names: dict[str, dict[str, str]] = {
        "environments": {
            ENV_IDS[0]: "choose the factor by which eq. 6 scales the tension",
            ENV_IDS[1]: "choose the tension setpoint in N",
            DRIVES_ID: "command both drives: their mean angle and the co-contraction",
            WORN_ID: "worn by a person: choose the co-contraction and how much the device follows the wearer",
        },
        "control loops": loop_names(),
        "suites": dict(SUITES),
        f"suites of {WORN_ID}": dict(WORN_SUITES),
        "splits": dict(zip(SPLITS, _USES, strict=True)),
        "laws": contender_names(),
        "profiles": {name: load_profile(name).description for name in profile_names()},
    }
    if arguments.json:
        print_json(names)
    show = printer(arguments)
    for heading, entries in names.items():
        show(Table(heading, ("", ""), list(entries.items()), left=(0, 1)).text() + "\n")
    return 0
