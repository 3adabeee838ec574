"""`amulett hil`: a firmware in the loop, beside the simulation's own loop."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from amulett_gym.cli.options import add_json, add_options, check_least, check_seconds
from amulett_gym.cli.output import print_json, printer

HELP = "run a firmware against the simulated device: on this computer, a simulated chip, or a real board"
EXAMPLES = """  amulett hil firmware --suite mixed
  amulett hil firmware --transport host chip --episodes 10 --out runs/hil
  amulett hil firmware --transport serial:/dev/ttyACM0 --episodes 5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("folder", metavar="DIR", help="firmware, as 'amulett export' writes it")
    parser.add_argument(
        "--transport",
        nargs="+",
        default=["host"],
        metavar="WHERE",
        help="where the firmware runs: host (64 bit), host-float, chip (a simulated ATmega2560), serial:PORT (default: "
        "host)",
    )
    add_options(parser, "--suite", default="mixed", help="suite of scenarios (default: mixed)")
    add_options(parser, "--split")
    parser.add_argument("--episodes", type=int, default=100, help="number of scenarios (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scenario (default: 0)")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="length of one [s] (default: 10)")
    parser.add_argument("--out", metavar="DIR", help="folder for hil.json and a page, index.html")
    add_json(parser, "the content of hil.json")


def run(arguments: argparse.Namespace) -> int:
    """Play, print the table, and write the files; return 1 if a device failed or the strings were let go."""
    from amulett_gym.firmware.description import read_description
    from amulett_gym.firmware.hil import agent_steps, compare, table, write_comparison
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.storage.writing import output_folder

    check_least(arguments, episodes=1, seed=0)
    check_seconds(arguments, "duration")
    described = read_description(arguments.folder)
    transports = list(dict.fromkeys(arguments.transport))
    options = {key: getattr(arguments, key) for key in ("suite", "split", "episodes", "seed", "duration")}
    out = arguments.out
    with nullcontext() if out is None else output_folder(out, "firmware in the loop", [["hil.json"]]):
        steps = agent_steps(described, arguments.duration) * arguments.episodes
        with Progress(steps * len(transports), "hil", "steps") as bar:
            found = compare(arguments.folder, transports, **options, advance=bar.update)
        if out is not None:
            write_comparison(found, Path(out))
    if arguments.json:
        print_json(found.content())
    show = printer(arguments)
    show(f"{found.description.law} on {found.protocol.profile.name}, {found.protocol.episodes} of {arguments.suite}")
    show(table(found).text(), wrap=False)
    if out is not None:
        show(f"Written: {out}/hil.json, {out}/index.html")
    return int(any(each.failures > found.kernel.failures or each.let_go for each in found.played))
