"""`amulett live`: the simulation in a browser, as one page that needs no network."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from pathlib import Path

from amulett_gym.cli.options import add_device, add_json, add_options, check_file, chosen_device
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import user_path
from amulett_gym.storage.writing import write_text

HELP = "show the simulation in a browser: drag the setpoint, push the forearm, choose law, loop and device"
EXAMPLES = """  amulett live
  amulett live --policy runs/ppo --profile mine.yaml
  amulett live --scenario my-scenario.json --loop computed-torque
  amulett live --out twin.html --no-open
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    policy = "laws and policies to choose from on the page, besides the shipped ones; the first one acts first"
    parser.add_argument("--policy", nargs="+", default=[], metavar="POLICY", help=policy)
    add_options(parser, "--scenario", help="own scenario (JSON or YAML), which is shown first")
    add_device(parser)
    loop = "control loop that is shown first (default: the paper's, or that of the policy)"
    parser.add_argument("--loop", metavar="LOOP", help=loop)
    parser.add_argument("--out", metavar="FILE.html", help="file to write (default: a temporary one)")
    parser.add_argument("--no-open", action="store_true", help="do not open a browser; needs --out")
    add_json(parser, "the file, its size and what is shown first")


def run(arguments: argparse.Namespace) -> int:
    """Write the page, and open it."""
    if arguments.no_open and arguments.out is None:
        raise AmulettError("--no-open without --out shows nothing; give --out FILE.html")
    check_file("out", arguments.out, (".html", ".htm"))
    from amulett_gym.live.choices import choices
    from amulett_gym.live.page import render

    found = choices(chosen_device(arguments), arguments.policy, arguments.scenario, arguments.loop)
    page = render(found)
    path = (
        Path(tempfile.mkdtemp(prefix="amulett-live-")) / "live.html"
        if arguments.out is None
        else user_path(arguments.out)
    )
    write_text(path, page)
    address = path.resolve().as_uri()
    opened = not arguments.no_open and webbrowser.open(address)
    if arguments.json:
        start = {"device": found.start["device"], "loop": found.start["loop"], "law": found.start["law"]["name"]}
        print_json({"file": str(path), "bytes": len(page.encode()), "opened": opened, **start})
    show = printer(arguments)
    show(f"wrote {path}", wrap=False)
    if not arguments.no_open and not opened:
        show(f"No browser could be opened. Open this address in one: {address}", wrap=False)
    return 0
