"""What the microcontroller reads of the device in a lane: the joint angle, both sliders, and the forces by these."""

from __future__ import annotations

import numpy as np

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.sensors import quantise, read_slider
from amulett_gym.model.spring import estimate_force
from amulett_gym.simulation import layout
from amulett_gym.simulation.commands import low_pass
from amulett_gym.simulation.dynamics import slider_deflection, stretch_biceps, stretch_triceps
from amulett_gym.simulation.random import noise

SENSOR_STREAMS = np.uint64(4)
ENCODER, SLIDER_BICEPS, SLIDER_TRICEPS, LATENESS = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def read_sensors(p, c, s, i, extended):
    """Measure the joint angle and both springs, and estimate the string forces."""
    key = c.noise_key[i]
    counter = np.uint64(s.tick[i]) * SENSOR_STREAMS
    more = c.noise_factor[i]
    angle_error = c.encoder_bias[i] + more * sensor_noise(p.encoder_noise, key, counter + ENCODER)
    s.measured_angle[i] = quantise(s.angle[i] + angle_error, p.encoder_resolution)
    biceps = stretch_biceps(p, c, i, s.drive_biceps[i], s.angle[i])
    triceps = stretch_triceps(p, c, i, s.drive_triceps[i], s.angle[i])
    s.measured_biceps[i] = read_slider(
        slider_deflection(p, biceps, extended),
        c.slider_bias_biceps[i] + more * sensor_noise(p.slider_noise, key, counter + SLIDER_BICEPS),
        p.slider_resolution,
        p.slider_travel,
    )
    s.measured_triceps[i] = read_slider(
        slider_deflection(p, triceps, extended),
        c.slider_bias_triceps[i] + more * sensor_noise(p.slider_noise, key, counter + SLIDER_TRICEPS),
        p.slider_resolution,
        p.slider_travel,
    )
    difference = s.measured_biceps[i] - s.measured_triceps[i]
    s.measured_difference[i] = low_pass(s.measured_difference[i], difference, p.switch_filter, p.control_period)
    raw = estimate_force(p.estimate_table, s.measured_biceps[i], p.max_spring_deflection)
    s.untrusted_biceps[i] = raw < p.force_floor
    trusted = trust(p, raw, s.estimate_biceps[i])
    s.estimate_biceps[i] = low_pass(s.estimate_biceps[i], trusted, p.force_filter, p.control_period)
    raw = estimate_force(p.estimate_table, s.measured_triceps[i], p.max_spring_deflection)
    s.untrusted_triceps[i] = raw < p.force_floor
    trusted = trust(p, raw, s.estimate_triceps[i])
    s.estimate_triceps[i] = low_pass(s.estimate_triceps[i], trusted, p.force_filter, p.control_period)


@compiled
def sensor_noise(deviation, key, counter):
    """Return noise of a standard deviation; nothing is drawn for an exact sensor."""
    return deviation * noise(key, counter) if deviation > 0.0 else 0.0


@compiled
def trust(p, estimate, last):
    """Return the force estimate after the treatment of those below the floor (Figure 5b)."""
    below = p.force_floor if p.below_floor == layout.CLAMP else last
    below = estimate if p.below_floor == layout.IGNORE else below
    return estimate if estimate >= p.force_floor else below
