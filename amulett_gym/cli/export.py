"""`amulett export`: loop and law as C for a microcontroller."""

from __future__ import annotations

import argparse

from amulett_gym.cli.options import add_device, add_json, chosen_device
from amulett_gym.cli.output import print_json, printer

HELP = "write loop and law as C99 for a microcontroller, with test vectors"
EXAMPLES = """  amulett export eq6 --out firmware
  amulett export constant:8 --profile configs/my_device.yaml --out firmware
  amulett export parametric --control decentralized --out firmware
  amulett export runs/small --numbers int8 --out firmware
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("law", metavar="LAW", help="law by name, tuned law's file or policy bundle's folder")
    add_device(parser)
    parser.add_argument("--control", metavar="LOOP", help="control loop (default: that of the law)")
    numbers = "numbers of a network: float, int16 or int8 (default: the finest that need no "
    numbers += "longer delay than that of the training, else those with the shortest)"
    parser.add_argument("--numbers", choices=("float", "int16", "int8"), help=numbers)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the sources, or of an earlier export")
    add_json(parser, "the files' names and sizes")


def run(arguments: argparse.Namespace) -> int:
    """Write the folder; return 0."""
    from amulett_gym.firmware.export import export

    show, device = printer(arguments), chosen_device(arguments)
    files = export(arguments.law, device, arguments.control, arguments.out, arguments.numbers, show)
    if arguments.json:
        print_json({name: len(content.encode()) for name, content in files.items()})
    show(f"The firmware is in {arguments.out}: {', '.join(sorted(files))}.")
    show("make check compares it with the simulation; README.md says what was checked.")
    return 0
