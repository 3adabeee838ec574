"""One contender in one scenario, recorded at control rate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from amulett_gym import FAILURES
from amulett_gym.envs.prices import prices
from amulett_gym.envs.transition import FIRST_METRIC, METRICS
from amulett_gym.evaluation.metrics import UNITS, control_prices, derive, failure_cost
from amulett_gym.evaluation.runner import Protocol, load_contender
from amulett_gym.laws.contenders import Contender, parse_contender
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.tasks.scenario import Scenario


@dataclass(frozen=True)
class Episode:
    """A recorded episode.

    Attributes
    ----------
    contender : str
    trajectory : Trajectory
        Until the failure, if there was one.
    scenario : Scenario
    metrics : dict of str to float
        Final values, NaN where not reached; without ``return``, which is defined at agent rate.
    failure : str
        Why the device failed; empty if it did not.
    """

    contender: str
    trajectory: Trajectory
    scenario: Scenario
    metrics: dict[str, float]
    failure: str


def record_episode(
    name: str | Contender,
    protocol: Protocol,
    scenario: str | Path | Mapping[str, Any] | Scenario | None = None,
    report: Callable[[int], object] = lambda seconds: None,
) -> Episode:
    """Play one episode with a contender and record every control tick.

    The contender acts at its own rate; the episode is, bit for bit, that of :func:`runner.evaluate`.

    Parameters
    ----------
    name : str or Contender
        A contender, its name or a policy bundle's folder.
    protocol : Protocol
        Its first scenario is played; `episodes` is ignored.
    scenario : str, Path, mapping or Scenario, optional
        Played instead of the protocol's.
    report : callable
        Called with 1 after each second of simulated time.

    Raises
    ------
    AmulettError
        If a name is unknown or a scenario is wrong.
    """
    contender = name if isinstance(name, Contender) else parse_contender(name)
    keywords = protocol.keywords(contender)
    env: Any = gym.make(protocol.env_of(contender), disable_env_checker=True, **keywords).unwrapped
    policy = load_contender(contender, env)
    if scenario is None and protocol.scenarios:
        scenario = protocol.scenarios[0]
    env.reset(seed=protocol.seed, options=None if scenario is None else {"scenario": scenario})
    episodes = env.episodes
    simulation = episodes.simulation
    ticks_per_step = round(keywords["agent_period"] / simulation.control_period)

    ticks_per_second = max(round(1.0 / simulation.control_period), 1)
    actions = np.zeros(0)

    def act(tick: int) -> None:
        """Begin and end the ramps of each agent step, as the environment does; the kernel handles late ticks."""
        nonlocal actions
        if tick > 0 and tick % ticks_per_second == 0:
            report(1)
        if tick % ticks_per_step == 0:
            if tick > 0:
                episodes.end_ramps(actions)
            actions = policy(episodes.observe()).astype(np.float64).ravel()
        if tick % ticks_per_step == keywords.get("action_delay", 0):
            episodes.begin_ramps(actions)

    trajectory = record(simulation, keywords["max_episode_steps"] * ticks_per_step, before_tick=act)
    failure = FAILURES[int(simulation.read("failure")[0])]
    if failure:
        rows = int(trajectory["tick"][-1]) + 1  # a failed device's clock stands still
        signals = {signal: values[:rows] for signal, values in trajectory.signals.items()}
        trajectory = replace(trajectory, signals=signals)
    raw = dict(zip(METRICS, episodes.report().T[FIRST_METRIC:], strict=True))
    ended = float(trajectory["time"][-1])
    charge = failure_cost(ended, protocol.duration, protocol.agent_period) if failure else 0.0
    family = int(episodes.scenario(0)["family"])
    tables = (table(protocol.profile, protocol.suite, families=[family]) for table in (prices, control_prices))
    values = derive(raw, np.array([charge]), *tables)
    metrics = {metric: float(values[metric][0]) for metric in UNITS if metric in values}
    return Episode(contender.name, trajectory, env.scenario, metrics, failure)
