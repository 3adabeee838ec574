"""The start of an episode: the device at rest in static equilibrium, and what its loop remembers that holds it there.

The functions take what those of :mod:`amulett_gym.simulation.kernel` do.
"""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.control.agonist import BICEPS, TRICEPS
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.plant import weight_torque
from amulett_gym.model.spring import inverse_look_up
from amulett_gym.simulation import layout
from amulett_gym.simulation.dynamics import (
    obstacle_torque,
    slider_deflection,
    spring_force,
    stretch_biceps,
    stretch_triceps,
    update_string_forces,
)
from amulett_gym.simulation.kernel import shares
from amulett_gym.simulation.loops import begin_loop
from amulett_gym.simulation.sensors import read_sensors, trust
from amulett_gym.simulation.setpoint import add_wave, find_setpoints


@compiled
def settle(p, which, c_blocks, s_blocks, paths, loop, extended, devices):
    """Reset the given devices, at rest at their initial angle with their initial tension."""
    for device in devices:
        # Unsigned as in a tick, so that nothing is compiled twice.
        block, i = device // layout.LANES, np.uint64(device % layout.LANES)
        c, s, own = c_blocks[block], s_blocks[block], which[block]
        parameters = p[own]
        settle_strings(parameters, c, s, i, extended)
        s.setpoint[i] = s.previous_setpoint[i] = s.angle[i]
        read_sensors(parameters, c, s, i, extended)
        s.position_signal[i] = s.setpoint[i] - s.measured_angle[i]
        if not parameters.position_on_error:
            s.position_signal[i] = -s.measured_angle[i]
        estimate = s.estimate_triceps[i] if s.agonist[i] == BICEPS else s.estimate_biceps[i]
        s.tension_signal[i] = s.tension_setpoint[i] - estimate
        if not parameters.tension_on_error:
            s.tension_signal[i] = -estimate
        find_setpoints(parameters, c, s, paths, block, i, i + np.uint64(1))
        if c.wave_amplitude[i] > 0.0:
            add_wave(parameters, c, s, i)
        begin(parameters, c, s, loop, own, block, i)


@compiled
def begin(p, c, s, loop, own, block, i):
    """Set the memory of a loop that is not the paper's."""
    if loop is not None:
        begin_loop(p, loop[0][own], c, s, loop[1][block], i)


@compiled
def settle_strings(p, c, s, i, extended):
    """Set the static equilibrium, and the controllers' memory that holds it."""
    angle = c.initial_angle[i]
    radius_biceps = p.drive_radius * c.pulley_biceps_factor[i]
    radius_triceps = p.drive_radius * c.pulley_triceps_factor[i]
    # Drive angles at which the strings are just slack.
    wound_biceps = angle * p.joint_radius / radius_biceps
    wound_triceps = angle * p.joint_radius / radius_triceps
    needed = (weight_torque(c.static_torque[i], angle) - obstacle_torque(c, i, angle, 0.0)) / p.joint_radius
    tension = c.initial_tension[i]
    s.agonist[i] = p.fixed_agonist
    if p.fixed_agonist == 0.0:
        s.agonist[i] = TRICEPS if needed < 0.0 else BICEPS
    biceps_is_agonist = s.agonist[i] == BICEPS
    if p.tension_loop:
        # The antagonist has the tension, the agonist in addition the load, which may be negative.
        pull_biceps = tension + needed if biceps_is_agonist else tension
        pull_triceps = tension if biceps_is_agonist else tension - needed
        biceps = inverse_look_up(p.force_table, pull_biceps / c.spring_biceps_factor[i]) / p.inverse_max_deflection
        triceps = inverse_look_up(p.force_table, pull_triceps / c.spring_triceps_factor[i]) / p.inverse_max_deflection
        turn_biceps = wound_biceps + biceps / radius_biceps
        turn_triceps = wound_triceps - triceps / radius_triceps
    else:
        common = position_only_equilibrium(p, c, i, needed, wound_biceps - wound_triceps, extended)
        turn_biceps = wound_biceps + common + p.position_only_offset
        turn_triceps = wound_biceps + common - p.position_only_offset
    s.angle[i] = angle
    s.drive_biceps[i] = s.command_biceps[i] = turn_biceps
    s.drive_triceps[i] = s.command_triceps[i] = turn_triceps
    update_string_forces(p, c, s, i, extended)
    if p.tension_loop:
        output = turn_biceps if biceps_is_agonist else turn_triceps
        biceps_share, triceps_share = shares(p, s.agonist[i])
        s.offset_biceps[i] = turn_biceps - output * biceps_share
        s.offset_triceps[i] = turn_triceps - output * triceps_share
    else:
        output = wound_biceps + common
        s.offset_biceps[i] = p.position_only_offset
        s.offset_triceps[i] = -p.position_only_offset
        tension = s.force_triceps[i] if biceps_is_agonist else s.force_biceps[i]
    s.position_output[i] = s.position_integral[i] = output
    s.tension_setpoint[i] = s.tension_command[i] = tension
    s.stiffness_setpoint[i] = math.nan  # most loops take none
    biceps = stretch_biceps(p, c, i, turn_biceps, angle)
    triceps = stretch_triceps(p, c, i, turn_triceps, angle)
    s.measured_difference[i] = slider_deflection(p, biceps, extended) - slider_deflection(p, triceps, extended)
    # The microcontroller knows the profile's springs only.
    biceps, triceps = s.force_biceps[i] / c.spring_biceps_factor[i], s.force_triceps[i] / c.spring_triceps_factor[i]
    s.estimate_biceps[i], s.estimate_triceps[i] = trust(p, biceps, biceps), trust(p, triceps, triceps)
    # A tension below the floor is overestimated; the controller starts with output zero nevertheless.
    estimate = s.estimate_triceps[i] if biceps_is_agonist else s.estimate_biceps[i]
    s.tension_integral[i] = p.tension_kp * (estimate - tension)
    s.contact_torque[i] = obstacle_torque(c, i, angle, 0.0)
    s.inside_since[i] = math.nan
    s.move[i] = -1


@compiled
def position_only_equilibrium(p, c, i, needed, apart, extended):
    """Return by bisection the turn of both drives beyond the biceps' slack angle [rad] for f_1 - f_2 = `needed` [N].

    `apart` is the biceps' slack angle minus the triceps' [rad].
    """
    reach = 1.0 / (p.inverse_max_deflection * p.drive_radius) + p.position_only_offset
    low, high = -2.0 * reach, 2.0 * reach
    scale_biceps = p.drive_radius * c.pulley_biceps_factor[i] * p.inverse_max_deflection
    scale_triceps = p.drive_radius * c.pulley_triceps_factor[i] * p.inverse_max_deflection
    for _ in range(60):
        middle = 0.5 * (low + high)
        biceps = spring_force(p, (middle + p.position_only_offset) * scale_biceps, extended)
        triceps = spring_force(p, (p.position_only_offset - middle - apart) * scale_triceps, extended)
        if c.spring_biceps_factor[i] * biceps - c.spring_triceps_factor[i] * triceps < needed:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
