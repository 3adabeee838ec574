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
from amulett_gym.model.damping import decay_rate, preload_force
from amulett_gym.model.drive import drive_rate, loaded_drive_rate
from amulett_gym.model.plant import (
    contact_torque,
    deflection_biceps,
    deflection_triceps,
    joint_acceleration,
    weight_torque,
)
from amulett_gym.model.sensors import quantise, read_slider
from amulett_gym.model.spring import (
    estimate_force,
    force_beyond,
    inverse_look_up,
    look_up,
    look_up_slope,
    slider_beyond,
    slope_beyond,
)
from amulett_gym.simulation import layout
from amulett_gym.simulation.commands import FARTHEST, choose, choose_agonists, choose_tensions, command_drives, low_pass
from amulett_gym.simulation.loops import begin_loop, predict_drives, run_loop
from amulett_gym.simulation.random import noise, random_bits

SENSOR_STREAMS = np.uint64(4)
ENCODER, SLIDER_BICEPS, SLIDER_TRICEPS, LATENESS = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
SHAKE_STREAM = np.uint64(0x5A4E)
NEGLIGIBLE = 1e-100  # [rad]; changes no bit of a command or of a sum
TIME_SLACK = 1e-5  # [s]; a time that is a multiple of the control period must not miss its tick by rounding. A
# scenario's times are 32-bit floats, off by up to 8 microseconds at 256 s


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


@compiled_lanes
def start_counting(p, c, s, m, first, end):
    """Stage 0: count this tick in the metrics, unless it lies before `measure_from`."""
    for i in range(first, end):
        m.counting[i] = 1.0 if s.tick[i] * p.control_period >= c.measure_from[i] - TIME_SLACK else 0.0


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


@compiled_lanes
def track_steps(p, c, s, m, first, end):
    """Stage 11: measure how the arm follows the setpoint."""
    for i in range(first, end):
        track_step(p, c, s, m, i)


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
def acceleration(p, c, i, angle, velocity, drive_biceps, drive_triceps, push, extended):
    """Return the joint's acceleration (eqs. 1-5) [rad/s2]."""
    biceps, triceps = string_forces(p, c, i, angle, drive_biceps, drive_triceps, extended)
    weight = weight_torque(c.static_torque[i], angle)
    return acceleration_by(p, c, i, angle, velocity, biceps, triceps, weight, push)


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
def acceleration_by(p, c, i, angle, velocity, force_biceps, force_triceps, weight, push):
    """Return the joint's acceleration [rad/s2] by the forces of both strings [N] (eq. 1)."""
    preload = preload_force(force_biceps, force_triceps, p.damping_by_mean)
    decay = c.friction[i] * decay_rate(preload, p.damping_a, p.damping_b, p.damping_c, p.damping_d)
    external = push + obstacle_torque(c, i, angle, velocity)
    return joint_acceleration(
        velocity, force_biceps, force_triceps, decay, weight, external, c.inertia[i], p.joint_radius
    )


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
def clear_rates(m, i):
    """Begin a Runge-Kutta step with zero rates; minus zero, since adding it changes no number, not even minus zero."""
    m.angle_rate[i] = m.velocity_rate[i] = m.biceps_rate[i] = m.triceps_rate[i] = -0.0
    m.angle_sum[i] = m.velocity_sum[i] = m.biceps_sum[i] = m.triceps_sum[i] = -0.0


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
