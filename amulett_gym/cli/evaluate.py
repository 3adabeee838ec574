"""`amulett evaluate`: compare contenders on the same scenarios."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from amulett_gym.cli.options import add_device, add_figures, add_json, add_options, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.cli.own_policies import POLICIES, digests, own_contenders
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder

HELP = "compare laws and policies with eq. 6 on the same scenarios"
EXAMPLES = """  amulett evaluate --policies eq6 eq6-printed constant:5 constant:10 position-only --out comparison
  amulett evaluate --policies runs/mine constant:10 --suite reach --episodes 200 --seed 1000 --out comparison
  amulett evaluate --policies mylaw.py:softer constant:8 --episodes 20 --json
  amulett evaluate --policies pretrained constant:6 --scenario lift.yaml reach.json --out own
  amulett evaluate --policies pretrained constant:6 --suite mixed --fleet my_devices.yaml --out fleet
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    names = f"{POLICIES}; eq6 always runs, as the baseline of the ratios"
    parser.add_argument("--policies", nargs="+", required=True, metavar="NAME", help=names)
    add_options(parser, "--trust-pickle", "--suite", "--split")
    add_device(parser, one=False)
    own = "own scenarios (JSON or YAML), played in turn instead of the suite's"
    add_options(parser, "--scenario", nargs="+", default=[], help=own)
    episodes = "number of scenarios, on each device (default: 100, or one of each own scenario)"
    parser.add_argument("--episodes", type=int, metavar="N", help=episodes)
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="episode length [s] (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="scenario i has the seed SEED + i (default: 0)")
    env_id = "environment (default: Amulett/Scaling-v0). Policies trained in Amulett/Drives-v0 always act there"
    parser.add_argument("--env-id", default="Amulett/Scaling-v0", help=env_id)
    parser.add_argument("--out", metavar="DIR", help="folder for results.json, scenarios.csv, report.html and figures")
    add_figures(parser)
    add_json(parser, "the content of results.json")


def run(arguments: argparse.Namespace) -> int:
    """Run the comparison, print its table, and write its files."""
    from amulett_gym.evaluation.across import fleet_in_words
    from amulett_gym.evaluation.comparison import in_words

    summary, earlier = compare(resolve(arguments), arguments.out, _command(arguments))
    if arguments.json:
        print_json(summary)
    show = printer(arguments)
    show((in_words if arguments.fleet is None else fleet_in_words)(summary))
    if arguments.out is not None:
        replaced = ", instead of the earlier comparison" if earlier else ""
        show(f"Written to {arguments.out}: report.html, results.json, scenarios.csv and figures{replaced}.")
    return 0


def resolve(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return a comparison's inputs as plain data, with the whole devices and the SHA-256 of learned policies."""
    from amulett_gym.fleet import load_fleet
    from amulett_gym.profile import load_profile
    from amulett_gym.tasks.scenario import load_scenario

    if arguments.fleet is None:
        devices: dict[str, Any] = {"profile": load_profile(arguments.profile).model_dump()}
    else:
        devices = {"fleet": [profile.model_dump() for profile in load_fleet(arguments.fleet)]}
    scenarios = [load_scenario(file).model_dump() for file in arguments.scenario]
    return {
        "policies": list(arguments.policies),
        "sha256": digests(arguments.policies),
        **{key: getattr(arguments, key) for key in ("suite", "split")},
        **devices,
        "env_id": arguments.env_id.split(":")[-1],
        "scenarios": scenarios,
        "duration": arguments.duration,
        "episodes": (len(scenarios) or 100) if arguments.episodes is None else arguments.episodes,
        **{key: getattr(arguments, key) for key in ("seed", "trust_pickle")},
    }


def compare(
    config: Mapping[str, Any], out: str | None, words: Sequence[str], places: Mapping[str, str] | None = None
) -> tuple[dict[str, Any], bool]:
    """Compare by a `config` of :func:`resolve`; write the report to `out`, if any, with the words of the command.

    `out` also gets copies of the policies that are files or folders. `places` are those of policies that were moved.
    Return the content of ``results.json``, and whether an earlier comparison in `out` was replaced.
    """
    from dataclasses import replace

    from amulett_gym.evaluation.across import FleetResults, evaluate_fleet, summarise_fleet
    from amulett_gym.evaluation.comparison import COMPARISON_MARKS, summarise
    from amulett_gym.evaluation.runner import Results, evaluate
    from amulett_gym.fleet import load_fleet
    from amulett_gym.laws.copies import copy_policies

    fleet = load_fleet(config["fleet"] if "fleet" in config else [config["profile"]])
    keywords = {key: config[key] for key in ("suite", "split", "env_id", "episodes", "seed")}
    keywords |= {key: config[key] for key in ("scenarios", "duration") if key in config}  # not in older folders
    policies = own_contenders(config["policies"], fleet[0], config["env_id"], config["trust_pickle"], places)
    with ExitStack() as stack:
        earlier = False
        if out is not None:
            earlier = stack.enter_context(output_folder(out, "comparison", [COMPARISON_MARKS]))
            stack.enter_context(locked_folder(out))
            copies = copy_policies(config["policies"], places)  # in memory: their place may be in `out`
        results: Results | FleetResults
        if "fleet" in config:
            results = evaluate_fleet(policies, fleet, progress=True, **keywords)
        else:
            results = evaluate(policies, profile=fleet[0], progress=True, **keywords)
        results = replace(results, command=shlex.join(words))
        if out is None:
            return (summarise_fleet(results) if isinstance(results, FleetResults) else summarise(results)), earlier

        from amulett_gym.evaluation.page import write_fleet_report, write_report
        from amulett_gym.storage.provenance import write_provenance

        seeds = range(config["seed"], config["seed"] + config["episodes"])
        copies.write(out)
        write_provenance(out, "evaluate", {**config, "kept": copies.record}, seeds, words)
        if isinstance(results, FleetResults):
            return write_fleet_report(results, out), earlier
        return write_report(results, out), earlier


def _command(arguments: argparse.Namespace) -> list[str]:
    device = "profile" if arguments.fleet is None else "fleet"
    options = ("policies", "scenario", "suite", device, "episodes", "duration", "seed", "env-id", "split", "out")
    return ["amulett", "evaluate", *command_words(arguments, *options, "trust-pickle")]
