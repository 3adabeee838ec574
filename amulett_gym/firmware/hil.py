"""A firmware in the loop against the simulation's own loop: the same scenarios, costs side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.prices import prices
from amulett_gym.envs.transition import METRICS
from amulett_gym.evaluation.metrics import control_prices, derive, failure_cost
from amulett_gym.evaluation.runner import Protocol, play_alone
from amulett_gym.evaluation.statistics import draw_weights, ratio_of_sums
from amulett_gym.firmware.chip import Measurement
from amulett_gym.firmware.description import Description, read_description
from amulett_gym.firmware.env import HardwareEnv
from amulett_gym.firmware.loops import check_transport
from amulett_gym.laws.contenders import Contender, parse_contender
from amulett_gym.logs.log import Log
from amulett_gym.logs.simulated import log_of
from amulett_gym.profile import load_profile
from amulett_gym.simulation.trajectory import record

KERNEL = "simulation"
"""Name of the simulation's own loop in tables."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Played:
    """What a firmware did in each scenario.

    Attributes
    ----------
    label : str
        Where it ran: `KERNEL`, or the transport.
    costs : ndarray, shape (episodes,)
    families : ndarray of int, shape (episodes,)
        Of each scenario, an index into `simulation.layout.FAMILIES`.
    failures : int
        Devices that failed.
    let_go : int
        Episodes in which the firmware let the strings go.
    retries : int
        Requests that were sent again.
    measurement : Measurement or None
        Of a simulated chip.
    """

    label: str
    costs: Values
    families: NDArray[np.int64]
    failures: int
    let_go: int = 0
    retries: int = 0
    measurement: Measurement | None = None


@dataclass(frozen=True)
class Comparison:
    """A firmware at several places beside the simulation's own loop.

    Attributes
    ----------
    description : Description
    protocol : Protocol
    kernel : Played
        The simulation with the firmware's `action_delay`.
    played : list of Played
    own : Played or None
        The simulation with the delay that the law was trained or tuned with, if that is another one.
    """

    description: Description
    protocol: Protocol
    kernel: Played
    played: list[Played]
    own: Played | None = None

    @property
    def rows(self) -> list[Played]:
        """All of them, the simulation first."""
        return [self.kernel, *([] if self.own is None else [self.own]), *self.played]

    def interval(self, played: Played) -> tuple[float, float] | None:
        """Return the 95 % interval, a paired bootstrap over scenarios, of the mean cost's difference; None of one."""
        found = ratio_of_sums(played.costs, self.kernel.costs, draw_weights(self.protocol.episodes))
        return (found.low - 1.0, found.high - 1.0) if math.isfinite(found.low) and math.isfinite(found.high) else None

    def difference(self, played: Played) -> tuple[float, float]:
        """Return the difference of the mean cost from the simulation's, and the largest of a scenario's cost.

        Both are shares of the simulation's mean cost; absolute if that is 0, in episodes that end before they count.
        """
        reference = float(self.kernel.costs.mean()) or 1.0
        apart = (played.costs - self.kernel.costs) / reference
        return float(apart.mean()), float(np.abs(apart).max())

    def content(self) -> dict[str, Any]:
        """Return what ``hil.json`` holds."""
        found = {}
        for each in self.rows:
            mean, largest = self.difference(each)
            found[each.label] = {
                "cost": float(each.costs.mean()),
                "cost_difference": mean,
                "interval": self.interval(each),
                "largest_difference": largest,
                "costs": each.costs.tolist(),
                **{key: getattr(each, key) for key in ("failures", "let_go", "retries")},
                **({} if each.measurement is None else {"chip": _measured(each.measurement, self.period)}),
            }
        protocol = {key: getattr(self.protocol, key) for key in ("suite", "split", "episodes", "seed", "duration")}
        own = {"law": self.description.law, "control": self.description.keywords["control"]}
        return {**own, "profile": self.protocol.profile.name, **protocol, "results": found}

    @property
    def period(self) -> float:
        """The control period [s]."""
        return self.protocol.profile.loop.control_period


def compare(
    folder: str | Path,
    transports: Sequence[str] = ("host",),
    suite: str = "mixed",
    split: str = "held-out",
    episodes: int = 100,
    seed: int = 0,
    duration: float = 10.0,
    advance: Callable[..., Any] = lambda steps, note: None,
) -> Comparison:
    """Play the same scenarios with the simulation's own loop and with a firmware.

    Parameters
    ----------
    folder : str or Path
        As `firmware.export.export` writes it.
    transports : sequence of str
        As `firmware.loops.open_loop` takes them.
    suite, split : str
    episodes, seed : int
        Scenario i has the seed ``seed + i``.
    duration : float
        Length of an episode [s].
    advance : callable
        Called with the number of agent steps done, and with `note`, the transport.

    Raises
    ------
    AmulettError
        If a name is unknown, the folder is no firmware, the law cannot be read any more, or a board fails.
    """
    found = read_description(folder)
    for transport in transports:
        check_transport(transport)
    profile = load_profile(found.keywords["profile"])
    protocol = Protocol(profile, suite, split, episodes=episodes, seed=seed, duration=duration)
    contender = parse_contender(found.contender)
    delay, trained = found.keywords["action_delay"], contender.env_keywords.get("action_delay", 0)
    own, kernel = None, _simulated(protocol, contender, KERNEL)
    if delay != trained:
        late = replace(contender, env_keywords={**contender.env_keywords, "action_delay": delay})
        own, kernel = replace(kernel, label=f"{KERNEL}, action_delay {trained}"), _simulated(protocol, late, KERNEL)
    played = [play(found, protocol, transport, partial(advance, note=transport)) for transport in transports]
    return Comparison(found, protocol, kernel, played, own)


def _simulated(protocol: Protocol, contender: Contender, label: str) -> Played:
    run = play_alone(protocol, contender)
    return Played(label, run.values["cost"], run.families, sum(reason != "" for reason in run.failures))


def agent_steps(found: Description, duration: float) -> int:
    """Return the agent steps of an episode [s], at least one."""
    return max(round(duration / float(found.keywords["agent_period"])), 1)


def play(
    found: Description, protocol: Protocol, transport: str, advance: Callable[[int], Any] = lambda steps: None
) -> Played:
    """Play a protocol's scenarios with a firmware, one after the other."""
    steps = agent_steps(found, protocol.duration)
    keywords = {"suite": protocol.suite, "split": protocol.split, "failure_horizon": steps}
    env = HardwareEnv(found.folder, transport, **keywords)
    try:
        raw = {name: np.empty(protocol.episodes) for name in METRICS}
        charges, families, let_go = np.zeros(protocol.episodes), np.zeros(protocol.episodes, dtype=np.int64), 0
        for k in range(protocol.episodes):
            env.reset(seed=protocol.seed + k)
            families[k] = env.episodes.scenario(0)["family"]
            for _ in range(steps):
                _, _, terminated, _, info = env.step(np.zeros(1, dtype=np.float32))
                advance(1)
                if terminated:
                    charges[k] = failure_cost(info["time"], protocol.duration, protocol.agent_period)
                    break
            let_go += info["board_reason"] != 0
            for name, column in raw.items():
                column[k] = info[name]
        tables = (table(protocol.profile, protocol.suite, families=families) for table in (prices, control_prices))
        costs = derive(raw, charges, *tables)["cost"]
        failures = int((charges > 0.0).sum())
        return Played(transport, costs, families, failures, let_go, env.loop.retries, env.loop.measure())
    finally:
        env.close()


def log_first(found: Description, protocol: Protocol, transport: str) -> Log:
    """Return what the device logs in a protocol's first scenario with a firmware in the loop."""
    keywords = {"suite": protocol.suite, "split": protocol.split}
    env = HardwareEnv(found.folder, transport, **keywords)
    try:
        env.reset(seed=protocol.seed)
        ticks = agent_steps(found, protocol.duration) * env.settings.ticks(env.profile)
        return log_of(record(env.episodes.simulation, ticks, tick=env.episodes.tick))
    finally:
        env.close()


def _measured(found: Measurement, period: float) -> Mapping[str, float]:
    shown = {key: getattr(found, key) for key in ("ticks", "most", "mean", "flash", "static", "stack")}
    return {**shown, "share_of_period": found.share_of_period(period)}
