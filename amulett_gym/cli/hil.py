"""`amulett hil`: a firmware in the loop, beside the simulation's own loop."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import (
    add_figures,
    add_json,
    add_options,
    check_file,
    check_least,
    check_seconds,
    command_words,
)
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.reading import user_path
from amulett_gym.storage.writing import output_folder

if TYPE_CHECKING:
    from amulett_gym.firmware.hil import Comparison

HELP = "run a firmware against the simulated device: on this computer, a simulated chip, or a real board"
EXAMPLES = """  amulett hil firmware --suite mixed
  amulett hil firmware --transport host chip --episodes 10 --out runs/hil
  amulett hil firmware --transport chip --readme
  amulett hil firmware --transport serial:/dev/ttyACM0 --episodes 5
  amulett hil firmware --episodes 1 --duration 60 --suite steps --log steps.csv
"""

_OPTIONS = ("suite", "split", "episodes", "seed", "duration")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("folder", metavar="DIR", help="firmware, as 'amulett export' writes it; its sources are run")
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
    log = "what the device logs in the first scenario, with the last transport (see docs/logs.md); .csv or .npz"
    parser.add_argument("--log", metavar="FILE", help=log)
    readme = "write memory and cycles, which the transport chip measures, into the firmware's README.md"
    parser.add_argument("--readme", action="store_true", help=readme)
    add_figures(parser, page=True)
    add_json(parser, "the content of hil.json")


def run(arguments: argparse.Namespace) -> int:
    """Play, print the table, and write the files; return 1 if a device failed or the strings were let go."""
    from amulett_gym.firmware.hil import log_first
    from amulett_gym.firmware.hil_page import chip_table, table, write_needs
    from amulett_gym.firmware.readme import MEASURED, README
    from amulett_gym.logs.writer import write_log
    from amulett_gym.reporting.document import check_document

    check_least(arguments, episodes=1, seed=0)
    check_seconds(arguments, "duration")
    check_file("log", arguments.log, (".csv", ".npz"))
    if arguments.readme:
        if "chip" not in arguments.transport:
            raise AmulettError("--readme writes what the simulated chip measures; add chip to --transport")
        check_document(user_path(arguments.folder) / README, [MEASURED])
    config = {
        "firmware": str(user_path(arguments.folder).resolve()),
        "transport": list(dict.fromkeys(arguments.transport)),
        **{key: getattr(arguments, key) for key in _OPTIONS},
    }
    words = ["amulett", "hil", arguments.folder, *command_words(arguments, "transport", *_OPTIONS, "out")]
    found = compare(config, arguments.out, words)
    if arguments.json:
        print_json(found.content())
    show = printer(arguments)
    show(f"{found.description.law} on {found.protocol.profile.name}, {found.protocol.episodes} of {arguments.suite}")
    show(table(found).text(), wrap=False)
    if (chip := chip_table(found)) is not None:
        show(f"\n{chip.text()}", wrap=False)
    if arguments.out is not None:
        show(f"Written: {arguments.out}/hil.json, {arguments.out}/index.html")
    if arguments.log is not None:
        write_log(arguments.log, log_first(found.description, found.protocol, config["transport"][-1]))
        show(f"Written: {arguments.log}")
    if arguments.readme:
        write_needs(found)
        show(f"Written: {arguments.folder}/{README}")
    return int(any(each.failures > found.kernel.failures or each.let_go for each in found.played))


def compare(
    config: Mapping[str, Any], out: str | None, words: Sequence[str], places: Mapping[str, str] | None = None
) -> Comparison:
    """Compare by a `config`; write the files to `out`, if any, with a copy of the firmware and the command's words.

    `places`: the firmware's path in `config` -> where it is now, if that is elsewhere.
    """
    from amulett_gym.firmware import hil, hil_page
    from amulett_gym.firmware.description import firmware_content, read_description
    from amulett_gym.laws.copies import Copies
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.storage.provenance import write_provenance
    from amulett_gym.storage.writing import files_together

    folder, transports = (places or {}).get(config["firmware"], config["firmware"]), config["transport"]
    options = {key: config[key] for key in _OPTIONS}
    steps = hil.agent_steps(read_description(folder), options["duration"]) * options["episodes"]
    copies = Copies()
    with ExitStack() as stack:
        if out is not None:
            stack.enter_context(output_folder(out, "firmware in the loop", [["hil.json"]]))
            stack.enter_context(locked_folder(out))
            copies.add(config["firmware"], firmware_content(folder))
        with Progress(steps * len(transports), "hil", "steps") as bar:
            found = hil.compare(folder, transports, **options, advance=bar.update)
        if out is not None:
            seeds = range(options["seed"], options["seed"] + options["episodes"])
            with files_together(out, hil_page.FILES) as new:
                hil_page.write_comparison(found, new, words)
                write_provenance(new, "hil", {**config, "kept": copies.record}, seeds, words)
                copies.write(out)
    return found
