"""`amulett tune`: search a recipe's settings with Optuna."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from amulett_gym.cli.options import add_json, add_options, add_workers, chosen_workers, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.learning import TUNING, check_installed, load_learning

HELP = "search for better settings of a recipe; the same command continues an interrupted or killed search"
EXAMPLES = """  amulett tune --config configs/ppo.yaml --space configs/tune.yaml --trials 40 --out runs/study
  amulett tune --space configs/tune.yaml --set total_steps=500000 --seeds 3 --trials 20 --out runs/study
  amulett tune --space configs/tune.yaml --batch 4 --workers 4 --out runs/study
  amulett train --config runs/study/best.yaml --out runs/best
"""

_MOST_SHOWN = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--config", metavar="FILE", help="recipe in YAML (default: the default recipe)")
    add_options(parser, "--set", help="change keys of the recipe before the search, for example total_steps=500000")
    parser.add_argument("--space", metavar="FILE", required=True, help="search space: keys with ranges or choices")
    parser.add_argument("--trials", type=int, default=40, help="trials, including finished ones (default: 40)")
    parser.add_argument(
        "--seeds", type=int, default=1, help="seeds of each trial; its result is their mean (default: 1)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the proposals (default: 0)")
    batch = "trials proposed together after the 8 random ones, which workers can train at a time (default: 1)"
    parser.add_argument("--batch", type=int, default=1, metavar="N", help=batch)
    add_workers(parser, "training runs", 1)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of the study")
    add_json(parser, "the trials")
    parser.set_defaults(resolved=None, places={})  # settings and kept policies of a study, for `amulett rerun`


def run(arguments: argparse.Namespace) -> int:
    """Tune; return 130 if Ctrl-C or SIGTERM ended it, 1 if all trials failed."""
    check_installed(TUNING)
    from dataclasses import asdict

    tuning, workers = load_learning("tuning"), chosen_workers(arguments)
    if arguments.resolved is None:
        config = load_learning("recipes").load_train_config(arguments.config, arguments.overrides)
        space = tuning.load_space(arguments.space, config)
    else:
        config, space = tuning.stored_study(arguments.resolved)

    show = printer(arguments)

    def report(trial: Any, best: Any) -> None:
        cost = f"cost {trial.cost:.4f}" if trial.costs else f"failed: {trial.error}"
        show(f"trial {trial.number}: {cost}; best {best.cost if best else float('nan'):.4f}")

    batch = [] if arguments.batch == 1 else ["batch"]
    options = ("config", "space", "trials", "seeds", "seed", *batch, "workers", "ray", "out")
    words = ["amulett", "tune", *command_words(arguments, *options)]
    words += ["--set", *arguments.overrides] if arguments.overrides else []
    study = (arguments.trials, arguments.out, arguments.seed, arguments.seeds)
    how = {"places": arguments.places, "workers": workers, "batch": arguments.batch}
    trials = tuning.tune(config, space, *study, command=words, progress=True, report=report, **how)
    if trials is None:
        print(f"interrupted; finished runs are kept. Continue with:\n       {shlex.join(words)}", file=sys.stderr)
        return 130
    best = tuning.best_of(trials)
    if arguments.json:
        print_json([asdict(trial) | {"cost": trial.cost} for trial in trials])
    show(_table(trials, list(space)))
    if best is not None:
        show(f"\nThe best recipe is in {Path(arguments.out) / tuning.BEST}.")
    return 0 if best is not None else 1


def _table(trials: list[Any], keys: list[str]) -> str:
    """Return the table of the best trials."""
    from amulett_gym.reporting.table import Table

    judged = sorted((trial for trial in trials if trial.costs), key=lambda trial: (trial.cost, trial.number))
    rows = [
        [str(trial.number), f"{trial.cost:.4f}", *(_short(trial.changes[key]) for key in keys)]
        for trial in judged[:_MOST_SHOWN]
    ]
    failed = len(trials) - len(judged)
    note = f"{failed} of {len(trials)} trials failed" if failed else ""
    return Table("", ("trial", "cost", *keys), rows, note).text()


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
