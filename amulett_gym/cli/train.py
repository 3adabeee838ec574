"""`amulett train`: train a policy with a recipe, or resume an interrupted run."""

from __future__ import annotations

import argparse
import shlex

from amulett_gym.cli.options import add_json, add_options
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError
from amulett_gym.learning import check_installed, load_learning

HELP = (
    "train a policy with a recipe; saves the best and the last one as bundles; resumes interrupted and killed runs; "
    "exit code 1: training diverged, 130: interrupted"
)
EXAMPLES = """  amulett train --config configs/ppo.yaml --out runs/first
  amulett train --config configs/ppo.yaml --set env.suite=reach ppo.learning_rate=3e-4 --seed 1 --out runs/reach
  amulett train --config configs/sac.yaml --out runs/sac
  amulett train --start pretrained --set env.profile=mine.yaml --out runs/mine
  amulett train --resume runs/first
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

    finished, show = False, printer(arguments)
    if arguments.resume is not None:
        _check_alone(arguments)
        training = load_learning("training")
        finished = training.is_finished(arguments.resume)
        result = training.resume(arguments.resume)
    else:
        if arguments.out is None:
            raise AmulettError("train needs --out DIR for a new run, or --resume DIR to continue one")
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


def _check_alone(arguments: argparse.Namespace) -> None:
    """Refuse options that would change a resumed run."""
    options = ("out", "config", "start", "overrides", "seed", "overwrite")
    given = [name for name in options if getattr(arguments, name) not in (None, False, [])]
    if wrong := ", ".join(f"--{name}" for name in given).replace("overrides", "set"):
        raise AmulettError(f"--resume continues with the run's own recipe, in its own folder; leave out {wrong}")
