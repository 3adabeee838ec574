"""The control tick: control, drive, integrate, sense.

The microcontroller reads its sensors at the end of a tick and acts on the readings in the next one, so that an agent
between two ticks observes exactly what the loop observes. Every function takes the parameters `p`, a block of scenarios
`c`, a block of states `s` and the lane `i` of the device in the block (see :mod:`amulett_gym.simulation.layout`); `m`
is the block's motion within the tick.

A tick is a sequence of stages, each one or more loops over the block's lanes that the compiler can vectorise (SIMD).
Therefore: where lanes differ, both values are computed and one is chosen; loops whose length differs from lane to lane
have a stage of their own; so do sines that most devices do not need, since vectorised code computes what a branch would
skip; choices that are the same for all lanes are made outside the loops, since a parameter that is read in a branch of
a loop is fetched for each lane; and no stage is too long. A lane's arithmetic does not depend on its position, so the
bits depend neither on the device's neighbours nor on their number.
"""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.control.agonist import BICEPS, TRICEPS
from amulett_gym.control.pid import filtered_derivative, integrate
from amulett_gym.jit.compiled import compiled, compiled_in_place, compiled_lanes
from amulett_gym.model.plant import weight_torque
from amulett_gym.simulation import layout
from amulett_gym.simulation.commands import FARTHEST, choose, choose_agonists, choose_tensions, command_drives, low_pass
from amulett_gym.simulation.dynamics import (
    acceleration_by,
    drive_rates,
    give_way,
    obstacle_torque,
    string_forces,
    update_string_forces,
)
from amulett_gym.simulation.layout import TIME_SLACK
from amulett_gym.simulation.loops import predict_drives, run_loop
from amulett_gym.simulation.metrics import start_counting, track_steps
from amulett_gym.simulation.random import noise, random_bits
from amulett_gym.simulation.sensors import LATENESS, SENSOR_STREAMS, read_sensors
from amulett_gym.simulation.setpoint import add_waves, find_setpoints

SHAKE_STREAM = np.uint64(0x5A4E)
NEGLIGIBLE = 1e-100  # [rad]; changes no bit of a command or of a sum


@compiled
def advance(p, which, c_blocks, s_blocks, paths, loop, extended, num_devices, ticks):
    """Advance all devices by a number of control ticks; a device that failed keeps its state.

    `which` holds the index of each block's profile, into `p` and the gains of `loop`. `paths` is `layout.Paths`, or
    None: then the code for paths is not compiled. `loop` is `layout.Loop`, or None: then the paper's loop runs, and the
    code for others is not compiled. `extended` is `Simulation.extended`, True or None: then the code for springs beyond
    their table and for drives that stall is not compiled.
    """
    # The array is used in each round: numba frees it after its last use, whether or not a record of it is in use.
    motion = np.empty(1, dtype=layout.MOTION_BLOCK)
    for block in range(s_blocks.shape[0]):
        lanes, own = min(layout.LANES, num_devices - block * layout.LANES), which[block]
        advance_block(
            p[own], c_blocks[block], s_blocks[block], motion[0], paths, loop, extended, own, block, lanes, ticks
        )


@compiled_in_place
def advance_block(p, c, s, m, paths, loop, extended, own, block, lanes, ticks):
    """Advance the devices in a block's first lanes by a number of control ticks; `own` is its profile's index."""
    for _ in range(ticks):
        first = 0
        while first < lanes:
            end = next_failed(s, first, lanes)
            # Unsigned: numba checks whether a signed index is negative, lane by lane.
            tick(p, c, s, m, paths, loop, extended, own, block, np.uint64(first), np.uint64(end))
            first = end + 1


@compiled
def next_failed(s, first, lanes):
    """Return the next lane whose device has failed, or the number of lanes."""
    for i in range(first, lanes):
        if s.failure[i] != layout.RUNNING:
            return i
    return lanes


@compiled_in_place
def tick(p, c, s, m, paths, loop, extended, own, block, first, end):
    """Advance the devices in the lanes from `first` to before `end` by one control tick."""
    start_counting(p, c, s, m, first, end)
    lane = first
    while lane < end:
        late = next_late(c, s, lane, end)
        act(p, s, m, loop, own, block, lane, late)
        lane = late + np.uint64(1)
    predict(s, loop, own, block, first, end)
    begin_motion(p, c, s, m, first, end)
    shake(p, c, s, m, first, end)
    move(p, c, s, m, first, end, extended)
    find_setpoints(p, c, s, paths, block, first, end)
    add_waves(p, c, s, first, end)
    track_steps(p, c, s, m, first, end)


@compiled
def next_late(c, s, first, end):
    """Return the next lane that misses its control tick (its commands are held for one more period), or `end`."""
    for i in range(first, end):
        if c.late_probability[i] > 0.0:
            counter = np.uint64(s.tick[i]) * SENSOR_STREAMS + LATENESS
            if float(random_bits(c.noise_key[i], counter)) * 2.0**-64 < c.late_probability[i]:
                return i
    return end


@compiled
def act(p, s, m, loop, own, block, first, end):
    """Stage 1: command the drives from the sensor readings."""
    if loop is None:
        run_paper_loop(p, s, m, first, end)
    else:
        run_loop(p, loop[0][own], s, loop[1][block], m, first, end)


@compiled
def run_paper_loop(p, s, m, first, end):
    """Stage 1 with the loop of section 2.2: set both drives' position commands from the sensor readings."""
    choose_agonists(p, s, m, first, end)
    if p.tension_loop:
        choose_tensions(p, s, first, end)
        control_tensions(p, s, m, first, end)
    control_positions(p, s, m, first, end)


@compiled_lanes
def control_tensions(p, s, m, first, end):
    """Stage 1, continued: run the tension controllers, and set the commands' offsets where the agonist switches."""
    for i in range(first, end):
        switched = m.switched[i] > 0.0
        control_tension(p, s, i, switched)
        # At a switch the offsets are set from the previous commands: each command then changes by the position
        # controller's ordinary increment only, although the tension controller restarts on the other string.
        biceps_share, triceps_share = shares(p, s.agonist[i])
        offset_biceps = s.command_biceps[i] - biceps_share * s.position_output[i]
        offset_triceps = s.command_triceps[i] - triceps_share * s.position_output[i]
        s.offset_biceps[i] = choose(switched, offset_biceps, s.offset_biceps[i])
        s.offset_triceps[i] = choose(switched, offset_triceps, s.offset_triceps[i])


@compiled_lanes
def control_positions(p, s, m, first, end):
    """Stage 1, continued: run the position controllers, and command the drives."""
    for i in range(first, end):
        control_position(p, s, i, s.setpoint[i] - s.measured_angle[i])
        agonist, pull = s.agonist[i], s.tension_output[i]
        biceps_share, triceps_share = shares(p, agonist)
        biceps = s.offset_biceps[i] + biceps_share * s.position_output[i] + (pull if agonist == TRICEPS else 0.0)
        triceps = s.offset_triceps[i] + triceps_share * s.position_output[i] - (pull if agonist == BICEPS else 0.0)
        kick = setpoint_kick(p, s, m, i)
        command_drives(p, s, m, i, biceps, triceps, biceps_share * kick, triceps_share * kick)


@compiled
def shares(p, agonist):
    """Return the shares of the position controller's output in the commands of biceps' and triceps' drive."""
    biceps = choose(agonist == BICEPS, 1.0, p.antagonist_share)
    triceps = choose(agonist == BICEPS, p.antagonist_share, 1.0)
    return biceps, triceps


@compiled
def control_position(p, s, i, error):
    """Run the joint's position controller."""
    signal = error if p.position_on_error else -s.measured_angle[i]
    s.position_derivative[i] = filtered_derivative(
        s.position_derivative[i], signal - s.position_signal[i], p.position_kd, p.position_filter, p.control_period
    )
    s.position_signal[i] = signal
    command = choose(s.agonist[i] == BICEPS, s.command_biceps[i], s.command_triceps[i])
    s.position_integral[i] = integrate(
        s.position_integral[i],
        error,
        p.position_ki,
        p.control_period,
        command < p.command_limit,
        command > -p.command_limit,
    )
    s.position_output[i] = p.position_kp * error + s.position_integral[i] + s.position_derivative[i]


@compiled
def control_tension(p, s, i, restart):
    """Run the antagonist's tension controller; after a switch it restarts on the other string with output zero."""
    biceps_is_antagonist = s.agonist[i] == TRICEPS
    estimate = choose(biceps_is_antagonist, s.estimate_biceps[i], s.estimate_triceps[i])
    untrusted = choose(biceps_is_antagonist, s.untrusted_biceps[i], s.untrusted_triceps[i])
    measured = choose(biceps_is_antagonist, s.measured_biceps[i], s.measured_triceps[i])
    command = choose(biceps_is_antagonist, s.command_biceps[i], -s.command_triceps[i])
    error = s.tension_setpoint[i] - estimate
    if p.below_floor == layout.IGNORE and untrusted:
        error = 0.0
    signal = error if p.tension_on_error else -estimate
    derivative = filtered_derivative(
        s.tension_derivative[i], signal - s.tension_signal[i], p.tension_kd, p.tension_filter, p.control_period
    )
    # No headroom where the drive or the sensor is at its limit: above the table, below the floor.
    integral = integrate(
        s.tension_integral[i],
        error,
        p.tension_ki,
        p.control_period,
        measured < p.slider_end and command < p.command_limit,
        command > -p.command_limit and not untrusted,
    )
    s.tension_derivative[i] = 0.0 if restart else derivative
    s.tension_integral[i] = -p.tension_kp * error if restart else integral
    s.tension_signal[i] = signal
    s.tension_output[i] = p.tension_kp * error + s.tension_integral[i] + s.tension_derivative[i]


@compiled
def setpoint_kick(p, s, m, i):
    """Return the part of the position controller's output in this tick that a jump of the setpoint causes [rad].

    It passes through the proportional and the derivative term and does not depend on arm and tension.
    """
    decayed = s.kick_derivative[i]
    if p.position_on_error:
        derivative = filtered_derivative(
            decayed, s.setpoint_jump[i], p.position_kd, p.position_filter, p.control_period
        )
        # Without end, it would decay to subnormal numbers, with which some processors take a third longer for a tick.
        s.kick_derivative[i] = choose(abs(derivative) < NEGLIGIBLE, 0.0, derivative)
    kick = p.position_kp * s.setpoint_jump[i] + s.kick_derivative[i] - decayed
    s.isav_kick[i] += m.counting[i] * kick * kick / p.control_period
    s.setpoint_jump[i] = 0.0
    return kick


@compiled
def predict(s, loop, own, block, first, end):
    """Advance the drives' model within a loop that has one, late ticks included, to the end of the tick."""
    if loop is not None:
        predict_drives(loop[0][own], s, loop[1][block], first, end)


@compiled_lanes
def begin_motion(p, c, s, m, first, end):
    """Stage 2: set the initial motion, no weight yet (`weigh`), and the push, constant in a tick as are commands."""
    for i in range(first, end):
        time = s.tick[i] * p.control_period
        push = 0.0
        for k in range(layout.MAX_PUSHES):
            elapsed = time - c.push_time[k, i]
            remaining = c.push_duration[k, i] - elapsed
            acts = k < c.push_count[i] and elapsed >= -TIME_SLACK and remaining > TIME_SLACK
            ramp = min(max(min(elapsed, remaining), 0.0) * c.push_inverse_rise[k, i], 1.0)
            strength = choose(c.push_inverse_rise[k, i] > 0.0, ramp, 1.0)
            push += choose(acts, strength * c.push_torque[k, i], 0.0)
        ideal = p.inverse_lag == 0.0
        m.push[i] = push
        m.weight[i] = 0.0
        m.angle[i], m.velocity[i] = s.angle[i], s.velocity[i]
        m.biceps[i] = s.command_biceps[i] if ideal else s.drive_biceps[i]
        m.triceps[i] = s.command_triceps[i] if ideal else s.drive_triceps[i]
        clear_rates(m, i)


@compiled_lanes
def shake(p, c, s, m, first, end):
    """Stage 3: add the random torque, if a scenario has one: white noise through two first-order low-passes."""
    for i in range(first, end):
        if c.shake_rms[i] > 0.0:
            elapsed = s.tick[i] * p.control_period - c.shake_time[i]
            if elapsed >= -TIME_SLACK and elapsed < c.shake_duration[i] - TIME_SLACK:
                lag = 1.0 / (2.0 * math.pi * c.shake_bandwidth[i])
                white = noise(c.noise_key[i] ^ SHAKE_STREAM, np.uint64(s.tick[i]))
                s.shake_inner[i] = low_pass(s.shake_inner[i], white, lag, p.control_period)
                s.shake_outer[i] = low_pass(s.shake_outer[i], s.shake_inner[i], lag, p.control_period)
                m.push[i] += c.shake_rms[i] * s.shake_outer[i] / shake_deviation(lag, p.control_period)


@compiled
def shake_deviation(lag, period):
    """Return the standard deviation of unit white noise after two equal low-passes in series.

    Their impulse response is a^2 (n + 1) q^n, where q = lag / (lag + period) and a = 1 - q.
    """
    q = lag / (lag + period)
    return (1.0 - q) ** 2 * math.sqrt((1.0 + q * q) / (1.0 - q * q) ** 3)


@compiled
def move(p, c, s, m, first, end, extended):
    """Stages 4 to 7: integrate over the tick and read the sensors."""
    if extended is not None and p.extended:
        move_as(p, c, s, m, first, end, extended)
    else:
        move_as(p, c, s, m, first, end, None)


@compiled
def move_as(p, c, s, m, first, end, extended):
    """Integrate over the tick and read the sensors; `extended` is None for springs within their table and no stall."""
    h = p.control_period / p.substeps  # of the classical Runge-Kutta method
    for _ in range(p.substeps):
        weigh(c, m, first, end, 0.0)
        evaluate(p, c, s, m, first, end, 0.0, 1.0, extended)
        weigh(c, m, first, end, 0.5 * h)
        evaluate(p, c, s, m, first, end, 0.5 * h, 2.0, extended)
        weigh(c, m, first, end, 0.5 * h)
        evaluate(p, c, s, m, first, end, 0.5 * h, 2.0, extended)
        weigh(c, m, first, end, h)
        evaluate(p, c, s, m, first, end, h, 1.0, extended)
        step(m, first, end, h)
    give_way(p, c, m, first, end, extended)
    sense(p, c, s, m, first, end, extended)


@compiled_lanes
def weigh(c, m, first, end, reach):
    """Stage 4: set the weight's torque `reach` [s] ahead by the last rates of change, where it has one.

    In `evaluate`, the sines of devices without weight would take a quarter of the tick.
    """
    for i in range(first, end):
        if c.static_torque[i] != 0.0:
            m.weight[i] = weight_torque(c.static_torque[i], m.angle[i] + reach * m.angle_rate[i])


@compiled_lanes
def evaluate(p, c, s, m, first, end, reach, weight, extended):
    """Stage 5: evaluate the rates of change `reach` [s] ahead by the last ones, and add them to the step's sum."""
    for i in range(first, end):
        x, v = m.angle[i] + reach * m.angle_rate[i], m.velocity[i] + reach * m.velocity_rate[i]
        a, b = m.biceps[i] + reach * m.biceps_rate[i], m.triceps[i] + reach * m.triceps_rate[i]
        m.angle_rate[i] = v
        biceps, triceps = string_forces(p, c, i, x, a, b, extended)
        m.velocity_rate[i] = acceleration_by(p, c, i, x, v, biceps, triceps, m.weight[i], m.push[i])
        m.biceps_rate[i], m.triceps_rate[i] = drive_rates(p, c, s, i, a, b, biceps, triceps, extended)
        m.angle_sum[i] += weight * m.angle_rate[i]
        m.velocity_sum[i] += weight * m.velocity_rate[i]
        m.biceps_sum[i] += weight * m.biceps_rate[i]
        m.triceps_sum[i] += weight * m.triceps_rate[i]


@compiled_lanes
def step(m, first, end, h):
    """Stage 6: integrate over `h` [s] with the weighted mean of the four evaluations' rates."""
    for i in range(first, end):
        m.angle[i] += h * m.angle_sum[i] / 6.0
        m.velocity[i] += h * m.velocity_sum[i] / 6.0
        m.biceps[i] += h * m.biceps_sum[i] / 6.0
        m.triceps[i] += h * m.triceps_sum[i] / 6.0
        clear_rates(m, i)


@compiled
def clear_rates(m, i):
    """Begin a Runge-Kutta step with zero rates; minus zero, since adding it changes no number, not even minus zero."""
    m.angle_rate[i] = m.velocity_rate[i] = m.biceps_rate[i] = m.triceps_rate[i] = -0.0
    m.angle_sum[i] = m.velocity_sum[i] = m.biceps_sum[i] = m.triceps_sum[i] = -0.0


@compiled_lanes
def sense(p, c, s, m, first, end, extended):
    """Stage 7: end the motion and read the sensors, for the next tick."""
    for i in range(first, end):
        end_motion(p, c, s, m, i, extended)
        s.tick[i] += 1
        last_angle = s.measured_angle[i]
        read_sensors(p, c, s, i, extended)
        s.measured_velocity[i] = filtered_derivative(
            s.measured_velocity[i], s.measured_angle[i] - last_angle, 1.0, p.velocity_filter, p.control_period
        )
        force = choose(s.agonist[i] == BICEPS, s.estimate_triceps[i], s.estimate_biceps[i])
        error = s.tension_setpoint[i] - force
        s.tension_ise_estimated[i] += m.counting[i] * p.control_period * error * error


@compiled
def end_motion(p, c, s, m, i, extended):
    """Store the state at the end of the motion, and update the metrics.

    A motion that is not finite ends where it began, and adds nothing to the metrics of the motion: a device that fails
    keeps a finite state. That is chosen without a branch, in which loads would be gathers.
    """
    x, v, push = m.angle[i], m.velocity[i], m.push[i]
    last_x, last_biceps, last_triceps = s.angle[i], s.drive_biceps[i], s.drive_triceps[i]
    finite = abs(x) <= FARTHEST and abs(v) <= FARTHEST
    failure = choose(abs(v) > p.velocity_limit, layout.VELOCITY_LIMIT, s.failure[i])
    failure = choose(abs(x) > p.angle_limit, layout.ANGLE_LIMIT, failure)
    x, v = choose(finite, x, last_x), choose(finite, v, s.velocity[i])
    biceps, triceps = choose(finite, m.biceps[i], last_biceps), choose(finite, m.triceps[i], last_triceps)
    counting = choose(finite, m.counting[i], 0.0)
    pushed = push != 0.0 and counting > 0.0
    error_before, error_after = s.setpoint[i] - last_x, s.setpoint[i] - x
    turn_biceps, turn_triceps = biceps - last_biceps, triceps - last_triceps
    pull_biceps, pull_triceps = s.force_biceps[i], s.force_triceps[i]
    s.failure[i] = choose(finite, failure, layout.NOT_FINITE)
    s.angle[i], s.velocity[i], s.drive_biceps[i], s.drive_triceps[i] = x, v, biceps, triceps
    s.push_torque[i] = choose(finite, push, s.push_torque[i])
    s.contact_torque[i] = obstacle_torque(c, i, x, v)
    update_string_forces(p, c, s, i, extended)
    # Eq. 8 of the drives' own motion, and the work that they do against their strings: by the mean force in the tick.
    squares = turn_biceps * turn_biceps + turn_triceps * turn_triceps
    s.drive_effort[i] += counting * squares / p.control_period
    work_biceps = c.pulley_biceps_factor[i] * (pull_biceps + s.force_biceps[i]) * turn_biceps
    work_triceps = c.pulley_triceps_factor[i] * (pull_triceps + s.force_triceps[i]) * -turn_triceps
    work = 0.5 * p.drive_radius * (max(work_biceps, 0.0) + max(work_triceps, 0.0))
    s.drive_work[i] += counting * work
    counted = counting * p.control_period
    s.position_ise[i] += 0.5 * counted * (error_before * error_before + error_after * error_after)
    s.contact_ise[i] += counted * s.contact_torque[i] * s.contact_torque[i]
    s.contact_peak[i] = max(s.contact_peak[i], counting * abs(s.contact_torque[i]))
    s.push_deflection[i] = max(s.push_deflection[i], choose(pushed, abs(error_after), 0.0))
    # At the end of the tick only: with an ideal drive the force jumps at its begin.
    force = choose(s.agonist[i] == BICEPS, s.force_triceps[i], s.force_biceps[i])
    tension_error = s.tension_setpoint[i] - force
    s.tension_ise[i] += counted * tension_error * tension_error
