"""Where the setpoint is in each tick: on the scenario's moves or its path, with a sinusoid or a chirp added.

These are stages 8 to 10 of the tick; functions take what those of :mod:`amulett_gym.simulation.kernel` do.
"""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled, compiled_lanes
from amulett_gym.simulation import layout
from amulett_gym.simulation.layout import TIME_SLACK
from amulett_gym.simulation.metrics import begin_step


@compiled
def find_setpoints(p, c, s, paths, block, first, end):
    """Stages 8 and 9; without paths (None), nothing of `follow_paths` is compiled."""
    if paths is None:
        begin_due_moves(p, c, s, first, end)
        follow_moves(p, c, s, first, end)
    else:
        follow_paths(p, c, s, paths[0], paths[1][block], first, end)


@compiled_lanes
def begin_due_moves(p, c, s, first, end):
    """Stage 8: begin the setpoint's moves that are due."""
    for i in range(first, end):
        begin_moves(p, c, s, i)


@compiled_lanes
def follow_moves(p, c, s, first, end):
    """Stage 9: set the position setpoint for the next tick."""
    for i in range(first, end):
        follow_setpoint(p, c, s, i)


@compiled_lanes
def follow_paths(p, c, s, parts, places, first, end):
    """Stages 8 and 9 for a batch in which some setpoints are paths."""
    for i in range(first, end):
        if places.count[i] > 0:
            follow_path(p, c, s, parts, places, i)
        else:
            begin_moves(p, c, s, i)
            follow_setpoint(p, c, s, i)


@compiled_lanes
def add_waves(p, c, s, first, end):
    """Stage 10: add sinusoids and chirps."""
    for i in range(first, end):
        if c.wave_amplitude[i] > 0.0:
            add_wave(p, c, s, i)


@compiled
def begin_moves(p, c, s, i):
    """Begin the setpoint's moves that are due, and the setpoint steps with them."""
    time = s.tick[i] * p.control_period
    while s.move[i] + 1 < c.move_count[i] and c.move_time[s.move[i] + 1, i] <= time + TIME_SLACK:
        s.move[i] += 1
        start = c.move_angle[s.move[i] - 1, i] if s.move[i] > 0 else c.initial_angle[i]
        change = c.move_angle[s.move[i], i] - start
        begin_step(s, i, time, c.move_angle[s.move[i], i], change if time >= c.measure_from[i] - TIME_SLACK else 0.0)


@compiled
def follow_setpoint(p, c, s, i):
    """Set the moves' position setpoint [rad] for the present time."""
    time = s.tick[i] * p.control_period
    k = s.move[i]
    if k < 0:
        return
    start = c.move_angle[k - 1, i] if k > 0 else c.initial_angle[i]
    progress = 1.0
    if c.move_duration[k, i] > 0.0:
        progress = min((time - c.move_time[k, i]) / c.move_duration[k, i], 1.0)
    last = s.setpoint[i] - s.setpoint_wave[i]
    s.setpoint[i] = start + (c.move_angle[k, i] - start) * minimum_jerk(progress)
    if c.move_duration[k, i] == 0.0:
        # Summed until the controller acts: it may miss a tick.
        s.setpoint_jump[i] += s.setpoint[i] - last


@compiled
def follow_path(p, c, s, parts, places, i):
    """Begin the parts of the path that are due, and set the position setpoint [rad] for the present time."""
    time = s.tick[i] * p.control_period
    first, count = places.first[i], places.count[i]
    while s.move[i] + 1 < count and parts[first + s.move[i] + 1].time <= time + TIME_SLACK:
        s.move[i] += 1
        part = parts[first + s.move[i]]
        change = part.angle - part.start
        if part.shape == layout.MINIMUM_JERK:
            begin_step(s, i, time, part.angle, change if time >= c.measure_from[i] - TIME_SLACK else 0.0)
        if part.duration == 0.0:
            s.setpoint_jump[i] += change
    if s.move[i] < 0:
        return
    part = parts[first + s.move[i]]
    progress = 1.0
    if part.duration > 0.0:
        progress = min(max((time - part.time) / part.duration, 0.0), 1.0)
    if part.shape == layout.MINIMUM_JERK:
        progress = minimum_jerk(progress)
    s.setpoint[i] = part.start + (part.angle - part.start) * progress


@compiled
def add_wave(p, c, s, i):
    """Add a sinusoid or chirp to the moves' position setpoint."""
    elapsed = s.tick[i] * p.control_period - c.wave_time[i]
    wave = 0.0
    if elapsed >= 0.0 and elapsed < c.wave_duration[i] - TIME_SLACK:
        cycles = elapsed * (c.wave_frequency[i] + 0.5 * c.wave_chirp[i] * elapsed)
        wave = c.wave_amplitude[i] * math.sin(2.0 * math.pi * cycles)
    s.setpoint[i] = wave + (c.initial_angle[i] if s.move[i] < 0 else s.setpoint[i])
    s.setpoint_wave[i] = wave


@compiled
def minimum_jerk(progress: float) -> float:
    """Return the minimum-jerk profile, 0 to 1 (Flash and Hogan, 1985), at a progress of 0 to 1."""
    return progress**3 * (10.0 + progress * (6.0 * progress - 15.0))
