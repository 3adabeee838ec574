"""`amulett train`: train a policy by a recipe."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec

from amulett_gym.errors import AmulettError

HELP = "train a policy by a recipe; keeps the best and the last one as bundles"
EXAMPLES = """  amulett train --config configs/ppo.yaml --out runs/first
  amulett train --config configs/ppo.yaml --set env.suite=reach ppo.learning_rate=3e-4 --seed 1 --out runs/reach
  amulett evaluate --policies eq6 constant:10 runs/first --suite steps --out runs/first-evaluation
  tensorboard --logdir runs
"""

_NEEDED = ("torch", "stable_baselines3", "tensorboard")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--config", metavar="FILE", help="recipe in YAML (default: the tuned recipe, configs/ppo.yaml)")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help="change keys of the recipe, for example ppo.gamma=0.98",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the run: logs, validations, bundles")
    parser.add_argument("--seed", type=int, help="in the place of the recipe's")
    parser.add_argument("--overwrite", action="store_true", help="replace the run that is in DIR already")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Train; exit code 130 if Ctrl-C ended it (the policies are kept all the same)."""
    check_installed()
    import json
    from dataclasses import asdict

    from amulett_agents import load_train_config

    overrides = [*arguments.overrides, *([] if arguments.seed is None else [f"seed={arguments.seed}"])]
    config = load_train_config(arguments.config, overrides)  # a wrong recipe is refused before torch is imported
    from amulett_agents import train

    result = train(
        config,
        arguments.out,
        progress=sys.stderr.isatty(),
        command=["amulett", *sys.argv[1:]],
        overwrite=arguments.overwrite,
    )
    if arguments.json:
        print(json.dumps(asdict(result), default=str, indent=2))
    else:
        if result.interrupted:
            print("interrupted; what was learned until then is kept")
        print(f"{result.steps:,} steps in {result.seconds:.0f} s, seed {config.seed}")
        print(f"best   cost {result.best_cost:.4f} on the validation scenarios, after {result.best_steps:,} steps")
        print(f"       {result.best}")
        print(f"last   cost {result.last_cost:.4f}")
        print(f"       {result.last}")
    return 130 if result.interrupted else 0


def check_installed() -> None:
    """Raise an error that says what to install if what learns is not there."""
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise AmulettError(f'training needs {", ".join(missing)}; install with: pip install "amulett-gym[agents]"')
