"""One agent step in one compiled call."""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.envs.action import ALL_NUMBERS, compiled_action_of, compiled_tension_of, first_nan
from amulett_gym.envs.privileged import hidden_values, observe_hidden
from amulett_gym.envs.reward import COST_TERMS, TERMS
from amulett_gym.envs.shares import first_share, given_to, next_share
from amulett_gym.jit.compiled import compiled, compiled_in_place, record
from amulett_gym.simulation.dynamics import joint_stiffness
from amulett_gym.simulation.kernel import advance_block
from amulett_gym.simulation.layout import FAMILIES, LANES, MOTION_BLOCK, RUNNING
from amulett_gym.simulation.random import noise

SETTINGS = record(
    [
        ("ticks", "i8"),  # control ticks in an agent step
        ("delay", "i8"),  # control ticks from an agent step's begin to that of its action's ramp
        ("horizon", "f8"),  # agent steps in an episode
        ("low", "f8"),  # tension setpoint at action -1 [N]
        ("high", "f8"),  # tension setpoint at action +1 [N]
        ("full_control", "i8"),  # 1: the effort is that of the drives' own motion
        ("mean_angle", "f8"),  # mean drive angle at action +1, if actions have one [rad]
        ("prices", "f8", (len(FAMILIES), len(COST_TERMS))),  # `reward.prices`, per rad2 s, rad2/s, N2 s, N2 m2 s
        ("cost_cap", "f8"),
        ("observation_noise", "f8"),
    ]
)

OBSERVATIONS = (
    "position_error",
    "joint_angle",
    "joint_velocity",
    "setpoint",
    "time_since_move",
    "estimated_tension_biceps",
    "estimated_tension_triceps",
    "spring_deflection_biceps",
    "spring_deflection_triceps",
    "agonist",
    "command_biceps",
    "command_triceps",
    "tension_setpoint",
)
"""Names of the observation's entries, in order."""

_ENTRIES = len(OBSERVATIONS)

OBSERVATION_SCALES = {
    "position_error": math.radians(90.0),
    "joint_angle": math.radians(150.0),
    "joint_velocity": math.radians(500.0),
    "time_since_move": 2.0,
    "estimated_tension": 20.0,
    "command": math.radians(720.0),
}
"""Values that an entry of 1 stands for [rad, rad/s, s, N]: constants, so a policy needs no normalisation data."""

_ERROR, _ANGLE, _VELOCITY, _TIME, _TENSION, _COMMAND = OBSERVATION_SCALES.values()

METRICS = (
    "position_ise",
    "tension_ise",
    "isav_biceps",
    "isav_triceps",
    "iav_biceps",
    "iav_triceps",
    "rise_time",
    "settling_time",
    "overshoot",
    "tension_ise_estimated",
    "isav_kick",
    "effort_biceps",
    "effort_triceps",
    "contact_ise",
    "contact_peak",
    "push_deflection",
    "resting_stiffness",
    "setpoint_steps",
    "steps_risen",
    "steps_settled",
    "agonist_switches",
    "drive_effort",
    "drive_work",
    "resting_time",
)
"""Names of the metrics in ``info``, in order; their units are in the environments' docstring."""

MAY_BE_MISSING = {"rise_time": "steps_risen", "settling_time": "steps_settled", "resting_stiffness": "resting_time"}
"""Metrics that are means over what may not have happened yet -> the metric that is 0 as long as they do not exist."""

READINGS = (
    "failure",
    "time",
    "joint_angle",
    "joint_velocity",
    "tension_setpoint",
    "force_biceps",
    "force_triceps",
    "joint_stiffness",
    "push_torque",
    "contact_torque",
    "stiffness_setpoint",
)
"""Names of further entries of ``info``: the true state. `stiffness_setpoint` is NaN in loops that take no stiffness."""

FIRST_TERM = 1
FIRST_READING = FIRST_TERM + len(TERMS)
FIRST_METRIC = FIRST_READING + len(READINGS)
REPORT_SIZE = FIRST_METRIC + len(METRICS)
"""Length of a report: reward, its terms, readings, metrics, in this order."""

BRIEF_SIZE = FIRST_READING + 1
"""Length of a brief report, which ends with `failure`: thousands of whole ones take a tenth of a step's time."""

_NOISE_STREAM = np.uint64(0x0B5E)
_DEG = 180.0 / math.pi


@compiled
def step(p, e, which, c_blocks, s_blocks, paths, loop, extended, hidden, means, actions, observations, report):
    """Take one agent step with all devices; fill observations and report, one row per device.

    `which` holds the index of each block's profile, for `p`, `e` and the gains in `loop`. `actions` are those for the
    tension; `means` those for the mean drive angle, or None: then the code for these is not compiled. `paths`, `loop`
    and `extended` are as of `kernel.advance`, and `hidden` of `privileged.observe_hidden`. If an action is NaN, nothing
    happens but that its device is returned (see `action.first_nan`).
    """
    wrong = first_nan(means, actions)
    if wrong >= 0:
        return wrong
    motion = np.empty(1, dtype=MOTION_BLOCK)
    memory = motion, paths, loop, extended, hidden, hidden_values(hidden)
    blocks, given = (0, s_blocks.shape[0]), (means, actions, observations, report)
    step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given)
    return ALL_NUMBERS


@compiled
def step_shares(p, e, which, c_blocks, s_blocks, paths, loop, extended, hidden, means, turns, looks):
    """Take shares of agent steps, one after the other, until none comes in so many looks.

    Arguments are those of :func:`step` and `shares.first_share`; of `means`, only the type matters. Nothing may raise
    between a share and its count as done: the others would wait forever.
    """
    motion = np.empty(1, dtype=MOTION_BLOCK)
    memory = motion, paths, loop, extended, hidden, hidden_values(hidden)
    blocks = first_share(turns, looks)
    while blocks[0] < blocks[1]:
        step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given_to(turns, means))
        blocks = next_share(turns, looks)


@compiled_in_place
def step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given):
    """Take one agent step with the devices of neighbouring blocks, from the first to the one before the second."""
    motion, paths, loop, extended, hidden, values = memory
    means, actions, observations, report = given
    for block in range(blocks[0], blocks[1]):
        first = block * LANES
        end = min(first + LANES, actions.size)
        c, s, own = c_blocks[block], s_blocks[block], which[block]
        others = motion[0], paths, loop, extended, hidden, values  # a record does not keep its array: `memory` does
        step_block(p[own], e[own], c, s, others, own, block, first, end, means, actions, observations, report)


@compiled_in_place
def step_block(p, e, c, s, others, own, block, first, end, means, actions, observations, report):
    """Take one agent step with the devices of a block, which stays in the processor's cache meanwhile."""
    m, paths, loop, extended, hidden, values = others
    for device in range(first, end):
        # The reward's terms hold the costs before the step, until they are its own.
        terms = report[device, FIRST_TERM:FIRST_READING]
        terms[0], terms[1], terms[2], terms[3] = costs(e, s, np.uint64(device - first))
    for begun in range(2):  # the last step's ramps end, then those of this one begin
        if begun:
            for device in range(first, end):
                begin_ramp(e, s, loop, block, np.uint64(device - first), means, actions, device)
        ticks = e.ticks - e.delay if begun else e.delay
        advance_block(p, c, s, m, paths, loop, extended, own, block, end - first, ticks)
    for device in range(first, end):
        i = np.uint64(device - first)
        end_ramp(e, s, loop, block, i, means, actions, device)
        observe(p, e, c, s, i, observations[device])
        write_reward(e, c, s, i, report[device])
        write_report(p, c, s, i, report[device])
        observe_hidden(p, hidden, own, c, s, i, values, observations[device])


@compiled
def wanted_tension(e, action):
    """Return the tension setpoint [N] of an action."""
    return compiled_tension_of(min(max(float(action), -1.0), 1.0), e.low, e.high)


@compiled
def begin_ramp(e, s, loop, block, i, means, actions, device):
    """Let tension and mean drive angle begin their ramps to those of an action.

    A jump would add effort in each agent step.
    """
    s.tension_rate[i] = (wanted_tension(e, actions[device]) - s.tension_command[i]) / e.ticks
    if means is not None:
        q = loop[1][block]
        q.mean_rate[i] = (wanted_mean(e, means[device]) - q.mean_command[i]) / e.ticks


@compiled
def end_ramp(e, s, loop, block, i, means, actions, device):
    """At an agent step's end, set tension and mean drive angle to where their ramps are, without rounding.

    That is at the end, or as many ticks before it as the ramps began late.
    """
    s.tension_command[i] = wanted_tension(e, actions[device]) - e.delay * s.tension_rate[i]
    if means is not None:
        q = loop[1][block]
        q.mean_command[i] = wanted_mean(e, means[device]) - e.delay * q.mean_rate[i]


@compiled
def begin_ramps(e, which, s_blocks, loop, means, actions):
    """Let all devices begin their ramps, one action each."""
    for device in range(actions.size):
        block, i = device // LANES, np.uint64(device % LANES)
        begin_ramp(e[which[block]], s_blocks[block], loop, block, i, means, actions, device)


@compiled
def end_ramps(e, which, s_blocks, loop, means, actions):
    """Set all devices' tensions and mean drive angles at an agent step's end, one action each."""
    for device in range(actions.size):
        block, i = device // LANES, np.uint64(device % LANES)
        end_ramp(e[which[block]], s_blocks[block], loop, block, i, means, actions, device)


@compiled
def wanted_mean(e, action):
    """Return the mean drive angle [rad] of an action."""
    return min(max(float(action), -1.0), 1.0) * e.mean_angle


@compiled
def report_devices(p, which, c_blocks, s_blocks, devices, report):
    """Fill the report of the given devices, one row each; rewards and terms are 0."""
    for row in range(devices.size):
        report[row, :FIRST_READING] = 0.0
        block, i = devices[row] // LANES, np.uint64(devices[row] % LANES)
        write_report(p[which[block]], c_blocks[block], s_blocks[block], i, report[row])


@compiled
def observe_devices(p, e, which, c_blocks, s_blocks, devices, observations):
    """Fill the observations of the given devices, one row each."""
    for row in range(devices.size):
        block, i = devices[row] // LANES, np.uint64(devices[row] % LANES)
        own = which[block]
        observe(p[own], e[own], c_blocks[block], s_blocks[block], i, observations[row])


@compiled
def observe(p, e, c, s, i, row):
    """Fill a row's first entries with the microcontroller's values, scaled and clipped to [-1, 1]."""
    time = s.tick[i] * p.control_period
    row[0] = (s.setpoint[i] - s.measured_angle[i]) / _ERROR
    row[1] = s.measured_angle[i] / _ANGLE
    row[2] = s.measured_velocity[i] / _VELOCITY
    row[3] = s.setpoint[i] / _ANGLE
    row[4] = (time - s.step_start[i]) / _TIME
    row[5] = s.estimate_biceps[i] / _TENSION
    row[6] = s.estimate_triceps[i] / _TENSION
    row[7] = s.measured_biceps[i] / p.max_spring_deflection
    row[8] = s.measured_triceps[i] / p.max_spring_deflection
    row[9] = s.agonist[i]
    row[10] = s.command_biceps[i] / _COMMAND
    row[11] = s.command_triceps[i] / _COMMAND
    # At the end of its ramp, where the last action wants it.
    row[12] = compiled_action_of(s.tension_setpoint[i] + e.delay * s.tension_rate[i], e.low, e.high)
    if e.observation_noise > 0.0:
        key = c.noise_key[i] ^ _NOISE_STREAM
        for k in range(_ENTRIES):
            row[k] += e.observation_noise * noise(key, np.uint64(s.tick[i] * _ENTRIES + k))
    for k in range(_ENTRIES):
        row[k] = min(max(row[k], -1.0), 1.0)


@compiled
def costs(e, s, i):
    """Return the raw costs of the episode so far, in the order of `COST_TERMS`."""
    effort = s.drive_effort[i] if e.full_control else s.effort_biceps[i] + s.effort_triceps[i]
    return s.position_ise[i], effort, s.tension_ise[i], s.contact_ise[i]


@compiled
def write_reward(e, c, s, i, report):
    """Report the step's reward with its terms, which hold the costs before the step, by the prices of the family."""
    charge(e, s, i, c.family[i], costs(e, s, i), report)


@compiled
def charge(e, s, i, family, costs, report):
    """Report the step's reward with its terms, which hold the costs before the step, by those after it."""
    terms = report[FIRST_TERM:FIRST_READING]
    terms[0] = -e.prices[family, 0] * (costs[0] - terms[0])
    terms[1] = -e.prices[family, 1] * (costs[1] - terms[1])
    terms[2] = -e.prices[family, 2] * (costs[2] - terms[2])
    terms[3] = -e.prices[family, 3] * (costs[3] - terms[3])
    terms[4] = 0.0
    cost = -(terms[0] + terms[1] + terms[2] + terms[3])
    if cost > e.cost_cap:
        for k in range(4):
            terms[k] *= e.cost_cap / cost
    if s.failure[i] != RUNNING:
        # As large as the largest possible cost of the remaining episode.
        terms[4] = -e.cost_cap * max(e.horizon - s.tick[i] // e.ticks, 1.0)
    report[0] = terms[0] + terms[1] + terms[2] + terms[3] + terms[4]


@compiled
def write_report(p, c, s, i, report):
    """Report the true state with the cumulative metrics; in a brief report, the failure alone."""
    report[FIRST_READING] = s.failure[i]
    if report.size == BRIEF_SIZE:
        return
    r = report[FIRST_READING:FIRST_METRIC]
    r[1] = s.tick[i] * p.control_period
    r[2] = s.angle[i] * _DEG
    r[3] = s.velocity[i] * _DEG
    r[4] = s.tension_setpoint[i]
    r[5] = s.force_biceps[i]
    r[6] = s.force_triceps[i]
    r[7] = joint_stiffness(p, c, i, s.angle[i], s.drive_biceps[i], s.drive_triceps[i])
    r[8] = s.push_torque[i]
    r[9] = s.contact_torque[i]
    r[10] = s.stiffness_setpoint[i]
    m = report[FIRST_METRIC:]
    settled, settling = s.settling_count[i], s.settling_sum[i]
    if not math.isnan(s.inside_since[i]):
        settled += 1.0
        settling += s.inside_since[i] - s.step_start[i]
    m[0] = s.position_ise[i] * _DEG * _DEG
    m[1] = s.tension_ise[i]
    m[2] = s.isav_biceps[i] * _DEG * _DEG
    m[3] = s.isav_triceps[i] * _DEG * _DEG
    m[4] = s.iav_biceps[i] * _DEG
    m[5] = s.iav_triceps[i] * _DEG
    m[6] = s.rise_sum[i] / max(s.rise_count[i], 1.0)
    m[7] = settling / max(settled, 1.0)
    m[8] = s.overshoot[i] * _DEG
    m[9] = s.tension_ise_estimated[i]
    m[10] = s.isav_kick[i] * _DEG * _DEG
    m[11] = s.effort_biceps[i] * _DEG * _DEG
    m[12] = s.effort_triceps[i] * _DEG * _DEG
    m[13] = s.contact_ise[i]
    m[14] = s.contact_peak[i]
    m[15] = s.push_deflection[i] * _DEG
    m[16] = s.resting_stiffness_sum[i] / s.resting_time[i] if s.resting_time[i] > 0.0 else 0.0
    m[17] = s.step_count[i]
    m[18] = s.rise_count[i]
    m[19] = settled
    m[20] = s.switch_count[i]
    m[21] = s.drive_effort[i] * _DEG * _DEG
    m[22] = s.drive_work[i]
    m[23] = s.resting_time[i]
