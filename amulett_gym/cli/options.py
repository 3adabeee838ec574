"""Options that several commands share."""

from __future__ import annotations

import argparse
import math
from typing import Any

from amulett_gym.errors import AmulettError

_SHARED: dict[str, dict[str, Any]] = {
    "--suite": {"default": "steps", "help": "suite of scenarios (default: steps)"},
    "--profile": {"default": "testbed", "help": "device profile, by name or YAML file (default: testbed)"},
    "--split": {"default": "held-out", "help": "train, validation, held-out (default) or shifted"},
    "--scenario": {"metavar": "FILE", "help": "own scenario (JSON or YAML), instead of the suite's"},
    "--trust-pickle": {
        "action": "store_true",
        "help": "also open zips of Stable-Baselines3: they contain pickles, which can run any code",
    },
    "--set": {"nargs": "+", "action": "extend", "default": [], "metavar": "KEY=VALUE", "dest": "overrides"},
    "--doc": {"metavar": "FILE.md", "help": "renew the generated part of a document, and its figures"},
}


def add_options(parser: argparse.ArgumentParser, *names: str, **changes: Any) -> None:
    """Add shared options; `changes` replaces keywords of each one's `add_argument`."""
    for name in names:
        parser.add_argument(name, **{**_SHARED[name], **changes})


def add_json(parser: argparse.ArgumentParser, content: str) -> None:
    """Add `--json`, which prints `content` instead of text."""
    parser.add_argument("--json", action="store_true", help=f"print {content} as JSON, and nothing else")


def check_least(arguments: argparse.Namespace, **least: int) -> None:
    """Raise an AmulettError if an option's number is below its smallest value; None is no number."""
    for name, smallest in least.items():
        value = getattr(arguments, name)
        if value is not None and value < smallest:
            raise AmulettError(f"--{name} is {value}; it has to be at least {smallest}")


def check_seconds(arguments: argparse.Namespace, *names: str) -> None:
    """Raise an AmulettError if an option is not a positive, finite number of seconds; None is no number."""
    for name in names:
        value = getattr(arguments, name)
        if value is not None and not 0 < value < math.inf:
            raise AmulettError(f"--{name} is {value}; it has to be a positive number of seconds")


def command_words(arguments: argparse.Namespace, *names: str) -> list[str]:
    """Return the words that give the named options their values again; unset options and flags are left out."""
    words = []
    for name in names:
        value = getattr(arguments, name.replace("-", "_"))
        if value is not None and value is not False and value != []:
            values = value if isinstance(value, list) else [] if value is True else [value]
            words += [f"--{name}", *map(str, values)]
    return words
