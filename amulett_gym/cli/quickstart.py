"""`amulett quickstart`: from training to the report."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_json, check_least, check_seconds, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.learning import check_installed, load_learning
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.writing import output_folder

if TYPE_CHECKING:
    from amulett_gym.evaluation.runner import Results

HELP = (
    "train a stiffness policy and compare it with eq. 6, tuned laws and constants, in about 2 minutes on two free cores"
)
EXAMPLES = """  amulett quickstart
  amulett quickstart --steps 500000 --seed 1 --out runs/short
"""

LAWS = (
    *("eq6", "eq6-printed", "eq6-held", "eq6-held-printed", "eq6-tuned", "parametric"),
    *("constant:4", "constant:5.25", "constant:5.5", "constant:6", "constant:10", "position-only"),
)

STEPS = 2_000_000
"""Agent steps of the training: about a minute on two free cores, enough for a lower cost than the best constant."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    steps = f"agent steps of the training (default: {STEPS:,})"
    parser.add_argument("--steps", type=int, default=STEPS, metavar="N", help=steps)
    limit = "time limit of the training [s]; if it ends the training, the policy depends on the machine"
    parser.add_argument("--seconds", type=float, help=limit)
    parser.add_argument("--episodes", type=int, default=100, help="new scenarios of the comparison (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training (default: 0)")
    parser.add_argument("--out", default="runs/quickstart", metavar="DIR", help="folder (default: runs/quickstart)")
    add_json(parser, "the content of results.json")


def run(arguments: argparse.Namespace) -> int:
    """Train on the recipe's suite, compare on new scenarios, and write the report."""
    check_installed()
    check_seconds(arguments, "seconds")
    check_least(arguments, steps=1, seed=0)

    from amulett_gym.evaluation.runner import Protocol
    from amulett_gym.profile import load_profile

    config = _recipe(arguments)
    protocol = Protocol(load_profile(config.env.profile), config.env.suite, episodes=arguments.episodes)
    out = Path(arguments.out)
    marks = [[f"ppo/{name}" for name in ("config.yaml", "command.json")]]
    with output_folder(out, "quickstart", marks) as earlier, locked_folder(out):
        if earlier:
            printer(arguments)(f"Replacing the earlier run and its report in {out}.")
        return _train_and_compare(arguments, config, protocol, out)


def _recipe(arguments: argparse.Namespace) -> Any:
    limit = [] if arguments.seconds is None else [f"max_seconds={arguments.seconds}"]
    short = [f"total_steps={arguments.steps}", f"seed={arguments.seed}", *limit]
    return load_learning("recipes").load_train_config(overrides=short)


def _train_and_compare(arguments: argparse.Namespace, config: Any, protocol: Any, out: Path) -> int:
    from dataclasses import replace

    from amulett_gym.evaluation.comparison import in_words
    from amulett_gym.evaluation.page import remove_comparison, write_report
    from amulett_gym.evaluation.runner import evaluate
    from amulett_gym.storage.provenance import write_provenance

    policy, show = out / "ppo", printer(arguments)
    show(f"Training PPO on '{protocol.suite}' ({protocol.profile.name}) for {config.total_steps:,} steps ...")
    # Every option, so that another version's defaults do not change it.
    command = ["amulett", "quickstart", *command_words(arguments, "steps", "seconds", "episodes", "seed", "out")]
    chosen = {name: getattr(arguments, name) for name in ("steps", "seconds", "episodes", "seed")}
    write_provenance(out, "quickstart", chosen, [arguments.seed, *range(arguments.episodes)], command)
    trained = load_learning("training").train(config, policy, command=command, overwrite=True)
    remove_comparison(out)  # of another policy
    try:
        if trained.interrupted:
            raise KeyboardInterrupt
        show(f"{trained.steps:,} steps. Comparing on {protocol.episodes} new scenarios ...")
        contenders, episodes = [*LAWS, str(policy)], protocol.episodes
        results = evaluate(contenders, protocol.suite, protocol.profile, episodes, progress=True)
        remarks = [*results.remarks, _training_length(trained), next_to_best_constant(results, str(policy))]
        summary = write_report(replace(results, remarks=remarks, command=shlex.join(command)), out)
    except KeyboardInterrupt:
        kept = f"after {trained.steps:,} steps; the best policy until then is kept in {trained.best}"
        compare = f"amulett evaluate --policies {shlex.quote(str(policy))} constant:10"
        print(f"amulett: interrupted {kept}. Compare it with: {compare}", file=sys.stderr)
        return 130
    if arguments.json:
        print_json(summary)
    show(in_words(summary))
    show(f"\nOpen {out / 'report.html'}. The policy is in {trained.best}.")
    show(f"Watch it: amulett play {shlex.quote(str(policy))}", wrap=False)
    return 0


def next_to_best_constant(results: Results, policy: str) -> str:
    """Return a policy's cost relative to the best constant's on the same scenarios, in words."""
    from amulett_gym.evaluation.statistics import draw_weights, ratio_of_sums
    from amulett_gym.laws.contenders import CONSTANT
    from amulett_gym.reporting.words import span

    costs = {name: values["cost"] for name, values in results.values.items()}
    best = min((name for name in costs if name.startswith(CONSTANT)), key=lambda name: float(costs[name].sum()))
    ratio = ratio_of_sums(costs[policy], costs[best], draw_weights(len(costs[best])))
    tension = best.removeprefix(CONSTANT)
    return (
        f"the best constant on these scenarios is {tension} N; the policy's cost is {span(ratio.plain())} of its cost"
    )


def _training_length(trained: Any) -> str:
    """Return in words how long a policy was trained, and how long the full recipe trains."""
    full = load_learning("recipes").TrainConfig().total_steps
    fewer = f"; the full recipe (amulett train) takes {full:,}" if trained.steps < full else ""
    broken = "" if trained.diverged is None else ", after which the training diverged"
    return f"the policy was trained for {trained.steps:,} steps{broken}{fewer}"
