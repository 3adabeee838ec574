"""Show how the best constant tension differs from suite to suite.

::

    python -m amulett_gym.evaluation.search.constants
    python -m amulett_gym.evaluation.search.constants --split shifted --scenarios 200 --profile simulation

A constant's cost is that of the reward: position, effort, tension and, where there are obstacles, contact, each in
units of eq. 6's cost in the same family. All constants meet the same scenarios.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.reward import COST_TERMS, prices
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import RUNNING
from amulett_gym.tasks.suites import SPLITS, episode_keys, sample, suite_names

TENSIONS = tuple(range(4, 16))  # [N]
SCENARIOS = 400
DURATION = 10.0  # [s]


def costs(profile: Profile, suite: str, split: str, tension: float | None, count: int) -> NDArray[np.float64]:
    """Return each scenario's cost under a constant tension [N], or under eq. 6 (None), shape (count,).

    Raises
    ------
    AmulettError
        If a name is unknown.
    ArithmeticError
        If a device fails: what it costs until then is not comparable.
    """
    seeds = np.arange(count, dtype=np.uint64)
    rows = sample(suite, episode_keys(seeds, np.zeros_like(seeds), split), profile, split=split)
    simulation = Simulation(profile, count, tension_law="eq6" if tension is None else "agent")
    simulation.reset(rows)
    if tension is not None:
        simulation.command_tension(tension)
    simulation.advance(round(DURATION / simulation.control_period))
    if (simulation.read("failure") != RUNNING).any():
        raise ArithmeticError(f"{(simulation.read('failure') != RUNNING).sum()} of {count} devices failed on {suite}")
    squared_degrees = float(np.degrees(1.0) ** 2)
    costs = {
        "position": simulation.read("position_ise") * squared_degrees,
        "effort": (simulation.read("effort_biceps") + simulation.read("effort_triceps")) * squared_degrees,
        "tension": simulation.read("tension_ise"),
        "contact": simulation.read("contact_ise"),
    }
    price = prices(profile, suite)[rows["family"]]
    return np.sum([price[:, k] * costs[term] for k, term in enumerate(COST_TERMS)], axis=0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m amulett_gym.evaluation.search.constants", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--split", default="held-out", choices=list(SPLITS))
    parser.add_argument("--profile", default="testbed", help="name or YAML file (default: testbed)")
    parser.add_argument("--scenarios", type=int, default=SCENARIOS, help=f"a suite (default: {SCENARIOS})")
    chosen = parser.parse_args(arguments)
    profile = load_profile(chosen.profile)
    print(f"mean cost of a constant tension, {chosen.scenarios} {chosen.split} scenarios on {profile.name}; eq. 6 is")
    print("about 1 on train. Best: the constant with the least mean, and in how many scenarios each third is best")
    print(
        f"{'suite':12}" + "".join(f"{tension:>7} N" for tension in TENSIONS) + "     eq6   best   4-7 N  8-11 N 12-15 N"
    )
    for suite in suite_names():
        table = np.array([costs(profile, suite, chosen.split, tension, chosen.scenarios) for tension in TENSIONS])
        means = table.mean(axis=1)
        thirds = np.bincount(table.argmin(axis=0) // 4, minlength=3) / chosen.scenarios
        eq6 = costs(profile, suite, chosen.split, None, chosen.scenarios).mean()
        shares = "".join(f"{100 * share:6.0f} %" for share in thirds)
        print(
            f"{suite:12}" + "".join(f"{mean:9.3f}" for mean in means),
            f"{eq6:7.3f} {TENSIONS[means.argmin()]:4} N",
            shares,
        )


if __name__ == "__main__":
    main()
