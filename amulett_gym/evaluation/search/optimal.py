"""The optimal reference for full control: for each scenario, the drives' commands of lowest cost, by optimal control.

Both drives are commanded directly, within the profile's limits, and the *true* device is known: its springs, pulleys,
inertia and load, and also the pushes, shakes and contacts to come. Sensors play no part. Minimised is the cost of the
track "full control" (`evaluation.metrics.control_cost`), of

- position: eq. 7 of the true joint angle [deg2 s];
- effort: eq. 8 of the drives' own motion, after lag and rate limit, of both together [deg2/s];
- contact: the integrated square of the obstacle's torque [N2 m2 s].

There is no tension term, since there is no tension setpoint. The problem is nonlinear and not convex; IPOPT finds local
optima from a few starts, minimum-jerk motions by inverse statics, and the best is taken: the result is a reference, not
a proven lower bound. See :mod:`amulett_gym.evaluation.search.transcription` for the method. Strings may be slack, where
the fit of Figure 3 gives no friction: the arm then coasts. They may not be stretched beyond their table, where the
simulation's force is constant (`Options.saturates` allows it; the many local optima there make the search unreliable).

There are two variants. *Causal* about setpoint jumps, the main one: commands before a jump do not depend on it. The
episode is solved part by part, from each jump on, as if the setpoint went on without the next one; the plan goes on for
`Options.preview` beyond the next jump, where it is dropped. *Anticipating*: all jumps are known, so that the arm moves
before the setpoint does, which no loop can do. Smooth moves and disturbances are known in advance in both. Time before
`measure_from` counts in what is minimised, since else the arm could move before a jump at no cost; it does not count in
the costs returned.

The commands are then played in `simulation.reference`, which shares only the profile and the springs' knots with the
solver; its costs are the result. A scenario's missed control ticks are not modelled.

``python -m amulett_gym.evaluation.search.optimal --suite mixed --scenarios 0:20 --out DIR`` prints each scenario's
cost, and keeps the results. CasADi is needed: the extra ``optimal``.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import CONTROL_TERMS, control_prices
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.transcription import Plan, Transcription, grid, load_casadi
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import ON_PATH, RUNNING, TIME_SLACK
from amulett_gym.simulation.reference import replay_motion
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.storage.kept import digest, kept

VERSION = 1
"""Version of the method, increased if the same options would find other commands."""

Values = NDArray[np.float64]

_UNITS = np.array([np.degrees(1.0) ** 2, np.degrees(1.0) ** 2, 1.0])  # the terms' reported units per SI units


@dataclass(frozen=True)
class Options:
    """How commands are searched.

    Attributes
    ----------
    causal : bool
        Whether commands are independent of setpoint jumps to come.
    saturates : bool
        Whether strings may be stretched beyond the end of the springs' table.
    interval : float
        Longest time for which commands are constant [s].
    preview : float
        Time that a plan goes on beyond the next jump of the setpoint [s].
    starts : tuple of tuple of float
        First guesses, the best result of which is taken: duration of the minimum-jerk motion after a jump [s], and the
        antagonist's tension as a share of the springs' largest force.
    """

    causal: bool = True
    saturates: bool = False
    interval: float = 0.02
    preview: float = 1.0
    starts: tuple[tuple[float, float], ...] = ((0.25, 0.45), (0.5, 0.75), (0.5, 0.1))


@dataclass(frozen=True)
class Course:
    """What happens to the arm in a scenario, whatever the commands: it is known in advance.

    Attributes
    ----------
    setpoint, torque : ndarray, shape (ticks,)
        Setpoint [rad] and external torque [N m] of each control tick.
    counted : ndarray of bool, shape (ticks,)
        Whether the tick counts in the costs.
    start : ndarray, shape (4,)
        Joint angle [rad], its rate [rad/s] and both drives' angles [rad].
    jumps : dict of int to float
        Tick -> jump of the setpoint [rad].
    """

    setpoint: Values
    torque: Values
    counted: NDArray[np.bool_]
    start: Values
    jumps: dict[int, float]


@dataclass(frozen=True)
class Optimal:
    """The commands that were found for one scenario.

    Attributes
    ----------
    commands : ndarray, shape (ticks, 2)
        Commands of biceps' and triceps' drive in each control tick [rad].
    predicted : ndarray, shape (3,)
        Raw terms by the solver's own model [deg2 s, deg2/s, N2 m2 s].
    played : ndarray, shape (3,)
        The same in the independent simulation.
    success : bool
        Whether the solver converged in every part and the device stayed within its limits.
    seconds : float
        Time of the search [s].
    """

    commands: Values
    predicted: Values
    played: Values
    success: bool
    seconds: float


@dataclass(frozen=True)
class OptimalCosts:
    """The results of some scenarios.

    Attributes
    ----------
    scenarios : ndarray of int, shape (S,)
    cost : ndarray, shape (S,)
        Sum of `terms`, each times weight over divisor of the scenario's family.
    predicted_cost : ndarray, shape (S,)
        The same by the solver's own model.
    terms : dict of str to ndarray, shape (S,)
        Raw terms by `evaluation.metrics.CONTROL_TERMS`: position [deg2 s], drive_effort [deg2/s], contact [N2 m2 s].
    success : ndarray of bool, shape (S,)
        See `Optimal`. The cost of a scenario without success is what its commands cost in the simulation, too.
    """

    scenarios: NDArray[np.int64]
    cost: Values
    predicted_cost: Values
    terms: dict[str, Values]
    success: NDArray[np.bool_]


def optimal_costs(
    profile: str | Path | Mapping[str, Any] | Profile = "testbed",
    suite: str = "mixed",
    split: str = "held-out",
    scenarios: Sequence[int] = range(20),
    folder: str | Path | None = None,
    duration: float = 10.0,
    options: Options = Options(),
    prices: Values | None = None,
    report: Callable[[str], object] = lambda note: None,
) -> OptimalCosts:
    """Return the costs of the optimal commands of some scenarios.

    Parameters
    ----------
    profile : str, Path, mapping or Profile
    suite, split : str
    scenarios : sequence of int
        Scenario i is that of `evaluation.runner.evaluate` with seed 0.
    folder : str or Path, optional
        Folder of results, one file for each scenario; they are reused if device, scenario, costs and options are the
        same.
    duration : float
        Length of an episode [s].
    options : Options
    prices : ndarray, shape (len(FAMILIES), 3), optional
        Cost of each family per deg2 s, deg2/s and N2 m2 s, instead of `evaluation.metrics.control_prices`.
    report : callable
        Called with a note after each scenario.

    Raises
    ------
    AmulettError
        If CasADi is missing, a name is unknown, a scenario's setpoint is a path, or a file cannot be written.
    """
    load_casadi()
    profile = load_profile(profile)
    prices = control_prices(profile, suite) if prices is None else prices
    found, costs = [], []
    for number in scenarios:
        protocol = Protocol(profile, suite, split, episodes=1, seed=int(number), duration=duration)
        trials = Trials(protocol)
        row = trials.rows[0]
        cost = prices[int(row["family"])]
        ticks = round(duration / profile.loop.control_period)
        inputs = digest([VERSION, asdict(options), ticks, cost], trials.digest())
        found.append(_kept(profile, row, cost, ticks, options, folder, protocol, inputs))
        costs.append(cost)
        report(f"scenario {number}: {float(cost @ found[-1].played):.4f}")
    raw, predicted = (np.array([getattr(one, name) for one in found]) for name in ("played", "predicted"))
    return OptimalCosts(
        np.array(scenarios, dtype=np.int64),
        (raw * costs).sum(axis=1),
        (predicted * costs).sum(axis=1),
        dict(zip(CONTROL_TERMS, raw.T, strict=True)),
        np.array([one.success for one in found]),
    )


def result_file(profile: Profile, suite: str, split: str, scenario: int, options: Options = Options()) -> str:
    """Return the name of a scenario's file in a folder of results."""
    return f"{profile.name}/{'causal' if options.causal else 'anticipating'}/{suite}-{split}-{scenario}.npz"


def optimise(profile: Profile, row: np.void, price: Values, ticks: int, options: Options = Options()) -> Optimal:
    """Return the optimal commands of one scenario and their costs.

    Parameters
    ----------
    profile : Profile
    row : record of `simulation.layout.SCENARIO`
    price : ndarray, shape (3,)
        Cost per deg2 s, deg2/s and N2 m2 s.
    ticks : int
        Length of the episode.
    options : Options

    Raises
    ------
    AmulettError
        If CasADi is missing, the scenario's setpoint is a path, or the device has what the model lacks: springs that go
        on beyond their table, drives that stall, or an elastic structure.
    """
    begun = time.monotonic()
    lacks = profile.spring.beyond, profile.drives.stall_torque, profile.structure
    if any(each is not None for each in lacks):
        raise AmulettError(
            f"the optimal control of '{profile.name}' cannot be computed: its model has springs whose force is held "
            "beyond their table (spring.beyond: null), drives without drives.stall_torque and a rigid structure "
            "(structure: null)"
        )
    course = read_course(profile, row, ticks)
    transcription = Transcription(profile, row, price * _UNITS, options.saturates)
    period = profile.loop.control_period
    length, preview = max(round(options.interval / period), 1), round(options.preview / period)
    parts = sorted({0, *course.jumps} if options.causal else {0})
    commands, predicted = np.empty((ticks, 2)), np.zeros(3)
    state, success = course.start, True
    for begin, end in zip(parts, [*parts[1:], ticks], strict=True):
        horizon = min(end + preview, ticks) if end < ticks else ticks
        hidden = {tick: jump for tick, jump in course.jumps.items() if options.causal and tick > begin}
        intervals = _grid(course, begin, end, horizon, length)
        plan = _plan(profile, row, course, state, intervals, hidden)
        guesses = [_guess(profile, row, course, plan, hidden, *start) for start in options.starts]
        solved = transcription.solve(plan, guesses)
        last = int(np.searchsorted(plan.ticks, end))
        state, success = solved.states[:, last], success and solved.success
        for k in range(last):
            first, after = plan.ticks[k], plan.ticks[k + 1]
            predicted += course.counted[first] * solved.terms[:, k]
            way = 1.0
            if profile.drives.lag == 0.0:  # ideal drives are led to the command
                way = np.arange(1, after - first + 1)[:, None] / (after - first)
            commands[first:after] = solved.states[2:, k] + way * (solved.commands[:, k] - solved.states[2:, k])
    seconds = time.monotonic() - begun
    played, inside = play(profile, row, course, commands)
    return Optimal(commands, predicted * _UNITS, played, success and inside, seconds)


def read_course(profile: Profile, row: np.void, ticks: int) -> Course:
    """Return what happens in a scenario during its first ticks.

    Raises
    ------
    AmulettError
        If the scenario's setpoint is a path, which its record does not hold.
    """
    if row["move_count"] == ON_PATH:
        raise AmulettError("the optimal control of a scenario with a sampled setpoint or more than 10 moves is missing")
    # Setpoint and torques do not depend on the motion, as long as the device does not fail.
    wide = {"angle_limit_deg": 180.0, "velocity_limit_deg": 1e5}
    plant = profile.plant.model_copy(update=wide)
    simulation = Simulation(profile.model_copy(update={"plant": plant}))
    simulation.reset(np.array([row]))
    trajectory = record(simulation, ticks)
    if simulation.read("failure")[0] != RUNNING:
        raise AmulettError("the paper's loop fails in the scenario beyond all limits, so that its course is unknown")
    period, jumps = profile.loop.control_period, dict[int, float]()
    angle = float(row["initial_angle"])
    for k in range(int(row["move_count"])):
        tick = max(math.ceil((float(row["move_time"][k]) - TIME_SLACK) / period), 0)
        if row["move_duration"][k] == 0.0 and tick < ticks:
            jumps[tick] = jumps.get(tick, 0.0) + float(row["move_angle"][k]) - angle
        angle = float(row["move_angle"][k])
    return Course(
        setpoint=trajectory["setpoint"][:-1],
        torque=trajectory["push_torque"][1:],
        counted=np.arange(ticks) * period >= float(row["measure_from"]) - TIME_SLACK,
        start=np.array([trajectory[name][0] for name in ("angle", "velocity", "drive_biceps", "drive_triceps")]),
        jumps=jumps,
    )


def play(profile: Profile, row: np.void, course: Course, commands: Values) -> tuple[Values, bool]:
    """Return what commands cost in the independent simulation, and whether the device stayed within its limits.

    Parameters
    ----------
    profile : Profile
    row : record of `simulation.layout.SCENARIO`
    course : Course
    commands : ndarray, shape (ticks, 2)
        Of biceps' and triceps' drive in each control tick [rad].

    Returns
    -------
    terms : ndarray, shape (3,)
        Raw terms [deg2 s, deg2/s, N2 m2 s].
    inside : bool
    """
    period = profile.loop.control_period
    given = {
        **{name: course.start[k : k + 1] for k, name in enumerate(("angle", "velocity", "drive_biceps"))},
        "drive_triceps": course.start[3:],
        "tick": np.arange(len(commands) + 1),
        "command_biceps": np.append(course.start[2], commands[:, 0]),
        "command_triceps": np.append(course.start[3], commands[:, 1]),
        "push_torque": np.append(0.0, course.torque),
    }
    motion = replay_motion(profile, row, Trajectory(profile.name, period, given))
    weight = period * course.counted
    before, after = course.setpoint - motion["angle"][:-1], course.setpoint - motion["angle"][1:]
    drives = [np.diff(motion[f"drive_{name}"]) / period for name in ("biceps", "triceps")]
    terms = (
        0.5 * weight @ (before**2 + after**2),
        weight @ (drives[0] ** 2 + drives[1] ** 2),
        weight @ motion["contact_torque"][1:] ** 2,
    )
    plant = profile.plant
    inside = np.abs(motion["angle"]).max() <= np.radians(plant.angle_limit_deg)
    inside &= np.abs(motion["velocity"]).max() <= np.radians(plant.velocity_limit_deg)
    return np.array(terms) * _UNITS, bool(inside)


def _grid(course: Course, begin: int, end: int, horizon: int, length: int) -> NDArray[np.int64]:
    """Return the begin of each interval; none spans the begin of a jump or of the costs, or the end of a part."""
    breaks = {begin, end, horizon, *course.jumps, int(np.argmax(course.counted))}
    return grid(sorted(tick for tick in breaks if begin <= tick <= horizon), length)


def _plan(
    profile: Profile, row: np.void, course: Course, state: Values, ticks: NDArray[np.int64], hidden: Mapping[int, float]
) -> Plan:
    """Return the problem of a part, without the setpoint's hidden jumps."""
    now = np.arange(ticks[0], ticks[-1])
    setpoint = course.setpoint[now].copy()
    for tick, jump in hidden.items():
        setpoint[now >= tick] -= jump
    return Plan(ticks, setpoint, course.torque[now], state)


def _guess(
    profile: Profile, row: np.void, course: Course, plan: Plan, hidden: Mapping[int, float], reach: float, share: float
) -> tuple[Values, Values]:
    """Return a first guess of states and commands: minimum-jerk motions after jumps, by inverse statics."""
    ticks, period = plan.ticks, profile.loop.control_period
    begin, now = int(ticks[0]), np.arange(ticks[0], ticks[-1])

    def left(tick: int) -> Values:
        """Return the part of a motion from a tick on that is left, 1 to 0."""
        share = np.clip((now - tick) * period / reach, 0.0, 1.0)
        return 1.0 - share**3 * (10.0 + share * (6.0 * share - 15.0))

    reference = plan.setpoint - (plan.setpoint[0] - plan.start[0]) * left(begin)
    for tick, jump in course.jumps.items():
        if tick > begin and tick not in hidden:
            reference -= jump * (now >= tick) * left(tick)
    rate = np.gradient(reference, period)
    torque = float(row["inertia"]) * np.gradient(rate, period) + float(row["static_torque"]) * np.sin(reference)
    drives = _inverse_statics(profile, row, reference, torque - plan.torque, share)
    drives += (plan.start[2:] - drives[:, 0])[:, None] * left(begin)
    states = np.vstack([reference, rate, drives])
    states = np.concatenate([states, states[:, -1:]], axis=1)[:, ticks - begin]
    states[:, 0] = plan.start
    ahead = drives + profile.drives.lag * np.gradient(drives, period, axis=1)
    return states, ahead[:, ticks[:-1] - begin]


def _inverse_statics(profile: Profile, row: np.void, joint: Values, torque: Values, share: float) -> Values:
    """Return both drives' angles [rad], shape (2, N), that give a torque [N m] at a joint angle [rad].

    The antagonist has a share of the largest force; where the springs do not have a force, the nearest that they have.
    """
    tables, plant = build_tables(profile.spring), profile.plant
    forces = np.append(tables.force[:, 0], tables.max_force)
    stretches = np.linspace(0.0, tables.max_deflection, forces.size)
    to_joint, angles = plant.joint_pulley_radius, []
    for name, sign in (("biceps", 1.0), ("triceps", -1.0)):
        force = share * tables.max_force + np.maximum(sign * torque, 0.0) / to_joint
        stretch = np.interp(force / float(row[f"spring_{name}_factor"]), forces, stretches)
        radius = plant.drive_pulley_radius * float(row[f"pulley_{name}_factor"])
        angles.append((to_joint * joint + sign * stretch) / radius)
    return np.array(angles)


def _kept(
    profile: Profile,
    row: np.void,
    price: Values,
    ticks: int,
    options: Options,
    folder: str | Path | None,
    protocol: Protocol,
    inputs: str,
) -> Optimal:
    """Return the stored result of a scenario, or find and store it."""
    if folder is None:
        return optimise(profile, row, price, ticks, options)
    path = Path(folder) / result_file(profile, protocol.suite, protocol.split, protocol.seed, options)

    def unpack(arrays: Mapping[str, Any]) -> Optimal:
        success, seconds = bool(arrays["success"]), float(arrays["seconds"])
        return Optimal(arrays["commands"], arrays["predicted"], arrays["played"], success, seconds)

    return kept(path, inputs, lambda: optimise(profile, row, price, ticks, options), _pack, unpack)


def _pack(found: Optimal) -> dict[str, Any]:
    return {name: np.array(value) for name, value in vars(found).items()}


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="testbed")
    parser.add_argument("--suite", default="mixed")
    parser.add_argument("--split", default="held-out")
    parser.add_argument("--scenarios", default="0:20", metavar="FIRST:END", help="scenario i has the seed i")
    parser.add_argument("--duration", type=float, default=10.0, help="of an episode [s]")
    parser.add_argument("--interval", type=float, default=Options.interval, help="time of constant commands [s]")
    parser.add_argument("--anticipating", action="store_true", help="know setpoint jumps in advance")
    parser.add_argument("--out", metavar="DIR", help="folder of results; they are reused")
    arguments = parser.parse_args(argv)
    first, _, end = arguments.scenarios.partition(":")
    scenarios = range(int(first), int(end or int(first) + 1))
    options = Options(causal=not arguments.anticipating, interval=arguments.interval)
    with Progress(len(scenarios), "optimal control", "scenarios") as bar:
        found = optimal_costs(
            arguments.profile,
            arguments.suite,
            arguments.split,
            scenarios,
            arguments.out,
            arguments.duration,
            options,
            report=lambda note: bar.update(note=note),
        )
    print(f"{'scenario':>8} {'cost':>8} {'predicted':>9} {'position':>9} {'effort':>9} {'contact':>8}  converged")
    for k, number in enumerate(found.scenarios):
        raw = [values[k] for values in found.terms.values()]
        print(
            f"{number:8} {found.cost[k]:8.4f} {found.predicted_cost[k]:9.4f} {raw[0]:9.2f} {raw[1]:9.4g} "
            f"{raw[2]:8.4f}  {'yes' if found.success[k] else 'no'}"
        )
    print(f"mean cost {found.cost.mean():.4f} (deg2 s, deg2/s, N2 m2 s)")


if __name__ == "__main__":
    main()
