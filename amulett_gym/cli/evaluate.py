"""`amulett evaluate`: contenders on the same scenarios, with intervals and a report."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from contextlib import nullcontext

from amulett_gym.cli.own_policies import add_trust, with_zips
from amulett_gym.files import output_folder

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
        help="laws by name (see: amulett list), folders of policy bundles, or zips of Stable-Baselines3 that you trust "
        "(--trust-pickle); eq6 always runs, as the yardstick",
    )
    add_trust(parser)
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
    from dataclasses import replace

    from amulett_gym.config import load_profile
    from amulett_gym.evaluation.results import COMPARISON_MARKS, in_words, summarise
    from amulett_gym.evaluation.runner import evaluate

    out, env_id, profile = arguments.out, arguments.env_id.split(":")[-1], load_profile(arguments.profile)
    policies = with_zips(arguments.policies, profile, env_id, arguments.trust_pickle)
    with nullcontext(False) if out is None else output_folder(out, "comparison", [COMPARISON_MARKS]) as earlier:
        results = evaluate(
            policies,
            suite=arguments.suite,
            profile=profile,
            episodes=arguments.episodes,
            seed=arguments.seed,
            env_id=env_id,
            split=arguments.split,
            progress=sys.stderr.isatty() and not arguments.json,
        )
        results = replace(results, command=_command(arguments))
        if out is None:
            summary = summarise(results)
        else:
            from amulett_gym.evaluation.report import write_report

            summary = write_report(results, out)
    if arguments.json:
        print(json.dumps(summary, indent=2, allow_nan=False))
        return 0
    print(in_words(summary))
    if out is not None:
        replaced = ", in the place of the comparison that was there" if earlier else ""
        print(f"Written to {out}: report.html, results.json, scenarios.csv and figures{replaced}.")
    return 0


def _command(arguments: argparse.Namespace) -> str:
    words = ["amulett", "evaluate", "--policies", *arguments.policies]
    for option in ("suite", "profile", "episodes", "seed", "env_id", "split", "out"):
        value = getattr(arguments, option)
        if value is not None:
            words += [f"--{option.replace('_', '-')}", str(value)]
    if arguments.trust_pickle:
        words.append("--trust-pickle")
    return shlex.join(words)
