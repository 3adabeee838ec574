"""Privileged observations: the hidden state of a device, its scenario included.

For the *causal reference* only: a policy that is trained with ``privileged=True`` shows what is possible if payload,
obstacle, coming pushes and all else are known. It cannot act on a real device.
"""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.damping import decay_rate
from amulett_gym.model.plant import weight_torque
from amulett_gym.model.spring import inverse_look_up, look_up
from amulett_gym.simulation.layout import LANES, Family

_SOON = 2.0
"""Horizon for coming events [s]: about the time between two of them in the suites."""

PRIVILEGED_SCALES = {
    # the device: relative deviation from its profile
    "spring_biceps_factor": 0.25,
    "spring_triceps_factor": 0.25,
    "pulley_biceps_factor": 0.04,
    "pulley_triceps_factor": 0.04,
    "damping_factor": 0.5,
    "noise_factor": 1.5,
    "loaded_inertia": 3.0,  # with the payload
    # sensor offsets [rad, m, m]; probability of a late tick
    "encoder_bias": math.radians(0.6),
    "slider_bias_biceps": 1e-4,
    "slider_bias_triceps": 1e-4,
    "late_probability": 0.2,
    # true state [rad, rad/s, N, N]; integrals of the controllers [rad]
    "true_error": math.radians(90.0),
    "true_velocity": math.radians(500.0),
    "force_biceps": 20.0,
    "force_triceps": 20.0,
    "position_integral": math.radians(720.0),
    "tension_integral": math.radians(180.0),
    # torques on the joint [N m]: weight at the horizontal, weight at this angle, pushes with shaking, obstacle
    "static_torque": 0.6,
    "weight_torque": 0.6,
    "push_torque": 0.6,
    "contact_torque": 1.0,
    # obstacle: existence, distance [rad], side, compliance [rad/(N m)], damping [N m s/rad]
    "obstacle": 1.0,
    "obstacle_distance": math.radians(60.0),
    "obstacle_side": 1.0,
    "obstacle_yield": 0.3,
    "obstacle_damping": 0.05,
    # remaining time of the present push [s]; time until the next one [s], its torque [N m], duration [s], rise [s]
    "push_remaining": _SOON,
    "next_push_in": _SOON,
    "next_push_torque": 0.6,
    "next_push_duration": _SOON,
    "next_push_rise": 0.5,
    "shake_rms": 0.1,
    "shake_bandwidth": 4.0,  # [Hz]
    # rest of the present move [rad, s]; time until the next one [s], its change [rad], duration [s]
    "move_remaining": math.radians(90.0),
    "move_ends_in": _SOON,
    "next_move_in": _SOON,
    "next_move_change": math.radians(90.0),
    "next_move_duration": 1.5,
    "wave_amplitude": math.radians(25.0),
    "wave_frequency": 1.0,  # now [Hz]
    "wave_sine": 1.0,
    "wave_cosine": 1.0,
    # time until rewards count [s]; family, whose prices apply
    "counts_in": 0.5,
    **{f"family_{family.replace('-', '_')}": 1.0 for family in get_args(Family)},
}
"""Name of each entry, in order -> the value that 1 stands for; all entries are clipped to [-1, 1]."""

PRIVILEGED = tuple(PRIVILEGED_SCALES)
"""Names of the entries that follow those of `transition.OBSERVATIONS`."""

FLEET_SCALES = {
    "device_radius_ratio": 0.5,  # R_1 / R_2
    "device_inertia": 0.02,  # of the bare arm [kg m2]
    "device_lag": 0.1,  # of the drives [s]
    "device_rate_limit": math.radians(2000.0),  # [rad/s]; none is 1
    "device_max_deflection": 0.02,  # of a string [m]
    # force of the springs at a third, two thirds and the end of that deflection [N]
    "device_force_third": 40.0,
    "device_force_two_thirds": 40.0,
    "device_force_end": 40.0,
    # decay rate at a preload of 2 and 15 N [1/s]
    "device_damping_low": 20.0,
    "device_damping_high": 20.0,
    "device_encoder_noise": math.radians(1.0),
    "device_slider_noise": 1e-4,  # [m]
    "device_control_period": 0.01,  # [s]
}
"""The same of the entries that describe the device itself, last, with a fleet."""

FLEET_PRIVILEGED = tuple(FLEET_SCALES)

_SCALES = np.array(list(PRIVILEGED_SCALES.values()))
_SENSORS, _TRUTH, _LOADS = (PRIVILEGED.index(name) for name in ("encoder_bias", "true_error", "static_torque"))
_OBSTACLE, _PUSHES, _MOVES = (PRIVILEGED.index(name) for name in ("obstacle", "push_remaining", "move_remaining"))
_WAVE, _TASK = PRIVILEGED.index("wave_amplitude"), PRIVILEGED.index("counts_in")
_SLACK = 1e-6  # [s]; a fraction of a control tick


def describe_devices(parameters: NDArray[np.void], bare_inertia: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the entries of `FLEET_PRIVILEGED`, a row for each of `layout.PARAMETERS` and arm's inertia [kg m2]."""
    rows = []
    for p, of_arm in zip(parameters, bare_inertia, strict=True):
        table, end = p["force_table"], 1.0
        if look_up(table, end) > p["max_force"]:  # with an elastic structure it may go on beyond the springs' range
            end = inverse_look_up(table, p["max_force"])
        forces = [look_up(table, share * end) for share in (1.0 / 3.0, 2.0 / 3.0, 1.0)]
        fit = [p[f"damping_{name}"] for name in "abcd"]
        rows.append(
            [
                p["drive_radius"] / p["joint_radius"],
                of_arm,
                1.0 / p["inverse_lag"] if p["inverse_lag"] > 0.0 else 0.0,
                p["rate_limit"],
                end / p["inverse_max_deflection"],
                *forces,
                *(decay_rate(preload, *fit) for preload in (2.0, 15.0)),
                p["encoder_noise"],
                p["slider_noise"],
                p["control_period"],
            ]
        )
    return np.clip(np.array(rows) / list(FLEET_SCALES.values()), -1.0, 1.0).astype(np.float32)


@compiled
def observe_privileged(p, which, hidden, c_blocks, s_blocks, devices, observations):
    """Write the given devices' hidden state into the last entries of the observations, one row each."""
    values = hidden_values(hidden)
    for row in range(devices.size):
        block, i = devices[row] // LANES, np.uint64(devices[row] % LANES)
        own = which[block]
        observe_hidden(p[own], hidden, own, c_blocks[block], s_blocks[block], i, values, observations[row])


@compiled
def hidden_values(hidden):
    """Return room for the hidden state of a device, or None if that is not observed."""
    if hidden is None:
        return None
    return np.empty(_SCALES.size)


@compiled
def observe_hidden(p, hidden, own, c, s, i, values, row):
    """Write a device's hidden state into the last entries of a row.

    Absent features (obstacle, push, move, wave) are 0; times until them are 1. `hidden` has, for each profile, the
    inertia [kg m2] of its arm without a payload, and the last entries, which describe it; None: nothing is written, and
    code for that is not compiled. `own` is the index of the profile, `values` room as of `hidden_values`.
    """
    if hidden is None:
        return
    bare_inertia, described = hidden
    time = s.tick[i] * p.control_period
    _write_device(bare_inertia[own], c, i, values)
    _write_truth(c, s, i, values)
    _write_obstacle(c, s, i, values[_OBSTACLE:])
    _write_pushes(c, i, time, values[_PUSHES:])
    _write_moves(c, s, i, time, values[_MOVES:])
    _write_wave(c, i, time, values[_WAVE:])
    values[_TASK] = max(c.measure_from[i] - time, 0.0)
    for k in range(1, _SCALES.size - _TASK):
        values[_TASK + k] = 1.0 if c.family[i] == k else 0.0
    entries = described.shape[1]
    first = row.size - entries - _SCALES.size
    for k in range(_SCALES.size):
        row[first + k] = min(max(values[k] / _SCALES[k], -1.0), 1.0)
    for k in range(entries):
        row[first + _SCALES.size + k] = described[own, k]


@compiled
def _write_device(bare_inertia, c, i, values):
    """Write the device's deviations from its profile, its payload included."""
    built, sensors = values, values[_SENSORS:]
    built[0] = c.spring_biceps_factor[i] - 1.0
    built[1] = c.spring_triceps_factor[i] - 1.0
    built[2] = c.pulley_biceps_factor[i] - 1.0
    built[3] = c.pulley_triceps_factor[i] - 1.0
    built[4] = c.damping_factor[i] - 1.0
    built[5] = c.noise_factor[i] - 1.0
    built[6] = c.inertia[i] / bare_inertia - 1.0
    sensors[0] = c.encoder_bias[i]
    sensors[1] = c.slider_bias_biceps[i]
    sensors[2] = c.slider_bias_triceps[i]
    sensors[3] = c.late_probability[i]


@compiled
def _write_truth(c, s, i, values):
    """Write the true state, then the loads on the joint."""
    truth, loads = values[_TRUTH:], values[_LOADS:]
    truth[0] = s.setpoint[i] - s.angle[i]
    truth[1] = s.velocity[i]
    truth[2] = s.force_biceps[i]
    truth[3] = s.force_triceps[i]
    truth[4] = s.position_integral[i]
    truth[5] = s.tension_integral[i]
    loads[0] = c.static_torque[i]
    loads[1] = weight_torque(c.static_torque[i], s.angle[i]) if c.static_torque[i] != 0.0 else 0.0
    loads[2] = s.push_torque[i]
    loads[3] = s.contact_torque[i]


@compiled
def _write_obstacle(c, s, i, values):
    values[:5] = 0.0
    if c.obstacle_stiffness[i] > 0.0:
        values[0] = 1.0
        values[1] = c.obstacle_side[i] * (c.obstacle_angle[i] - s.angle[i])
        values[2] = c.obstacle_side[i]
        values[3] = np.float32(1.0) / c.obstacle_stiffness[i]  # in the precision of the stored stiffness
        values[4] = c.obstacle_damping[i]


@compiled
def _write_pushes(c, i, time, values):
    """Write the rest of the present push, the next push, the shaking."""
    remaining, wait, following = 0.0, math.inf, -1
    for k in range(c.push_count[i]):
        elapsed = time - c.push_time[k, i]
        if elapsed >= -_SLACK:
            remaining = max(remaining, c.push_duration[k, i] - elapsed)
        elif -elapsed < wait:
            wait, following = -elapsed, k
    values[0] = remaining
    values[1] = min(wait, _SOON)
    values[2:5] = 0.0
    if following >= 0:
        slope = c.push_inverse_rise[following, i]
        values[2] = c.push_torque[following, i]
        values[3] = c.push_duration[following, i]
        values[4] = 1.0 / slope if slope > 0.0 else 0.0
    values[5] = c.shake_rms[i]
    values[6] = c.shake_bandwidth[i]


@compiled
def _write_moves(c, s, i, time, values):
    """Write the rest of the setpoint's present move, then its next move."""
    present = s.move[i]
    target, left = c.initial_angle[i], 0.0
    if present >= 0:
        target = c.move_angle[present, i]
        left = max(c.move_time[present, i] + c.move_duration[present, i] - time, 0.0)
    values[0] = target - (s.setpoint[i] - s.setpoint_wave[i]) if left > 0.0 else 0.0
    values[1] = left
    values[2], values[3], values[4] = _SOON, 0.0, 0.0
    following = present + 1
    if following < c.move_count[i]:
        values[2] = min(c.move_time[following, i] - time, _SOON)
        values[3] = c.move_angle[following, i] - target
        values[4] = c.move_duration[following, i]


@compiled
def _write_wave(c, i, time, values):
    elapsed = time - c.wave_time[i]
    values[0] = c.wave_amplitude[i]
    values[1] = c.wave_frequency[i]
    values[2], values[3] = 0.0, 0.0
    if c.wave_amplitude[i] > 0.0 and 0.0 <= elapsed < c.wave_duration[i] - _SLACK:
        phase = 2.0 * math.pi * elapsed * (c.wave_frequency[i] + 0.5 * c.wave_chirp[i] * elapsed)
        values[1] = c.wave_frequency[i] + c.wave_chirp[i] * elapsed
        values[2] = math.sin(phase)
        values[3] = math.cos(phase)
