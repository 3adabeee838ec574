"""What control loops share: at their begin, agonist and tension setpoint, at their end, the drives' commands."""

from __future__ import annotations

from amulett_gym.control.agonist import select_agonist
from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.jit.compiled import compiled, compiled_lanes
from amulett_gym.simulation import layout

FARTHEST = 1e100  # [rad], [rad/s]; beyond, the square in a metric could overflow


@compiled
def choose(condition, yes, no):
    """Return one of two values, both of which are read: a branch would prevent vectorisation."""
    return yes if condition else no


@compiled
def low_pass(last, value, time_constant, period):
    """Return the next value of a first-order low-pass, discretised by backward differences."""
    return last + (value - last) * period / (time_constant + period)


@compiled_lanes
def choose_agonists(p, s, m, first, end):
    """Choose the agonists, and note where they switch."""
    for i in range(first, end):
        error = s.setpoint[i] - s.measured_angle[i]
        selected = select_agonist(
            s.agonist[i], s.measured_difference[i], error, p.switch_hysteresis, p.tie_width, p.tie_error
        )
        agonist = choose(p.fixed_agonist == 0.0, selected, p.fixed_agonist)
        m.switched[i] = choose(agonist != s.agonist[i], 1.0, 0.0)
        s.agonist[i] = agonist
        s.switch_count[i] += m.counting[i] * m.switched[i]


@compiled_lanes
def choose_tensions(p, s, first, end):
    """Set the tension setpoints [N]: the agent's, interpolated, or eq. 6 at control rate."""
    if p.law == layout.AGENT:
        for i in range(first, end):
            s.tension_command[i] += s.tension_rate[i]
            s.tension_setpoint[i] = s.tension_command[i]
    elif p.law == layout.EQ6:
        for i in range(first, end):
            error = s.setpoint[i] - s.measured_angle[i]
            factor = scaling_factor(error, p.nominal_tension, p.minimum_tension, p.error_offset)
            s.tension_setpoint[i] = factor * p.nominal_tension
    else:
        for i in range(first, end):
            error = s.setpoint[i] - s.measured_angle[i]
            factor = scaling_factor_printed(error, p.nominal_tension, p.minimum_tension, p.error_offset)
            s.tension_setpoint[i] = factor * p.nominal_tension


@compiled
def command_drives(p, s, m, i, biceps, triceps, kick_biceps, kick_triceps):
    """Limit and set both commands, and add their change to ISAV (eq. 8, as a sum over control ticks) and effort.

    The effort excludes the contribution of the setpoint's jump, which is the same under every law.
    """
    limit = p.command_limit
    effort_biceps = min(max(biceps - kick_biceps, -limit), limit) - s.command_biceps[i]
    effort_triceps = min(max(triceps - kick_triceps, -limit), limit) - s.command_triceps[i]
    s.effort_biceps[i] += m.counting[i] * effort_biceps * effort_biceps / p.control_period
    s.effort_triceps[i] += m.counting[i] * effort_triceps * effort_triceps / p.control_period
    biceps = min(max(biceps, -limit), limit)
    triceps = min(max(triceps, -limit), limit)
    change_biceps = biceps - s.command_biceps[i]
    change_triceps = triceps - s.command_triceps[i]
    s.isav_biceps[i] += m.counting[i] * change_biceps * change_biceps / p.control_period
    s.isav_triceps[i] += m.counting[i] * change_triceps * change_triceps / p.control_period
    s.iav_biceps[i] += m.counting[i] * abs(change_biceps)
    s.iav_triceps[i] += m.counting[i] * abs(change_triceps)
    s.previous_setpoint[i] = s.setpoint[i]
    s.command_biceps[i] = biceps
    s.command_triceps[i] = triceps
