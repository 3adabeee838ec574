"""`amulett fit`: a device's parameters from its logs."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.cli.options import add_figures, add_json, add_workers, check_least, chosen_workers
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.storage.writing import check_writable

if TYPE_CHECKING:
    from amulett_gym.identification.from_logs.recording import Recording
    from amulett_gym.tasks.scenario import Payload

HELP = "fit a device's parameters to its logs, with intervals"
EXAMPLES = """  amulett fit steps.csv --base testbed --out mine.yaml
  amulett fit steps.csv ramps.csv --hold-out reach.csv --out mine.yaml --fleet mine_fleet.yaml
  amulett fit steps.csv weight.csv --payload weight.csv 0.2 0.15 --release weight.csv --out mine.yaml
"""

_HELD_OUT = 0.2  # of the last log, if no log is held out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("logs", nargs="+", metavar="LOG", help="CSV or .npz file; see amulett log check")
    base = "profile by name or file: its loop, and what the logs do not tell (default: testbed)"
    parser.add_argument("--base", default="testbed", metavar="PROFILE", help=base)
    out = "profile to write; beside it a page (.html) and all numbers (.json) with the same name"
    parser.add_argument("--out", required=True, metavar="FILE.yaml", help=out)
    parser.add_argument("--mapping", metavar="M.yaml", help="names, units, signs and offsets of the logs' columns")
    held = "log to predict, not to fit (default: the last fifth of the last log)"
    parser.add_argument("--hold-out", nargs="+", default=[], metavar="LOG", help=held)
    prior = "fleet of the devices that are plausible before the logs (default: plausible)"
    parser.add_argument("--prior", default="plausible", metavar="FLEET", help=prior)
    weight = "log with a weight of MASS [kg] on the arm, ARM [m] from the joint; several times for several logs"
    parser.add_argument("--payload", nargs=3, action="append", default=[], metavar=("LOG", "MASS", "ARM"), help=weight)
    release = "log that begins with the arm displaced, at rest, and let go"
    parser.add_argument("--release", nargs="+", default=[], metavar="LOG", help=release)
    fleet = "also write devices drawn from the result, to train a policy on (see train --set env.fleet=FILE)"
    parser.add_argument("--fleet", metavar="FILE.yaml", help=fleet)
    parser.add_argument("--devices", type=int, default=64, metavar="N", help="of that fleet (default: 64)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of that fleet (default: 0)")
    parser.add_argument("--starts", type=int, default=6, metavar="N", help="most starts of the search (default: 6)")
    add_workers(parser, "starts of the search", 1)
    add_figures(parser, page=True)
    add_json(parser, "the content of the .json file")


def run(arguments: argparse.Namespace) -> int:
    """Fit, print the result, and write the files."""
    check_least(arguments, devices=1, seed=0, starts=1)
    workers = chosen_workers(arguments)
    out = _files(arguments)
    from amulett_gym.evaluation.fit_page import figures_of, in_words, page
    from amulett_gym.fleet import load_fleet
    from amulett_gym.identification.from_logs.experiments import outlooks
    from amulett_gym.identification.from_logs.fit import fit
    from amulett_gym.identification.from_logs.profile import draw_fleet, profile_content
    from amulett_gym.identification.from_logs.recording import cut
    from amulett_gym.identification.from_logs.result import content
    from amulett_gym.profile import load_profile
    from amulett_gym.storage.provenance import process_words
    from amulett_gym.storage.safe_yaml import to_yaml
    from amulett_gym.storage.writing import after_results, write_json, write_text

    show, base, prior = printer(arguments), load_profile(arguments.base), load_fleet(arguments.prior)
    fitted, held_out = recordings(arguments, show)
    cut(held_out, base.loop.control_period, whole=True)  # what cannot be predicted is refused before the fit
    found = fit(base, fitted, prior, arguments.starts, show, workers)
    result = content(found, base, held_out, outlooks(found))
    command, name = shlex.join(process_words()), out.stem
    head = f"# Written by: {command}\n"
    write_text(out, head + to_yaml(profile_content(found, base, name), width=120))
    write_json(out.with_suffix(".json"), result)
    written = [str(out), str(out.with_suffix(".json"))]
    if arguments.fleet is not None:
        devices = draw_fleet(found, base, name, arguments.devices, arguments.seed)
        write_text(arguments.fleet, head + to_yaml(devices, width=120))
        written.append(arguments.fleet)
    if arguments.json:
        print_json(result)
    show(in_words(result), wrap=False)
    with after_results(", ".join(written)):
        figures = figures_of(found, held_out)
        write_text(out.with_suffix(".html"), page(found, result, name, figures, command))
        written.append(str(out.with_suffix(".html")))
        if arguments.format is not None:
            from amulett_gym.reporting.style import save_figures

            named = {f"{name}-{key.removeprefix('fit-')}": figure for key, (_, figure) in figures.items()}
            written += map(str, save_figures(named, out.parent))
    show(f"Written: {', '.join(written)}.")
    return 0


def _files(arguments: argparse.Namespace) -> Path:
    """Return the profile's path; refuse files that cannot be written or options that name no log."""
    for option in ("out", "fleet"):
        path = getattr(arguments, option)
        if path is not None and Path(path).suffix.lower() not in (".yaml", ".yml"):
            raise AmulettError(f"--{option} '{path}' has to end in .yaml")
    out = Path(arguments.out)
    for path in (out, out.with_suffix(".json"), out.with_suffix(".html"), arguments.fleet):
        if path is not None:
            check_writable(path)
    named = {"payload": [each[0] for each in arguments.payload], "release": arguments.release}
    logs = [*arguments.logs, *arguments.hold_out]
    for option, names in named.items():
        for name in names:
            if name not in logs:
                raise AmulettError(f"--{option} names '{name}'; it has to be one of the logs: {', '.join(logs)}")
    files: dict[Path, str] = {}
    for option, names in (("fit", arguments.logs), ("hold out", arguments.hold_out)):
        for name in names:
            if (other := files.setdefault(Path(name).resolve(), option)) != option:
                raise AmulettError(f"'{name}' is to be fitted and held out; choose one")
            if names.count(name) > 1:
                raise AmulettError(f"'{name}' is named twice among the logs to {other}")
    return out


def recordings(arguments: argparse.Namespace, show: object) -> tuple[list[Recording], list[Recording]]:
    """Return what is fitted and what is held out."""
    from dataclasses import replace

    from amulett_gym.identification.from_logs.recording import Recording
    from amulett_gym.logs import read_log

    payloads = {name: _payload(mass, arm) for name, mass, arm in arguments.payload}
    files = [Path(path).name for path in (*arguments.logs, *arguments.hold_out)]

    def load(path: str) -> Recording:
        columns, name = read_log(path, arguments.mapping).columns, Path(path).name
        return Recording(
            name if files.count(name) == 1 else path, columns, payloads.get(path), path in arguments.release
        )

    fitted, held_out = [load(path) for path in arguments.logs], [load(path) for path in arguments.hold_out]
    if not held_out:
        last = fitted[-1]
        time = last.columns["time"]
        border = float(time[-1] - _HELD_OUT * (time[-1] - time[0]))
        fitted[-1] = replace(last, end=border)
        held_out = [replace(last, begin=border, name=f"last fifth of {last.name}", released=False)]
    return fitted, held_out


def _payload(mass: str, arm: str) -> Payload:
    from pydantic import ValidationError

    from amulett_gym.settings import describe
    from amulett_gym.tasks.scenario import Payload

    try:
        return Payload(mass=float(mass), arm=float(arm))
    except ValidationError as error:
        raise describe(error, Payload, "--payload") from error
    except ValueError as error:
        raise AmulettError(f"--payload needs a mass [kg] and an arm [m], two numbers, not '{mass} {arm}'") from error
