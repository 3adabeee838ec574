"""`amulett train`: train a policy with a recipe, or resume an interrupted run."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_json, add_options, add_workers, chosen_workers, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.learning import check_installed, load_learning

if TYPE_CHECKING:
    from amulett_gym.reporting.table import Table
    from amulett_gym.workers.call import Workers

HELP = (
    "train a policy with a recipe; saves the best and the last one as bundles; resumes interrupted and killed runs; "
    "exit code 1: training diverged, 130: interrupted"
)
EXAMPLES = """  amulett train --config configs/ppo.yaml --out runs/first
  amulett train --config configs/ppo.yaml --set env.suite=reach ppo.learning_rate=3e-4 --seed 1 --out runs/reach
  amulett train --config configs/sac.yaml --out runs/sac
  amulett train --start pretrained --set env.profile=mine.yaml --out runs/mine
  amulett train --resume runs/first
  amulett train --config configs/ppo.yaml --seeds 0 1 2 3 --workers 2 --out runs/four
  amulett evaluate --policies eq6 constant:10 runs/first --suite steps --out runs/first-evaluation
  tensorboard --logdir runs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--config", metavar="FILE", help="recipe in YAML (default: the tuned recipe, configs/ppo.yaml)")
    add_options(parser, "--set", help="change keys of the recipe, for example ppo.gamma=0.98")
    parser.add_argument(
        "--start",
        metavar="POLICY",
        help="adapt a policy (pretrained, or a folder) for a minute, usually on another device, instead of a recipe: "
        "its inputs and actions are kept, and itself if no better one is found",
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the run: logs, validations, bundles")
    parser.add_argument("--resume", metavar="DIR", help="continue the run in DIR with its own recipe")
    parser.add_argument("--seed", type=int, help="seed instead of the recipe's")
    seeds = "train with each of these seeds, in DIR/seed-<k>; --resume DIR continues all of them"
    parser.add_argument("--seeds", type=int, nargs="+", metavar="N", help=seeds)
    add_workers(parser, "of several seeds: runs", 1)
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier run in DIR")
    add_json(parser, "the result")


def run(arguments: argparse.Namespace) -> int:
    """Train; return 130 if Ctrl-C or SIGTERM ended it, 1 if it diverged (the policies until then are kept)."""
    check_installed()
    from dataclasses import asdict
    from pathlib import Path

    from amulett_gym import DRIVES_ID, WORN_ID
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks, start_remarks
    from amulett_gym.profile import load_profile
    from amulett_gym.simulation.layout import DRIVES
    from amulett_gym.storage.provenance import process_words

    finished, show, workers = False, printer(arguments), chosen_workers(arguments)
    if arguments.resume is not None:
        _check_alone(arguments)
        if load_learning("training").holds_seeds(arguments.resume):
            return _train_seeds(arguments, workers, None)
        _check_one_run(arguments)
        training = load_learning("training")
        finished = training.is_finished(arguments.resume)
        result = training.resume(arguments.resume)
    else:
        if arguments.out is None:
            raise AmulettError("train needs --out DIR for a new run, or --resume DIR to continue one")
        if arguments.seeds is None:
            _check_one_run(arguments)
        elif arguments.seed is not None:
            raise AmulettError("--seed and --seeds are both given; give one of them")
        overrides = [*arguments.overrides, *([] if arguments.seed is None else [f"seed={arguments.seed}"])]
        if None not in (arguments.start, arguments.config):
            raise AmulettError("--start has its own recipe, the policy's; change its keys with --set, not --config")
        # A wrong recipe is refused before torch is imported.
        config = load_learning("recipes").load_train_config(arguments.config, overrides, arguments.start)
        tensions = tuple(config.env.tension_range)
        loops = () if config.env.id == DRIVES_ID else (config.env.control,)
        if config.env.fleet is None:  # those of a fleet are taken as they are
            device = load_profile(config.env.profile)
            suite = None if config.env.id == WORN_ID else config.env.suite  # eq. 6 divides no costs there
            print_remarks(device_remarks(device, tension_range=tensions, loops=loops, suite=suite))
        if config.network.start is not None:
            control = DRIVES if config.env.id == DRIVES_ID else config.env.control
            print_remarks(start_remarks(config.network.start, config.env.devices, control))
        if arguments.seeds is not None:
            return _train_seeds(arguments, workers, config)
        train = load_learning("training").train
        result = train(config, arguments.out, command=process_words(), overwrite=arguments.overwrite)
    if arguments.json:
        print_json(asdict(result))
    else:
        if result.interrupted:
            show("interrupted; the policies until then are kept. Continue with:")
            show(f"       amulett train --resume {shlex.quote(str(result.out))}", wrap=False)
        if result.diverged is not None:
            show(f"diverged after {result.diverged:,} steps; earlier policies are kept. Try a lower learning rate")
        if finished:
            show("this run is finished; there is nothing to resume")
        doffed = load_learning("recipes").load_train_config(Path(result.out) / "config.yaml").env.doffed_cost
        if doffed is not None:
            show(f"for comparison: without the device, the same wearers cost {doffed:.4g}")
        show(f"{result.steps:,} steps in {result.seconds:.0f} s, seed {result.seed}")
        show(f"best   cost {result.best_cost:.4f} on the validation scenarios, after {result.best_steps:,} steps")
        show(f"       {result.best}")
        if arguments.start is not None and result.best_steps == 0:
            show("       this is the policy to start from: none of those trained is better")
        show(f"last   cost {result.last_cost:.4f}")
        show(f"       {result.last}")
    return 130 if result.interrupted else 0 if result.diverged is None else 1


def _train_seeds(arguments: argparse.Namespace, workers: Workers, config: Any) -> int:
    """Train with several seeds by a recipe, or continue such runs if it is None; the exit code is as of `run`."""
    from dataclasses import asdict

    from amulett_gym.storage.provenance import process_words

    show, learning = printer(arguments), load_learning("training")
    out = arguments.resume if config is None else arguments.out

    def report(result: Any) -> None:
        show(f"seed {result.seed}: best cost {result.best_cost:.4f} after {result.best_steps:,} steps")

    try:
        if config is None:
            results = learning.resume_seeds(out, workers, report=report)
        else:
            how = {"command": process_words(), "overwrite": arguments.overwrite, "report": report}
            results = learning.train_seeds(config, arguments.seeds, out, workers, **how)
    except KeyboardInterrupt:
        if not learning.holds_seeds(out):  # nothing is begun
            raise
        words = ["amulett", "train", "--resume", out, *command_words(arguments, "workers", "ray")]
        print(f"interrupted; checkpoints are kept. Continue with:\n       {shlex.join(words)}", file=sys.stderr)
        return 130
    if arguments.json:
        print_json([asdict(result) for result in results])
    show(_table_of_seeds(results).text())
    show(f"Written to {out}: a training run in seed-<k> for each seed.")
    return 1 if any(result.diverged is not None for result in results) else 0


def _table_of_seeds(results: Sequence[Any]) -> Table:
    """Return the table of runs with several seeds."""
    from statistics import mean

    from amulett_gym.reporting.table import Table

    rows = [
        (
            str(result.seed),
            *(f"{cost:.4f}" for cost in (result.best_cost, result.last_cost)),
            f"{result.best_steps:,}",
            f"{result.seconds:.0f}",
            "" if result.diverged is None else f"after {result.diverged:,} steps",
        )
        for result in results
    ]
    costs = [result.best_cost for result in results]
    note = f"costs on the validation scenarios; best: mean {mean(costs):.4f}, {min(costs):.4f} to {max(costs):.4f}"
    return Table("", ("seed", "best cost", "last cost", "steps of best", "seconds", "diverged"), rows, note)


def _check_one_run(arguments: argparse.Namespace) -> None:
    """Refuse options for several seeds."""
    if given := [name for name in ("workers", "ray") if getattr(arguments, name) is not None]:
        raise AmulettError(
            f"--{given[0]} is for runs with several seeds; give them by --seeds, for example --seeds 0 1"
        )


def _check_alone(arguments: argparse.Namespace) -> None:
    """Refuse options that would change a resumed run."""
    options = ("out", "config", "start", "overrides", "seed", "seeds", "overwrite")
    given = [name for name in options if getattr(arguments, name) not in (None, False, [])]
    if wrong := ", ".join(f"--{name}" for name in given).replace("overrides", "set"):
        raise AmulettError(f"--resume continues with the run's own recipe, in its own folder; leave out {wrong}")
