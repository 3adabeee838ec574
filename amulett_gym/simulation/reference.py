"""An independent, slow second model of the device, to check the kernel.

:func:`replay_motion` integrates plant and drives (eqs. 1-5) between control ticks with scipy, to tight tolerances;
:func:`replay_control` is section 2.2 in plain Python. Both take the recorded inputs from a trajectory and return the
expected outputs, so that the two halves of a loop are checked separately and do not amplify each other's rounding.
Only the profile and the knots of the springs' tables are shared with the kernel.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Pid, Profile, Spring
from amulett_gym.simulation.layout import Control, slider_end
from amulett_gym.simulation.trajectory import Trajectory

RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = (1e-12, 1e-10, 1e-11, 1e-11)  # joint [rad], its rate [rad/s], both drives [rad]


def string_force(profile: Profile) -> Callable[[float], float]:
    """Return f(Delta l) [N] over a string's deflection [m]: 0 in a slack string."""
    own, force = own_deflection(profile), spring_force(profile.spring)
    return lambda deflection: force(own(deflection))


def own_deflection(profile: Profile) -> Callable[[float], float]:
    """Return the deflection of a string's springs [m] over that of the string, which is also that of the structure."""
    if profile.structure is None:
        return lambda deflection: deflection
    force, stiffness = spring_force(profile.spring), profile.structure.stiffness

    def own(deflection: float) -> float:
        if deflection <= 0.0:
            return deflection
        return float(brentq(lambda y: y + force(y) / stiffness - deflection, 0.0, deflection, xtol=1e-15, rtol=1e-14))

    return own


def spring_force(spring: Spring) -> Callable[[float], float]:
    """Return the force of a string's springs [N] over their deflection [m]: 0 in a slack string."""
    tables = build_tables(spring)
    knots = np.append(tables.force[:, 0], tables.max_force)
    curve = _one_by_one(PchipInterpolator(np.linspace(0.0, tables.max_deflection, knots.size), knots))
    end, most = tables.max_deflection, float(knots[-1])

    further = _beyond(spring)

    def force(deflection: float) -> float:
        if deflection <= 0.0:
            return 0.0
        return curve(deflection) if deflection < end else most + further(deflection) - further(end)

    return force


def _one_by_one(curve: PchipInterpolator) -> Callable[[float], float]:
    """Return an interpolator's values within its knots, the same bits: scipy takes eight times as long for one."""
    knots, pieces = curve.x.tolist(), curve.c.T.tolist()

    def value(place: float) -> float:
        piece = min(max(bisect_right(knots, place) - 1, 0), len(pieces) - 1)
        cubic, square, linear, constant = pieces[piece]
        beyond = place - knots[piece]
        squared = beyond * beyond
        return constant + linear * beyond + square * squared + cubic * (squared * beyond)

    return value


def _beyond(spring: Spring) -> Callable[[float], float]:
    """Return a function whose rise from the table's end on is that of the force [N], over the deflection [m].

    A measured curve continues with its last slope.
    """
    if spring.beyond is None:
        return lambda _: 0.0
    if spring.stop_stiffness is not None:
        stop = spring.stop_stiffness
        return lambda y: stop * y
    if spring.measured_curve is None:  # two linear springs, anchored half_width beside the string

        def pull(y: float) -> float:
            length = math.hypot(spring.half_width, y)
            return 2 * spring.stiffness * (length - spring.free_length) * y / length

        return pull
    curve = spring.measured_curve
    first = [0.0] if curve.deflection_m[0] > 0.0 else []
    slope = float(PchipInterpolator([*first, *curve.deflection_m], [*first, *curve.force_N])(curve.deflection_m[-1], 1))
    return lambda y: slope * y


def decay_rate(profile: Profile, preload: float) -> float:
    """Return delta [1/s] of Figure 3 at a preload [N], in the form that the profile names."""
    fit = profile.damping
    exponent = fit.b * (preload + fit.c) if fit.fit == "shifted" else fit.b * preload + fit.c
    return max(fit.a * math.exp(exponent) + fit.d, 0.0)


def arm(
    profile: Profile, payload_mass: float = 0.0, payload_arm: float = 0.0, orientation: str = "profile"
) -> tuple[float, float]:
    """Return J of eq. 3 [kg m2] and M_m of eq. 2 [N m] of the arm with a payload."""
    masses = np.array([item.mass for item in profile.plant.masses])
    arms = np.array([item.arm for item in profile.plant.masses])
    if payload_mass > 0.0:
        masses, arms = np.append(masses, payload_mass), np.append(arms, payload_arm)
    plane = profile.plant.orientation if orientation == "profile" else orientation
    weight = 9.81 * float(masses @ arms) if plane == "vertical" else 0.0
    return float(masses.sum() * arms.max() ** 2 / 12 + masses @ arms**2), weight


def replay_motion(
    profile: Profile, scenario: NDArray[np.void] | np.void, trajectory: Trajectory
) -> dict[str, NDArray[np.float64]]:
    """Return the expected motion of the arm under the recorded commands.

    Parameters
    ----------
    profile : Profile
    scenario : record of `layout.SCENARIO`
    trajectory : Trajectory
        Source of the first row's angles, the commands of every tick and, with a random torque, the push torque.

    Returns
    -------
    dict of str to ndarray, shape (ticks + 1,)
        ``angle``, ``drive_biceps``, ``drive_triceps`` [rad], ``velocity`` [rad/s], ``force_biceps``,
        ``force_triceps`` [N], ``push_torque`` and ``contact_torque`` [N m].

    Raises
    ------
    ArithmeticError
        If scipy cannot integrate to the tolerances.
    """
    period, lag = profile.loop.control_period, profile.drives.lag
    to_biceps, to_triceps = (
        profile.plant.drive_pulley_radius * float(scenario[f"pulley_{name}_factor"]) for name in ("biceps", "triceps")
    )
    stronger_biceps, stronger_triceps = (float(scenario[f"spring_{name}_factor"]) for name in ("biceps", "triceps"))
    to_joint = profile.plant.joint_pulley_radius
    fastest = math.inf if profile.drives.rate_limit_deg is None else math.radians(profile.drives.rate_limit_deg)
    bare, _ = arm(profile)
    plane = ("profile", "horizontal", "vertical")[int(scenario["orientation"])]
    inertia, weight = arm(profile, float(scenario["payload_mass"]), float(scenario["payload_arm"]), plane)
    inertia *= float(scenario["inertia_factor"])
    friction_inertia = (bare if profile.damping.keeps == "torque" else inertia) * float(scenario["damping_factor"])
    force = string_force(profile)
    stall = math.inf if profile.drives.stall_torque is None else profile.drives.stall_torque
    wall = {name: float(scenario[f"obstacle_{name}"]) for name in ("angle", "side", "stiffness", "damping")}

    def forces(state: NDArray[np.float64]) -> tuple[float, float]:
        joint, _, biceps, triceps = state
        pull_biceps = stronger_biceps * force(biceps * to_biceps - joint * to_joint)
        pull_triceps = stronger_triceps * force(joint * to_joint - triceps * to_triceps)
        if lag > 0.0:
            return pull_biceps, pull_triceps
        return min(pull_biceps, stall / to_biceps), min(pull_triceps, stall / to_triceps)

    def slipped(state: NDArray[np.float64]) -> tuple[float, float]:
        """Return the angles at which drives without a lag are: they give way to more than the stall torque."""
        joint, _, biceps, triceps = state
        most_biceps, most_triceps = stall / to_biceps / stronger_biceps, stall / to_triceps / stronger_triceps
        stretch_biceps, stretch_triceps = biceps * to_biceps - joint * to_joint, joint * to_joint - triceps * to_triceps
        if force(stretch_biceps) > most_biceps:
            biceps -= (stretch_biceps - _deflection(force, most_biceps, stretch_biceps)) / to_biceps
        if force(stretch_triceps) > most_triceps:
            triceps += (stretch_triceps - _deflection(force, most_triceps, stretch_triceps)) / to_triceps
        return biceps, triceps

    def contact(joint: float, velocity: float) -> float:
        depth = (joint - wall["angle"]) * wall["side"]
        if depth <= 0.0 or wall["stiffness"] == 0.0:
            return 0.0
        resistance = wall["stiffness"] * depth + wall["damping"] * velocity * wall["side"]
        return -max(resistance, 0.0) * wall["side"]

    def derivative(
        _: float, state: NDArray[np.float64], biceps_command: float, triceps_command: float, push: float
    ) -> tuple[float, float, float, float]:
        joint, velocity, biceps, triceps = state
        pull_biceps, pull_triceps = forces(state)
        preload = min(pull_biceps, pull_triceps)
        if profile.damping.preload == "mean":
            preload = (pull_biceps + pull_triceps) / 2
        friction = 2 * decay_rate(profile, preload) * friction_inertia * velocity
        torque = (pull_biceps - pull_triceps) * to_joint - weight * math.sin(joint) - friction
        torque += push + contact(joint, velocity)
        turn_biceps = turn_triceps = 0.0
        if lag > 0.0:
            # Under load a drive winds its string more slowly, by the straight line to the stall torque and beyond.
            left_biceps, left_triceps = 1.0 - pull_biceps * to_biceps / stall, 1.0 - pull_triceps * to_triceps / stall
            turn_biceps = max(min((biceps_command - biceps) / lag, fastest * left_biceps), -fastest)
            turn_triceps = min(max((triceps_command - triceps) / lag, -fastest * left_triceps), fastest)
        return velocity, torque / inertia, turn_biceps, turn_triceps

    names = ("angle", "velocity", "drive_biceps", "drive_triceps")
    state = np.array([trajectory[name][0] for name in names])
    rows = [(*state, *forces(state), 0.0, contact(state[0], state[1]))]
    for tick in range(len(trajectory) - 1):
        commands = float(trajectory["command_biceps"][tick + 1]), float(trajectory["command_triceps"][tick + 1])
        push = push_torque(scenario, tick, period)
        if scenario["shake_rms"] > 0.0:
            push = float(trajectory["push_torque"][tick + 1])
        if lag == 0.0:
            state[2:] = commands
        # Short steps, since springs, friction and obstacle have kinks.
        tolerances = {"rtol": RELATIVE_TOLERANCE, "atol": ABSOLUTE_TOLERANCE, "max_step": min(period / 2, 1e-3)}
        solution = solve_ivp(derivative, (0.0, period), state, "DOP853", args=(*commands, push), **tolerances)
        if not solution.success:
            raise ArithmeticError(f"tick {tick}: {solution.message}")
        state = solution.y[:, -1]
        if lag == 0.0:
            state[2:] = slipped(state)
        rows.append((*state, *forces(state), push, contact(state[0], state[1])))
    columns = (*names, "force_biceps", "force_triceps", "push_torque", "contact_torque")
    return dict(zip(columns, np.array(rows).T, strict=True))


def _deflection(force: Callable[[float], float], wanted: float, beyond: float) -> float:
    """Return the string deflection [m], less than `beyond`, at which a string has a force [N]."""
    return float(brentq(lambda stretch: force(stretch) - wanted, 0.0, beyond, xtol=1e-16, rtol=1e-14))


def replay_control(
    profile: Profile, trajectory: Trajectory, control: Control = "decentralized", late: NDArray[np.bool_] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Return the expected commands for the recorded sensor readings.

    Parameters
    ----------
    profile : Profile
    trajectory : Trajectory
        Source of setpoint, measured angle and deflections, estimated forces and tension setpoint of every tick, and of
        the first row's commands, agonist and memory of the tension controller.
    control : {"decentralized", "position-only"}
    late : ndarray of bool, shape (ticks,), optional
        Missed control ticks: the commands are held and the controllers not updated.

    Returns
    -------
    dict of str to ndarray, shape (ticks + 1,)
        ``command_biceps``, ``command_triceps`` [rad] and ``agonist``.
    """
    loop, period = profile.loop, profile.loop.control_period
    limit = math.inf if profile.drives.command_limit_deg is None else math.radians(profile.drives.command_limit_deg)
    sensor_end = slider_end(profile, build_tables(profile.spring).max_spring_deflection)
    other = {"biceps": "triceps", "triceps": "biceps"}
    pulls = {"biceps": 1.0, "triceps": -1.0}  # sense in which a drive tightens its string
    leader = "biceps" if trajectory["agonist"][0] > 0 else "triceps"
    command = {name: float(trajectory[f"command_{name}"][0]) for name in other}
    gains = loop.position if control == "decentralized" else loop.position_only
    position = _Pid(gains, period, 1.0, float(trajectory["position_signal"][0]))
    tension = _Pid(loop.tension, period, math.radians(1.0), float(trajectory["tension_signal"][0]))
    share = 1.0 if loop.wiring == "sum" else 0.0
    tension.integral = float(trajectory["tension_integral"][0])
    position.integral = command[leader]
    offset = {leader: 0.0, other[leader]: command[other[leader]] - share * position.integral}
    if control == "position-only":
        offset = {name: pulls[name] * math.radians(loop.offset_deg) for name in other}
        position.integral = command["biceps"] - offset["biceps"]
    last_output = position.integral
    difference = float(trajectory["measured_difference"][0])
    weight = period / (loop.switch_filter + period)
    rows = [(command["biceps"], command["triceps"], pulls[leader])]
    for row in range(len(trajectory) - 1):
        error = float(trajectory["setpoint"][row] - trajectory["measured_angle"][row])
        stretch = {name: float(trajectory[f"measured_{name}"][row]) for name in other}
        if row > 0:
            difference += weight * (stretch["biceps"] - stretch["triceps"] - difference)
        if late is not None and late[row]:
            rows.append((command["biceps"], command["triceps"], pulls[leader]))
            continue
        before = leader
        leader = _leader(profile, leader, difference, error)
        follower = other[leader]
        room = command[leader] < limit, command[leader] > -limit
        output = position.update(error, -float(trajectory["measured_angle"][row]), *room)
        if control == "position-only":
            command = {name: min(max(offset[name] + output, -limit), limit) for name in other}
            rows.append((command["biceps"], command["triceps"], pulls[leader]))
            continue
        estimate = float(trajectory[f"estimate_{follower}"][row])
        untrusted = bool(trajectory[f"untrusted_{follower}"][row])
        lack = float(trajectory["tension_setpoint"][row + 1]) - estimate
        if untrusted and profile.sensors.below_floor == "ignore":
            lack = 0.0
        if leader == before:
            wound = command[follower] * pulls[follower]
            room = wound < limit and stretch[follower] < sensor_end, wound > -limit and not untrusted
            pull = tension.update(lack, -estimate, *room)
        else:
            # Both drives continue from their angles: the tension controller restarts with output zero.
            pull = 0.0
            tension.restart(lack, -estimate)
            shares = {leader: 1.0, follower: share}
            offset = {name: command[name] - shares[name] * last_output for name in other}
        command[leader] = offset[leader] + output
        command[follower] = offset[follower] + share * output + pulls[follower] * pull
        command = {name: min(max(angle, -limit), limit) for name, angle in command.items()}
        last_output = output
        rows.append((command["biceps"], command["triceps"], pulls[leader]))
    return dict(zip(("command_biceps", "command_triceps", "agonist"), np.array(rows).T, strict=True))


def replay_setpoint(scenario: Mapping[str, Any], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the setpoint [rad] of a scenario at times [s], shape (N,): of its moves or samples, without the wave.

    `scenario` is the content of a `tasks.scenario.Scenario`. Times of samples and moves may be off by rounding.
    """
    begun = times[:, None] + 1e-5
    start, angles = scenario["initial_angle_deg"], np.full(times.shape, scenario["initial_angle_deg"])
    samples = scenario["setpoint"]
    if samples is not None:
        sampled, values = np.array(samples["time"]), np.array(samples["angle_deg"])
        last = (begun >= sampled).sum(axis=1) - 1
        following = np.minimum(last + 1, sampled.size - 1)
        share = np.zeros(times.shape)
        if samples["interpolation"] == "linear":
            width = sampled[following] - sampled[last]
            share = np.divide(times - sampled[last], width, out=share, where=width > 0.0)
        share = np.clip(share, 0.0, 1.0)
        path = values[last] + share * (values[following] - values[last])
        return np.radians(np.where(last < 0, start, path))
    for move in scenario["moves"]:
        elapsed = times - move["time"]
        share = np.clip(elapsed / move["duration"], 0.0, 1.0) if move["duration"] > 0.0 else np.ones(times.shape)
        bell = 30 * (np.linspace(0, 1, 2001) * (1 - np.linspace(0, 1, 2001))) ** 2  # minimum jerk's velocity
        way = np.interp(share, np.linspace(0, 1, 2001), np.append(0.0, np.cumsum((bell[1:] + bell[:-1]) / 4000)))
        angles = np.where(elapsed >= -1e-5, start + (move["angle_deg"] - start) * way, angles)
        start = move["angle_deg"]
    return np.radians(angles)


class _Pid:
    """One PID controller: K_p e + K_i integral e + K_d s/(filter s + 1) e, discretised by backward differences."""

    def __init__(self, gains: Pid, period: float, unit: float, signal: float) -> None:
        self.gains, self.period, self.unit, self.signal = gains, period, unit, signal
        self.integral = self.slope = 0.0

    def update(self, error: float, minus_measurement: float, may_rise: bool, may_fall: bool) -> float:
        """Return the output for one tick."""
        signal = error if self.gains.derivative_on == "error" else minus_measurement
        weight = self.period / (self.gains.derivative_filter + self.period)
        self.slope += weight * ((signal - self.signal) / self.period - self.slope)
        self.signal = signal
        if may_rise if error > 0.0 else may_fall:
            self.integral += self.unit * self.gains.ki * self.period * error
        return self.unit * (self.gains.kp * error + self.gains.kd * self.slope) + self.integral

    def restart(self, error: float, minus_measurement: float) -> None:
        """Reset the memory so that the output is zero at this error."""
        self.signal = error if self.gains.derivative_on == "error" else minus_measurement
        self.slope = 0.0
        self.integral = -self.unit * self.gains.kp * error


def _leader(profile: Profile, leader: str, difference: float, error: float) -> str:
    """Return the agonist: the drive of the more deflected spring, on a tie that of the desired motion (section 2.2)."""
    loop = profile.loop
    if loop.agonist != "switching":
        return loop.agonist
    if abs(difference) > loop.switch_hysteresis:
        return "biceps" if difference > 0 else "triceps"
    wanted = abs(error) >= math.radians(loop.tie_error_deg) and error != 0.0
    if wanted and abs(difference) <= loop.tie_width:
        return "biceps" if error > 0 else "triceps"
    return leader


def push_torque(scenario: NDArray[np.void] | np.void, tick: int, period: float) -> float:
    """Return the sum of the pushes [N m] that act in a tick: begun at its start and not yet over."""
    total = 0.0
    for push in range(int(scenario["push_count"])):
        since = tick * period - float(scenario["push_time"][push])
        left = float(scenario["push_duration"][push]) - since
        if since >= -1e-5 and left > 1e-5:  # times are 32-bit floats
            slope = float(scenario["push_inverse_rise"][push])
            share = min(max(min(since, left), 0.0) * slope, 1.0) if slope > 0.0 else 1.0
            total += share * float(scenario["push_torque"][push])
    return total
