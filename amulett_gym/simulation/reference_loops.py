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

from amulett_gym.gains import group_name
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import Control, slider_end
from amulett_gym.simulation.reference import arm, decay_rate, own_deflection, spring_force
from amulett_gym.simulation.trajectory import Trajectory

Pair = tuple[float, float]
Motion = tuple[float, float, float, float]


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
    period, gains = profile.loop.control_period, getattr(profile.loops, group_name(control))
    limit = math.inf if profile.drives.command_limit_deg is None else math.radians(profile.drives.command_limit_deg)
    device = Device(profile)
    command = float(trajectory["command_biceps"][0]), float(trajectory["command_triceps"][0])
    start = float(trajectory["angle"][0])
    fastest = device.max_force * device.joint_radius / device.inertia
    motion = ReferenceMotion(gains.reference, gains.reference_time, start, fastest)
    joint_rate = Rate(getattr(gains, "velocity_filter", 0.0), float(trajectory["measured_angle"][0]))
    loop = _LOOPS[control](device, gains)

    def reading(row: int, tension: float, motion_now: Motion, velocity: float) -> Reading:
        signals = {name: float(trajectory[name][row]) for name in _SIGNALS}
        return Reading(*motion_now, elapsed, velocity, tension, command, drives, period, limit, **signals)

    drives, elapsed = command, period
    trim = loop.begin(reading(0, float(trajectory["tension_setpoint"][0]), (start, 0.0, 0.0, 0.0), 0.0))
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


_SIGNALS = (
    *("measured_angle", "measured_biceps", "measured_triceps"),
    *("estimate_biceps", "estimate_triceps", "untrusted_biceps", "untrusted_triceps"),
)


@dataclass(frozen=True)
class Reading:
    """What a loop reads in a tick: SI units and radians; pairs are of biceps and triceps."""

    reference: float
    reference_rate: float
    reference_acceleration: float
    jump_jerk: float  # of what is left of the last jump
    elapsed: float  # since the last tick that was not late
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
    untrusted_biceps: float
    untrusted_triceps: float

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
        self.profile, self.force = profile, spring_force(profile.spring)
        self.own_deflection = own_deflection(profile)  # the device's, which the loop does not know
        self.slider_range = tables.max_spring_deflection
        self.end, self.max_force = tables.max_deflection, tables.max_force
        knots = np.append(tables.force[:, 0], tables.max_force)
        places = np.linspace(0.0, 1.0, knots.size)
        self.slope = PchipInterpolator(places * self.end, knots).derivative()
        self.slider_at = PchipInterpolator(
            places * self.end, np.append(tables.spring_deflection[:, 0], self.slider_range)
        )
        self.estimate = PchipInterpolator(places, np.append(tables.estimated_force[:, 0], self.max_force))
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

    def slider_force(self, stretch: float) -> float:
        """Return the string force [N] that the microcontroller's table gives for a slider's reading [m]."""
        return float(self.estimate(math.sqrt(min(max(stretch, 0.0) / self.slider_range, 1.0))))

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

    def affordable(self, torque: float, tension: float) -> float:
        """Return the tension [N], lowered as far as the torque needs it."""
        return float(np.clip(self.max_force - abs(torque) / self.joint_radius, 0.0, tension))

    def turn(self, angle: float, command: float) -> float:
        """Return a drive's angle [rad] after a control period by the model of lag and largest rate."""
        return angle + float(np.clip((command - angle) * self.share, -self.most, self.most))


class ReferenceMotion:
    """The setpoint, whose jumps become smooth motions."""

    def __init__(self, shape: str, duration: float, start: float, fastest: float) -> None:
        self.shape, self.duration, self.last, self.last_rate = shape, duration, start, 0.0
        self.fastest = fastest  # acceleration [rad/s2] that the springs can give the arm
        self.begin, self.begun = 0.0, (0.0, 0.0, 0.0)
        self.polynomial = np.polynomial.Polynomial([0.0])

    def update(self, time: float, elapsed: float, setpoint: float, jump: float) -> Motion:
        """Return reference, rate, acceleration, and the last jump's jerk [rad, s]."""
        moved = setpoint - self.last - jump
        if abs(moved) > 100.0 * elapsed:
            jump, moved = jump + moved, 0.0
        setpoint_rate = moved / elapsed
        change = (setpoint_rate - self.last_rate) / elapsed
        if abs(change) > self.fastest:
            change = 0.0
        if jump != 0.0:
            offset, rate, acceleration, _ = self._offset(time)
            self.begin, self.begun = time, (offset - jump, rate, acceleration)
            self.polynomial = self._way_to_zero(*self.begun)
        offset, rate, acceleration, jerk = self._offset(time)
        self.last, self.last_rate = setpoint, setpoint_rate
        return setpoint + offset, setpoint_rate + rate, change + acceleration, jerk

    def _offset(self, time: float) -> tuple[float, float, float, float]:
        elapsed = time - self.begin
        if self.shape != "minimum-jerk":
            return self._filtered(elapsed)
        if elapsed >= self.duration:
            return 0.0, 0.0, 0.0, 0.0
        offset, rate, acceleration, jerk = (float(self.polynomial.deriv(order)(elapsed)) for order in range(4))
        return offset, rate, acceleration, jerk

    def _filtered(self, elapsed: float) -> tuple[float, float, float, float]:
        """Return a filter's free answer, by the exponential of its matrix, which has 2 % left at the duration."""
        if self.shape == "first-order":
            pace = brentq(lambda pace: math.exp(-pace * self.duration) - 0.02, 0.0, 100.0 / self.duration)
            left = self.begun[0] * math.exp(-pace * elapsed)
            return left, -pace * left, pace**2 * left, -(pace**3) * left
        pace = brentq(
            lambda p: (1.0 + p * self.duration) * math.exp(-p * self.duration) - 0.02, 0.0, 100 / self.duration
        )
        matrix = np.array([[0.0, 1.0], [-(pace**2), -2.0 * pace]])
        state = expm(matrix * elapsed) @ self.begun[:2]
        return float(state[0]), float(state[1]), float((matrix @ state)[1]), float((matrix @ matrix @ state)[1])

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
        self.lead = getattr(gains, "lead", 0.0) * device.profile.drives.lag
        self.integral = 0.0

    def begin(self, now: Reading) -> Pair:
        """Return what is added to the drive angles that the loop wants [rad], so that it starts at rest."""
        wanted = type(self)(self.device, self.gains).wants(now)  # a twin, which has no memory yet
        return now.command[0] - wanted[0], now.command[1] - wanted[1]

    def wants(self, now: Reading) -> Pair:
        """Return the drive angles [rad] that the loop wants."""
        raise NotImplementedError

    def equilibrium(self, now: Reading) -> Pair:
        """Return the drive angles [rad] that hold the led reference against the bare arm's weight."""
        angle = now.reference + self.lead * now.reference_rate
        torque = self.device.weight * math.sin(now.reference)
        return self.device.hold(angle, torque, self.device.affordable(torque, now.tension))

    def move(self, now: Reading, biceps: float, triceps: float, joint_rate: float | None = None) -> Pair:
        """Return the commands that bring the drives to given angles [rad], which move with the reference, or a rate."""
        rate = (
            (now.reference_rate if joint_rate is None else joint_rate)
            * self.device.joint_radius
            / self.device.drive_radius
        )
        own, factor = np.array(now.drives), min(self.gains.factor, 1.0 / self.device.share)
        led = own + factor * (np.array([biceps, triceps]) - own) + self.lead * rate
        return float(led[0]), float(led[1])

    def integrate(self, now: Reading, error: float, gain: float) -> float:
        """Return the integral term, which stops at the commands' limits."""
        if now.may_rise if error > 0.0 else now.may_fall:
            self.integral += gain * error * now.period
        return self.integral

    def integrate_torque(self, now: Reading, error: float, gain: float) -> float:
        """Return the integral term, which stops also where the spring of the wound string is at its end."""
        wound = now.measured_biceps if error > 0.0 else now.measured_triceps
        return self.integrate(now, error, gain) if wound < self.device.slider_end else self.integral


class _EquilibriumPoint(Loop):
    def wants(self, now: Reading) -> Pair:
        return self.equilibrium(now)


class _CoRotation(Loop):
    def wants(self, now: Reading) -> Pair:
        error, gains = now.reference - now.measured_angle, self.gains
        turn = gains.kp * error + self.integrate_torque(now, error, gains.ki)
        turn += gains.kd * (now.reference_rate - now.velocity)
        biceps, triceps = self.equilibrium(now)
        return biceps + turn, triceps + turn


class _TorqueStiffness(Loop):
    def __init__(self, device: Device, gains: Any) -> None:
        super().__init__(device, gains)
        chain = np.diag([1.0, 1.0], 1)
        by_torque = np.array([[0.0], [0.0], [1.0 / device.inertia]])
        weights = np.diag([max(gains.integral_weight, 1e-9), gains.angle_weight, gains.rate_weight])
        riccati = solve_continuous_are(chain, by_torque, weights, [[gains.torque_weight]])
        self.feedback = (by_torque.T @ riccati)[0] / gains.torque_weight

    def wants(self, now: Reading) -> Pair:
        device, (of_integral, of_angle, of_rate) = self.device, self.feedback
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
        turn = gains.kp * error + self.integrate_torque(now, error, gains.ki)
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
            self.reference += (stiffness - self.reference) * now.period / (now.period + self.lead)
        error = self.reference - self.device.stiffness(now) if measurable else 0.0
        self.error += (error - self.error) * now.period / (now.period + gains.stiffness_filter)
        seen = max(now.measured_biceps, now.measured_triceps) < self.device.slider_end
        if now.may_rise and now.may_fall and measurable and (seen or self.error < 0.0):
            self.stiffness_integral += gains.stiffness_ki * self.error * now.period
        rate = (self.error - last) / now.period
        return float(gains.stiffness_kp * self.error + self.stiffness_integral + gains.stiffness_kd * rate)


class _Observing(Loop):
    """A loop that observes the joint's motion, the disturbance and both string forces."""

    def observe_start(self, now: Reading) -> None:
        """Set what is known at rest."""
        self.motion = np.array([now.reference, 0.0])
        stretches = [max(self.device.own_deflection(stretch), 0.0) for stretch in self.stretches(now)]
        sliders = [float(self.device.slider_at(stretch)) for stretch in stretches]
        self.forces = np.array([self.device.slider_force(slider) for slider in sliders])
        self.correction = np.array([self.device.deflection(force) for force in self.forces]) - self.stretches(now)
        self.disturbance, self.acceleration = -self.model_acceleration(), 0.0

    def stretches(self, now: Reading) -> NDArray[np.float64]:
        """Return both string deflections [m] by the model."""
        wound = self.device.joint_radius * self.motion[0]
        turned = self.device.drive_radius * np.array(now.drives)
        return np.array([turned[0] - wound, wound - turned[1]])

    def decay(self) -> float:
        """Return delta [1/s]."""
        profile = self.device.profile
        return decay_rate(profile, self.forces.mean() if profile.damping.preload == "mean" else self.forces.min())

    def model_acceleration(self) -> float:
        """Return the acceleration [rad/s2] by eq. 1."""
        device, (angle, velocity) = self.device, self.motion
        torque = device.joint_radius * (self.forces[0] - self.forces[1]) - device.weight * math.sin(angle)
        return float(torque / device.inertia - 2.0 * self.decay() * velocity)

    def observe(self, now: Reading) -> None:
        """Update all estimates."""
        h, kept = now.elapsed, 1.0 / (1.0 + self.gains.observer_bandwidth * now.elapsed)
        transition = np.array([[1.0, h, h * h / 2.0], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
        state = transition @ [*self.motion, self.acceleration]
        missed = now.measured_angle - state[0]
        gain = np.array([1.0 - kept**3, 1.5 * (1.0 - kept) ** 2 * (1.0 + kept) / h, (1.0 - kept) ** 3 / h**2])
        self.motion = state[:2] + gain[:2] * missed
        self.disturbance += gain[2] * missed
        self.stretched = self.stretches(now) + self.correction
        self.forces = np.array([self.device.force(stretch) for stretch in self.stretched])
        sliders = [self.device.slider_force(slider) for slider in (now.measured_biceps, now.measured_triceps)]
        self.correction += (sliders - self.forces) / self.slopes() * h / (self.gains.slider_time + h)
        self.acceleration = self.model_acceleration() + self.disturbance

    def slopes(self) -> NDArray[np.float64]:
        """Return both springs' slopes [N/m], limited from below."""
        least = self.gains.slope_floor * self.device.max_force / self.device.end
        within = (self.stretched >= 0.0) & (self.stretched <= self.device.end)
        return np.maximum(np.where(within, self.device.slope(self.stretched), 0.0), least)

    def saturated(self, now: Reading) -> tuple[bool, bool]:
        """Return whether each string is at its spring's end."""
        end = self.device.slider_end
        biceps, triceps = self.stretched >= self.device.end
        return bool(biceps or now.measured_biceps >= end), bool(triceps or now.measured_triceps >= end)

    def turn(self, rate: float) -> float:
        """Return how far a command is ahead of a drive [rad]."""
        step = (
            float(np.clip(rate, -self.gains.most_rate, self.gains.most_rate)) * self.device.profile.loop.control_period
        )
        return float(np.clip(step, -self.device.most, self.device.most)) / self.device.share


class _FeedbackLinearisation(_Observing):
    def begin(self, now: Reading) -> Pair:
        self.observe_start(now)
        wanted = self.equilibrium(now)
        self.trim = now.command[0] - wanted[0], now.command[1] - wanted[1]
        return self.trim

    def wants(self, now: Reading) -> Pair:
        self.observe(now)
        device, gains, (angle, velocity), decay = self.device, self.gains, self.motion, self.decay()
        w, acceleration = gains.bandwidth, now.reference_acceleration
        jerk = now.jump_jerk + 3.0 * w * (acceleration - self.acceleration)
        jerk += 3.0 * w**2 * (now.reference_rate - velocity) + w**3 * (now.reference - angle)
        torque = device.inertia * (acceleration + 2.0 * decay * now.reference_rate - self.disturbance)
        torque += device.weight * math.sin(now.reference)
        antagonist = device.affordable(torque, now.tension)
        agonist = min(antagonist + abs(torque) / device.joint_radius, device.max_force)
        tension_rate = gains.tension_bandwidth * ((agonist + antagonist) / 2.0 - self.forces.mean())
        # the linear equations of x''' and s' by both drives' rates
        r1, r2, (first, second) = device.drive_radius, device.joint_radius, self.slopes()
        matrix = r1 * np.array([[r2 / device.inertia * first, r2 / device.inertia * second], [first / 2, -second / 2]])
        weight = device.weight / device.inertia * math.cos(angle)
        drift = -(r2**2 / device.inertia * (first + second) + weight) * velocity - 2.0 * decay * self.acceleration
        known = np.array([jerk - drift, tension_rate + r2 * (first - second) / 2.0 * velocity])
        biceps, triceps = np.linalg.solve(matrix, known)
        still = velocity * r2 / r1
        end_biceps, end_triceps = self.saturated(now)
        biceps, triceps = min(biceps, still) if end_biceps else biceps, max(triceps, still) if end_triceps else triceps
        share = min(self.forces.min() / gains.taut_force, 1.0)
        taut = np.add(now.drives, (self.turn(biceps), self.turn(triceps))) - self.trim
        mixed = share * taut + (1.0 - share) * np.array(self.equilibrium(now))
        return float(mixed[0]), float(mixed[1])


class _Torque(_Observing):
    def begin(self, now: Reading) -> Pair:
        self.observe_start(now)
        torque = self.device.joint_radius * (self.forces[0] - self.forces[1])
        self.load = torque - self.device.weight * math.sin(now.reference)
        apart = (now.command[0] - now.command[1]) / 2.0 - self.apart(now, self.setpoint(now))
        return apart, -apart

    def setpoint(self, now: Reading) -> float:
        """Return the torque setpoint [N m]."""
        device, gains, (angle, velocity) = self.device, self.gains, self.motion
        most = device.max_force * device.joint_radius
        torque = gains.virtual_stiffness * (now.reference - angle)
        torque += gains.virtual_damping * (now.reference_rate - velocity)
        return float(np.clip(torque + device.weight * math.sin(angle) + self.load, -most, most))

    def apart(self, now: Reading, torque: float) -> float:
        """Return half the angle between both drives [rad] that gives the co-contraction."""
        biceps, triceps = self.device.hold(0.0, torque, self.device.affordable(torque, now.tension))
        return (biceps - triceps) / 2.0

    def wants(self, now: Reading) -> Pair:
        self.observe(now)
        device, gains, velocity = self.device, self.gains, self.motion[1]
        torque = self.setpoint(now)
        missing = torque - device.joint_radius * (self.forces[0] - self.forces[1])
        end_biceps, end_triceps = self.saturated(now)
        missing = min(missing, 0.0) if end_biceps else missing
        missing = max(missing, 0.0) if end_triceps else missing
        ratio = device.drive_radius / device.joint_radius
        stiffness = device.joint_radius**2 * float(self.slopes().sum())
        middle = sum(now.drives) / 2.0
        middle += self.turn(missing / (gains.torque_time * ratio * stiffness) + velocity / ratio)
        apart = self.apart(now, torque)
        return middle + apart, middle - apart


class _Cascade(Loop):
    def wants(self, now: Reading) -> Pair:
        error, gains, device = now.reference - now.measured_angle, self.gains, self.device
        difference = gains.kp * error - gains.kd * now.velocity
        difference += device.weight * math.sin(now.reference) / device.joint_radius
        tension = device.affordable(device.joint_radius * difference, now.tension)
        turn, wound = self.integrate_torque(now, error, gains.ki), []
        for sense, estimate, untrusted in (
            (1.0, now.estimate_biceps, now.untrusted_biceps),
            (-1.0, now.estimate_triceps, now.untrusted_triceps),
        ):
            lack = min(tension + max(sense * difference, 0.0), device.max_force) - estimate
            wound.append(0.0 if untrusted and lack < 0.0 else sense * gains.kf * lack)
        biceps, triceps = self.equilibrium(now)
        return biceps + turn + wound[0], triceps + turn + wound[1]


class _ComputedTorque(Loop):
    def wants(self, now: Reading) -> Pair:
        error, gains, device = now.reference - now.measured_angle, self.gains, self.device
        feedback = gains.kd * (now.reference_rate - now.velocity) + gains.kp * error + self.integral
        asked = float(np.clip(now.tension, self.least, device.max_force))
        damping = 2.0 * decay_rate(device.profile, asked) * now.reference_rate
        torque = device.inertia * (now.reference_acceleration + feedback + damping)
        torque += device.weight * math.sin(now.measured_angle)
        most = device.joint_radius * (device.max_force - self.least)
        if abs(torque) < most or torque * error < 0.0:
            self.integrate(now, error, gains.ki)
        far = abs(device.inertia * gains.kp * error) / most if most > 0.0 else math.inf
        share = float(np.interp(far, [1.0, 2.0], [0.0, 1.0]))
        tension = max(device.affordable(torque, asked), self.least)
        return self.move(
            now, *self.pair(now, torque, tension), (1.0 - share) * now.reference_rate + share * now.velocity
        )

    @property
    def least(self) -> float:
        """The smallest co-contraction [N]."""
        return min(float(self.gains.least_tension), self.device.max_force)

    def pair(self, now: Reading, torque: float, tension: float) -> Pair:
        """Return the drive angles [rad] that give a torque with a co-contraction [N]."""
        return self.device.hold(now.measured_angle, torque, tension)


class _MinimalMotion(_ComputedTorque):
    def pair(self, now: Reading, torque: float, tension: float) -> Pair:
        device = self.device
        pull = min(abs(torque) / device.joint_radius, device.max_force - tension)
        sign = 1.0 if torque >= 0.0 else -1.0
        wound = now.measured_angle * device.joint_radius
        own = now.drives[0] * device.drive_radius - wound, wound - now.drives[1] * device.drive_radius
        agonist, antagonist = own[:: int(sign)]

        def slope(stretch: float) -> float:
            """Return the slope of the squared distance along the antagonist's deflection, where it is 0 times f' f'."""
            other = device.deflection(device.force(stretch) + pull)
            return float((stretch - antagonist) * device.slope(other) + (other - agonist) * device.slope(stretch))

        low, high = device.deflection(tension), device.deflection(device.max_force - pull)
        best = low if slope(low) >= 0.0 else high
        if slope(low) < 0.0 < slope(high):
            best = float(brentq(slope, low, high, xtol=1e-15, rtol=1e-14))
        biceps, triceps = (device.deflection(device.force(best) + pull), best)[:: int(sign)]
        return (wound + biceps) / device.drive_radius, (wound - triceps) / device.drive_radius


_LOOPS: dict[Control, Callable[[Device, Any], Loop]] = {
    "equilibrium-point": _EquilibriumPoint,
    "co-rotation": _CoRotation,
    "torque-stiffness": _TorqueStiffness,
    "feedforward-feedback": _FeedforwardFeedback,
    "feedback-linearisation": _FeedbackLinearisation,
    "torque": _Torque,
    "cascade": _Cascade,
    "computed-torque": _ComputedTorque,
    "minimal-motion": _MinimalMotion,
}
