"""`amulett check`: conformance of the environments, a line for each promise."""

from __future__ import annotations

import argparse
import json

HELP = "check that an environment keeps its promises"
EXAMPLES = """  amulett check
  amulett check Amulett/Tension-v0 --profile simulation --suite paper-step
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("env_id", nargs="?", metavar="ENV_ID", help="environment to check (default: all of them)")
    parser.add_argument("--profile", help="device profile (default: every shipped one)")
    parser.add_argument("--suite", help="suite of scenarios (default: steps)", default="steps")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Run all checks; return 1 if one failed."""
    from amulett_gym import ENV_IDS
    from amulett_gym.config import load_profile, profile_names
    from amulett_gym.errors import unknown
    from amulett_gym.evaluation.conformance import Subject, run_checks
    from amulett_gym.tasks.suites import suite_names

    env_id = arguments.env_id and arguments.env_id.split(":")[-1]
    if env_id and env_id not in ENV_IDS:
        raise unknown("environment", env_id, ENV_IDS)
    if arguments.suite not in suite_names():
        raise unknown("suite", arguments.suite, suite_names())
    if arguments.profile:
        load_profile(arguments.profile)
    results = []
    failed = 0
    for name in [env_id] if env_id else ENV_IDS:
        for profile in [arguments.profile] if arguments.profile else profile_names():
            subject = Subject(name, {"profile": profile, "suite": arguments.suite})
            if not arguments.json:
                print(f"{name}, profile {profile}, suite {arguments.suite}")
            for outcome in run_checks(subject):
                failed += bool(outcome.problem)
                state = "failed" if outcome.problem else "skipped" if outcome.skipped else "ok"
                remark = outcome.problem or outcome.skipped
                results.append(
                    {"env_id": name, "profile": profile, "check": outcome.promise, "result": state, "remark": remark}
                )
                if not arguments.json:
                    print(f"  {state:7} {outcome.promise}{': ' + remark if remark else ''}", flush=True)
    if arguments.json:
        print(json.dumps({"failed": failed, "checks": results}, indent=2))
    else:
        print(f"{len(results) - failed} of {len(results)} checks without a failure")
    return 1 if failed else 0
