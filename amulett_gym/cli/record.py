"""`amulett record`: a data set of episodes, in the format of Minari."""

from __future__ import annotations

import argparse
from typing import Any

from amulett_gym.cli.options import add_json, add_options, check_least, check_seconds
from amulett_gym.cli.output import print_json, printer
from amulett_gym.cli.own_policies import POLICIES, digests, own_contenders

HELP = "record episodes of policies as a data set for offline learning, in the format of Minari"
EXAMPLES = """  amulett record --policies eq6-held --suite mixed --episodes 500
  amulett record --policies eq6-tuned constant:8 random --suite mixed --name amulett/scaling/several-v0
  amulett record --policies pretrained --suite mixed --fleet plausible --episodes 10 --out data
  amulett record --policies mylaw.py:softer --env-id Amulett/Tension-v0 --author "A. Author" --json
"""

RANDOM = "random"
"""Name of uniformly random actions."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    names = f"{POLICIES}; random (actions): all that act from outside the loop. All get the same seeds"
    parser.add_argument("--policies", nargs="+", required=True, metavar="NAME", help=names)
    add_options(parser, "--trust-pickle")
    add_options(parser, "--suite", default=None, help="suite of scenarios (default: the environment's)")
    add_options(parser, "--split", default="train", help="train (default), validation, held-out or shifted")
    device = parser.add_mutually_exclusive_group()
    profile = "device profile, by name or YAML file (default: the environment's)"
    add_options(device, "--profile", default=None, help=profile)
    add_options(device, "--fleet")
    episodes = "each policy's episodes, on each device (default: 100)"
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help=episodes)
    seed = "seed of the first episode; each next one has the next (default: 0)"
    parser.add_argument("--seed", type=int, default=0, help=seed)
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="episode length [s] (default: 10)")
    env_id = "environment (default: Amulett/Scaling-v0)"
    parser.add_argument("--env-id", default="Amulett/Scaling-v0", metavar="ID", help=env_id)
    name = "the data set's name, with a version (default: made of environment, device, suite and policies)"
    parser.add_argument("--name", help=name)
    out = "folder of data sets (default: MINARI_DATASETS_PATH, or ~/.minari/datasets)"
    parser.add_argument("--out", metavar="DIR", help=out)
    parser.add_argument("--overwrite", action="store_true", help="replace a data set of this name")
    parser.add_argument("--author", nargs="+", metavar="NAME", help="authors, kept in the data set")
    parser.add_argument("--email", nargs="+", metavar="ADDRESS", help="their addresses")
    parser.add_argument("--description", metavar="TEXT", help="instead of a sentence made of the options")
    add_json(parser, "name, folder and the policies' returns")


def run(arguments: argparse.Namespace) -> int:
    """Record the episodes, and print what the data set holds."""
    check_least(arguments, episodes=1, seed=0)
    check_seconds(arguments, "duration")
    from amulett_gym.datasets.files import check_minari, datasets_folder

    check_minari()
    from dataclasses import asdict

    from amulett_gym import DRIVES_ID, WORN_ID
    from amulett_gym.datasets.playing import Random
    from amulett_gym.datasets.recording import record_dataset
    from amulett_gym.evaluation.remarks import loop_remarks, print_remarks
    from amulett_gym.storage.provenance import process_words

    names, env_id = list(dict.fromkeys(arguments.policies)), arguments.env_id.removeprefix("amulett_gym:")
    contenders = [Random(RANDOM) if name == RANDOM else _named(name, env_id, arguments.trust_pickle) for name in names]
    if env_id not in (DRIVES_ID, WORN_ID):  # there, every policy has a loop of its own, or none
        print_remarks(loop_remarks(contenders))
    given = {key: getattr(arguments, key) for key in ("profile", "fleet", "suite", "split")}
    found = record_dataset(
        contenders,
        arguments.name,
        env_id=env_id,
        given={key: value for key, value in given.items() if value is not None},
        **{key: getattr(arguments, key) for key in ("episodes", "seed", "duration", "overwrite")},
        root=arguments.out,
        about=_about(arguments),
        origin={"command": process_words(), "sha256": digests(names)},
        progress=True,
    )
    if arguments.json:
        print_json(asdict(found))
        return 0
    from amulett_gym.reporting.table import Table

    show = printer(arguments)
    rows = [
        (name, f"{each.episodes:,}", f"{each.mean_return:.3f}", f"{each.failures:,}")
        for name, each in found.policies.items()
    ]
    show(Table("", ("policy", "episodes", "mean return", "failures"), rows, left=(0,)).text())
    show(f"Written: {found.name}, {found.steps:,} steps, in {arguments.out or datasets_folder()}")
    return 0


def _named(name: str, env_id: str, trust_pickle: bool) -> Any:
    from amulett_gym.profile import load_profile

    return own_contenders([name], load_profile("testbed"), env_id, trust_pickle)[0]


def _about(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the given ones of Minari's metadata."""
    given = {
        "author": set(arguments.author or ()),
        "author_email": set(arguments.email or ()),
        "description": arguments.description,
    }
    return {key: value for key, value in given.items() if value}
