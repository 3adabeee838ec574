"""`amulett simulate`: one episode, recorded at control rate."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from amulett_gym.evaluation.episode import Episode

HELP = "record one episode with a law or policy: CSV, figure, metrics"
EXAMPLES = """  amulett simulate --law eq6 --suite paper-step --profile simulation --out step.csv --plot step.png
  amulett simulate --law constant:10 --suite hold-push --seed 3 --plot pushes.svg
  amulett simulate --law runs/mine --scenario my_scenario.json --duration 5 --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--law", default="eq6", help="a law's name (see: amulett list) or a policy bundle's folder (default: eq6)"
    )
    parser.add_argument("--suite", default="steps", help="suite that the scenario is drawn from (default: steps)")
    parser.add_argument("--profile", default="testbed", help="device profile, by name or YAML file (default: testbed)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the scenario and the sensor noise (default: 0)")
    parser.add_argument("--split", default="held-out", help="train, validation, held-out (default) or shifted")
    parser.add_argument(
        "--scenario", metavar="FILE", help="a scenario of your own (JSON or YAML) instead of the suite's"
    )
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="seconds to simulate (default: 10)")
    parser.add_argument("--out", metavar="FILE.csv", help="trajectory, one row a control tick")
    parser.add_argument("--plot", metavar="FILE.png", help="figure of the trajectory (.png or .svg)")
    parser.add_argument("--json", action="store_true", help="print metrics, units and scenario as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write what was asked for, and print the metrics."""
    if not 0 < arguments.duration < math.inf:
        raise AmulettError(f"--duration is {arguments.duration}; it has to be a positive number of seconds")
    if arguments.out is not None and Path(arguments.out).suffix.lower() != ".csv":
        raise AmulettError(f"--out '{arguments.out}' has to end in .csv")
    if arguments.plot is not None and Path(arguments.plot).suffix.lower() not in (".png", ".svg"):
        raise AmulettError(f"--plot '{arguments.plot}' has to end in .png or .svg")

    from amulett_gym.evaluation.episode import record_episode
    from amulett_gym.evaluation.metrics import UNITS
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.evaluation.runner import Protocol, labels
    from amulett_gym.profile import load_profile
    from amulett_gym.simulation.trajectory import write_csv

    profile = load_profile(arguments.profile)
    protocol = Protocol(
        profile, arguments.suite, arguments.split, episodes=1, seed=arguments.seed, duration=arguments.duration
    )
    remarks = device_remarks(profile, [arguments.law])
    print_remarks(remarks)
    episode = record_episode(arguments.law, protocol, arguments.scenario)
    if arguments.out is not None:
        write_csv(episode.trajectory, arguments.out)
    scenario = f"suite {arguments.suite}" if arguments.scenario is None else f"scenario {arguments.scenario}"
    title = f"{labels([arguments.law])[arguments.law]}, profile {profile.name}, {scenario}"
    if arguments.json:
        metrics = {name: value if math.isfinite(value) else None for name, value in episode.metrics.items()}
        content = {
            "law": arguments.law,
            "profile": profile.name,
            "suite": arguments.suite,
            "split": arguments.split,
            "seed": arguments.seed,
            "duration": arguments.duration,
            "failure": episode.failure,
            "metrics": metrics,
            "units": {name: UNITS[name] for name in metrics},
            "remarks": remarks,
            "scenario": episode.scenario.model_dump(),
        }
        print(json.dumps(content, indent=2, allow_nan=False))
    else:
        _print(arguments, episode, title)
    if arguments.plot is not None:  # last: an error in a figure loses no number
        from amulett_gym.evaluation.plots import trajectory_figure
        from amulett_gym.reporting.style import save_figure

        save_figure(trajectory_figure(episode.trajectory, title), arguments.plot)
        if not arguments.json:
            print(f"Written: {arguments.plot}")
    return 0


def _print(arguments: argparse.Namespace, episode: Episode, title: str) -> None:
    """Print metrics, failure, and where the trajectory is."""
    from amulett_gym.evaluation.metrics import UNITS

    print(f"{title}, seed {arguments.seed}, {arguments.duration:g} s")
    for name, value in episode.metrics.items():
        shown = f"{value:.4g}" if math.isfinite(value) else "-"
        print(f"  {name:22} {shown:>10}  {UNITS[name] if UNITS[name] != '1' else ''}".rstrip())
    if episode.failure:
        print(f"The device failed after {episode.trajectory['time'][-1]:g} s: {episode.failure}.")
    if arguments.out is not None:
        print(f"Written: {arguments.out}")
