"""`amulett clone`: behaviour cloning from a data set."""

from __future__ import annotations

import argparse

from amulett_gym.cli.options import add_json, check_least
from amulett_gym.cli.output import print_json, printer
from amulett_gym.learning import check_installed, load_learning

HELP = "learn a policy from a data set alone, by behaviour cloning: it imitates the recorded actions"
EXAMPLES = """  amulett clone amulett/scaling/mixed-eq6-held-v0 --out runs/clone
  amulett clone amulett/scaling/several-v0 --policy eq6-tuned --out runs/clone
  amulett clone data/amulett/scaling/plausible-mixed-pretrained-v0 --memory --out runs/clone
  amulett evaluate --policies eq6-held runs/clone --suite mixed
"""

_UNITS = {"tension": " N", "mean_drive_angle": " deg", "assistance": ""}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    names = "the data set's name (those of `amulett record`, see `minari list local`) or folder"
    parser.add_argument("dataset", metavar="DATASET", help=names)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of the policy bundle")
    parser.add_argument("--policy", metavar="NAME", help="imitate only this one of the data set's policies")
    memory = "the network also sees means over the episode so far, as pretrained does"
    parser.add_argument("--memory", action="store_true", help=memory)
    parser.add_argument("--steps", type=int, default=5000, metavar="N", help="gradient steps (default: 5000)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the network (default: 0)")
    parser.add_argument("--overwrite", action="store_true", help="replace a policy in DIR")
    add_json(parser, "the data set, what was learned from, and the error")


def run(arguments: argparse.Namespace) -> int:
    """Clone, and print how well the policy imitates."""
    check_least(arguments, steps=1, seed=0)
    from amulett_gym.datasets.files import check_minari

    check_minari()
    check_installed()
    from dataclasses import asdict

    from amulett_gym.evaluation.remarks import print_remarks
    from amulett_gym.storage.provenance import process_words

    cloning = load_learning("cloning")
    found = cloning.clone(
        arguments.dataset,
        arguments.out,
        cloning.CloneSettings(memory=arguments.memory, gradient_steps=arguments.steps, seed=arguments.seed),
        arguments.policy,
        overwrite=arguments.overwrite,
        progress=True,
        command=process_words(),
    )
    if found.split != "train":
        advice = "evaluate the clone in another split, or record with --split train"
        print_remarks([f"the recorded scenarios are of the split {found.split}; {advice}"])
    if arguments.json:
        print_json(asdict(found))
        return 0
    show = printer(arguments)
    show(f"Imitated: {', '.join(found.policies)}; mean return of the recorded episodes {found.recorded_return:.3f}")
    show(f"Learned from {found.episodes:,} episodes, {found.steps:,} steps")
    errors = ", ".join(f"{name.replace('_', ' ')} {error:.3g}{_UNITS[name]}" for name, error in found.errors.items())
    show(f"Difference of its actions in other episodes (root mean square): {errors}")
    show(f"Written: {found.folder}")
    return 0
