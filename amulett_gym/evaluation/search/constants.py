"""Best constant tensions: of each device of a fleet, and a printed table of each suite.

::

    python -m amulett_gym.evaluation.search.constants
    python -m amulett_gym.evaluation.search.constants --split shifted --scenarios 200 --profile simulation

The cost is minus the return. All constants meet the same scenarios, those of ``amulett evaluate`` from seed 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.reward import SCHEDULE, Track
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import Control
from amulett_gym.tasks.suites import SPLITS, suite_names

TENSIONS = tuple(range(4, 16))  # [N]
SCENARIOS = 400

REFINED = np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])
"""Tensions that are tried around the best whole number [N]."""


def best_constants(
    fleet: Sequence[Profile],
    suite: str = "mixed",
    control: Control = "decentralized",
    track: Track = SCHEDULE,
    scenarios: int = 40,
    threads: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the best constant tension of each device and its mean cost, each of shape (devices,).

    All devices play the first training scenarios of the suite. Tensions are compared in steps of 1 N over the loop's
    range, then of 0.25 N about the best.

    Parameters
    ----------
    fleet : sequence of Profile
    suite, control, track : str
    scenarios : int
        Number of scenarios for each device and tension, at least 1.
    threads : int
        Threads that simulate; they do not change results.

    Raises
    ------
    AmulettError
        If a name is unknown, a number is too small, or a device does not fit the loop.
    """
    protocol = Protocol(fleet[0], suite, "train", episodes=scenarios)
    trials = Trials(protocol, control, threads=threads, track=track, fleet=fleet, crossed=True)
    (low, high), every = trials.tension_range, np.arange(len(trials.rows))

    def tried(tensions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean cost of each tension on each device, shapes (devices, K)."""
        each = np.repeat(tensions, scenarios, axis=0).T
        costs = [trials.costs(every, held(column, trials.tension_range), track=track) for column in each]
        return np.array(costs).reshape(len(each), len(fleet), scenarios).mean(axis=2).T

    tensions = np.tile(np.arange(np.ceil(low), high + 0.5), (len(fleet), 1))
    costs, devices = tried(tensions), np.arange(len(fleet))
    finer = np.clip(tensions[devices, costs.argmin(axis=1)][:, None] + REFINED, low, high)
    tensions, costs = np.hstack([tensions, finer]), np.hstack([costs, tried(finer)])
    best = costs.argmin(axis=1)
    return tensions[devices, best], costs[devices, best]


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
