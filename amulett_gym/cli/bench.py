"""`amulett bench`: steps a second, beside Gymnasium's own environments in the same run."""

from __future__ import annotations

import argparse
import json
import sys

HELP = "measure the environments' speed beside Gymnasium's own"
EXAMPLES = """  amulett bench
  amulett bench --devices 4096 --turns 15 --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--devices", type=int, default=1024, help="devices in the vector environments (default: 1024)")
    parser.add_argument("--turns", type=int, default=7, help="interleaved turns that each one takes (default: 7)")
    parser.add_argument("--seed", type=int, default=0, help="of scenarios and actions (default: 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Race all contestants and print their speeds and ratios."""
    from dataclasses import asdict

    from tqdm import tqdm

    from amulett_gym.errors import AmulettError
    from amulett_gym.evaluation.speed import contestants, race

    for option, smallest in (("devices", 1), ("turns", 1), ("seed", 0)):
        if getattr(arguments, option) < smallest:
            raise AmulettError(f"--{option} is {getattr(arguments, option)}; it has to be at least {smallest}")
    entrants = contestants(arguments.devices, arguments.seed)
    quiet = not sys.stderr.isatty()
    with tqdm(total=arguments.turns * len(entrants), desc="turns", leave=False, disable=quiet) as bar:
        speeds = {speed.name: speed for speed in race(entrants, arguments.turns, watch=bar.update)}
    pendulum = speeds["Pendulum-v1, single"]
    cartpole = speeds[f"CartPole-v1, vector of {arguments.devices}"]
    ratios = {
        name: speed.steps_per_second / (cartpole if "vector" in name else pendulum).steps_per_second
        for name, speed in speeds.items()
    }
    if arguments.json:
        print(json.dumps({name: {**asdict(speed), "ratio": ratios[name]} for name, speed in speeds.items()}, indent=2))
        return 0
    print(f"{'':32}{'agent steps/s':>14}{'slowest':>13}{'fastest':>13}{'ticks/s':>14}{'ratio':>8}")
    for name, speed in speeds.items():
        print(
            f"{name:32}{speed.steps_per_second:14,.0f}{speed.slowest:13,.0f}{speed.fastest:13,.0f}"
            f"{speed.ticks_per_second:14,.0f}{ratios[name]:8.2f}"
        )
    print("medians of interleaved turns; ratio: to Pendulum-v1 (single), to CartPole-v1 (vector); 1.3 or less is a tie")
    return 0
