"""An independent, slow second model of a device on a wearer's arm, to check :mod:`amulett_gym.simulation.worn`.

Device and arm are integrated between control ticks with scipy, to tight tolerances. The recorded inputs are the drives'
commands, the tremor and the intention; what the wearer answers is computed here. Only the profile, the knots of the
spring tables and the decay rate's fit are shared with the kernel.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from amulett_gym.fitting import Fitting
from amulett_gym.profile import Profile
from amulett_gym.simulation.reference import arm, decay_rate, push_torque, string_force
from amulett_gym.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from amulett_gym.tasks.wearer import Wearer

STATES = ("angle", "velocity", "drive_biceps", "drive_triceps", "elbow", "elbow_rate", "flexor", "extensor")
CABLES = ("loss_biceps", "loss_triceps")


def replay_worn(
    profile: Profile,
    scenario: NDArray[np.void] | np.void,
    wearer: Wearer,
    trajectory: Trajectory,
    tolerance: float = 1e-10,
    payload: tuple[float, float] = (0.0, 0.0),
) -> dict[str, NDArray[np.float64]]:
    """Return the expected motion of device and arm under the recorded commands of both drives.

    Parameters
    ----------
    profile : Profile
        With drives that have a lag, and no stall torque.
    scenario : record of `layout.SCENARIO`
    wearer : Wearer
    trajectory : Trajectory
    tolerance : float
        Relative tolerance of the integration.
    payload : tuple of float
        Mass [kg] and lever arm [m] of what is put into the hand.

    Returns
    -------
    dict of str to ndarray, shape (ticks + 1,)
        `STATES`, `CABLES`, and ``cuff_torque`` [N m].
    """
    fitting, plant, period = profile.wearer or Fitting(), profile.plant, profile.loop.control_period
    bare, weight = arm(profile)
    force, lag = string_force(profile), profile.drives.lag
    fastest = math.radians(profile.drives.rate_limit_deg or math.inf)
    to_drive, to_joint = plant.drive_pulley_radius, plant.joint_pulley_radius
    length = 0.146 * wearer.height
    own_mass = 0.022 * wearer.mass
    inertia = own_mass * (0.827 * length) ** 2
    hand_weight = 9.81 * own_mass * 0.682 * length if plant.orientation == "vertical" else 0.0
    k0, b0 = 1.5 * wearer.tone, 0.1 * wearer.tone
    g, h = 3.0 * wearer.strength, 0.2 * wearer.strength
    rest = math.radians(wearer.rest_angle_deg)
    load_inertia, load_weight = payload[0] * payload[1] ** 2, 9.81 * payload[0] * payload[1]
    load_weight *= plant.orientation == "vertical"
    bend = [fitting.cable.friction * math.radians(fitting.cable.bend_biceps_deg)]
    bend.append(fitting.cable.friction * math.radians(fitting.cable.bend_triceps_deg))
    cabled, before_spring = max(bend) > 0.0, fitting.cable.side == "drive"

    def cuff(state: NDArray[np.float64]) -> float:
        if not wearer.worn:
            return 0.0
        gap, closing = state[0] - state[4], state[1] - state[5]
        play = math.radians(fitting.cuff.slack_deg) / 2
        if play == 0.0:
            return fitting.cuff.stiffness * gap + fitting.cuff.damping * closing
        if abs(gap) <= play:
            return 0.0
        torque = fitting.cuff.stiffness * (gap - math.copysign(play, gap)) + fitting.cuff.damping * closing
        return max(torque, 0.0) if gap > 0 else min(torque, 0.0)

    def derivative(
        _: float,
        state: NDArray[np.float64],
        drives: tuple[float, float],
        wanted: tuple[float, float],
        outer: float,
        held: float,
        balance: float,
    ) -> list[float]:
        joint, rate, biceps, triceps, elbow, elbow_rate, flexor, extensor, *lost = state
        pulls = force(biceps * to_drive - joint * to_joint), force(joint * to_joint - triceps * to_drive)
        turns = [
            max(min((drives[0] - biceps) / lag, fastest), -fastest),
            max(min((drives[1] - triceps) / lag, fastest), -fastest),
        ]
        at_joint, lost_rates = pulls, []
        if cabled:
            slides = (
                (to_drive * turns[0], -to_drive * turns[1]) if before_spring else (to_joint * rate, -to_joint * rate)
            )
            for bent, loss, speed in zip(bend, lost, slides, strict=True):
                sliding = 1 - math.exp(-math.copysign(bent, speed))
                lost_rates.append(abs(speed) / fitting.cable.presliding * (sliding - loss))
            if not before_spring:
                at_joint = pulls[0] * (1 - lost[0]), pulls[1] * (1 - lost[1])
        preload = min(at_joint) if profile.damping.preload == "smaller" else sum(at_joint) / 2
        slowing = 2 * decay_rate(profile, preload) * bare * rate
        between = cuff(state)
        joint_torque = (at_joint[0] - at_joint[1]) * to_joint - weight * math.sin(joint) - slowing - between
        pull = (k0 + g * flexor) * (0.87 * flexor - elbow + balance) - (b0 + h * flexor) * elbow_rate
        push = (k0 + g * extensor) * (0.87 * extensor + elbow - balance) + (b0 + h * extensor) * elbow_rate
        elbow_torque = pull - push - 0.5 * elbow_rate + between + outer
        elbow_torque -= (hand_weight + held * load_weight) * math.sin(elbow)
        lags = [0.025 if want > have else 0.045 for want, have in zip(wanted, (flexor, extensor), strict=True)]
        rises = [(wanted[0] - flexor) / lags[0], (wanted[1] - extensor) / lags[1]]
        return [
            rate,
            joint_torque / bare,
            *turns,
            elbow_rate,
            elbow_torque / (inertia + held * load_inertia),
            *rises,
            *lost_rates,
        ]

    names = STATES + CABLES if cabled else STATES
    state = np.array([float(trajectory[name][0]) for name in names])
    correction = 0.0
    rows, errors, delay = [[*state, cuff(state)]], [], round(wearer.reflex_delay / period)
    for tick in range(len(trajectory) - 1):
        intended = [float(trajectory[name][tick]) for name in ("intention", "intention_rate", "intention_acceleration")]
        errors.append((intended[0] - state[4], intended[1] - state[5]))
        late = errors[max(tick - delay, 0)]
        habit = wearer.co_contraction
        slow = 0.5 + 2 * (b0 + h * habit)
        torque = hand_weight * math.sin(intended[0])
        torque += wearer.anticipation * (inertia * intended[2] + slow * intended[1])
        answer = wearer.feedback_stiffness * late[0] + wearer.feedback_damping * late[1]
        correction += period * (answer / wearer.correction_time - correction / wearer.relaxation_time)
        torque += answer + correction
        wanted = (habit, habit) if wearer.guided else _activations(torque, habit, k0, g)
        held = float(tick * period > wearer.payload_time - 0.5 * period)
        drives = float(trajectory["command_biceps"][tick + 1]), float(trajectory["command_triceps"][tick + 1])
        outer = push_torque(scenario, tick, period) + float(trajectory["tremor"][tick + 1])
        solution = solve_ivp(
            derivative,
            (0.0, period),
            state,
            "DOP853",
            args=(drives, wanted, outer, held, rest if wearer.guided else intended[0]),
            rtol=tolerance,
            atol=1e-12,
            max_step=period / 4,
        )
        if not solution.success:
            raise ArithmeticError(f"tick {tick}: {solution.message}")
        state = solution.y[:, -1]
        rows.append([*state, cuff(state)])
    return dict(zip((*names, "cuff_torque"), np.array(rows).T, strict=True))


def _activations(torque: float, habit: float, k0: float, g: float) -> tuple[float, float]:
    """Return the activations about a habitual co-contraction that give a torque in balance, by bisection."""

    def pair(lead: float) -> tuple[float, float]:
        if abs(lead) <= habit:
            return min(habit + lead, 1.0), min(habit - lead, 1.0)
        alone = min(habit + abs(lead), 1.0)
        return (alone, 0.0) if lead > 0 else (0.0, alone)

    def given(lead: float) -> float:
        flexor, extensor = pair(lead)
        return (k0 + g * flexor) * 0.87 * flexor - (k0 + g * extensor) * 0.87 * extensor

    low, high = habit - 1.0, 1.0 - habit
    if given(high) <= torque or given(low) >= torque:
        return pair(high if given(high) <= torque else low)
    return pair(float(brentq(lambda lead: given(lead) - torque, low, high, xtol=1e-15)))
