"""The loops of the literature as stages of a tick: what they read, what they remember, what they command.

A loop reads what the device measures: the joint angle and both sliders, in `s`. Its parameters are `g`
(`layout.LOOP_PARAMETERS`), its memory `q` (`layout.LOOP_BLOCK`). Which loop runs is asked once for a block, outside the
lanes. The mathematics of each is in its module of :mod:`amulett_gym.control`.

A tick after late ones advances integrals by one control period, as that of the paper's loop does.
"""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.control.cascade import force_difference, winding
from amulett_gym.control.co_rotation import correction
from amulett_gym.control.computed_torque import followed_rate, wanted_acceleration
from amulett_gym.control.drive_model import drive_command, next_angle
from amulett_gym.control.drives import co_contraction, drive_commands
from amulett_gym.control.equilibrium_point import equilibrium
from amulett_gym.control.feedback_linearisation import desired_jerk, drive_rates, tautness
from amulett_gym.control.feedforward_feedback import opening
from amulett_gym.control.force_estimate import next_correction
from amulett_gym.control.inverse_dynamics import joint_torque
from amulett_gym.control.inverse_statics import affordable_tension, drive_angles, stiff_pair, string_forces
from amulett_gym.control.joint_observer import observe
from amulett_gym.control.minimal_motion import nearest_pair
from amulett_gym.control.pid import filtered_derivative, integrate
from amulett_gym.control.reference_motion import MINIMUM_JERK, minimum_jerk_offset, remaining_jerk, remaining_offset
from amulett_gym.control.torque import common_rate, desired_torque
from amulett_gym.jit.compiled import compiled, compiled_in_place, compiled_lanes
from amulett_gym.model.damping import decay_rate, preload_force
from amulett_gym.model.plant import deflection_biceps, deflection_triceps, joint_acceleration, weight_torque
from amulett_gym.model.spring import estimate_force, find_position, find_positions, look_up, look_up_slope
from amulett_gym.simulation.commands import FARTHEST, choose, choose_agonists, choose_tensions, command_drives, low_pass
from amulett_gym.simulation.layout import LOOPS

EQUILIBRIUM_POINT, CO_ROTATION = (LOOPS.index(name) for name in ("equilibrium-point", "co-rotation"))
TORQUE_STIFFNESS, FEEDFORWARD_FEEDBACK = (LOOPS.index(name) for name in ("torque-stiffness", "feedforward-feedback"))
FEEDBACK_LINEARISATION, TORQUE = (LOOPS.index(name) for name in ("feedback-linearisation", "torque"))
CASCADE, COMPUTED_TORQUE, MINIMAL_MOTION = map(LOOPS.index, ("cascade", "computed-torque", "minimal-motion"))
DRIVES = len(LOOPS)
AT_REFERENCE = EQUILIBRIUM_POINT, CO_ROTATION, FEEDFORWARD_FEEDBACK, FEEDBACK_LINEARISATION, CASCADE
AT_MEASURED_ANGLE = TORQUE_STIFFNESS, COMPUTED_TORQUE, MINIMAL_MOTION
"""Loops that hold the arm's weight at the reference, and at the measured angle."""
FASTEST = 100.0  # [rad/s]; a setpoint that moves faster jumps


@compiled
def run_loop(p, g, s, q, m, first, end):
    """Command the drives of the lanes from `first` to before `end`."""
    prepare(p, g, s, q, m, first, end)
    begin_motions(g, s, q, first, end)
    move_reference(g, q, first, end)
    if observes(g):
        observe_device(p, g, s, q, first, end)
    want(p, g, s, q, first, end)
    command(p, s, q, m, first, end)


@compiled
def observes(g):
    """Return whether the loop observes the joint's motion and the string forces (`observe_device`)."""
    return g.loop == FEEDBACK_LINEARISATION or g.loop == TORQUE


@compiled
def weigh(g, s, q, first, end):
    """Set the torques of the bare arm's weight at the angles at which the chosen loop needs them.

    In the loops' own stages, their sines would be computed for an arm without weight, too; here only those
    with a weight have any.
    """
    for i in range(first, end):
        q.weight[i] = q.weight_slope[i] = q.reference_weight[i] = 0.0
    if g.weight != 0.0:
        for i in range(first, end):
            if observes(g):
                q.weight[i] = weight_torque(g.weight, q.observed_angle[i])
            if g.loop == FEEDBACK_LINEARISATION:
                q.weight_slope[i] = g.weight * math.cos(q.observed_angle[i])
            if g.loop in AT_REFERENCE:
                q.reference_weight[i] = weight_torque(g.weight, q.reference[i])
            if g.loop in AT_MEASURED_ANGLE:
                q.weight[i] = weight_torque(g.weight, s.measured_angle[i])


@compiled
def want(p, g, s, q, first, end):
    """Set what the chosen loop wants of both drives."""
    weigh(g, s, q, first, end)
    if g.loop == EQUILIBRIUM_POINT:
        run_equilibrium_point(p, g, s, q, first, end)
    elif g.loop == CO_ROTATION:
        run_co_rotation(p, g, s, q, first, end)
    elif g.loop == TORQUE_STIFFNESS:
        find_needed_torque(p, g, s, q, first, end)
        run_torque_stiffness(p, g, s, q, first, end)
    elif g.loop == FEEDFORWARD_FEEDBACK:
        find_needed_torque(p, g, s, q, first, end)
        run_feedforward_feedback(p, g, s, q, first, end)
    elif g.loop == FEEDBACK_LINEARISATION:
        find_jump_jerk(g, q, first, end)
        run_feedback_linearisation(p, g, s, q, first, end)
        if lets_go(q, first, end):
            hand_over(p, g, s, q, first, end)
    elif g.loop == TORQUE:
        run_torque(p, g, s, q, first, end)
    elif g.loop == CASCADE:
        run_cascade(p, g, s, q, first, end)
    elif g.loop == COMPUTED_TORQUE:
        find_torques(p, g, s, q, first, end)
        run_computed_torque(p, g, s, q, first, end)
    elif g.loop == MINIMAL_MOTION:
        find_torques(p, g, s, q, first, end)
        run_minimal_motion(p, g, s, q, first, end)
    elif g.loop == DRIVES:
        run_drives(p, g, s, q, first, end)


@compiled
def prepare(p, g, s, q, m, first, end):
    """Choose agonist and tension setpoint, read setpoint and joint angle, and estimate the joint's rate.

    The agonist is reported, and the string of the tension's metrics; these loops treat both drives alike.
    """
    choose_agonists(p, s, m, first, end)
    choose_tensions(p, s, first, end)
    note_setpoints(p, g, s, q, first, end)


@compiled_lanes
def note_setpoints(p, g, s, q, first, end):
    """Read the setpoints and the joint angles."""
    for i in range(first, end):
        note_setpoint(p, g, s, q, i)


@compiled
def note_setpoint(p, g, s, q, i):
    """Read the setpoint and the joint angle, and add to the setpoint's jump what is too fast for a motion."""
    time = s.tick[i] * p.control_period
    elapsed = max(time - q.last_time[i], p.control_period)  # more than a period after late ticks
    moved = s.setpoint[i] - q.last_setpoint[i] - s.setpoint_jump[i]
    jumps = abs(moved) > FASTEST * elapsed
    s.setpoint_jump[i] += choose(jumps, moved, 0.0)
    setpoint_rate = choose(jumps, 0.0, moved) / elapsed
    acceleration = (setpoint_rate - q.last_rate[i]) / elapsed
    # Where the springs cannot give it, the rate jumps (corners, coarse samples): no torque is fed forward for that.
    kinks = abs(acceleration) * g.inertia > g.max_force * p.joint_radius
    q.setpoint_acceleration[i] = choose(kinks, 0.0, acceleration)
    q.velocity[i] = filtered_derivative(
        q.velocity[i], s.measured_angle[i] - q.last_angle[i], 1.0, g.velocity_filter, elapsed
    )
    q.elapsed[i] = elapsed
    q.last_setpoint[i], q.last_rate[i], q.last_time[i] = s.setpoint[i], setpoint_rate, time
    q.last_angle[i] = s.measured_angle[i]


@compiled_lanes
def begin_motions(g, s, q, first, end):
    """Begin a motion of the reference where the setpoint has jumped: rarely, so that a branch is faster."""
    for i in range(first, end):
        if s.setpoint_jump[i] != 0.0:
            begun = q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i]
            since = q.last_time[i] - q.jump_time[i]
            offset, rate, acceleration = remaining_offset(g.reference_shape, *begun, since, g.reference_time)
            q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i] = offset - s.setpoint_jump[i], rate, acceleration
            q.jump_time[i] = q.last_time[i]
            s.setpoint_jump[i] = 0.0


@compiled
def move_reference(g, q, first, end):
    """Set the reference motion for this tick: the setpoint with what is left of its jumps."""
    if g.reference_shape == MINIMUM_JERK:
        move_by_minimum_jerk(g, q, first, end)
    else:
        move_by_filter(g, q, first, end)


@compiled_lanes
def move_by_minimum_jerk(g, q, first, end):
    """Set a minimum-jerk reference."""
    for i in range(first, end):
        since = q.last_time[i] - q.jump_time[i]
        offset, rate, acceleration = minimum_jerk_offset(
            q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i], since, g.reference_time
        )
        add_offset(q, i, offset, rate, acceleration)


@compiled_lanes
def move_by_filter(g, q, first, end):
    """Set a reference behind a filter."""
    for i in range(first, end):
        since = q.last_time[i] - q.jump_time[i]
        offset, rate, acceleration = remaining_offset(
            g.reference_shape, q.jump_offset[i], q.jump_rate[i], 0.0, since, g.reference_time
        )
        add_offset(q, i, offset, rate, acceleration)


@compiled
def add_offset(q, i, offset, rate, acceleration):
    """Set the reference to the setpoint plus an offset."""
    q.reference[i] = q.last_setpoint[i] + offset
    q.reference_rate[i] = q.last_rate[i] + rate
    q.reference_acceleration[i] = q.setpoint_acceleration[i] + acceleration


@compiled_lanes
def command(p, s, q, m, first, end):
    """Command the drives. A reference has no jump, so that the effort is the whole ISAV."""
    for i in range(first, end):
        biceps, triceps = q.biceps[i] + q.trim_biceps[i], q.triceps[i] + q.trim_triceps[i]
        # A number that overflows, on a device without any force for example, must not reach the drives.
        sound = abs(biceps) <= FARTHEST and abs(triceps) <= FARTHEST
        biceps, triceps = choose(sound, biceps, s.command_biceps[i]), choose(sound, triceps, s.command_triceps[i])
        command_drives(p, s, m, i, biceps, triceps, 0.0, 0.0)


@compiled_lanes
def predict_drives(g, s, q, first, end):
    """Advance the model of both drives by a control period."""
    for i in range(first, end):
        q.model_biceps[i] = next_angle(q.model_biceps[i], s.command_biceps[i], g.drive_share, g.drive_step)
        q.model_triceps[i] = next_angle(q.model_triceps[i], s.command_triceps[i], g.drive_share, g.drive_step)


@compiled_in_place
def begin_loop(p, g, c, s, q, i):
    """Set a device's memory for a start at rest: the commands go on from where the drives are."""
    q.reference[i] = q.last_setpoint[i] = s.angle[i]  # before a jump of the setpoint at the very begin
    q.reference_rate[i] = q.reference_acceleration[i] = q.last_rate[i] = 0.0
    q.last_time[i], q.jump_time[i] = -p.control_period, 0.0
    q.jump_offset[i] = q.jump_rate[i] = q.jump_acceleration[i] = 0.0
    q.velocity[i], q.last_angle[i] = 0.0, s.measured_angle[i]
    q.model_biceps[i], q.model_triceps[i] = s.command_biceps[i], s.command_triceps[i]
    q.integral[i] = q.stiffness_integral[i] = q.stiffness_error[i] = 0.0
    q.stiffness_reference[i] = -1.0
    begin_drives(p, g, s, q, i)
    if observes(g):
        begin_estimates(p, g, c, s, q, i)  # sets the weights
    if g.loop == FEEDBACK_LINEARISATION:
        q.biceps[i], q.triceps[i] = hold_reference(p, g, s, q, i)  # its trim is that of the feed-forward
    else:
        want(p, g, s, q, i, i + np.uint64(1))
    q.trim_biceps[i] = s.command_biceps[i] - q.biceps[i]
    q.trim_triceps[i] = s.command_triceps[i] - q.triceps[i]
    if g.loop == TORQUE:  # what the drives turn together is the feedback's
        q.trim_biceps[i] = 0.5 * (q.trim_biceps[i] - q.trim_triceps[i])
        q.trim_triceps[i] = -q.trim_biceps[i]
    q.integral[i] = q.stiffness_integral[i] = q.stiffness_error[i] = 0.0


@compiled
def hold_at(p, g, angle, torque, tension):
    """Return the drive angles [rad] that hold a joint angle [rad] with a torque [N m] at a tension [N]."""
    biceps, triceps = string_forces(torque, tension, p.joint_radius, g.max_force)
    return drives_at(p, g, angle, *find_positions(g.force_table, g.position_table, biceps, triceps))


@compiled
def drives_at(p, g, angle, biceps, triceps):
    """Return the drive angles [rad] at a joint angle [rad] for the strings' positions in the force table."""
    end = g.inverse_max_deflection
    return drive_angles(angle, biceps / end, triceps / end, p.drive_radius, p.joint_radius)


@compiled
def hold_reference(p, g, s, q, i):
    """Return the drive angles [rad] of equilibrium-point control."""
    angle, torque = equilibrium(q.reference[i], q.reference_rate[i], g.lead), q.reference_weight[i]
    return hold_at(p, g, angle, torque, affordable_tension(torque, s.tension_setpoint[i], p.joint_radius, g.max_force))


@compiled
def predict_positions(p, g, q, i, angle):
    """Return both strings' positions in the force table by the drives' model and a joint angle [rad]."""
    scale = g.inverse_max_deflection
    return (
        deflection_biceps(q.model_biceps[i], angle, p.drive_radius, p.joint_radius) * scale,
        deflection_triceps(q.model_triceps[i], angle, p.drive_radius, p.joint_radius) * scale,
    )


@compiled
def slope_at(g, position):
    """Return the slope of the force by the position in its table [N], limited from below."""
    return max(look_up_slope(g.force_table, position), g.slope_floor * g.max_force)


@compiled
def model_acceleration(p, g, q, i):
    """Return the joint's acceleration [rad/s2] by eq. 1 and the estimates, and the decay rate [1/s]."""
    biceps, triceps = q.force_biceps[i], q.force_triceps[i]
    preload = preload_force(biceps, triceps, p.damping_by_mean)
    decay = decay_rate(preload, p.damping_a, p.damping_b, p.damping_c, p.damping_d)
    weight, velocity = q.weight[i], q.observed_velocity[i]
    return joint_acceleration(velocity, biceps, triceps, decay, weight, 0.0, g.inertia, p.joint_radius), decay


@compiled_in_place
def begin_estimates(p, g, c, s, q, i):
    """Set the memory of `observe_device` for a start at rest: the device has averaged its sensors' readings."""
    angle = s.angle[i] + c.encoder_bias[i]
    q.observed_angle[i], q.observed_velocity[i], q.observed_acceleration[i] = angle, 0.0, 0.0
    radius_biceps = p.drive_radius * c.pulley_biceps_factor[i]
    radius_triceps = p.drive_radius * c.pulley_triceps_factor[i]
    biceps = deflection_biceps(s.drive_biceps[i], s.angle[i], radius_biceps, p.joint_radius)
    triceps = deflection_triceps(s.drive_triceps[i], s.angle[i], radius_triceps, p.joint_radius)
    slider_biceps = look_up(p.spring_table, biceps * p.inverse_max_deflection) + c.slider_bias_biceps[i]
    slider_triceps = look_up(p.spring_table, triceps * p.inverse_max_deflection) + c.slider_bias_triceps[i]
    q.force_biceps[i] = estimate_force(p.estimate_table, slider_biceps, p.max_spring_deflection)
    q.force_triceps[i] = estimate_force(p.estimate_table, slider_triceps, p.max_spring_deflection)
    at_biceps, at_triceps = predict_positions(p, g, q, i, q.observed_angle[i])
    q.correction_biceps[i] = find_position(g.force_table, g.position_table, q.force_biceps[i]) - at_biceps
    q.correction_triceps[i] = find_position(g.force_table, g.position_table, q.force_triceps[i]) - at_triceps
    q.slope_biceps[i] = slope_at(g, at_biceps + q.correction_biceps[i]) * g.inverse_max_deflection
    q.slope_triceps[i] = slope_at(g, at_triceps + q.correction_triceps[i]) * g.inverse_max_deflection
    weigh(g, s, q, i, i + np.uint64(1))
    acceleration, _ = model_acceleration(p, g, q, i)
    q.disturbance[i] = -acceleration
    q.load[i] = p.joint_radius * (q.force_biceps[i] - q.force_triceps[i]) - q.weight[i]
    q.saturated_biceps[i] = q.saturated_triceps[i] = 0.0


@compiled_lanes
def observe_device(p, g, s, q, first, end):
    """Estimate the joint's motion and both string forces, and find the strings at their springs' end."""
    for i in range(first, end):
        period = q.elapsed[i]
        angle, velocity, change = observe(
            q.observed_angle[i],
            q.observed_velocity[i],
            q.observed_acceleration[i],
            s.measured_angle[i],
            g.observer_bandwidth,
            period,
        )
        q.observed_angle[i], q.observed_velocity[i] = angle, velocity
        q.disturbance[i] += change
        at_biceps, at_triceps = predict_positions(p, g, q, i, q.observed_angle[i])
        at_biceps += q.correction_biceps[i]
        at_triceps += q.correction_triceps[i]
        biceps, triceps = look_up(g.force_table, at_biceps), look_up(g.force_table, at_triceps)
        slope_biceps, slope_triceps = slope_at(g, at_biceps), slope_at(g, at_triceps)
        slider_biceps = estimate_force(p.estimate_table, s.measured_biceps[i], p.max_spring_deflection)
        slider_triceps = estimate_force(p.estimate_table, s.measured_triceps[i], p.max_spring_deflection)
        q.correction_biceps[i] = next_correction(
            q.correction_biceps[i], slider_biceps, biceps, slope_biceps, g.slider_time, period
        )
        q.correction_triceps[i] = next_correction(
            q.correction_triceps[i], slider_triceps, triceps, slope_triceps, g.slider_time, period
        )
        q.force_biceps[i], q.force_triceps[i] = biceps, triceps
        q.slope_biceps[i] = slope_biceps * g.inverse_max_deflection
        q.slope_triceps[i] = slope_triceps * g.inverse_max_deflection
        q.saturated_biceps[i] = at_biceps >= 1.0 or s.measured_biceps[i] >= p.slider_end
        q.saturated_triceps[i] = at_triceps >= 1.0 or s.measured_triceps[i] >= p.slider_end


@compiled
def turn(p, g, rate):
    """Return how far a command has to be ahead of a drive [rad] for it to turn at a rate [rad/s], within its limits."""
    step = min(max(rate, -g.most_rate), g.most_rate) * p.control_period
    return min(max(step, -g.drive_step), g.drive_step) / g.drive_share


@compiled_lanes
def run_equilibrium_point(p, g, s, q, first, end):
    """Run `control.equilibrium_point`."""
    for i in range(first, end):
        q.biceps[i], q.triceps[i] = hold_reference(p, g, s, q, i)


@compiled_lanes
def run_co_rotation(p, g, s, q, first, end):
    """Run `control.co_rotation`."""
    for i in range(first, end):
        biceps, triceps = hold_reference(p, g, s, q, i)
        both = correct_position(p, g, s, q, i)
        q.biceps[i], q.triceps[i] = biceps + both, triceps + both


@compiled
def correct_position(p, g, s, q, i):
    """Return by how much the PID of the position turns both drives [rad]."""
    error = integrate_position(p, g, s, q, i)
    return correction(error, q.reference_rate[i] - q.velocity[i], q.integral[i], g.kp, g.kd)


@compiled
def integrate_position(p, g, s, q, i):
    """Integrate the position error, as far as turning both drives changes the torque, and return it [rad]."""
    error = q.reference[i] - s.measured_angle[i]
    rise, fall = room_to_turn(p, s, i)
    q.integral[i] = integrate(q.integral[i], error, g.ki, p.control_period, rise, fall)
    return error


@compiled
def headroom(p, s, i):
    """Return whether both commands may still rise, and whether they may still fall."""
    highest = max(s.command_biceps[i], s.command_triceps[i])
    lowest = min(s.command_biceps[i], s.command_triceps[i])
    return highest < p.command_limit, lowest > -p.command_limit


@compiled_lanes
def find_needed_torque(p, g, s, q, first, end):
    """Set the torque [N m] that the reference motion needs, with the bare arm.

    It is a stage of its own, since in the longer stages that use it, the `exp` of `decay_rate` would slow all lanes.
    """
    for i in range(first, end):
        weight = choose(g.loop == TORQUE_STIFFNESS, q.weight[i], q.reference_weight[i])
        decay = decay_rate(s.tension_setpoint[i], p.damping_a, p.damping_b, p.damping_c, p.damping_d)
        q.torque[i] = joint_torque(q.reference_acceleration[i], q.reference_rate[i], g.inertia, decay, weight)


@compiled
def hold_stiff(p, g, s, i, angle, torque):
    """Return the drive angles [rad] that hold a joint angle with a torque at the stiffness asked for.

    The tension setpoint asks for the stiffness [N m/rad] that it gives without a torque; `stiffness_setpoint` is set to
    it. Returned as well are the stiffness that the strings can have with the torque, and the antagonist's deflection as
    a share of the table's range.
    """
    by_slope = g.inverse_max_deflection * p.joint_radius * p.joint_radius
    biceps, triceps, slopes, wanted = stiff_pair(
        g.force_table, g.position_table, torque / p.joint_radius, s.tension_setpoint[i], g.max_force
    )
    s.stiffness_setpoint[i] = wanted * by_slope
    antagonist = min(biceps, triceps)
    biceps, triceps = drives_at(p, g, angle, biceps, triceps)
    return biceps, triceps, slopes * by_slope, antagonist


@compiled
def move_drives(p, g, q, i, biceps, triceps, joint_rate):
    """Want the commands that bring the drives to given angles [rad], which move with the joint at a rate [rad/s]."""
    rate = joint_rate * p.joint_radius / p.drive_radius
    factor = min(g.factor, g.highest_factor)
    q.biceps[i] = drive_command(q.model_biceps[i], biceps, factor, rate, g.lead)
    q.triceps[i] = drive_command(q.model_triceps[i], triceps, factor, rate, g.lead)


@compiled_lanes
def run_torque_stiffness(p, g, s, q, first, end):
    """Run `control.torque_stiffness`."""
    most = g.max_force * p.joint_radius
    for i in range(first, end):
        error = q.reference[i] - s.measured_angle[i]
        torque = q.torque[i] + (g.torque_kp * error + g.torque_kd * (q.reference_rate[i] - q.velocity[i]))
        rise, fall = headroom(p, s, i)
        rise, fall = rise and torque + q.integral[i] < most, fall and torque + q.integral[i] > -most
        q.integral[i] = integrate(q.integral[i], error, g.torque_ki, p.control_period, rise, fall)
        biceps, triceps, _, _ = hold_stiff(p, g, s, i, s.measured_angle[i], torque + q.integral[i])
        move_drives(p, g, q, i, biceps, triceps, q.reference_rate[i])


@compiled_lanes
def run_feedforward_feedback(p, g, s, q, first, end):
    """Run `control.feedforward_feedback`."""
    for i in range(first, end):
        estimate = estimate_stiffness(p, g, s, i)  # before what takes longest, the processor works on both at once
        biceps, triceps, stiffness, antagonist = hold_stiff(p, g, s, i, q.reference[i], q.torque[i])
        both = correct_position(p, g, s, q, i)
        rise, fall = headroom(p, s, i)
        apart = control_stiffness(p, g, s, q, i, estimate, stiffness, antagonist >= g.floor_position, rise and fall)
        move_drives(p, g, q, i, biceps + both + apart, triceps + both - apart, q.reference_rate[i])


@compiled
def control_stiffness(p, g, s, q, i, estimate, stiffness, measurable, room):
    """Return by how much the PID of the stiffness turns each drive against the other [rad].

    `estimate` is the stiffness by the sliders, `stiffness` that of the inverse model [N m/rad], `measurable` if both
    its strings are above the force floor; without `room` a command is at its limit.
    """
    late = low_pass(q.stiffness_reference[i], stiffness, g.lead, p.control_period)
    q.stiffness_reference[i] = choose(q.stiffness_reference[i] < 0.0, stiffness, late)  # below 0: at the begin
    error = choose(measurable, q.stiffness_reference[i] - estimate, 0.0)
    last_error = q.stiffness_error[i]
    q.stiffness_error[i] = low_pass(last_error, error, g.stiffness_filter, p.control_period)
    # A slider at its end does not measure that its string gets tighter.
    seen = max(s.measured_biceps[i], s.measured_triceps[i]) < p.slider_end
    q.stiffness_integral[i] = integrate(
        q.stiffness_integral[i],
        q.stiffness_error[i],
        g.stiffness_ki,
        p.control_period,
        room and measurable and seen,
        room and measurable,
    )
    rate = (q.stiffness_error[i] - last_error) / p.control_period
    return opening(q.stiffness_error[i], rate, q.stiffness_integral[i], g.stiffness_kp, g.stiffness_kd)


@compiled
def estimate_stiffness(p, g, s, i):
    """Return the joint stiffness [N m/rad] by the sliders."""
    biceps = estimate_force(g.slope_table, s.measured_biceps[i], p.max_spring_deflection)
    triceps = estimate_force(g.slope_table, s.measured_triceps[i], p.max_spring_deflection)
    return (biceps + triceps) * p.joint_radius * p.joint_radius


@compiled_lanes
def find_jump_jerk(g, q, first, end):
    """Set the jerk of what is left of the setpoint's jumps."""
    for i in range(first, end):
        begun = q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i]
        elapsed = q.last_time[i] - q.jump_time[i]
        q.jump_jerk[i] = remaining_jerk(g.reference_shape, *begun, elapsed, g.reference_time)


@compiled_lanes
def run_feedback_linearisation(p, g, s, q, first, end):
    """Run `control.feedback_linearisation`."""
    for i in range(first, end):
        angle, velocity = q.observed_angle[i], q.observed_velocity[i]
        biceps, triceps = q.force_biceps[i], q.force_triceps[i]
        by_model, decay = model_acceleration(p, g, q, i)
        acceleration = by_model + q.disturbance[i]
        q.observed_acceleration[i] = acceleration
        jerk = desired_jerk(
            q.reference[i] - angle,
            q.reference_rate[i] - velocity,
            q.reference_acceleration[i] - acceleration,
            q.jump_jerk[i],
            g.bandwidth,
        )
        torque = g.inertia * (q.reference_acceleration[i] + 2.0 * decay * q.reference_rate[i] - q.disturbance[i])
        torque += q.reference_weight[i]
        tension = affordable_tension(torque, s.tension_setpoint[i], p.joint_radius, g.max_force)
        wanted_biceps, wanted_triceps = string_forces(torque, tension, p.joint_radius, g.max_force)
        tension_rate = g.tension_bandwidth * 0.5 * (wanted_biceps + wanted_triceps - biceps - triceps)
        needed = jerk + 2.0 * decay * acceleration + q.weight_slope[i] / g.inertia * velocity
        slopes = q.slope_biceps[i], q.slope_triceps[i]
        rate_biceps, rate_triceps = drive_rates(
            needed, tension_rate, velocity, slopes, g.inertia, p.drive_radius, p.joint_radius
        )
        still = velocity * p.joint_radius / p.drive_radius  # the drives' rate at which forces stay
        rate_biceps = min(rate_biceps, still) if q.saturated_biceps[i] else rate_biceps
        rate_triceps = max(rate_triceps, still) if q.saturated_triceps[i] else rate_triceps
        q.tautness[i] = tautness(biceps, triceps, g.taut_force)
        q.biceps[i] = q.model_biceps[i] + turn(p, g, rate_biceps) - q.trim_biceps[i]
        q.triceps[i] = q.model_triceps[i] + turn(p, g, rate_triceps) - q.trim_triceps[i]


@compiled
def lets_go(q, first, end):
    """Return whether a string of any lane comes near slack: rarely, so that most ticks can do without `hand_over`."""
    least = 1.0
    for i in range(first, end):
        least = min(least, q.tautness[i])
    return least < 1.0


@compiled_lanes
def hand_over(p, g, s, q, first, end):
    """Mix feed-forward into the commands where a string comes near slack."""
    for i in range(first, end):
        if q.tautness[i] < 1.0:
            biceps, triceps = hold_reference(p, g, s, q, i)
            q.biceps[i] = biceps + q.tautness[i] * (q.biceps[i] - biceps)
            q.triceps[i] = triceps + q.tautness[i] * (q.triceps[i] - triceps)


@compiled_lanes
def run_torque(p, g, s, q, first, end):
    """Run `control.torque`."""
    for i in range(first, end):
        angle, velocity = q.observed_angle[i], q.observed_velocity[i]
        biceps, triceps = q.force_biceps[i], q.force_triceps[i]
        by_model, _ = model_acceleration(p, g, q, i)
        q.observed_acceleration[i] = by_model + q.disturbance[i]
        torque = desired_torque(
            q.reference[i] - angle,
            q.reference_rate[i] - velocity,
            g.virtual_stiffness,
            g.virtual_damping,
            q.weight[i] + q.load[i],
            g.max_force * p.joint_radius,
        )
        missing = torque - p.joint_radius * (biceps - triceps)
        missing = min(missing, 0.0) if q.saturated_biceps[i] else missing
        missing = max(missing, 0.0) if q.saturated_triceps[i] else missing
        stiffness = p.joint_radius * p.joint_radius * (q.slope_biceps[i] + q.slope_triceps[i])
        rate = common_rate(missing, velocity, stiffness, g.torque_time, p.drive_radius, p.joint_radius)
        middle = 0.5 * (q.model_biceps[i] + q.model_triceps[i]) + turn(p, g, rate)
        tension = affordable_tension(torque, s.tension_setpoint[i], p.joint_radius, g.max_force)
        pull_biceps, pull_triceps = hold_at(p, g, 0.0, torque, tension)
        apart = 0.5 * (pull_biceps - pull_triceps)
        q.biceps[i], q.triceps[i] = middle + apart, middle - apart


@compiled
def room_to_turn(p, s, i):
    """Return whether turning both drives can still raise, and lower, the torque.

    It cannot if a command is at its limit, or the spring of the string that is wound is at its end.
    """
    rise, fall = headroom(p, s, i)
    # Without "and": a parameter that is not read for every lane is gathered.
    return rise & (s.measured_biceps[i] < p.slider_end), fall & (s.measured_triceps[i] < p.slider_end)


@compiled_lanes
def run_cascade(p, g, s, q, first, end):
    """Run `control.cascade`."""
    for i in range(first, end):
        biceps, triceps = hold_reference(p, g, s, q, i)
        error = integrate_position(p, g, s, q, i)
        torque = q.reference_weight[i]
        torque += p.joint_radius * force_difference(error, q.velocity[i], g.kp, g.kd)
        tension = affordable_tension(torque, s.tension_setpoint[i], p.joint_radius, g.max_force)
        want_biceps, want_triceps = string_forces(torque, tension, p.joint_radius, g.max_force)
        q.biceps[i] = biceps + q.integral[i] + winding(want_biceps, s.estimate_biceps[i], s.untrusted_biceps[i], g.kf)
        q.triceps[i] = (
            triceps + q.integral[i] - winding(want_triceps, s.estimate_triceps[i], s.untrusted_triceps[i], g.kf)
        )


@compiled_lanes
def find_torques(p, g, s, q, first, end):
    """Set torque [N m] and co-contraction [N] of `control.computed_torque`, and the rate [rad/s] of its drives.

    The co-contraction is that asked for, but at least the loop's smallest, and lowered as far as the torque needs it.
    It is a stage of its own because of the `exp` of `decay_rate`, as `find_needed_torque` is.
    """
    least = min(g.least_tension, g.max_force)
    most = p.joint_radius * (g.max_force - least)
    for i in range(first, end):
        tension = min(max(s.tension_setpoint[i], least), g.max_force)
        error = q.reference[i] - s.measured_angle[i]
        wanted = wanted_acceleration(
            q.reference_acceleration[i], q.reference_rate[i] - q.velocity[i], error, q.integral[i], g.kd, g.kp
        )
        decay = decay_rate(tension, p.damping_a, p.damping_b, p.damping_c, p.damping_d)
        torque = joint_torque(wanted, q.reference_rate[i], g.inertia, decay, q.weight[i])
        rise, fall = headroom(p, s, i)  # a spring at its end is no limit: the other string can be let go
        q.integral[i] = integrate(
            q.integral[i], error, g.ki, p.control_period, rise and torque < most, fall and torque > -most
        )
        q.torque[i] = torque
        q.tension[i] = max(affordable_tension(torque, tension, p.joint_radius, g.max_force), least)
        q.drive_rate[i] = followed_rate(q.reference_rate[i], q.velocity[i], g.inertia * g.kp * error, most)


@compiled_lanes
def run_computed_torque(p, g, s, q, first, end):
    """Run `control.computed_torque`."""
    for i in range(first, end):
        biceps, triceps = hold_at(p, g, s.measured_angle[i], q.torque[i], q.tension[i])
        move_drives(p, g, q, i, biceps, triceps, q.drive_rate[i])


@compiled_lanes
def run_minimal_motion(p, g, s, q, first, end):
    """Run `control.minimal_motion`."""
    for i in range(first, end):
        angle = s.measured_angle[i]
        at_biceps, at_triceps = predict_positions(p, g, q, i, angle)
        difference = q.torque[i] / p.joint_radius
        biceps, triceps = nearest_pair(
            g.force_table, g.position_table, difference, q.tension[i], g.max_force, at_biceps, at_triceps
        )
        biceps, triceps = drives_at(p, g, angle, biceps, triceps)
        move_drives(p, g, q, i, biceps, triceps, q.drive_rate[i])


@compiled
def begin_drives(p, g, s, q, i):
    """Begin the agent's ramps where the drives are: at their mean angle, and the tension at which they co-contract."""
    q.mean_command[i] = 0.5 * (s.command_biceps[i] + s.command_triceps[i])
    q.mean_rate[i] = 0.0
    if g.loop == DRIVES:
        deflection = co_contraction(s.command_biceps[i], s.command_triceps[i], p.drive_radius)
        s.tension_command[i] = s.tension_setpoint[i] = look_up(g.force_table, deflection * g.inverse_max_deflection)


@compiled_lanes
def run_drives(p, g, s, q, first, end):
    """Run `control.drives`; a late tick leaves mean and tension as they are."""
    for i in range(first, end):
        q.mean_command[i] += q.mean_rate[i]
        position = find_position(g.force_table, g.position_table, s.tension_setpoint[i])
        deflection = position / g.inverse_max_deflection
        q.biceps[i], q.triceps[i] = drive_commands(q.mean_command[i], deflection, p.drive_radius)
