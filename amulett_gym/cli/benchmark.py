"""`amulett benchmark`: every contender on every suite, references, claims, and one page that shows them."""

from __future__ import annotations

import argparse
import shlex

from amulett_gym.cli.output import add_json, print_json, printer

HELP = "run the benchmark: train what is missing, judge all on all suites, and check the claims; resumes by itself"
EXAMPLES = """  amulett benchmark --quick --out runs/benchmark-quick
  amulett benchmark --config configs/benchmark.yaml --out runs/benchmark
  amulett benchmark --config configs/benchmark.yaml --runs runs/stored --out runs/benchmark --doc docs/benchmark.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    from amulett_gym.cli.own_policies import add_trust

    parser.add_argument("--out", metavar="DIR", required=True, help="folder; what is finished in it is not done again")
    parser.add_argument(
        "--config", metavar="FILE", help="description in YAML (default: that of configs/benchmark.yaml, in code)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="show that all works, in a few minutes: few suites, scenarios and seeds, short training, no claim judged",
    )
    parser.add_argument(
        "--runs",
        metavar="DIR",
        help="folder of training runs, <entry>/seed-<k>; what is missing is trained there (default: DIR/runs in --out)",
    )
    parser.add_argument(
        "--policies", nargs="+", default=[], metavar="NAME", help="further contenders: laws, bundles, or trusted zips"
    )
    add_trust(parser)
    parser.add_argument("--doc", metavar="FILE.md", help="renew the generated part of a document, and its figures")
    add_json(parser, "the content of benchmark.json")


def run(arguments: argparse.Namespace) -> int:
    """Do what is not done yet, print claims and ranking, and write the files."""
    from amulett_gym import ENV_IDS
    from amulett_gym.cli.own_policies import own_contenders
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.laws.contenders import Contender, parse_contender
    from amulett_gym.reporting.document import check_document
    from amulett_gym.storage.provenance import machine
    from amulett_gym.studies.benchmark.claims import check_claims
    from amulett_gym.studies.benchmark.description import load_benchmark, load_profile_of, quick, recipe_folder
    from amulett_gym.studies.benchmark.document import MARKS, write_document
    from amulett_gym.studies.benchmark.page import PAGE, in_words, judged, write_benchmark
    from amulett_gym.studies.benchmark.results import content
    from amulett_gym.studies.benchmark.stages import run_benchmark

    description, recipes = load_benchmark(arguments.config), recipe_folder(arguments.config)
    if arguments.quick:
        description = quick(description)
    if arguments.doc is not None:
        check_document(arguments.doc, [MARKS], images=True)
    profile = load_profile_of(description, recipes)
    named = own_contenders(arguments.policies, profile, ENV_IDS[0], arguments.trust_pickle)
    own = [name if isinstance(name, Contender) else parse_contender(name) for name in named]
    print_remarks(device_remarks(profile))
    words = _command(arguments)
    show = printer(arguments)
    evidence = run_benchmark(
        description,
        arguments.out,
        recipes,
        arguments.runs,
        own,
        [*words, "--out", arguments.out],
        say=show,
        progress=True,
    )
    show("Drawing intervals and figures ...")
    found = content(evidence, shlex.join(words), machine(), arguments.quick)
    claims = check_claims(found)
    figures = write_benchmark(evidence, found, claims, arguments.out)
    if arguments.doc is not None:
        write_document(found, claims, figures, arguments.doc)
        show(f"Renewed: {arguments.doc}")
    if arguments.json:
        print_json(judged(found, claims))
        return 0
    show(f"\n{in_words(found, claims)}\n")
    lost = ", and the scenarios that are lost most clearly" if found["worst"] else ""
    show(f"Written to {arguments.out}: {PAGE}, benchmark.json, tables, figures{lost}.")
    return 0


def _command(arguments: argparse.Namespace) -> list[str]:
    """Return the command that makes the same again; where it writes to is nobody else's business."""
    words = ["amulett", "benchmark"]
    if arguments.config is not None:
        words += ["--config", arguments.config]
    words += ["--quick"] * arguments.quick
    if arguments.policies:
        words += ["--policies", *arguments.policies, *(["--trust-pickle"] * arguments.trust_pickle)]
    return words
