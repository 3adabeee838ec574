"""`amulett benchmark`: every contender on every suite."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from amulett_gym.cli.options import add_figures, add_json, add_options, add_workers, chosen_workers, command_words
from amulett_gym.cli.output import print_json, printer

if TYPE_CHECKING:
    from amulett_gym.workers.call import Workers

T = TypeVar("T")

HELP = "run the benchmark: train missing policies, compare all on all suites, and check the claims; resumes by itself"
EXAMPLES = """  amulett benchmark --quick --out runs/benchmark-quick
  amulett benchmark --config configs/benchmark.yaml --out runs/benchmark
  amulett benchmark --config configs/full_control.yaml --out runs/full-control
  amulett benchmark --config configs/devices.yaml --workers 2 --out runs/devices
  amulett benchmark --config configs/benchmark.yaml --runs runs/stored --out runs/benchmark --doc docs/benchmark.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", metavar="DIR", required=True, help="folder; finished stages in it are not repeated")
    parser.add_argument("--config", metavar="FILE", help="description in YAML (default: as configs/benchmark.yaml)")
    quick = "a test of a few minutes: few suites, scenarios and seeds, short training, claims are not judged"
    parser.add_argument("--quick", action="store_true", help=quick)
    runs = "folder of training runs, <entry>/seed-<k>; missing ones are trained there (default: DIR/runs in --out)"
    parser.add_argument("--runs", metavar="DIR", help=runs)
    add_workers(parser, "searches, training runs, contenders, problems of optimal control", 1, processes=True)
    further = "further contenders: laws, bundles, or trusted zips"
    parser.add_argument("--policies", nargs="+", default=[], metavar="NAME", help=further)
    add_options(parser, "--trust-pickle", "--doc")
    add_figures(parser)
    add_json(parser, "the content of benchmark.json")
    parser.set_defaults(places={})  # of kept policies, for `amulett rerun`


def run(arguments: argparse.Namespace) -> int:
    """Run the stages that are not finished, print claims and ranking, and write the files."""
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.reporting.document import check_document
    from amulett_gym.storage.provenance import machine
    from amulett_gym.studies.benchmark.claims import check_claims
    from amulett_gym.studies.benchmark.description import PAPERS, load_benchmark, load_profile_of, quick, recipe_folder
    from amulett_gym.studies.benchmark.document import MARKS, write_document
    from amulett_gym.studies.benchmark.page import in_words, judged, write_benchmark
    from amulett_gym.studies.benchmark.results import content
    from amulett_gym.studies.benchmark.stages import run_benchmark

    workers = chosen_workers(arguments)
    if arguments.config is not None and (content_of_file := _over_devices(arguments.config)) is not None:
        return _run_over_devices(arguments, content_of_file, workers)
    description, recipes = load_benchmark(arguments.config), recipe_folder(arguments.config)
    if arguments.quick:
        description = quick(description)
    if arguments.doc is not None:
        check_document(arguments.doc, [MARKS], images=True)
    profile, words = load_profile_of(description, recipes), _words(arguments)
    print_remarks(device_remarks(profile, loops=description.loops or [PAPERS], suite=description.headline))
    evidence = _measure(arguments, run_benchmark, description, recipes, profile, words, workers)
    found = content(evidence, shlex.join(words), machine(), arguments.quick)
    claims = check_claims(found)
    figures = write_benchmark(evidence, found, claims, arguments.out)
    if arguments.doc is not None:
        write_document(found, claims, figures, arguments.doc)
    lost = ", and the scenarios with the largest losses" if found["worst"] else ""
    return _print(arguments, judged(found, claims), in_words(found, claims), lost)


def _over_devices(path: str) -> Mapping[str, Any] | None:
    """Return the content of a description of a benchmark over devices; None if it is one on a single device."""
    from amulett_gym.settings import find_config
    from amulett_gym.storage.safe_yaml import read_yaml

    content = read_yaml(find_config(path, "benchmark"), "benchmark")
    return content if "fleets" in content else None


def _run_over_devices(arguments: argparse.Namespace, content_of_file: Mapping[str, Any], workers: Workers) -> int:
    """Run a benchmark over devices as `run` does one on a single device."""
    from amulett_gym.reporting.document import check_document
    from amulett_gym.storage.provenance import machine
    from amulett_gym.studies.benchmark.description import recipe_folder
    from amulett_gym.studies.benchmark.devices.claims import check_claims
    from amulett_gym.studies.benchmark.devices.description import load_fleets, parse_devices_benchmark, quick
    from amulett_gym.studies.benchmark.devices.report import (
        MARKS,
        in_words,
        judged,
        write_devices_benchmark,
        write_document,
    )
    from amulett_gym.studies.benchmark.devices.results import content
    from amulett_gym.studies.benchmark.devices.stages import run_devices_benchmark

    folder = recipe_folder(arguments.config)
    description = parse_devices_benchmark(content_of_file, arguments.config)
    if arguments.quick:
        description = quick(description, folder)
    if arguments.doc is not None:
        check_document(arguments.doc, [MARKS], images=True)
    device, words = load_fleets(description, folder)["judge"][0], _words(arguments)
    evidence = _measure(arguments, run_devices_benchmark, description, folder, device, words, workers)
    found = content(evidence, shlex.join(words), machine(), arguments.quick)
    claims = check_claims(found)
    figures = write_devices_benchmark(evidence, found, claims, arguments.out)
    if arguments.doc is not None:
        write_document(found, claims, figures, arguments.doc)
    return _print(arguments, judged(found, claims), in_words(found, claims))


def _words(arguments: argparse.Namespace) -> list[str]:
    """Return the words of the command, without its folder."""
    options = ("config", "quick", "policies", *(["trust-pickle"] if arguments.policies else []))
    return ["amulett", "benchmark", *command_words(arguments, *options)]


def _measure(
    arguments: argparse.Namespace,
    stages: Callable[..., T],
    description: Any,
    folder: Path,
    device: Any,
    words: list[str],
    workers: Workers,
) -> T:
    """Return what the function `stages` finds, which runs those of a description; own policies act on `device`."""
    from amulett_gym import ENV_IDS
    from amulett_gym.cli.own_policies import own_contenders
    from amulett_gym.laws.copies import copy_policies

    own = own_contenders(arguments.policies, device, ENV_IDS[0], arguments.trust_pickle, arguments.places)
    copies = copy_policies(arguments.policies, arguments.places)
    show = printer(arguments)
    evidence = stages(
        *(description, arguments.out, folder, arguments.runs, own, [*words, "--out", arguments.out], copies),
        say=show,
        progress=True,
        workers=workers,
    )
    show("Drawing intervals and figures ...")
    return evidence


def _print(arguments: argparse.Namespace, found: Mapping[str, Any], text: str, more: str = "") -> int:
    """Print a benchmark's results as JSON or in words, with the files that it wrote; `more` names further ones."""
    from amulett_gym.studies.benchmark.page import PAGE

    if arguments.json:
        print_json(found)
        return 0
    show = printer(arguments)
    if arguments.doc is not None:
        show(f"Renewed: {arguments.doc}")
    show(f"\n{text}\n")
    show(f"Written to {arguments.out}: {PAGE}, benchmark.json, tables, figures{more}.")
    return 0
