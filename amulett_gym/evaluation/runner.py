"""Paired runs: every contender plays the same scenarios with the same sensor noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS, FAILURES, WORN_ID
from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE, Track
from amulett_gym.envs.transition import METRICS
from amulett_gym.errors import AmulettError, refuse_worn, unknown
from amulett_gym.evaluation.metrics import UNITS, control_prices, derive, failure_cost
from amulett_gym.evaluation.remarks import device_remarks, loop_remarks
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import (
    CONSTANT,
    Contender,
    Own,
    constant_tension,
    contender_names,
    loops_of,
    parse_contender,
    python_file,
    split_loop,
)
from amulett_gym.laws.parametric import is_tuned, is_tuned_file
from amulett_gym.laws.policies import begin_episode, named_policy, own_policy
from amulett_gym.laws.training import other_device, other_loop
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.simulation.layout import CONTROLS, DRIVES, FAMILIES, LOOPS
from amulett_gym.storage.reading import user_path
from amulett_gym.tasks.names import check_suite
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack
from amulett_gym.tasks.suites import SPLITS, families_of

YARDSTICK = "eq6"
"""The baseline, with which all other contenders are compared; it always runs."""

PUSH_SUITE = "hold-push"
"""Suite for the response to pushes if the compared suite has none; it shows whether an arm is slack."""

MOST_EPISODES = 20_000
"""With more, the bootstrap's draws would take more than 640 MB, and intervals are narrow enough."""

SCHEDULE_EPISODES = 100
"""Number of episodes whose schedule is kept for the figures."""

_MOVING = np.radians(5.0)
"""Least joint rate of a moving arm [rad/s]; the noise of the measured rate is well below."""

Values = NDArray[np.float64]
Policy = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class Protocol:
    """The conditions that all contenders share.

    Attributes
    ----------
    profile : Profile
    suite, split, env_id : str
    episodes : int
        Number of scenarios.
    seed : int
        Scenario i is the first episode of the environment after a reset with ``seed + i``.
    duration : float
        Length of an episode [s].
    agent_period : float
        Time between two actions of a contender without its own period [s].
    scenarios : tuple of Scenario
        Own scenarios to play in turn instead of the suite's; those without a family have the suite's cost.
    unit : Profile or None
        The device by whose costs of eq. 6 costs are divided; None: `profile`. Returns are the environment's.
    """

    profile: Profile
    suite: str = "steps"
    split: str = "held-out"
    env_id: str = ENV_IDS[0]
    episodes: int = 100
    seed: int = 0
    duration: float = 10.0
    agent_period: float = 0.02
    scenarios: tuple[Scenario, ...] = ()
    unit: Profile | None = None

    def __post_init__(self) -> None:
        if self.env_id == WORN_ID:
            raise refuse_worn("a comparison of laws")
        for kind, name, choices in (("environment", self.env_id, ENV_IDS), ("split", self.split, SPLITS)):
            if name not in choices:
                raise unknown(kind, name, choices)
        check_suite(self.suite)
        for key, smallest in (("episodes", 1), ("seed", 0)):
            if getattr(self, key) < smallest:
                raise AmulettError(f"{key} is {getattr(self, key)}; it has to be at least {smallest}")
        if self.episodes > MOST_EPISODES:
            raise AmulettError(f"episodes is {self.episodes}; it has to be at most {MOST_EPISODES}")
        for key in ("duration", "agent_period"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise AmulettError(f"{key} is {getattr(self, key)} s; it has to be a positive number of seconds")
        if self.episodes < len(self.scenarios):
            raise AmulettError(f"episodes is {self.episodes}; there are {len(self.scenarios)} own scenarios to play")
        for scenario in self.scenarios[: self.episodes - len(self.scenarios)]:
            if scenario.noise_seed is not None:
                raise AmulettError(
                    f"{self.episodes} episodes would repeat a scenario with the same sensor noise: its noise_seed is "
                    f"{scenario.noise_seed}; set that to null, or play {len(self.scenarios)} episodes"
                )

    @property
    def task(self) -> str:
        """The suite's name or ``"own scenarios"``."""
        return "own scenarios" if self.scenarios else self.suite

    @property
    def families(self) -> list[str]:
        """The suites whose weights and divisors the scenarios' costs have."""
        if not self.scenarios:
            return families_of(self.suite)
        rows = (pack(scenario, self.profile) for scenario in self.scenarios)
        return list(dict.fromkeys(FAMILIES[int(row["family"][0])] or self.suite for row in rows))

    def env_of(self, contender: Contender) -> str:
        """Return the id of a contender's environment.

        In a comparison in `Amulett/Drives-v0`, laws for a tension, eq. 6 among them, act in the first of `ENV_IDS`.
        """
        if contender.env_id == WORN_ID:
            raise refuse_worn(f"a comparison with '{contender.name}', which acts there alone,")
        if contender.env_id is not None:
            return contender.env_id
        own = isinstance(contender, Own)
        return ENV_IDS[0] if self.env_id == DRIVES_ID and not own else self.env_id

    def options(self, episodes: int) -> dict[str, Any] | None:
        """Return the vector environment's reset options for own scenarios; None for the suite's."""
        if not self.scenarios:
            return None
        return {"scenario": [self.scenarios[k % len(self.scenarios)] for k in range(episodes)]}

    def keywords(self, contender: Contender) -> dict[str, Any]:
        """Return the environment's keywords for a contender, ``max_episode_steps`` among them.

        Raises
        ------
        AmulettError
            If the episode is not a whole number of the contender's agent steps, or the contender's tensions begin at
            0 N, which its loop cannot hold.
        """
        keywords: dict[str, Any] = {"agent_period": self.agent_period, **needed_keywords(contender)}
        keywords |= {"profile": self.profile, "suite": self.suite, "split": self.split}
        steps = agent_steps(self.duration, keywords["agent_period"], contender.name)
        return {**keywords, "max_episode_steps": steps, "failure_horizon": steps}


def agent_steps(duration: float, period: float, name: str) -> int:
    """Return the agent steps of `period` in an episode of `duration` [s]; `name` of the policy is for the message.

    Raises
    ------
    AmulettError
        If they are no whole number.
    """
    steps = max(round(duration / period), 1)
    if abs(steps * period - duration) > 1e-9 * duration:
        raise AmulettError(f"an episode of {duration} s is no whole number of the {period} s steps of '{name}'")
    return steps


def needed_keywords(contender: Contender) -> dict[str, Any]:
    """Return the environment's keywords that a contender needs, a bundle's tension range among them.

    Raises
    ------
    AmulettError
        If its tensions begin at 0 N, which its loop cannot hold.
    """
    keywords: dict[str, Any] = {}
    name = contender.policy_name
    if name is not None and is_bundle(name):  # its range may be wider than the default
        keywords["tension_range"] = read_bundle(name).policy.tension_range
        control = contender.env_keywords.get("control", CONTROLS[0])
        if contender.env_id is None and control not in LOOPS and keywords["tension_range"][0] == 0.0:
            raise AmulettError(
                f"'{contender.name}' chooses tensions from 0 N on, and the loop '{control}' needs more; it can act "
                f"in {', '.join(sorted(LOOPS))}"
            )
    return keywords | contender.env_keywords


@dataclass(frozen=True)
class Schedule:
    """The tensions that a policy chose, one entry for each agent step.

    Attributes
    ----------
    error : ndarray
        Absolute measured position error when the tension was chosen [deg].
    tension : ndarray
        Tension setpoint [N].
    phase : ndarray of int
        1: the joint moved towards its setpoint, -1: away from it, 0: it stood.
    tension_range : tuple of float
        Range of the policy's tension setpoints [N].
    approach : ndarray
        Measured joint rate, positive towards the setpoint [deg/s].
    """

    error: Values
    tension: Values
    phase: NDArray[np.int64]
    tension_range: tuple[float, float]
    approach: Values


@dataclass(frozen=True)
class Results:
    """The results of all contenders, scenario by scenario.

    Attributes
    ----------
    protocol : Protocol
    values : dict of str to dict of str to ndarray, shape (episodes,)
        Contender -> metric (see `evaluation.metrics.UNITS`) -> value in each scenario; NaN where not reached.
    failures : dict of str to list of str
        Contender -> why its device failed in each scenario, an empty string where it did not.
    schedules : dict of str to Schedule
        Of the contenders that act from outside the loop.
    listed : bool
        Whether the user named eq6.
    push_suite : str
        Suite in which `push_deflection` was measured; the protocol's `task` if that has pushes.
    push_failures : dict of str to int
        Contender -> number of its failures in `push_suite`, if that is another suite.
    remarks : list of str
        Warnings, such as policies trained elsewhere.
    command : str or None
        The command that repeats this comparison.
    contenders : dict of str to Contender
    families : list of str
        Family of each scenario, by whose weights and divisors its cost is computed.
    """

    protocol: Protocol
    values: dict[str, dict[str, Values]]
    failures: dict[str, list[str]]
    schedules: dict[str, Schedule] = field(default_factory=dict)
    listed: bool = True
    push_suite: str = PUSH_SUITE
    push_failures: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    command: str | None = None
    contenders: dict[str, Contender] = field(default_factory=dict)
    families: list[str] = field(default_factory=list)

    @property
    def track(self) -> Track:
        """*Full control* if a contender acts in another loop than the paper's or on the drives, else *schedule*."""
        contenders = self.contenders.values()
        loops = [contender.env_keywords.get("control") for contender in contenders]
        drives = DRIVES_ID in [self.protocol.env_of(contender) for contender in contenders]
        return FULL_CONTROL if drives or any(loop in LOOPS for loop in loops) else SCHEDULE

    def contender(self, name: str) -> Contender:
        """Return a contender by its name."""
        return self.contenders.get(name) or parse_contender(name)


def evaluate(
    policies: Sequence[str | Contender],
    suite: str = "steps",
    profile: str | Path | Mapping[str, Any] | Profile = "testbed",
    episodes: int | None = None,
    seed: int = 0,
    env_id: str = ENV_IDS[0],
    split: str = "held-out",
    duration: float = 10.0,
    agent_period: float = 0.02,
    progress: bool = False,
    scenarios: Sequence[str | Path | Mapping[str, Any] | Scenario] = (),
) -> Results:
    """Return the results of contenders, and of the baseline eq. 6, on the same scenarios.

    After a failure, `cost` increases by `COST_CAP` for each agent step left, as in the reward; the other metrics stay
    what they were at the failure.

    Parameters
    ----------
    policies : sequence of str or Contender
        Names of contenders (`laws.contenders.contender_names`), folders of policy bundles, or your own policies
        (:class:`Own`). One that is named twice, even by another name, runs once.
    suite, split, env_id : str
    profile : str, Path, mapping or Profile
    episodes : int, optional
        100, or one of each of `scenarios`, if None.
    seed : int
        Scenario i has the seed ``seed + i``: comparisons whose seeds are closer than `episodes` share scenarios.
    duration, agent_period : float
        Length of an episode, and time between two actions of a contender without its own period [s].
    progress : bool
        Whether to show progress on stderr.
    scenarios : sequence of str, Path, mapping or Scenario
        Own scenarios, or their files, to play in turn instead of the suite's.

    Raises
    ------
    AmulettError
        If a name is unknown or a value is out of its range; nothing runs then.
    """
    own = tuple(load_scenario(scenario) for scenario in scenarios)
    episodes = (len(own) or 100) if episodes is None else episodes
    protocol = Protocol(load_profile(profile), suite, split, env_id, episodes, seed, duration, agent_period, own)
    named = [entry if isinstance(entry, Contender) else parse_contender(entry) for entry in policies]
    listed = YARDSTICK in [contender.name for contender in named]
    contenders, remarks = _unique(named if listed else [parse_contender(YARDSTICK), *named])
    label = labels([contender.name for contender in contenders])
    remarks += training_remarks(contenders, protocol)
    remarks += loop_remarks(replace(contender, name=label[contender.name]) for contender in contenders)
    places = {contender.name: contender.policy_name for contender in contenders}
    remarks += device_remarks(protocol.profile, label, places=places, loops=loops_of(contenders), suite=suite)

    with ExitStack() as stack:

        def make(protocol: Protocol, contender: Contender) -> tuple[Any, Policy]:
            env = _make(protocol, contender)
            stack.callback(env.close)
            return env, load_contender(contender, env)

        players = [make(protocol, contender) for contender in contenders]
        without_pushes = not _has_pushes(players[0][0], protocol)
        push_protocol = replace(protocol, suite=PUSH_SUITE, scenarios=()) if without_pushes else None
        pushed_players = [] if push_protocol is None else [make(push_protocol, contender) for contender in contenders]
        by_name = {contender.name: contender for contender in contenders}
        push_suite = protocol.task if push_protocol is None else PUSH_SUITE
        results = Results(protocol, {}, {}, {}, listed, push_suite, remarks=remarks, contenders=by_name)
        total = sum(env.max_episode_steps for env, _ in [*players, *pushed_players])
        bar = stack.enter_context(Progress(total, f"{protocol.episodes} episodes at once", "steps", progress))
        for k, contender in enumerate(contenders):
            advance = partial(bar.update, note=contender.name)
            run = play(protocol, *players[k], advance)
            if push_protocol is not None:
                pushed = play(push_protocol, *pushed_players[k], advance)
                run.values["push_deflection"] = pushed.values["push_deflection"]
                results.push_failures[contender.name] = sum(reason != "" for reason in pushed.failures)
            results.values[contender.name] = run.values
            results.families[:] = [FAMILIES[family] or suite for family in run.families]
            results.failures[contender.name] = run.failures
            if acts_from_outside(contender):
                results.schedules[contender.name] = run.schedule
    return results


def labels(names: Sequence[str]) -> dict[str, str]:
    """Return a short label for each contender: of a bundle's folder only the end, if that is unique."""
    short = {name: _short(name) for name in names}
    return {name: label if list(short.values()).count(label) == 1 else name for name, label in short.items()}


def acts_from_outside(contender: Contender) -> bool:
    """Return whether a contender chooses the tension by observations, and not the loop itself."""
    return contender.policy_name is not None or isinstance(contender, Own)


def is_bundle(name: str) -> bool:
    """Return whether a contender's name, in any loop, is that of a learned policy's folder."""
    _, name = split_loop(name)
    known = name in contender_names() or name.startswith(CONSTANT) or is_tuned(name)
    return not known and python_file(name) is None


def training_remarks(contenders: Iterable[Contender], protocol: Protocol, task: bool = True) -> list[str]:
    """Return how learned policies' trainings differ from the protocol, as sentences without a full stop.

    Compared are the device, the loop and, with `task`, the suite.
    """
    contenders = list(contenders)
    label = labels([contender.name for contender in contenders])
    differences = ((label[each.name], training_differs(each, protocol, task)) for each in contenders)
    return [f"{name} {difference}" for name, difference in differences if difference]


def training_differs(contender: Contender, protocol: Protocol, task: bool = True) -> str:
    """Return how a learned policy's training differs from the protocol, an empty string if it does not.

    The environments of a tension, `Amulett/Scaling-v0` and `Amulett/Tension-v0`, do not differ: an action means the
    same in both.
    """
    if contender.policy_name is None or not is_bundle(contender.policy_name):
        return ""
    trained = read_bundle(contender.policy_name).env
    control = contender.env_keywords.get("control", DRIVES if trained.id == DRIVES_ID else CONTROLS[0])
    places = [other_device(trained, protocol.profile), *other_loop(trained, [protocol.profile], control)]
    suite = trained.keywords.get("suite", "steps")
    if task and suite != protocol.task:
        places.append(f"for {suite}, not {protocol.task}")
    return f"was trained {'; '.join(filter(None, places))}" if any(places) else ""


def _short(name: str) -> str:
    loop, name = split_loop(name)
    if loop:
        return f"{loop}/{_short(name)}"
    parts = [part for part in Path(name).parts if part not in ("best", "last", "/", ".", "..")]
    return parts[-1] if parts else name


def _unique(contenders: Sequence[Contender]) -> tuple[list[Contender], list[str]]:
    """Return every contender once, and a remark for each that was named again by another name."""
    kept: dict[Any, Contender] = {}
    remarks = []
    for contender in contenders:
        policy: Any = contender.policy_name
        if policy is not None and policy.startswith(CONSTANT):
            policy = constant_tension(policy)
        elif policy is not None and (is_bundle(policy) or is_tuned_file(policy)):
            policy = user_path(policy).resolve()
        key = (
            policy,
            contender.env_id,
            repr(contender.env_keywords),
            contender.act if isinstance(contender, Own) else None,
        )
        first = kept.setdefault(key, contender)
        if first is not contender and first.name != contender.name:
            remarks.append(f"{contender.name} is the same as {first.name}, and ran once")
    names = [contender.name for contender in kept.values()]
    for contender in kept.values():
        taken = isinstance(contender, Own) and contender.name in contender_names()
        if taken or names.count(contender.name) > 1:
            raise AmulettError(f"two contenders would be called '{contender.name}'; give one of them another name")
    return list(kept.values()), remarks


@dataclass(frozen=True)
class Run:
    """The results of one contender in each scenario.

    Attributes
    ----------
    values : dict of str to ndarray, shape (episodes,)
        Metric -> value; NaN where not reached.
    failures : list of str
        Why its device failed, an empty string where it did not.
    families : ndarray of int, shape (episodes,)
        Of each scenario, an index into `simulation.layout.FAMILIES`.
    schedule : Schedule
    """

    values: dict[str, Values]
    failures: list[str]
    families: NDArray[np.int64]
    schedule: Schedule


def _make(protocol: Protocol, contender: Contender) -> Any:
    return gym.make_vec(protocol.env_of(contender), num_envs=protocol.episodes, **protocol.keywords(contender))


def load_contender(contender: Contender, env: Any) -> Policy:
    """Return a contender's policy for its environment: a batch of observations -> a batch of actions."""
    if isinstance(contender, Own):
        if not callable(contender.act):
            raise AmulettError(f"contender '{contender.name}' has no policy: give it a callable, act=...")
        return own_policy(contender.act, env, contender.name)
    if contender.policy_name is None:
        size = env.unwrapped.episodes.action_size
        return lambda observations: np.zeros((len(observations), size), dtype=np.float32)
    return named_policy(contender.policy_name, env)


def play_alone(protocol: Protocol, contender: Contender) -> Run:
    """Play the protocol's scenarios with one contender."""
    env = _make(protocol, contender)
    try:
        return play(protocol, env, load_contender(contender, env))
    finally:
        env.close()


def _has_pushes(env: Any, protocol: Protocol) -> bool:
    env.reset(seed=protocol.seed, options=protocol.options(protocol.episodes))
    return any(scenario.pushes for scenario in env.scenarios)


def play(protocol: Protocol, env: Any, policy: Policy, advance: Callable[[int], Any] = lambda steps: None) -> Run:
    """Play one episode with each device; its metrics are those of the step in which the episode ended."""
    count = protocol.episodes
    metrics = {name: np.empty(count) for name in METRICS}
    returns, charges = np.zeros(count), np.zeros(count)
    failures = [""] * count
    running = np.ones(count, dtype=bool)
    seen: list[tuple[Values, Values, NDArray[np.int64], Values]] = []
    observations, _ = env.reset(seed=protocol.seed, options=protocol.options(count))
    begin_episode(policy)
    families = env.episodes.simulation.read_scenarios(np.arange(count))["family"]
    for _ in range(env.max_episode_steps):
        error, phase, approach = _look(env)
        observations, rewards, terminated, truncated, info = env.step(policy(observations))
        advance(1)
        returns[running] += rewards[running]
        kept = np.flatnonzero(running[:SCHEDULE_EPISODES])
        seen.append((error[kept], info["tension_setpoint"][kept], phase[kept], approach[kept]))
        ended = running & (terminated | truncated)
        for name, column in metrics.items():
            column[ended] = info[name][ended]
        for device in np.flatnonzero(ended & terminated):
            failures[device] = FAILURES[int(info["failure"][device])]
            charges[device] = failure_cost(info["time"][device], protocol.duration, protocol.agent_period)
        running &= ~ended
    unit = protocol.unit or protocol.profile
    tables = (table(unit, protocol.suite, families=families) for table in (prices, control_prices))
    values = derive(metrics, charges, *tables)
    values["return"] = returns
    error, tension, phase, approach = (np.concatenate(column) for column in zip(*seen, strict=True))
    schedule = Schedule(error, tension, phase, env.tension_range, approach)
    return Run({name: values[name] for name in UNITS}, failures, families.astype(np.int64), schedule)


def _look(env: Any) -> tuple[Values, NDArray[np.int64], Values]:
    """Return each device's absolute position error [deg], phase and approach [deg/s], by its own sensors."""
    simulation = env.episodes.simulation
    error = simulation.read("setpoint") - simulation.read("measured_angle")
    velocity = simulation.read("measured_velocity")
    phase = np.where(np.abs(velocity) < _MOVING, 0, np.sign(velocity * error)).astype(np.int64)
    return np.degrees(np.abs(error)), phase, np.degrees(velocity * np.sign(error))
