"""The equations of motion of the device in a lane, by its profile and its scenario: strings, joint, drives, obstacle.

The functions take what those of :mod:`amulett_gym.simulation.kernel` do; the mathematics is in
:mod:`amulett_gym.model`.
"""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.damping import decay_rate, preload_force
from amulett_gym.model.drive import drive_rate, loaded_drive_rate
from amulett_gym.model.plant import (
    contact_torque,
    deflection_biceps,
    deflection_triceps,
    joint_acceleration,
    weight_torque,
)
from amulett_gym.model.spring import force_beyond, look_up, look_up_slope, slider_beyond, slope_beyond


@compiled
def string_forces(p, c, i, angle, drive_biceps, drive_triceps, extended):
    """Return the forces of both strings [N]; a drive without a lag gives way to more than its stall torque."""
    biceps = c.spring_biceps_factor[i] * spring_force(p, stretch_biceps(p, c, i, drive_biceps, angle), extended)
    triceps = c.spring_triceps_factor[i] * spring_force(p, stretch_triceps(p, c, i, drive_triceps, angle), extended)
    if extended is not None and p.inverse_lag == 0.0:
        biceps = min(biceps, p.stall_torque / (p.drive_radius * c.pulley_biceps_factor[i]))
        triceps = min(triceps, p.stall_torque / (p.drive_radius * c.pulley_triceps_factor[i]))
    return biceps, triceps


@compiled
def drive_rates(p, c, s, i, angle_biceps, angle_triceps, force_biceps, force_triceps, extended):
    """Return the speeds of both drives [rad/s]."""
    if extended is None:
        biceps = drive_rate(s.command_biceps[i], angle_biceps, p.inverse_lag, p.rate_limit)
        triceps = drive_rate(s.command_triceps[i], angle_triceps, p.inverse_lag, p.rate_limit)
    else:
        load = p.drive_radius / p.stall_torque
        load_biceps = force_biceps * c.pulley_biceps_factor[i] * load
        load_triceps = force_triceps * c.pulley_triceps_factor[i] * load
        biceps = loaded_drive_rate(s.command_biceps[i], angle_biceps, p.inverse_lag, p.rate_limit, 1.0, load_biceps)
        triceps = loaded_drive_rate(
            s.command_triceps[i], angle_triceps, p.inverse_lag, p.rate_limit, -1.0, load_triceps
        )
    return biceps, triceps


@compiled
def give_way(p, c, m, first, end, extended):
    """Turn drives without a lag back to where their strings load them with no more than the stall torque."""
    if extended is not None and p.inverse_lag == 0.0 and p.stall_torque < math.inf:
        for i in range(first, end):
            at_biceps = stretch_biceps(p, c, i, m.biceps[i], m.angle[i])
            at_triceps = stretch_triceps(p, c, i, m.triceps[i], m.angle[i])
            radius_biceps = p.drive_radius * c.pulley_biceps_factor[i]
            radius_triceps = p.drive_radius * c.pulley_triceps_factor[i]
            slip_biceps = slip(p, at_biceps, p.stall_torque / (radius_biceps * c.spring_biceps_factor[i]))
            slip_triceps = slip(p, at_triceps, p.stall_torque / (radius_triceps * c.spring_triceps_factor[i]))
            m.biceps[i] -= slip_biceps / (p.inverse_max_deflection * radius_biceps)
            m.triceps[i] += slip_triceps / (p.inverse_max_deflection * radius_triceps)


@compiled
def slip(p, position, force):
    """Return by how much a position is beyond the one with a string force [N], by bisection; 0 if it is not."""
    if spring_force(p, position, True) <= force:
        return 0.0
    low, high = 0.0, position
    for _ in range(60):
        middle = 0.5 * (low + high)
        if spring_force(p, middle, True) < force:
            low = middle
        else:
            high = middle
    return position - 0.5 * (low + high)


@compiled
def acceleration(p, c, i, angle, velocity, drive_biceps, drive_triceps, push, extended):
    """Return the joint's acceleration (eqs. 1-5) [rad/s2]."""
    biceps, triceps = string_forces(p, c, i, angle, drive_biceps, drive_triceps, extended)
    weight = weight_torque(c.static_torque[i], angle)
    return acceleration_by(p, c, i, angle, velocity, biceps, triceps, weight, push)


@compiled
def acceleration_by(p, c, i, angle, velocity, force_biceps, force_triceps, weight, push):
    """Return the joint's acceleration [rad/s2] by the forces of both strings [N] (eq. 1)."""
    preload = preload_force(force_biceps, force_triceps, p.damping_by_mean)
    decay = c.friction[i] * decay_rate(preload, p.damping_a, p.damping_b, p.damping_c, p.damping_d)
    external = push + obstacle_torque(c, i, angle, velocity)
    return joint_acceleration(
        velocity, force_biceps, force_triceps, decay, weight, external, c.inertia[i], p.joint_radius
    )


@compiled
def spring_force(p, position, extended):
    """Return the force of the profile's springs [N] at a deflection, a share of the look-up tables' range."""
    force = look_up(p.force_table, position)
    if extended is not None:
        force += force_beyond(position, p.beyond_slope, p.beyond_free_length, p.beyond_width)
    return force


@compiled
def slider_deflection(p, position, extended):
    """Return the linear spring's deflection [m] at a string's deflection, a share of the look-up tables' range."""
    deflection = look_up(p.spring_table, position)
    if extended is not None:
        deflection += slider_beyond(position, p.beyond_slider, p.beyond_width)
    return deflection


@compiled
def stretch_biceps(p, c, i, drive, angle):
    """Return the deflection of the biceps' string as a share of the look-up tables' range."""
    radius = p.drive_radius * c.pulley_biceps_factor[i]
    return deflection_biceps(drive, angle, radius, p.joint_radius) * p.inverse_max_deflection


@compiled
def stretch_triceps(p, c, i, drive, angle):
    """Return the deflection of the triceps' string as a share of the look-up tables' range."""
    radius = p.drive_radius * c.pulley_triceps_factor[i]
    return deflection_triceps(drive, angle, radius, p.joint_radius) * p.inverse_max_deflection


@compiled
def obstacle_torque(c, i, angle, velocity):
    """Return the torque of the scenario's obstacle [N m]."""
    stiffness, damping = float(c.obstacle_stiffness[i]), float(c.obstacle_damping[i])
    return contact_torque(angle, velocity, c.obstacle_angle[i], float(c.obstacle_side[i]), stiffness, damping)


@compiled
def update_string_forces(p, c, s, i, extended):
    """Set the true string forces [N] of the present state."""
    s.force_biceps[i], s.force_triceps[i] = string_forces(
        p, c, i, s.angle[i], s.drive_biceps[i], s.drive_triceps[i], extended
    )


@compiled
def joint_stiffness(p, c, i, angle, drive_biceps, drive_triceps):
    """Return the strings' stiffness about the joint, R_2^2 (f'_1 + f'_2) [N m/rad]."""
    biceps, triceps = stretch_biceps(p, c, i, drive_biceps, angle), stretch_triceps(p, c, i, drive_triceps, angle)
    slope_biceps, slope_triceps = look_up_slope(p.force_table, biceps), look_up_slope(p.force_table, triceps)
    if p.extended:
        slope_biceps += slope_beyond(biceps, p.beyond_slope, p.beyond_free_length, p.beyond_width)
        slope_triceps += slope_beyond(triceps, p.beyond_slope, p.beyond_free_length, p.beyond_width)
    slope_biceps, slope_triceps = c.spring_biceps_factor[i] * slope_biceps, c.spring_triceps_factor[i] * slope_triceps
    return (slope_biceps + slope_triceps) * p.inverse_max_deflection * p.joint_radius * p.joint_radius


@compiled
def recorded_stiffness(p, c, i, angles, drives_biceps, drives_triceps):
    """Return the `joint_stiffness` [N m/rad] of one device at recorded angles [rad]."""
    stiffness = np.empty(angles.size)
    for row in range(angles.size):
        stiffness[row] = joint_stiffness(p, c, i, angles[row], drives_biceps[row], drives_triceps[row])
    return stiffness
