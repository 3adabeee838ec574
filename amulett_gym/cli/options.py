"""Options that several commands share."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.errors import AmulettError
from amulett_gym.reporting.figure_files import COLUMN_WIDTHS, KINDS
from amulett_gym.storage.writing import check_writable

if TYPE_CHECKING:
    from amulett_gym.profile import Profile
    from amulett_gym.workers.call import Workers

_SHARED: dict[str, dict[str, Any]] = {
    "--suite": {"default": "steps", "help": "suite of scenarios (default: steps)"},
    "--profile": {"default": "testbed", "help": "device profile, by name or YAML file (default: testbed)"},
    "--fleet": {"metavar": "FLEET", "help": "several devices instead: a shipped fleet's name, or a YAML or JSON file"},
    "--split": {"default": "held-out", "help": "train, validation, held-out (default) or shifted"},
    "--scenario": {"metavar": "FILE", "help": "own scenario (JSON or YAML), instead of the suite's"},
    "--trust-pickle": {
        "action": "store_true",
        "help": "also open zips of Stable-Baselines3: they contain pickles, which can run any code",
    },
    "--set": {"nargs": "+", "action": "extend", "default": [], "metavar": "KEY=VALUE", "dest": "overrides"},
    "--doc": {"metavar": "FILE.md", "help": "renew the generated part of a document, and its figures"},
}


def add_options(parser: argparse._ActionsContainer, *names: str, **changes: Any) -> None:
    """Add shared options; `changes` replaces keywords of each one's `add_argument`."""
    for name in names:
        parser.add_argument(name, **{**_SHARED[name], **changes})


def add_device(parser: argparse.ArgumentParser, one: bool = True) -> None:
    """Add `--profile` and `--fleet`, of which one may be given; if `one`, also `--device`, one of the fleet."""
    add_options(parser.add_mutually_exclusive_group(), "--profile", "--fleet")
    if one:
        parser.add_argument("--device", metavar="NAME", help="the fleet's device")


def chosen_device(arguments: argparse.Namespace) -> Profile:
    """Return the device that `--profile`, or `--fleet` with `--device`, name.

    Raises
    ------
    AmulettError
        If the profile or fleet cannot be read, or one of `--fleet` and `--device` is missing or has no such device.
    """
    from amulett_gym.fleet import device_of, load_fleet
    from amulett_gym.profile import load_profile

    if arguments.fleet is None:
        if arguments.device is not None:
            raise AmulettError(f"--device '{arguments.device}' is one of a fleet; give the fleet with --fleet")
        return load_profile(arguments.profile)
    fleet = load_fleet(arguments.fleet)
    if arguments.device is None:
        raise AmulettError(f"choose one of the fleet's {len(fleet)} devices, for example --device {fleet[0].name}")
    return device_of(fleet, arguments.device)


def add_workers(
    parser: argparse.ArgumentParser, what: str, default: int | None = None, processes: bool = False
) -> None:
    """Add `--workers` and `--ray`: how many of `what` are made at a time, and where; the default is all cores.

    `processes` adds the earlier name of `--workers`, too.
    """
    number = os.cpu_count() or 1 if default is None else default
    shown = "cores" if default is None else f"{default}"
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--workers", type=int, metavar="N", help=f"{what} at a time (default: {shown}; with --ray all)")
    if processes:
        group.add_argument("--processes", type=int, metavar="N", help="deprecated: use --workers")
    ray = "make them on a Ray cluster: auto, HOST:PORT or ray://HOST:PORT (docs/scale.md)"
    parser.add_argument("--ray", metavar="ADDRESS", help=ray)
    parser.set_defaults(default_workers=number, processes=None)


def chosen_workers(arguments: argparse.Namespace) -> Workers:
    """Return the workers that `--workers` and `--ray` choose, after checking both.

    Raises
    ------
    AmulettError
        If the number is below 1, Ray is not installed, or the address is none.
    """
    from amulett_gym.workers.call import chosen

    check_least(arguments, processes=1)
    if arguments.processes is not None:
        print("amulett: note: --processes is deprecated; use --workers", file=sys.stderr)
        arguments.workers, arguments.processes = arguments.processes, None
    number = arguments.default_workers if (arguments.workers, arguments.ray) == (None, None) else arguments.workers
    return chosen(number, arguments.ray)


def add_figures(
    parser: argparse.ArgumentParser, kind: bool = True, page: bool = False, into: Sequence[str] = ("out",)
) -> None:
    """Add `--format` (if `kind`) and `--columns`, with which `main` runs the command.

    `page`: figures are on a page. `into`: the options, any of which says where figures are written.
    """
    parser.set_defaults(figures_into=tuple(into))
    if kind:
        on_page = "also write the page's figures as files of this format; earlier ones of another format stay"
        what = on_page if page else "format of figures (default: png)"
        parser.add_argument("--format", choices=KINDS, help=what)
    widths = ", ".join(f"{columns}: {width:g} in" for columns, width in COLUMN_WIDTHS.items())
    wide = f"draw figures for print, this number of columns of a page wide ({widths}), with text of 8 pt"
    parser.add_argument("--columns", type=int, choices=list(COLUMN_WIDTHS), help=wide)


def check_figures(arguments: argparse.Namespace) -> None:
    """Raise an AmulettError if it is said how figures are drawn, and the command writes none."""
    into = getattr(arguments, "figures_into", ())
    files = tuple(name for name in into if name != "doc")  # a document's figures are PNG
    for option, places in (("format", files), ("columns", into)):
        if getattr(arguments, option, None) is None or any(getattr(arguments, name) for name in places):
            continue
        where = " or ".join(f"--{name}" for name in places)
        raise AmulettError(f"--{option} is for figures, which are written only with {where}; add that or leave it out")


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


def check_file(option: str, path: str | None, suffixes: Sequence[str]) -> None:
    """Raise an AmulettError if a file to write does not end in one of these suffixes, or cannot be written."""
    if path is None:
        return
    if Path(path).suffix.lower() not in suffixes:
        raise AmulettError(f"--{option} '{path}' has to end in {' or '.join(suffixes)}")
    check_writable(path)
