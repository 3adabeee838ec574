"""`amulett reproduce`: the paper's step responses, and every number of its Tables 2-5 beside ours."""

from __future__ import annotations

import argparse
import json
from contextlib import nullcontext

from amulett_gym.files import output_folder

HELP = "run what the paper measured, and compare Tables 2-5 with ours"
EXAMPLES = """  amulett reproduce --out runs/reproduction
  amulett reproduce --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", metavar="DIR", help="folder for reproduction.json, rows.csv and readings.csv")
    parser.add_argument("--json", action="store_true", help="print the content of reproduction.json and nothing else")


def run(arguments: argparse.Namespace) -> int:
    """Reproduce, print the tables, and write the files."""
    from amulett_gym.paper.reproduction import reproduce
    from amulett_gym.paper.results import REPRODUCTION_MARKS, content, in_words, write

    out = arguments.out
    with nullcontext(False) if out is None else output_folder(out, "reproduction", [REPRODUCTION_MARKS]) as earlier:
        reproduction = reproduce()
        result = content(reproduction) if out is None else write(reproduction, out)
    if arguments.json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return 0
    print(in_words(reproduction))
    if out is not None:
        replaced = ", in the place of the reproduction that was there" if earlier else ""
        print(f"Written to {out}: reproduction.json, rows.csv and readings.csv{replaced}.")
    return 0
