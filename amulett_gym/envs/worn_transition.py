"""One agent step of worn devices in one compiled call; the device's own parts are those of `envs.transition`."""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.envs import transition
from amulett_gym.envs.action import ALL_NUMBERS, compiled_tension_of, first_nan
from amulett_gym.envs.shares import first_share, given_to, next_share
from amulett_gym.envs.transition import (
    BRIEF_SIZE,
    FIRST_READING,
    FIRST_TERM,
    begin_ramp,
    charge,
    end_ramp,
    observe,
    write_report,
)
from amulett_gym.jit.compiled import compiled, compiled_in_place
from amulett_gym.simulation.layout import LANES, MOTION_BLOCK
from amulett_gym.simulation.random import noise
from amulett_gym.simulation.worn import advance_block
from amulett_gym.simulation.worn_layout import ARM_BLOCK

OBSERVATIONS = (*transition.OBSERVATIONS, "measured_cuff", "cuff_rate", "assistance")
"""Names of the observation's entries, in order."""

CUFF_SCALE, CUFF_RATE_SCALE = 2.0, 20.0
"""Torque [N m] and its rate [N m/s] that an entry of 1 stands for."""

READINGS = ("elbow_angle", "elbow_velocity", "intention", "cuff_torque", "flexor", "extensor", "assistance")
"""Names of further entries of ``info``, after those of the device: the wearer's true state."""

METRICS = (
    "muscle_effort",
    "cuff_ise",
    "cuff_peak",
    "tracking_ise",
    "moving_cuff_ise",
    "moving_time",
    "load_deflection",
)
"""Names of further metrics in ``info``, after those of the wearer's state."""


FIRST_WORN_READING = transition.REPORT_SIZE
FIRST_WORN_METRIC = FIRST_WORN_READING + len(READINGS)
REPORT_SIZE = FIRST_WORN_METRIC + len(METRICS)
"""Length of a report: that of the device, then the wearer's readings and metrics."""

_BARE = len(transition.OBSERVATIONS)
_SINCE_MOVE = transition.OBSERVATIONS.index("time_since_move")
_ADDED = len(OBSERVATIONS) - _BARE
_NOISE_STREAM = np.uint64(0x0B5F)
_DEG = 180.0 / math.pi


@compiled
def step(p, e, which, c_blocks, s_blocks, paths, loop, extended, worn, assistances, actions, observations, report):
    """Take one agent step with all devices; fill observations and report, one row per device.

    `actions` are those for the tension, `assistances` those for the assistance; else as `transition.step`.
    """
    wrong = first_nan(assistances, actions)
    if wrong >= 0:
        return wrong
    motion, motion_of_arm = np.empty(1, dtype=MOTION_BLOCK), np.empty(1, dtype=ARM_BLOCK)
    memory = motion, motion_of_arm, paths, loop, extended, worn
    blocks, given = (0, s_blocks.shape[0]), (assistances, actions, observations, report)
    step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given)
    return ALL_NUMBERS


@compiled
def step_shares(p, e, which, c_blocks, s_blocks, paths, loop, extended, worn, assistances, turns, looks):
    """Take shares of agent steps; see `transition.step_shares`."""
    motion, motion_of_arm = np.empty(1, dtype=MOTION_BLOCK), np.empty(1, dtype=ARM_BLOCK)
    memory = motion, motion_of_arm, paths, loop, extended, worn
    blocks = first_share(turns, looks)
    while blocks[0] < blocks[1]:
        step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given_to(turns, assistances))
        blocks = next_share(turns, looks)


@compiled_in_place
def step_blocks(p, e, which, c_blocks, s_blocks, memory, blocks, given):
    """Take one agent step with the devices of neighbouring blocks, from the first to the one before the second."""
    motion, motion_of_arm, paths, loop, extended, worn = memory
    assistances, actions, observations, report = given
    for block in range(blocks[0], blocks[1]):
        first = block * LANES
        ends = first, min(first + LANES, actions.size)
        c, s, own = c_blocks[block], s_blocks[block], which[block]
        others = motion[0], motion_of_arm[0], paths, loop, extended, worn  # see `transition.step_blocks`
        step_block(p[own], e[own], c, s, others, own, block, ends, assistances, actions, observations, report)


@compiled_in_place
def step_block(p, e, c, s, others, own, block, ends, assistances, actions, observations, report):
    """Take one agent step with the devices of a block; `others` are m, k and what follows in `worn.advance_block`."""
    m, k, paths, loop, extended, worn = others
    first, end = ends
    h, w = worn[1][block], worn[2][block]
    for device in range(first, end):
        # The reward's terms hold the costs before the step, until they are its own.
        terms = report[device, FIRST_TERM:FIRST_READING]
        terms[0], terms[1], terms[2], terms[3] = costs(s, w, np.uint64(device - first))
    for begun in range(2):  # the last step's ramps end, then those of this one begin
        if begun:
            for device in range(first, end):
                i = np.uint64(device - first)
                begin_ramp(e, s, loop, block, i, None, actions, device)
                begin_assistance(e, w, i, assistances[device])
        ticks = e.ticks - e.delay if begun else e.delay
        advance_block(p, c, s, m, k, paths, loop, extended, worn, own, block, end - first, ticks)
    for device in range(first, end):
        i = np.uint64(device - first)
        end_ramp(e, s, loop, block, i, None, actions, device)
        end_assistance(e, w, i, assistances[device])
        observe_worn(p, e, c, s, h, w, i, observations[device])
        charge(e, s, i, c.family[i], costs(s, w, i), report[device])
        write_worn_report(p, c, s, w, i, report[device])


@compiled
def wanted_assistance(action):
    """Return the assistance in [0, 1] of an action."""
    return compiled_tension_of(min(max(float(action), -1.0), 1.0), 0.0, 1.0)


@compiled
def begin_assistance(e, w, i, action):
    """Let the assistance begin its ramp to that of an action."""
    w.assistance_step[i] = (wanted_assistance(action) - w.assistance[i]) / e.ticks


@compiled
def end_assistance(e, w, i, action):
    """At an agent step's end, set the assistance to where its ramp is, without rounding; see `transition.end_ramp`."""
    w.assistance[i] = wanted_assistance(action) - e.delay * w.assistance_step[i]


@compiled
def begin_ramps(e, which, s_blocks, loop, worn, assistances, actions):
    """Let all devices begin their ramps, one action each."""
    for device in range(actions.size):
        block, i = device // LANES, np.uint64(device % LANES)
        own = e[which[block]]
        begin_ramp(own, s_blocks[block], loop, block, i, None, actions, device)
        begin_assistance(own, worn[2][block], i, assistances[device])


@compiled
def end_ramps(e, which, s_blocks, loop, worn, assistances, actions):
    """Set all devices' tensions and assistances at an agent step's end, one action each."""
    for device in range(actions.size):
        block, i = device // LANES, np.uint64(device % LANES)
        own = e[which[block]]
        end_ramp(own, s_blocks[block], loop, block, i, None, actions, device)
        end_assistance(own, worn[2][block], i, assistances[device])


@compiled
def report_devices(p, which, c_blocks, s_blocks, worn, devices, report):
    """Fill the report of the given devices, one row each; rewards and terms are 0."""
    for row in range(devices.size):
        report[row, :FIRST_READING] = 0.0
        block, i = devices[row] // LANES, np.uint64(devices[row] % LANES)
        write_worn_report(p[which[block]], c_blocks[block], s_blocks[block], worn[2][block], i, report[row])


@compiled
def observe_devices(p, e, which, c_blocks, s_blocks, worn, devices, observations):
    """Fill the observations of the given devices, one row each."""
    for row in range(devices.size):
        block, i = devices[row] // LANES, np.uint64(devices[row] % LANES)
        own, h, w = which[block], worn[1][block], worn[2][block]
        observe_worn(p[own], e[own], c_blocks[block], s_blocks[block], h, w, i, observations[row])


@compiled
def observe_worn(p, e, c, s, h, w, i, row):
    """Fill a row's entries with what the device knows, scaled and clipped to [-1, 1]."""
    observe(p, e, c, s, i, row)
    if h.guided[i] == 0.0:
        row[_SINCE_MOVE] = 1.0  # the moves are the wearer's, of which the device knows nothing
    row[_BARE] = w.measured_cuff[i] / CUFF_SCALE
    row[_BARE + 1] = w.cuff_rate[i] / CUFF_RATE_SCALE
    row[_BARE + 2] = w.assistance[i] + e.delay * w.assistance_step[i]  # at the end of its ramp
    if e.observation_noise > 0.0:
        key = c.noise_key[i] ^ _NOISE_STREAM
        for k in range(_ADDED):
            row[_BARE + k] += e.observation_noise * noise(key, np.uint64(s.tick[i] * _ADDED + k))
    for k in range(_ADDED):
        row[_BARE + k] = min(max(row[_BARE + k], -1.0), 1.0)


@compiled
def costs(s, w, i):
    """Return the raw costs of the episode so far, in the order of `worn_reward.WORN_WEIGHTS`."""
    return w.effort[i], w.tracking_ise[i], w.moving_cuff_ise[i], s.effort_biceps[i] + s.effort_triceps[i]


@compiled
def write_worn_report(p, c, s, w, i, report):
    """Report the true state of device and wearer with the cumulative metrics; briefly as `write_report`."""
    write_report(p, c, s, i, report)
    if report.size == BRIEF_SIZE:
        return
    r = report[FIRST_WORN_READING:FIRST_WORN_METRIC]
    r[0] = w.elbow[i] * _DEG
    r[1] = w.elbow_rate[i] * _DEG
    r[2] = w.intention[i] * _DEG
    r[3] = w.cuff_torque[i]
    r[4] = w.flexor[i]
    r[5] = w.extensor[i]
    r[6] = w.assistance[i]
    m = report[FIRST_WORN_METRIC:]
    m[0] = w.effort[i]
    m[1] = w.cuff_ise[i]
    m[2] = w.cuff_peak[i]
    m[3] = w.tracking_ise[i] * _DEG * _DEG
    m[4] = w.moving_cuff_ise[i]
    m[5] = w.moving_time[i]
    m[6] = w.load_deflection[i] * _DEG
