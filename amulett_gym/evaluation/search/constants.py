"""Print the mean costs of constant tensions on each suite.

::

    python -m amulett_gym.evaluation.search.constants
    python -m amulett_gym.evaluation.search.constants --split shifted --scenarios 200 --profile simulation

The cost is minus the return. All constants meet the same scenarios, those of ``amulett evaluate`` from seed 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.profile import load_profile
from amulett_gym.tasks.suites import SPLITS, suite_names

TENSIONS = tuple(range(4, 16))  # [N]
SCENARIOS = 400


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--split", default="held-out", choices=list(SPLITS))
    parser.add_argument("--profile", default="testbed", help="name or YAML file (default: testbed)")
    parser.add_argument("--scenarios", type=int, default=SCENARIOS, help=f"of each suite (default: {SCENARIOS})")
    chosen = parser.parse_args(arguments)
    profile, every = load_profile(chosen.profile), np.arange(chosen.scenarios)
    print(f"mean cost of a constant tension, {chosen.scenarios} {chosen.split} scenarios on {profile.name}; eq. 6 is")
    print("about 1 on train. Best: the constant with the least mean; shares of scenarios in which each third is best")
    tensions = "".join(f"{tension:>7} N" for tension in TENSIONS)
    print(f"{'suite':12}{tensions}     eq6   best   4-7 N  8-11 N 12-15 N")
    for suite in suite_names():
        protocol = Protocol(profile, suite, chosen.split, episodes=chosen.scenarios)
        trials = Trials(protocol)
        costs = [trials.play(every, held(np.full(every.size, tension))).sum(axis=0) for tension in TENSIONS]
        eq6 = Trials(protocol, tension_law="eq6").play(every, held(np.full(every.size, 10.0))).sum(axis=0).mean()
        means = np.mean(costs, axis=1)
        thirds = 100 * np.bincount(np.argmin(costs, axis=0) // 4, minlength=3) / every.size
        row = "".join(f"{mean:9.3f}" for mean in means)
        print(f"{suite:12}{row} {eq6:7.3f} {TENSIONS[means.argmin()]:4} N", "".join(f"{x:6.0f} %" for x in thirds))


if __name__ == "__main__":
    main()
