"""`amulett evaluate`: contenders on the same scenarios, with intervals and a report."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path

from amulett_gym.errors import AmulettError

HELP = "compare laws and policies with eq. 6 on the same scenarios"
EXAMPLES = """  amulett evaluate --policies eq6 eq6-printed constant:5 constant:10 position-only --out comparison
  amulett evaluate --policies runs/mine constant:10 --suite reach --episodes 200 --seed 1000 --out comparison
  amulett evaluate --policies constant:8 --episodes 20 --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--policies",
        nargs="+",
        required=True,
        metavar="NAME",
        help="laws by name (see: amulett list) or folders of policy bundles; eq6 always runs, as the yardstick",
    )
    parser.add_argument("--suite", default="steps", help="suite of scenarios (default: steps)")
    parser.add_argument("--profile", default="testbed", help="device profile, by name or YAML file (default: testbed)")
    parser.add_argument("--episodes", type=int, default=100, help="number of scenarios (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="scenario i has the seed SEED + i (default: 0)")
    parser.add_argument("--env-id", default="Amulett/Scaling-v0", help="environment (default: Amulett/Scaling-v0)")
    parser.add_argument("--split", default="held-out", help="train, validation or held-out (default: held-out)")
    parser.add_argument("--out", metavar="DIR", help="folder for results.json, scenarios.csv, report.html and figures")
    parser.add_argument("--json", action="store_true", help="print the content of results.json and nothing else")


def run(arguments: argparse.Namespace) -> int:
    """Run the comparison, print its table, and write its files."""
    if arguments.out is not None and Path(arguments.out).exists() and not Path(arguments.out).is_dir():
        raise AmulettError(f"--out '{arguments.out}' is a file; it has to be a folder")

    from dataclasses import replace

    from amulett_gym.evaluation.results import summarise, table
    from amulett_gym.evaluation.runner import evaluate

    results = evaluate(
        arguments.policies,
        suite=arguments.suite,
        profile=arguments.profile,
        episodes=arguments.episodes,
        seed=arguments.seed,
        env_id=arguments.env_id.split(":")[-1],
        split=arguments.split,
        progress=not arguments.json,
    )
    results = replace(results, command=_command(arguments))
    if arguments.out is None:
        summary = summarise(results)
    else:
        from amulett_gym.evaluation.report import write_report

        summary = write_report(results, arguments.out)
    if arguments.json:
        print(json.dumps(summary, indent=2, allow_nan=False))
        return 0
    print(table(summary))
    print()
    print(summary["verdict"])
    if not results.listed:
        print("eq6 was not asked for; it always runs, as the yardstick.")
    if arguments.out is not None:
        print(f"Written to {arguments.out}: report.html, results.json, scenarios.csv and figures.")
    return 0


def _command(arguments: argparse.Namespace) -> str:
    words = ["amulett", "evaluate", "--policies", *arguments.policies]
    for option in ("suite", "profile", "episodes", "seed", "env_id", "split", "out"):
        value = getattr(arguments, option)
        if value is not None:
            words += [f"--{option.replace('_', '-')}", str(value)]
    return shlex.join(words)
