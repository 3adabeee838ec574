"""`amulett quickstart`: the main job, end to end: train, compare, report."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from amulett_gym.cli.train import check_installed

HELP = "train a stiffness policy and compare it with every hand-tuned law, in about 3 minutes"
EXAMPLES = """  amulett quickstart
  amulett quickstart --seconds 30 --seed 1 --out runs/short
"""

LAWS = ("eq6", "eq6-printed", "eq6-held", "constant:5", "constant:8", "constant:10", "constant:12", "position-only")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--seconds", type=float, default=100.0, help="time to train [s] (default: 100)")
    parser.add_argument("--episodes", type=int, default=100, help="fresh scenarios to compare on (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the training (default: 0)")
    parser.add_argument("--out", default="runs/quickstart", metavar="DIR", help="folder (default: runs/quickstart)")
    parser.add_argument("--json", action="store_true", help="print the content of results.json and nothing else")


def run(arguments: argparse.Namespace) -> int:
    """Train on `steps`, compare on scenarios that were never trained on, and write the report."""
    check_installed()
    from dataclasses import replace

    from amulett_agents import load_train_config, train
    from amulett_gym.evaluation.report import write_report
    from amulett_gym.evaluation.results import table
    from amulett_gym.evaluation.runner import evaluate

    out = Path(arguments.out)
    config = load_train_config(overrides=[f"max_seconds={arguments.seconds}", f"seed={arguments.seed}"])
    _say(arguments, f"Training PPO on '{config.env.suite}' ({config.env.profile}) for {arguments.seconds:g} s ...")
    command = ["amulett", *sys.argv[1:]]
    trained = train(config, out / "ppo", progress=sys.stderr.isatty(), command=command, overwrite=True)
    if trained.interrupted:
        raise KeyboardInterrupt
    _say(arguments, f"{trained.steps:,} steps. Comparing on {arguments.episodes} scenarios never trained on ...")
    results = evaluate(
        [*LAWS, str(out / "ppo")],
        suite=config.env.suite,
        profile=config.env.profile,
        episodes=arguments.episodes,
        progress=sys.stderr.isatty() and not arguments.json,
    )
    summary = write_report(replace(results, command=" ".join(command)), out)
    if arguments.json:
        print(json.dumps(summary, indent=2, allow_nan=False))
        return 0
    print(table(summary))
    print(f"\n{summary['verdict']}\n")
    print(f"Open {out / 'report.html'}. The policy is in {trained.best}.")
    return 0


def _say(arguments: argparse.Namespace, message: str) -> None:
    if not arguments.json:
        print(message, flush=True)
