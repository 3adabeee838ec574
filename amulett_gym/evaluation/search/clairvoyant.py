"""The clairvoyant reference: for each scenario, the best tension schedule that a search with full knowledge finds.

The search knows future setpoints, pushes and sensor noise: every trial replays the scenario with its noise key. A
schedule has one tension setpoint for each agent step, within the loop's range of the default actions, reached on a
ramp, as actions are. Its cost is an estimate of the lower bound for all policies of the same environment. Contenders
that act at control rate or with other gains (`eq6`, `position-only`) are not policies of it, and may cost less.

With `Trials.redrawn` the search knows all but chance (the *foresight* reference): the cost of a schedule is its mean
over several draws of the noise, which differ from the scenario's own. Its cost in the scenario itself shows how much of
the clairvoyant's advantage is foresight, and how much is a response to noise.

The search starts from the schedules of every constant and of given laws and policies, so it is never worse than any of
them. The best of them are improved in rounds. A round tries many *changes* of a schedule at once: trapezoids of random
place, width and height, or parts of another start's schedule. A change affects costs for about a second; so each
candidate has one change in every *segment* of time, and each change is judged by the cost of its own segment. The best
changes of all segments are combined to further candidates. A candidate with a lower total cost replaces the schedule.

``python -m amulett_gym.evaluation.search.clairvoyant --suite steps --episodes 50 --out DIR`` searches and prints
the reference's cost with those of the contenders.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym import ENV_IDS
from amulett_gym.envs.action import tension_to_action
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol, load_contender
from amulett_gym.evaluation.search.trials import Actions, Trials, held, scheduled
from amulett_gym.laws.actor import TENSION_SETPOINT
from amulett_gym.laws.contenders import CONSTANT, EQ6_HELD, parse_contender
from amulett_gym.profile import load_profile
from amulett_gym.storage.kept import digest, kept, read_kept, write_kept
from amulett_gym.workers.call import ALONE, Call, Workers
from amulett_gym.workers.report import advance
from amulett_gym.workers.run import results

VERSION = 2
"""Version of the search, increased if the same settings would find other schedules."""

CONSTANTS = tuple(float(tension) for tension in range(16))
"""Constant tensions to start from [N], as far as the loop's range holds them."""

LAWS = tuple(EQ6_HELD)
"""Laws whose schedules are starts, in addition to those that the caller names."""

SUCCESS = 0.15
"""Share of successful changes at which their height is constant; it decreases if fewer succeed."""

Values = NDArray[np.float64]
Devices = NDArray[np.int64]


@dataclass(frozen=True)
class Stage:
    """A part of the search.

    The rise, the plateau and the fall of a change last from `shortest` to `longest` [s]; `segment` is the length of a
    segment of time with one change [s].
    """

    rounds: int
    shortest: float
    longest: float
    segment: float


@dataclass(frozen=True)
class Effort:
    """The effort of a search.

    Attributes
    ----------
    stages : tuple of Stage
        From coarse to fine.
    restarts : int
        Number of a scenario's best starts that are improved.
    candidates : int
        Candidates of a round, for each of these.
    height : float
        Initial standard deviation of the changes' heights [N].
    seed : int
    """

    stages: tuple[Stage, ...] = (Stage(40, 0.06, 0.6, 2.0), Stage(40, 0.02, 0.3, 1.2), Stage(40, 0.02, 0.12, 0.8))
    restarts: int = 2
    candidates: int = 24
    height: float = 1.5
    seed: int = 0

    @property
    def rounds(self) -> int:
        """Number of rounds of a block of scenarios."""
        return sum(stage.rounds for stage in self.stages)


@dataclass(frozen=True)
class Reference:
    """The result of a search.

    Attributes
    ----------
    costs : ndarray, shape (S,)
        Cost of the best schedule of each scenario: minus its return.
    actions : ndarray of float32, shape (S, steps)
        That schedule, as actions of the trials' range.
    restarts : ndarray, shape (restarts, S)
        Final cost of the search from each start.
    starts : dict of str to ndarray, shape (S,)
        Cost of each start.
    curve : ndarray, shape (rounds + 1, 2)
        Number of simulated episodes for each scenario so far, and the mean cost then.
    """

    costs: Values
    actions: Actions
    restarts: Values
    starts: dict[str, Values]
    curve: Values


def clairvoyant(
    trials: Trials,
    effort: Effort = Effort(),
    laws: Sequence[str] = (),
    folder: str | Path | None = None,
    block: int = 25,
    report: Callable[[int], object] = lambda rounds: None,
    workers: Workers = ALONE,
) -> Reference:
    """Return each scenario's best schedule.

    Parameters
    ----------
    trials : Trials
        With several draws of each scenario, costs are their means.
    effort : Effort
    laws : sequence of str
        Contenders (names or folders) that act from outside the loop; their schedules are starts in addition to those of
        `LAWS` and `CONSTANTS`.
    folder : str or Path, optional
        Folder of results; they are reused if scenarios, device, costs, starts and effort are the same.
    block : int
        Number of scenarios that are searched at once and stored in one file.
    report : callable
        Called with the number of rounds that were done; those of a reused block count, too.
    workers : Workers
        Each searches a block at a time, if there is a folder. They change no result.

    Raises
    ------
    AmulettError
        If a contender is unknown or acts in the loop, or a file cannot be read or written.
    """
    count = len(trials.rows) // trials.draws
    schedules = start_schedules(trials, laws)
    blocks = [
        _Block(
            trials,
            (scenarios := np.arange(first, min(first + block, count))),
            {name: actions[scenarios] for name, actions in schedules.items()},
            effort,
        )
        for first in range(0, count, block)
    ]
    missing = {}
    if folder is not None and not workers.alone:
        missing = {each.file: each for each in blocks if read_kept(Path(folder) / each.file, each.digest()) is None}
    calls = {file: Call(_search, (each,)) for file, each in missing.items()}
    with closing(results(calls, workers, report)) as finished:
        for file, arrays in finished:
            write_kept(Path(folder or "") / file, missing[file].digest(), arrays)
    found = [_kept(each, folder, _nothing if each.file in missing else report) for each in blocks]
    shares = np.array([part.costs.size for part in found]) / count
    return Reference(
        costs=np.concatenate([part.costs for part in found]),
        actions=np.concatenate([part.actions for part in found]),
        restarts=np.concatenate([part.restarts for part in found], axis=1),
        starts={name: np.concatenate([part.starts[name] for part in found]) for name in found[0].starts},
        curve=np.tensordot(shares, np.array([part.curve for part in found]), axes=1),
    )


def start_schedules(trials: Trials, laws: Sequence[str] = ()) -> dict[str, Actions]:
    """Return the schedules of the constants and laws in each scenario's first draw, shape (S, steps)."""
    count = len(trials.rows) // trials.draws
    schedules = {}
    low, high = trials.tension_range
    for tension in (tension for tension in CONSTANTS if low <= tension <= high):
        action = tension_to_action(np.array(tension), trials.tension_range).astype(np.float32)
        schedules[f"{CONSTANT}{tension:g}"] = np.full((count, trials.steps), action)
    for name in dict.fromkeys([*LAWS, *laws]):
        if name not in schedules:
            schedules[name] = _followed(trials, name)[:: trials.draws]
    return schedules


def replay(trials: Trials, actions: Actions) -> Values:
    """Return the cost of a schedule for each scenario, the mean over its draws, shape (S,)."""
    return _cost(trials, np.arange(len(actions)), actions)


def improve(
    trials: Trials,
    scenarios: Devices,
    starts: dict[str, Actions],
    effort: Effort,
    report: Callable[[int], object] = lambda rounds: None,
) -> Reference:
    """Return the best schedules of some scenarios; each start has the shape (len(scenarios), steps)."""
    rng = np.random.default_rng(effort.seed)
    (low, high), names = trials.tension_range, list(starts)
    donors = np.array(list(starts.values()))
    own = np.tile(scenarios, len(names))
    traces = _play(trials, own, donors.reshape(own.size, 1, -1))[:, 0]
    start_costs = traces.sum(axis=1).reshape(len(names), scenarios.size)
    order = np.argsort(start_costs, axis=0, kind="stable")[: effort.restarts]
    chosen = (order * scenarios.size + np.arange(scenarios.size)).reshape(-1)
    state = _State(
        scenarios=np.tile(scenarios, len(order)),
        actions=donors.reshape(own.size, -1)[chosen].astype(np.float64),
        traces=traces[chosen],
        donors=np.tile(donors, (1, len(order), 1)).astype(np.float64),
        heights=np.full(chosen.size, 2.0 * effort.height / (high - low)),
    )
    episodes = len(names)
    shape = len(order), scenarios.size
    curve = [[episodes, state.costs().reshape(shape).min(axis=0).mean()]]
    for stage in effort.stages:
        for _ in range(stage.rounds):
            episodes += len(order) * _round(trials, state, stage, effort.candidates, rng)
            curve.append([episodes, state.costs().reshape(shape).min(axis=0).mean()])
            report(1)
    costs = state.costs().reshape(shape)
    best = costs.argmin(axis=0)
    actions = state.actions.reshape(*shape, -1)[best, np.arange(scenarios.size)].astype(np.float32)
    return Reference(costs.min(axis=0), actions, costs, dict(zip(names, start_costs, strict=True)), np.array(curve))


@dataclass
class _State:
    """The present N schedules.

    `actions` and `traces` (the cost of each agent step) have the shape (N, steps), `donors` (K, N, steps).
    """

    scenarios: Devices
    actions: Values
    traces: Values
    donors: Values
    heights: Values

    def costs(self) -> Values:
        """Return the cost of each schedule, shape (N,)."""
        return self.traces.sum(axis=1)


def _round(trials: Trials, state: _State, stage: Stage, candidates: int, rng: np.random.Generator) -> int:
    """Try changes of all schedules, keep those with a lower total cost; return the number of episodes for each."""
    period = trials.protocol.agent_period
    count, steps = state.actions.shape
    length = max(round(stage.segment / period), 2)
    offset = int(rng.integers(length))
    segment = (np.arange(steps) + offset) // length
    bounds = np.flatnonzero(np.diff(segment, prepend=-1))
    window = _windows(steps, segment, offset, length, (count, candidates), stage, period, rng)
    # Every third candidate changes towards another start's schedule, the others up or down.
    height = state.heights[:, None, None] * rng.normal(size=(count, candidates, bounds.size))
    changes = window * height[:, :, segment]
    crossed = np.arange(0, candidates, 3)
    donor = rng.integers(len(state.donors), size=(count, crossed.size, bounds.size))
    given = state.donors[donor[:, :, segment], np.arange(count)[:, None, None], np.arange(steps)]
    share = rng.uniform(size=(count, crossed.size, bounds.size))
    changes[:, crossed] = window[:, crossed] * share[:, :, segment] * (given - state.actions[:, None])
    tried = np.clip(state.actions[:, None] + changes, -1.0, 1.0)
    traces = _play(trials, state.scenarios, tried)
    gains = np.add.reduceat(state.traces[:, None] - traces, bounds, axis=2)  # (count, candidates, segments)
    blind = np.delete(gains, crossed, axis=1) if candidates > crossed.size else gains
    state.heights *= np.exp((np.mean(blind > 0.0, axis=(1, 2)) - SUCCESS) / 2.0)
    np.clip(state.heights, 0.002, 0.5, out=state.heights)
    together = np.clip(state.actions[:, None] + _combined(changes, gains, segment), -1.0, 1.0)
    traces = np.concatenate([traces, _play(trials, state.scenarios, together)], axis=1)
    tried = np.concatenate([tried, together], axis=1)
    best, rows = traces.sum(axis=2).argmin(axis=1), np.arange(count)
    better = traces[rows, best].sum(axis=1) < state.costs()
    state.actions[better] = tried[rows, best][better]
    state.traces[better] = traces[rows, best][better]
    return tried.shape[1]


def _windows(
    steps: int,
    segment: Devices,
    offset: int,
    length: int,
    shape: tuple[int, int],
    stage: Stage,
    period: float,
    rng: np.random.Generator,
) -> Values:
    """Return trapezoids of height 1, one in each segment, shape (*shape, steps)."""
    segments = int(segment[-1]) + 1

    def duration() -> Values:
        shortest, longest = np.log(stage.shortest / period), np.log(stage.longest / period)
        return np.exp(rng.uniform(shortest, longest, size=(*shape, segments)))[:, :, segment]

    rise, hold, fall = duration(), duration(), duration()
    begin = (rng.uniform(-0.25, 0.75, size=(*shape, segments)) * length)[:, :, segment]
    since = np.arange(steps) + offset - length * segment - begin
    return np.clip(np.minimum((since + 1.0) / rise, (rise + hold + fall - since) / fall), 0.0, 1.0)


def _combined(changes: Values, gains: Values, segment: Devices) -> Values:
    """Return combinations of the tried changes, shape (count, 6, steps).

    They are the best change of each segment; these in even and in odd segments only, since neighbours can reduce each
    other's gain; and the mean of all changes, weighted by their gain relative to the average, in which chance cancels:
    a step along the estimated gradient, in three lengths.
    """
    count, candidates, _ = gains.shape
    rows, steps = np.arange(count)[:, None], np.arange(segment.size)
    best = gains.argmax(axis=1)
    helps = np.take_along_axis(gains, best[:, None], axis=1)[:, 0] > 0.0
    chosen = changes[rows, best[:, segment], steps] * helps[:, segment]
    even = segment % 2 == 0
    weights = gains - gains.mean(axis=1, keepdims=True)
    weights /= np.maximum(np.abs(weights).sum(axis=1, keepdims=True), 1e-300)
    slope = np.zeros_like(chosen)
    for k in range(candidates):
        slope += weights[:, k][:, segment] * changes[:, k]
    return np.stack([chosen, np.where(even, chosen, 0.0), np.where(even, 0.0, chosen), slope, 3 * slope, 9 * slope], 1)


def _play(trials: Trials, scenarios: Devices, actions: NDArray[np.floating[Any]]) -> Values:
    """Return the cost of each step of each schedule, shape as `actions`: (scenarios, tried, steps)."""
    count, tried, steps = actions.shape
    rows = _rows(trials, np.repeat(scenarios, tried))
    flat = np.repeat(actions.reshape(-1, steps).astype(np.float32), trials.draws, axis=0)
    costs = trials.play(rows, scheduled(flat)).T.reshape(count, tried, trials.draws, steps)
    return np.ascontiguousarray(costs.mean(axis=2))


def _cost(trials: Trials, scenarios: Devices, actions: Actions) -> Values:
    """Return the costs of schedules, one for each of some scenarios, shape (len(scenarios),)."""
    return _play(trials, scenarios, actions[:, None])[:, 0].sum(axis=1)


def _rows(trials: Trials, scenarios: Devices) -> Devices:
    """Return all rows of some scenarios, scenario by scenario."""
    return (scenarios[:, None] * trials.draws + np.arange(trials.draws)).reshape(-1)


def _followed(trials: Trials, name: str) -> Actions:
    """Return the actions that a law or policy chooses in each scenario, shape (S, steps)."""
    contender = parse_contender(name)
    if contender.policy_name is None:
        raise AmulettError(f"'{name}' acts inside the loop and has no schedule at agent rate; it cannot be a start")
    # What the trials' actions mean, in their loop.
    meant = {"tension_range": trials.tension_range, "control": trials.control}
    keywords = {**trials.protocol.keywords(contender), **meant}
    env = gym.make(ENV_IDS[1], disable_env_checker=True, **keywords)
    policy = load_contender(contender, env)
    hold = keywords["agent_period"] / trials.protocol.agent_period
    if not math.isclose(hold, round(hold), rel_tol=1e-9):
        raise AmulettError(
            f"'{name}' acts every {keywords['agent_period']} s, which is no multiple of the schedules' "
            f"{trials.protocol.agent_period} s; it cannot be a start"
        )
    steps: list[Actions] = []
    last, wanted = np.zeros((2, len(trials.rows)), dtype=np.float32)

    def choose(step: int, observations: NDArray[np.float32]) -> Actions:
        nonlocal last, wanted
        turn = step % round(hold)
        if turn == 0:
            last, wanted = observations[:, TENSION_SETPOINT], np.clip(policy(observations)[:, 0], -1.0, 1.0)
        # The ramp over the law's own period, one agent step at a time.
        left = 1.0 - (turn + 1) / round(hold)
        steps.append((wanted + (last - wanted) * left).astype(np.float32))
        return steps[-1]

    trials.play(np.arange(len(trials.rows)), choose)
    env.close()
    return np.array(steps).T


@dataclass(frozen=True)
class _Block:
    """Scenarios that are searched at once, with their starts."""

    trials: Trials
    scenarios: Devices
    starts: dict[str, Actions]
    effort: Effort

    @property
    def file(self) -> str:
        """Name of the file of its result."""
        protocol = self.trials.protocol
        number = protocol.seed + int(self.scenarios[0])
        return f"{protocol.profile.name}/{protocol.suite}-{protocol.split}-{number}.npz"

    def digest(self) -> str:
        """Return the digest of all that its result depends on."""
        settings = json.dumps([VERSION, asdict(self.effort), list(self.starts)])
        return digest(settings, self.trials.digest(_rows(self.trials, self.scenarios)), *self.starts.values())

    def search(self, report: Callable[[int], object] = lambda rounds: None) -> Reference:
        """Return the best schedules."""
        return improve(self.trials, self.scenarios, self.starts, self.effort, report)


def _nothing(rounds: int) -> None:
    """Report no rounds: they were reported before."""


def _search(block: _Block) -> dict[str, NDArray[Any]]:
    return _pack(block.search(advance))


def _kept(block: _Block, folder: str | Path | None, report: Callable[[int], object]) -> Reference:
    """Return the stored result for a block's scenarios, or search and store it."""
    if folder is None:
        return block.search(report)

    def unpack(arrays: Mapping[str, NDArray[Any]]) -> Reference:
        found = Reference(
            starts=dict(zip(arrays["names"].tolist(), arrays["starts"], strict=True)),
            **{key: arrays[key] for key in ("costs", "actions", "restarts", "curve")},
        )
        if not np.allclose(_cost(block.trials, block.scenarios, found.actions), found.costs, rtol=1e-9):
            raise ValueError("their costs differ in this version of the simulation")
        report(block.effort.rounds)
        return found

    return kept(Path(folder) / block.file, block.digest(), lambda: block.search(report), _pack, unpack)


def _pack(found: Reference) -> dict[str, Any]:
    return {
        "names": np.array(list(found.starts)),
        "starts": np.array(list(found.starts.values())),
        **{key: getattr(found, key) for key in ("costs", "actions", "restarts", "curve")},
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", nargs="+", default=["steps"])
    parser.add_argument("--split", default="held-out")
    parser.add_argument("--profile", default="testbed")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="scenario i has the seed SEED + i")
    parser.add_argument("--policies", nargs="*", default=[], metavar="NAME", help="contenders for further starts")
    parser.add_argument("--out", metavar="DIR", help="folder of results; they are reused")
    arguments = parser.parse_args(argv)
    profile, split, episodes = load_profile(arguments.profile), arguments.split, arguments.episodes
    for suite in arguments.suite:
        protocol = Protocol(profile, suite, split, episodes=episodes, seed=arguments.seed)
        found = clairvoyant(Trials(protocol), laws=arguments.policies, folder=arguments.out)
        print(f"\n{suite}, {split}, {episodes} scenarios from seed {arguments.seed}: mean cost")
        for name, cost in _mean_costs(protocol, found).items():
            print(f"  {name:44} {cost:.4f}", flush=True)
        print("  by number of episodes for each scenario:")
        for simulated, cost in found.curve[:: max(len(found.curve) // 12, 1)]:
            print(f"    {simulated:6.0f} {cost:.4f}")


def _mean_costs(protocol: Protocol, found: Reference) -> dict[str, float]:
    """Return the mean costs of the contenders in the loop, of the starts, and of the search's results, by name."""
    every, action = np.arange(protocol.episodes), held(np.full(protocol.episodes, 10.0))
    constants = {name: costs.mean() for name, costs in found.starts.items() if name.startswith(CONSTANT)}
    best = min(constants, key=lambda name: constants[name])
    named = {
        "position-only (in the loop)": Trials(protocol, control="position-only").play(every, action).sum(axis=0).mean(),
        "eq6 (in the loop)": Trials(protocol, tension_law="eq6").play(every, action).sum(axis=0).mean(),
        f"best constant here ({best})": constants[best],
    }
    named |= {name: costs.mean() for name, costs in found.starts.items() if name not in constants}
    named["best start of each scenario"] = np.min(list(found.starts.values()), axis=0).mean()
    named |= {f"clairvoyant, search {k + 1} alone": costs.mean() for k, costs in enumerate(found.restarts)}
    named["clairvoyant"] = found.costs.mean()
    return {name: float(cost) for name, cost in named.items()}


if __name__ == "__main__":
    main()
