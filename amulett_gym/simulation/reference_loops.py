"""An independent, slow second model of the loops of the literature, to check the kernel.

:func:`replay_loop` is plain Python: from the recorded sensor readings to the expected commands, as
:func:`amulett_gym.simulation.reference.replay_control` is for the paper's loop. It shares only the profile, and the
knots of the spring tables, with the kernel: springs are inverted by root finding, and reference motions are the
polynomials that meet their boundary conditions, found by linear algebra.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import brentq

from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import Control, slider_end
from amulett_gym.simulation.reference import arm, decay_rate, string_force
from amulett_gym.simulation.trajectory import Trajectory

Pair = tuple[float, float]


def replay_loop(
    profile: Profile, trajectory: Trajectory, control: Control, late: NDArray[np.bool_] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Return the expected commands for the recorded sensor readings.

    Parameters
    ----------
    profile : Profile
    trajectory : Trajectory
        Source of setpoint with its jumps, measured angle and deflections, estimated forces and tension setpoint of
        every tick, and of the first row's angle and commands.
    control : str
        One of `layout.LOOPS`.
    late : ndarray of bool, shape (ticks,), optional
        Missed control ticks: the commands are held and the loop not updated.

    Returns
    -------
    dict of str to ndarray, shape (ticks + 1,)
        ``command_biceps``, ``command_triceps`` [rad].
    """
    period, gains = profile.loop.control_period, getattr(profile.loops, control.replace("-", "_"))
    limit = math.inf if profile.drives.command_limit_deg is None else math.radians(profile.drives.command_limit_deg)
    device = Device(profile)
    command = float(trajectory["command_biceps"][0]), float(trajectory["command_triceps"][0])
    start = float(trajectory["angle"][0])
    motion = ReferenceMotion(gains.reference, gains.reference_time, start)
    joint_rate = Rate(getattr(gains, "velocity_filter", 0.0), float(trajectory["measured_angle"][0]))
    loop = _LOOPS[control](device, gains)

    def reading(row: int, tension: float, motion_now: tuple[float, float, float], velocity: float) -> Reading:
        signals = {name: float(trajectory[name][row]) for name in _SIGNALS}
        return Reading(*motion_now, velocity, tension, command, drives, period, limit, **signals)

    drives = command
    wanted = loop.wants(reading(0, float(trajectory["tension_setpoint"][0]), (start, 0.0, 0.0), 0.0))
    trim = command[0] - wanted[0], command[1] - wanted[1]
    loop = _LOOPS[control](device, gains)
    rows, last = [command], -1
    for row in range(len(trajectory) - 1):
        if late is None or not late[row]:
            elapsed, last = (row - last) * period, row
            jump = float(trajectory["setpoint_jump"][row])
            moved = motion.update(row * period, elapsed, float(trajectory["setpoint"][row]), jump)
            velocity = joint_rate.update(float(trajectory["measured_angle"][row]), elapsed)
            wanted = loop.wants(reading(row, float(trajectory["tension_setpoint"][row + 1]), moved, velocity))
            biceps, triceps = (min(max(w + t, -limit), limit) for w, t in zip(wanted, trim, strict=True))
            command = biceps, triceps
        drives = device.turn(drives[0], command[0]), device.turn(drives[1], command[1])
        rows.append(command)
    return dict(zip(("command_biceps", "command_triceps"), np.array(rows).T, strict=True))


_SIGNALS = ("measured_angle", "measured_biceps", "measured_triceps", "estimate_biceps", "estimate_triceps")


@dataclass(frozen=True)
class Reading:
    """What a loop reads in a tick: SI units and radians; pairs are of biceps and triceps."""

    reference: float
    reference_rate: float
    reference_acceleration: float
    velocity: float  # estimated
    tension: float
    command: Pair  # the last one
    drives: Pair  # by the drives' model
    period: float
    limit: float
    measured_angle: float
    measured_biceps: float
    measured_triceps: float
    estimate_biceps: float
    estimate_triceps: float

    @property
    def may_rise(self) -> bool:
        """Whether no command is at its upper limit."""
        return max(self.command) < self.limit

    @property
    def may_fall(self) -> bool:
        """Whether no command is at its lower limit."""
        return min(self.command) > -self.limit


class Device:
    """What a loop knows of its device: the profile, not the scenario."""

    def __init__(self, profile: Profile) -> None:
        tables = build_tables(profile.spring)
        self.profile, self.force = profile, string_force(profile)
        self.end, self.max_force = tables.max_deflection, tables.max_force
        knots = np.append(tables.force[:, 0], tables.max_force)
        self.slope = PchipInterpolator(np.linspace(0.0, self.end, knots.size), knots).derivative()
        self.slider_end = slider_end(profile, tables.max_spring_deflection)
        self.drive_radius, self.joint_radius = profile.plant.drive_pulley_radius, profile.plant.joint_pulley_radius
        self.inertia, self.weight = arm(profile)
        fastest = profile.drives.rate_limit_deg
        self.most = math.inf if fastest is None else math.radians(fastest) * profile.loop.control_period
        lag = profile.drives.lag
        self.share = 1.0 if lag == 0.0 else 1.0 - math.exp(-profile.loop.control_period / lag)

    def deflection(self, force: float) -> float:
        """Return the string deflection [m] at a force [N], limited to what the springs give."""
        if force <= 0.0:
            return 0.0
        if force >= self.max_force:
            return self.end
        return float(brentq(lambda stretch: self.force(stretch) - force, 0.0, self.end, xtol=1e-16, rtol=1e-14))

    def hold(self, angle: float, torque: float, tension: float) -> Pair:
        """Return the drive angles [rad] that hold an angle with a torque, the antagonist with a tension."""
        pull = min(max(tension, 0.0) + abs(torque) / self.joint_radius, self.max_force)
        stretch, other = self.deflection(pull), self.deflection(tension)
        biceps, triceps = (stretch, other) if torque >= 0.0 else (other, stretch)
        wound = angle * self.joint_radius
        return (wound + biceps) / self.drive_radius, (wound - triceps) / self.drive_radius

    def hold_stiff(self, angle: float, torque: float, tension: float) -> tuple[float, float, float, float]:
        """Return the drive angles [rad] for an angle and a torque, the stiffness [N m/rad], the smaller force [N].

        The stiffness is that of the tension without a torque, as near as the strings can have it.
        """
        pull = min(abs(torque) / self.joint_radius, self.max_force)

        def stiffness(antagonist: float) -> float:
            stretches = self.deflection(antagonist), self.deflection(antagonist + pull)
            return self.joint_radius**2 * float(sum(self.slope(stretches)))

        wanted = 2.0 * self.joint_radius**2 * float(self.slope(self.deflection(tension)))
        low, high = 0.0, self.max_force - pull
        if stiffness(low) >= wanted:
            tension = low
        elif stiffness(high) <= wanted:
            tension = high
        else:
            tension = float(brentq(lambda force: stiffness(force) - wanted, low, high, xtol=1e-12))
        return *self.hold(angle, torque, tension), stiffness(tension), tension

    def stiffness(self, now: Reading) -> float:
        """Return the joint stiffness [N m/rad] by both sliders, for springs with the geometric model."""
        width = self.profile.spring.half_width
        longer = np.array([now.measured_biceps, now.measured_triceps]) + width
        stretches = np.minimum(np.sqrt(np.maximum(longer**2 - width**2, 0.0)), self.end)
        return self.joint_radius**2 * float(self.slope(stretches).sum())

    def torque(self, now: Reading, angle: float) -> float:
        """Return the torque [N m] that the reference motion needs at an angle [rad]."""
        friction = 2.0 * decay_rate(self.profile, now.tension) * now.reference_rate
        return self.inertia * (now.reference_acceleration + friction) + self.weight * math.sin(angle)

    def turn(self, angle: float, command: float) -> float:
        """Return a drive's angle [rad] after a control period by the model of lag and largest rate."""
        return angle + float(np.clip((command - angle) * self.share, -self.most, self.most))


class ReferenceMotion:
    """The setpoint, whose jumps become smooth motions."""

    def __init__(self, shape: str, duration: float, start: float) -> None:
        self.shape, self.duration, self.last, self.last_rate = shape, duration, start, 0.0
        self.begin, self.begun = 0.0, (0.0, 0.0, 0.0)
        self.polynomial = np.polynomial.Polynomial([0.0])

    def update(self, time: float, elapsed: float, setpoint: float, jump: float) -> tuple[float, float, float]:
        """Return reference, rate and acceleration [rad, rad/s, rad/s2]."""
        moved = setpoint - self.last - jump
        if abs(moved) > 100.0 * elapsed:
            jump, moved = jump + moved, 0.0
        if jump != 0.0:
            offset, rate, acceleration = self._offset(time)
            self.begin, self.begun = time, (offset - jump, rate, acceleration)
            self.polynomial = self._way_to_zero(*self.begun)
        setpoint_rate = moved / elapsed
        offset, rate, acceleration = self._offset(time)
        change = (setpoint_rate - self.last_rate) / elapsed
        self.last, self.last_rate = setpoint, setpoint_rate
        return setpoint + offset, setpoint_rate + rate, change + acceleration

    def _offset(self, time: float) -> tuple[float, float, float]:
        elapsed = time - self.begin
        if self.shape != "minimum-jerk":
            return self._filtered(elapsed)
        if elapsed >= self.duration:
            return 0.0, 0.0, 0.0
        first, second = self.polynomial.deriv(1), self.polynomial.deriv(2)
        return float(self.polynomial(elapsed)), float(first(elapsed)), float(second(elapsed))

    def _filtered(self, elapsed: float) -> tuple[float, float, float]:
        """Return a filter's free answer, by the exponential of its matrix, which has 2 % left at the duration."""
        if self.shape == "first-order":
            pace = brentq(lambda pace: math.exp(-pace * self.duration) - 0.02, 0.0, 100.0 / self.duration)
            left = self.begun[0] * math.exp(-pace * elapsed)
            return left, -pace * left, pace**2 * left
        pace = brentq(
            lambda p: (1.0 + p * self.duration) * math.exp(-p * self.duration) - 0.02, 0.0, 100 / self.duration
        )
        matrix = np.array([[0.0, 1.0], [-(pace**2), -2.0 * pace]])
        state = expm(matrix * elapsed) @ self.begun[:2]
        return float(state[0]), float(state[1]), float((matrix @ state)[1])

    def _way_to_zero(self, offset: float, rate: float, acceleration: float) -> np.polynomial.Polynomial:
        t, powers = self.duration, np.arange(6)
        ends = [
            t**powers,
            powers * t ** np.maximum(powers - 1, 0),
            powers * (powers - 1) * t ** np.maximum(powers - 2, 0),
        ]
        known = [offset, rate, acceleration / 2.0]
        rest = np.linalg.solve(np.array(ends)[:, 3:], -np.array(ends)[:, :3] @ known)
        return np.polynomial.Polynomial([*known, *rest])


class Rate:
    """The filtered rate of a signal."""

    def __init__(self, time_constant: float, value: float) -> None:
        self.time_constant, self.value, self.rate = time_constant, value, 0.0

    def update(self, value: float, elapsed: float) -> float:
        """Return the rate [1/s]: backward differences of a first-order filter."""
        weight = elapsed / (self.time_constant + elapsed)
        self.rate += weight * ((value - self.value) / elapsed - self.rate)
        self.value = value
        return self.rate


class Loop:
    """One loop of the literature."""

    def __init__(self, device: Device, gains: Any) -> None:
        self.device, self.gains = device, gains
        self.integral = 0.0

    def wants(self, now: Reading) -> Pair:
        """Return the drive angles [rad] that the loop wants."""
        raise NotImplementedError

    def equilibrium(self, now: Reading) -> Pair:
        """Return the drive angles [rad] that hold the led reference against the bare arm's weight."""
        angle = now.reference + self.gains.lead * now.reference_rate
        return self.device.hold(angle, self.device.weight * math.sin(now.reference), now.tension)

    def move(self, now: Reading, biceps: float, triceps: float) -> Pair:
        """Return the commands that bring the drives to given angles [rad], which move with the reference."""
        rate = now.reference_rate * self.device.joint_radius / self.device.drive_radius
        own, factor = np.array(now.drives), min(self.gains.factor, 1.0 / self.device.share)
        led = own + factor * (np.array([biceps, triceps]) - own) + self.gains.lead * rate
        return float(led[0]), float(led[1])

    def integrate(self, now: Reading, error: float, gain: float) -> float:
        """Return the integral term, which stops at the commands' limits."""
        if now.may_rise if error > 0.0 else now.may_fall:
            self.integral += gain * error * now.period
        return self.integral


class _EquilibriumPoint(Loop):
    def wants(self, now: Reading) -> Pair:
        return self.equilibrium(now)


class _CoRotation(Loop):
    def wants(self, now: Reading) -> Pair:
        error, gains = now.reference - now.measured_angle, self.gains
        turn = gains.kp * error + self.integrate(now, error, gains.ki)
        turn += gains.kd * (now.reference_rate - now.velocity)
        biceps, triceps = self.equilibrium(now)
        return biceps + turn, triceps + turn


class _TorqueStiffness(Loop):
    def wants(self, now: Reading) -> Pair:
        gains, device = self.gains, self.device
        chain = np.diag([1.0, 1.0], 1)
        by_torque = np.array([[0.0], [0.0], [1.0 / device.inertia]])
        weights = np.diag([max(gains.integral_weight, 1e-9), gains.angle_weight, gains.rate_weight])
        riccati = solve_continuous_are(chain, by_torque, weights, [[gains.torque_weight]])
        of_integral, of_angle, of_rate = (by_torque.T @ riccati)[0] / gains.torque_weight
        error, most = now.reference - now.measured_angle, device.max_force * device.joint_radius
        torque = device.torque(now, now.measured_angle) + of_angle * error
        torque += of_rate * (now.reference_rate - now.velocity)
        if abs(torque + self.integral) < most or (torque + self.integral) * error < 0.0:
            self.integrate(now, error, of_integral)
        return self.move(now, *device.hold_stiff(now.measured_angle, torque + self.integral, now.tension)[:2])


class _FeedforwardFeedback(Loop):
    def __init__(self, device: Device, gains: Any) -> None:
        super().__init__(device, gains)
        self.reference, self.error, self.stiffness_integral = math.nan, 0.0, 0.0

    def wants(self, now: Reading) -> Pair:
        gains, error = self.gains, now.reference - now.measured_angle
        turn = gains.kp * error + self.integrate(now, error, gains.ki)
        turn += gains.kd * (now.reference_rate - now.velocity)
        torque = self.device.torque(now, now.reference)
        biceps, triceps, stiffness, slackest = self.device.hold_stiff(now.reference, torque, now.tension)
        apart = self._apart(now, stiffness, slackest >= self.device.profile.sensors.force_floor)
        return self.move(now, biceps + turn + apart, triceps + turn - apart)

    def _apart(self, now: Reading, stiffness: float, measurable: bool) -> float:
        gains, last = self.gains, self.error
        if math.isnan(self.reference):
            self.reference = stiffness
        else:
            self.reference += (stiffness - self.reference) * now.period / (now.period + gains.lead)
        error = self.reference - self.device.stiffness(now) if measurable else 0.0
        self.error += (error - self.error) * now.period / (now.period + gains.stiffness_filter)
        seen = max(now.measured_biceps, now.measured_triceps) < self.device.slider_end
        if now.may_rise and now.may_fall and measurable and (seen or self.error < 0.0):
            self.stiffness_integral += gains.stiffness_ki * self.error * now.period
        rate = (self.error - last) / now.period
        return float(gains.stiffness_kp * self.error + self.stiffness_integral + gains.stiffness_kd * rate)


_LOOPS: dict[Control, Callable[[Device, Any], Loop]] = {
    "equilibrium-point": _EquilibriumPoint,
    "co-rotation": _CoRotation,
    "torque-stiffness": _TorqueStiffness,
    "feedforward-feedback": _FeedforwardFeedback,
}
