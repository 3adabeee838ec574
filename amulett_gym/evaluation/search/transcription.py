"""The optimal control problem of full control as a nonlinear program: direct multiple shooting, solved by IPOPT.

Time is divided into intervals of whole control ticks. In each, both commands are constant, so that the drives' motion
(a first-order lag) and its eq. 8 are closed forms; the joint is integrated by the classical Runge-Kutta method on
shorter steps. The states between two intervals are variables and their continuity a constraint (Betts, Practical
Methods for Optimal Control, 2010; Kelly, SIAM Review 59, 2017). A drive at its rate limit is a constraint as well:
|command - angle| <= lag times rate limit when an interval begins, after which the difference only falls. Ideal drives
(no lag) reach their command on a straight line within the interval.

The cost is summed over control ticks as in the simulation, with the joint between two steps by cubic Hermite
interpolation. Kinks of the model are rounded, by widths that hardly change the motion: slack and saturated strings, the
damping's clip at zero, the obstacle's surface. The springs' table is replaced by a polynomial.

This needs CasADi, the extra ``optimal``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError, install_extra
from amulett_gym.model.spring import SpringTables, build_tables
from amulett_gym.profile import Profile

Values = NDArray[np.float64]

STEP = 5e-3
"""Longest Runge-Kutta step [s]."""

DEGREE = 9
"""Degree of the polynomial that replaces the springs' table."""

ROUNDED_STRETCH = 4e-3
"""Width over which slack and saturated strings are rounded, as a share of the table's range."""
ROUNDED_DECAY = 0.2
"""Width over which the damping's clip at zero is rounded [1/s]."""
ROUNDED_SURFACE = 1e-3
"""Width over which the obstacle's surface is rounded [rad]."""
ROUNDED_PRESS = 1e-3
"""Width over which the obstacle's clip at zero torque is rounded [N m]."""

SOLVER = {
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "max_iter": 200,
        "tol": 1e-6,
        "mu_strategy": "adaptive",
        # Kinks stall the last digits: the cost no longer changes by 1e-5 of it, and states meet within 1e-4 rad.
        "acceptable_tol": 1e-3,
        "acceptable_constr_viol_tol": 1e-4,
        "acceptable_obj_change_tol": 1e-5,
        "acceptable_iter": 8,
    },
    "print_time": False,
}
"""Options of CasADi's `nlpsol` with IPOPT."""


def load_casadi() -> ModuleType:
    """Return CasADi; raise an AmulettError that says how to install it."""
    try:
        import casadi
    except ImportError as error:
        raise AmulettError(f"the optimal control needs CasADi: {install_extra('optimal')}") from error
    return casadi


def spring_polynomial(tables: SpringTables) -> tuple[Values, float]:
    """Return coefficients of the string force over a deflection from 0 to 1, and their largest error [N].

    The force is w times the polynomial of the coefficients (constant first), so that a slack string has none.
    """
    share = np.linspace(0.0, 1.0, 1025)
    force = np.array([tables.force_at(part * tables.max_deflection) for part in share])
    powers = share[:, None] ** np.arange(1, DEGREE + 1)
    fitted = np.polynomial.Chebyshev.fit(share[1:], force[1:] / share[1:], DEGREE - 1, domain=[0, 1], w=share[1:])
    polynomial = fitted.convert(kind=np.polynomial.Polynomial, domain=[-1, 1])
    coefficients: Values = np.asarray(polynomial.coef, dtype=np.float64)
    return coefficients, float(np.abs(powers @ coefficients - force).max())


@dataclass(frozen=True)
class Plan:
    """The part of an episode that is optimised at once.

    Attributes
    ----------
    ticks : ndarray of int, shape (N + 1,)
        Control ticks at which the N intervals begin, and the last one's end.
    setpoint, torque : ndarray, shape (ticks,)
        Setpoint [rad] and external torque [N m] of every tick from the first of `ticks` on.
    start : ndarray, shape (4,)
        Joint angle [rad], its rate [rad/s] and both drives' angles [rad] at the begin.
    """

    ticks: NDArray[np.int64]
    setpoint: Values
    torque: Values
    start: Values


@dataclass(frozen=True)
class Solution:
    """States, shape (4, N + 1), and commands, shape (2, N), of a plan.

    `terms` are the `evaluation.metrics.CONTROL_TERMS` of each interval, shape (3, N), in rad2 s, rad2/s and N2 m2 s.
    """

    states: Values
    commands: Values
    terms: Values
    cost: float
    success: bool
    status: str
    iterations: int


class Transcription:
    """The nonlinear programs of one device in one scenario.

    Parameters
    ----------
    profile : Profile
    row : record of `simulation.layout.SCENARIO`
    prices : ndarray, shape (3,)
        Costs per rad2 s, rad2/s and N2 m2 s.
    saturates : bool
        Whether strings may be stretched beyond the end of the springs' table when an interval ends.

    Raises
    ------
    AmulettError
        If CasADi is missing.
    """

    def __init__(self, profile: Profile, row: np.void, prices: Values, saturates: bool = False) -> None:
        self._ca: Any = load_casadi()
        self._profile, self._row, self._prices, self._saturates = profile, row, prices, saturates
        self._tables = build_tables(profile.spring)
        self._intervals: dict[int, Any] = {}
        limit, fastest = profile.drives.command_limit_deg, profile.drives.rate_limit_deg
        self._command_limit = np.inf if limit is None else np.radians(limit)
        self._rate_limit = np.inf if fastest is None else np.radians(fastest)

    def solve(self, plan: Plan, guesses: Sequence[tuple[Values, Values]]) -> Solution:
        """Return the best local optimum from first guesses of states, shape (4, N + 1), and commands, shape (2, N)."""
        ca, count = self._ca, plan.ticks.size - 1
        states, commands = ca.MX.sym("states", 4, count + 1), ca.MX.sym("commands", 2, count)
        lengths = np.diff(plan.ticks)
        objective, constraints, groups = 0.0, [], []
        for length in np.unique(lengths):
            which = np.flatnonzero(lengths == length)
            ticks = (plan.ticks[which] - plan.ticks[0])[:, None] + np.arange(length)
            interval = self._interval(int(length)).map(which.size)
            given = plan.setpoint[ticks].T, plan.torque[ticks].T
            columns, following = which.tolist(), (which + 1).tolist()
            end, costs = interval(states[:, columns], commands[:, columns], *given)
            constraints.append(ca.vec(end - states[:, following]))
            objective += ca.sum2(ca.mtimes(ca.DM(self._prices).T, costs))
            groups.append((which, interval, given))
        rows = sum(part.numel() for part in constraints)
        low, high = np.zeros(rows), np.zeros(rows)
        for limited, lowest, highest in self._limits(states, commands, lengths):
            constraints.append(ca.vec(limited))
            low, high = np.append(low, np.full(limited.numel(), lowest)), np.append(high, highest)
        problem = {"x": ca.veccat(states, commands), "f": objective, "g": ca.vertcat(*constraints)}
        solver = ca.nlpsol("optimal", "ipopt", problem, SOLVER)
        bounds = self._bounds(count)
        fixed = {"lbx": np.append(plan.start, -bounds[4:]), "ubx": np.append(plan.start, bounds[4:])}
        solutions, split = [], states.numel()
        for guess in guesses:
            flat = np.concatenate([part.T.reshape(-1) for part in guess])
            found = solver(x0=np.clip(flat, -bounds, bounds), lbg=low, ubg=high, **fixed)
            best = np.array(found["x"]).reshape(-1)
            best_states, best_commands = best[:split].reshape(-1, 4).T, best[split:].reshape(-1, 2).T
            terms = np.zeros((3, count))
            for which, interval, given in groups:
                terms[:, which] = np.array(interval(best_states[:, which], best_commands[:, which], *given)[1])
            stats, cost = solver.stats(), float(found["f"])
            status = bool(stats["success"]), stats["return_status"], stats["iter_count"]
            solutions.append(Solution(best_states, best_commands, terms, cost, *status))
        return min(solutions, key=lambda solution: (not solution.success, solution.cost))

    def _limits(self, states: Any, commands: Any, lengths: NDArray[np.int64]) -> list[tuple[Any, float, Values]]:
        """Return constrained quantities with their least value and their largest values: rates and deflections."""
        limits, count, lag = [], lengths.size, self._profile.drives.lag
        if np.isfinite(self._rate_limit):
            # Ideal drives take the whole interval for the way to their command.
            time = np.full(count, lag) if lag > 0.0 else lengths * self._profile.loop.control_period
            way = self._ca.vec((commands - states[2:, :count]) / self._ca.DM(np.tile(time, (2, 1))))
            limits.append((way, -self._rate_limit, np.full(2 * count, self._rate_limit)))
        if not self._saturates:
            joint, biceps, triceps = states[0, 1:], states[2, 1:], states[3, 1:]
            shares = [stretch / self._tables.max_deflection for stretch in self._stretches(joint, biceps, triceps)]
            limits.append((self._ca.horzcat(*shares), -np.inf, np.ones(2 * count)))
        return limits

    def _stretches(self, joint: Any, biceps: Any, triceps: Any) -> tuple[Any, Any]:
        """Return both strings' deflections [m] by eqs. 4 and 5."""
        plant, row = self._profile.plant, self._row
        wound_biceps = biceps * plant.drive_pulley_radius * float(row["pulley_biceps_factor"])
        wound_triceps = triceps * plant.drive_pulley_radius * float(row["pulley_triceps_factor"])
        return wound_biceps - joint * plant.joint_pulley_radius, joint * plant.joint_pulley_radius - wound_triceps

    def _bounds(self, count: int) -> Values:
        """Return the largest absolute values of all variables: the device's limits."""
        plant = self._profile.plant
        limits = [np.radians(plant.angle_limit_deg), np.radians(plant.velocity_limit_deg), np.inf, np.inf]
        return np.append(np.tile(limits, count + 1), np.full(2 * count, self._command_limit))

    def _interval(self, length: int) -> Any:
        """Return the function of an interval of some ticks.

        It maps state, commands, setpoints and torques of its ticks to the state at its end and the costs' terms.
        """
        if length in self._intervals:
            return self._intervals[length]
        ca, period, lag = self._ca, self._profile.loop.control_period, self._profile.drives.lag
        state, command = ca.SX.sym("state", 4), ca.SX.sym("command", 2)
        setpoint, torque = ca.SX.sym("setpoint", length), ca.SX.sym("torque", length)
        begin, whole = state[2:], length * period

        def drives(time: float) -> Any:
            """Return both drives' angles."""
            return command + (begin - command) * (np.exp(-time / lag) if lag > 0.0 else 1.0 - time / whole)

        move = ca.sumsqr(command - begin)
        effort = move * ((1.0 - np.exp(-2.0 * whole / lag)) / (2.0 * lag) if lag > 0.0 else 1.0 / whole)
        joint, rate = state[0], state[1]
        position = contact = ca.SX(0)
        most = max(int(STEP / period + 1e-9), 1)
        bounds = [*range(0, length, most), length]
        for first, end in pairwise(bounds):
            step, at = (end - first) * period, first * period
            external = ca.sum1(torque[first:end]) / (end - first)
            before, middle, after = drives(at), drives(at + step / 2), drives(at + step)
            k1 = self._acceleration(joint, rate, before, external)
            k2 = self._acceleration(joint + step / 2 * rate, rate + step / 2 * k1, middle, external)
            k3 = self._acceleration(joint + step / 2 * rate + step**2 / 4 * k1, rate + step / 2 * k2, middle, external)
            k4 = self._acceleration(joint + step * rate + step**2 / 2 * k2, rate + step * k3, after, external)
            new_joint = joint + step * rate + step**2 / 6 * (k1 + k2 + k3)
            new_rate = rate + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            angle = joint
            for tick in range(first, end):
                share = (tick + 1 - first) / (end - first)
                next_angle, next_rate = _hermite(share, step, joint, rate, new_joint, new_rate)
                error, next_error = setpoint[tick] - angle, setpoint[tick] - next_angle
                position += period / 2 * (error**2 + next_error**2)
                contact += period * self._contact_torque(next_angle, next_rate) ** 2
                angle = next_angle
            joint, rate = new_joint, new_rate
        ended = ca.vertcat(joint, rate, drives(whole))
        costs = ca.vertcat(position, effort, contact)
        names = ["state", "command", "setpoint", "torque"], ["end", "costs"]
        inputs = [state, command, setpoint, torque]
        self._intervals[length] = ca.Function(f"interval{length}", inputs, [ended, costs], *names)
        return self._intervals[length]

    @cached_property
    def _spring(self) -> Values:
        return spring_polynomial(self._tables)[0]

    def _force(self, deflection: Any) -> Any:
        """Return a string's force [N] over its deflection [m], rounded where it is slack and where it saturates."""
        share = deflection / self._tables.max_deflection
        share = self._positive(share, ROUNDED_STRETCH)
        share = 1.0 - self._positive(1.0 - share, ROUNDED_STRETCH)
        force = 0.0
        for coefficient in self._spring[::-1]:
            force = force * share + coefficient
        return force * share

    def _acceleration(self, joint: Any, rate: Any, drives: Any, external: Any) -> Any:
        """Return the joint's acceleration (eqs. 1-5) [rad/s2]."""
        ca, row, fit = self._ca, self._row, self._profile.damping
        stretches = self._stretches(joint, drives[0], drives[1])
        biceps, triceps = (
            float(row[f"spring_{name}_factor"]) * self._force(stretch)
            for name, stretch in zip(("biceps", "triceps"), stretches, strict=True)
        )
        preload = (biceps + triceps) / 2 if fit.preload == "mean" else ca.fmin(biceps, triceps)
        exponent = fit.b * (preload + fit.c) if fit.fit == "shifted" else fit.b * preload + fit.c
        decay = float(row["friction"]) * self._positive(fit.a * ca.exp(exponent) + fit.d, ROUNDED_DECAY)
        torque = (biceps - triceps) * self._profile.plant.joint_pulley_radius - float(row["static_torque"]) * ca.sin(
            joint
        )
        torque += external + self._contact_torque(joint, rate)
        return torque / float(row["inertia"]) - 2.0 * decay * rate

    def _contact_torque(self, joint: Any, rate: Any) -> Any:
        """Return the obstacle's torque [N m]."""
        ca, row = self._ca, self._row
        if row["obstacle_stiffness"] <= 0.0:
            return 0.0
        side = float(row["obstacle_side"])
        depth = side * (joint - float(row["obstacle_angle"]))
        inside = (1.0 + depth / ca.sqrt(depth**2 + ROUNDED_SURFACE**2)) / 2
        press = float(row["obstacle_stiffness"]) * depth + float(row["obstacle_damping"]) * side * rate
        return -side * inside * self._positive(press, ROUNDED_PRESS)

    def _positive(self, value: Any, width: float) -> Any:
        """Return max(value, 0), rounded."""
        return (value + self._ca.sqrt(value**2 + width**2)) / 2


def _hermite(share: float, step: float, joint: Any, rate: Any, next_joint: Any, next_rate: Any) -> tuple[Any, Any]:
    """Return angle and rate within a step by cubic Hermite interpolation, `share` of it done."""
    s = share
    if s == 1.0:
        return next_joint, next_rate
    way = next_joint - joint
    angle = joint + way * s**2 * (3 - 2 * s) + step * (rate * s * (1 - s) ** 2 - next_rate * s**2 * (1 - s))
    slope = way / step * 6 * s * (1 - s) + rate * (1 - 4 * s + 3 * s**2) + next_rate * (3 * s**2 - 2 * s)
    return angle, slope


def grid(breaks: Sequence[int], length: int) -> NDArray[np.int64]:
    """Return the ticks at which intervals begin, and the last end: at most `length` ticks each, and at all breaks."""
    parts = [np.arange(first, end, length) for first, end in pairwise(breaks)]
    return np.append(np.concatenate(parts), breaks[-1])
