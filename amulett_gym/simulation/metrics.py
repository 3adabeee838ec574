"""From when on the metrics count, and those of the setpoint's steps: rise, settling, overshoot, stiffness at rest.

What integrals and peaks add up in a tick is added where it arises: `kernel.end_motion`, `commands.command_drives`.
"""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled, compiled_lanes
from amulett_gym.simulation.dynamics import joint_stiffness
from amulett_gym.simulation.layout import TIME_SLACK


@compiled_lanes
def start_counting(p, c, s, m, first, end):
    """Stage 0: count this tick in the metrics, unless it lies before `measure_from`."""
    for i in range(first, end):
        m.counting[i] = 1.0 if s.tick[i] * p.control_period >= c.measure_from[i] - TIME_SLACK else 0.0


@compiled_lanes
def track_steps(p, c, s, m, first, end):
    """Stage 11: measure how the arm follows the setpoint."""
    for i in range(first, end):
        track_step(p, c, s, m, i)


@compiled
def begin_step(s, i, time, target, change):
    """Close the setpoint step in progress and open the next, unless nothing changes or counts."""
    if not math.isnan(s.inside_since[i]):
        s.settling_sum[i] += s.inside_since[i] - s.step_start[i]
        s.settling_count[i] += 1.0
    s.inside_since[i] = math.nan
    s.step_start[i] = time
    s.step_target[i] = target
    s.step_direction[i] = math.copysign(1.0, change) if change != 0.0 else 0.0
    s.risen[i] = 0
    if change != 0.0:
        s.step_count[i] += 1.0


@compiled
def track_step(p, c, s, m, i):
    """Update rise and settling time, overshoot and the stiffness at rest."""
    if s.step_direction[i] != 0.0:
        beyond = s.step_direction[i] * (s.angle[i] - s.step_target[i])
        s.overshoot[i] = max(s.overshoot[i], beyond)
        time = s.tick[i] * p.control_period
        if abs(beyond) > p.margin:
            s.inside_since[i] = math.nan
        else:
            if math.isnan(s.inside_since[i]):
                s.inside_since[i] = time
            if not s.risen[i]:
                s.risen[i] = 1
                s.rise_sum[i] += time - s.step_start[i]
                s.rise_count[i] += 1.0
    if abs(s.setpoint[i] - s.angle[i]) <= p.margin and s.setpoint[i] == s.previous_setpoint[i]:
        stiffness = joint_stiffness(p, c, i, s.angle[i], s.drive_biceps[i], s.drive_triceps[i])
        s.resting_stiffness_sum[i] += m.counting[i] * p.control_period * stiffness
        s.resting_time[i] += m.counting[i] * p.control_period
