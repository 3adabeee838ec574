"""`amulett check`: conformance of the environments, one line for each requirement."""

from __future__ import annotations

import argparse
from collections import Counter

from amulett_gym.cli.options import add_json
from amulett_gym.cli.output import print_json, printer

HELP = "check that environments conform to Gymnasium's API and to their documentation"
EXAMPLES = """  amulett check
  amulett check Amulett/Tension-v0 --profile simulation --suite paper-step
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("env_id", nargs="?", metavar="ENV_ID", help="environment to check (default: all)")
    parser.add_argument("--profile", help="device profile (default: all shipped ones)")
    parser.add_argument("--suite", help="suite of scenarios (default: all)")
    add_json(parser, "every check and its result")


def run(arguments: argparse.Namespace) -> int:
    """Run all checks; return 1 if one failed."""
    from amulett_gym import ENV_IDS, WORN_ID
    from amulett_gym.errors import unknown
    from amulett_gym.evaluation.conformance import CHECKS, Subject, run_checks
    from amulett_gym.profile import device_names, load_profile
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.tasks.suites import suite_names
    from amulett_gym.tasks.worn_suites import WORN_SUITES

    env_id = arguments.env_id and arguments.env_id.split(":")[-1]
    if env_id and env_id not in ENV_IDS:
        raise unknown("environment", env_id, ENV_IDS)
    suites = {name: tuple(WORN_SUITES) if name == WORN_ID else suite_names() for name in ENV_IDS}
    suites = {name: own for name, own in suites.items() if env_id in (None, name)}
    known = [suite for own in suites.values() for suite in own]
    if arguments.suite and arguments.suite not in known:
        raise unknown("suite", arguments.suite, set(known))
    if arguments.profile:
        load_profile(arguments.profile)
    subjects = [
        (name, profile, suite)
        for name, own in suites.items()
        for profile in ([arguments.profile] if arguments.profile else ["worn"] if name == WORN_ID else device_names())
        for suite in own
        if arguments.suite in (None, suite)
    ]
    checks, show = [], printer(arguments)
    with Progress(len(subjects) * len(CHECKS), "check", "checks") as bar:
        for name, profile, suite in subjects:
            about = {"env_id": name, "profile": profile, "suite": suite}
            show(f"{name}, profile {profile}, suite {suite}")
            for outcome in run_checks(Subject(name, {"profile": profile, "suite": suite})):
                result = "failed" if outcome.problem else "skipped" if outcome.skipped else "ok"
                remark = outcome.problem or outcome.skipped
                checks.append({**about, "check": outcome.requirement, "result": result, "remark": remark})
                show(f"  {result:7} {outcome.requirement}{': ' + remark if remark else ''}")
                bar.update(note=outcome.requirement)
    count = Counter(check["result"] for check in checks)
    if arguments.json:
        print_json({"failed": count["failed"], "checks": checks})
    else:
        show(f"{count['ok']} ok, {count['failed']} failed, {count['skipped']} skipped")
    return 1 if count["failed"] else 0
