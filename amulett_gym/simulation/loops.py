"""The loops of the literature as stages of a tick: what they read, what they remember, what they command.

A loop reads what the device measures: the joint angle and both sliders, in `s`. Its parameters are `g`
(`layout.LOOP_PARAMETERS`), its memory `q` (`layout.LOOP_BLOCK`). Which loop runs is asked once for a block, outside the
lanes. The mathematics of each is in its module of :mod:`amulett_gym.control`.
"""

from __future__ import annotations

import numpy as np

from amulett_gym.control.agonist import select_agonist
from amulett_gym.control.co_rotation import correction
from amulett_gym.control.drive_model import drive_command, next_angle
from amulett_gym.control.equilibrium_point import equilibrium
from amulett_gym.control.feedforward_feedback import opening
from amulett_gym.control.inverse_dynamics import joint_torque
from amulett_gym.control.inverse_statics import drive_angles, stiff_pair, string_forces
from amulett_gym.control.pid import filtered_derivative, integrate
from amulett_gym.control.reference_motion import remaining_offset
from amulett_gym.jit.compiled import compiled, compiled_in_place, compiled_lanes
from amulett_gym.model.damping import decay_rate
from amulett_gym.model.spring import estimate_force, find_position, look_up_curve
from amulett_gym.simulation.commands import choose, choose_tension, command_drives, low_pass
from amulett_gym.simulation.layout import LOOPS

EQUILIBRIUM_POINT, CO_ROTATION = (LOOPS.index(name) for name in ("equilibrium-point", "co-rotation"))
TORQUE_STIFFNESS, FEEDFORWARD_FEEDBACK = (LOOPS.index(name) for name in ("torque-stiffness", "feedforward-feedback"))
FASTEST = 100.0  # [rad/s]; a setpoint that moves faster jumps


@compiled
def run_loop(p, g, s, q, m, first, end):
    """Command the drives of the lanes from `first` to before `end`."""
    prepare(p, g, s, q, m, first, end)
    want(p, g, s, q, first, end)
    command(p, s, q, m, first, end)


@compiled
def want(p, g, s, q, first, end):
    """Set what the chosen loop wants of both drives."""
    if g.loop == EQUILIBRIUM_POINT:
        run_equilibrium_point(p, g, s, q, first, end)
    elif g.loop == CO_ROTATION:
        run_co_rotation(p, g, s, q, first, end)
    elif g.loop == TORQUE_STIFFNESS:
        run_torque_stiffness(p, g, s, q, first, end)
    elif g.loop == FEEDFORWARD_FEEDBACK:
        run_feedforward_feedback(p, g, s, q, first, end)


@compiled_lanes
def prepare(p, g, s, q, m, first, end):
    """Choose the tension setpoint, move the reference, and estimate the joint's rate."""
    for i in range(first, end):
        error = s.setpoint[i] - s.measured_angle[i]
        agonist = p.fixed_agonist
        if agonist == 0.0:
            # Reported, and the string of the tension's metrics; these loops treat both drives alike.
            agonist = select_agonist(
                s.agonist[i], s.measured_difference[i], error, p.switch_hysteresis, p.tie_width, p.tie_error
            )
        s.switch_count[i] += m.counting[i] if agonist != s.agonist[i] else 0.0
        s.agonist[i] = agonist
        s.tension_setpoint[i] = choose_tension(p, s, i, error)
        move_reference(p, g, s, q, i)


@compiled
def move_reference(p, g, s, q, i):
    """Set the reference motion for this tick, and the joint's estimated rate."""
    time = s.tick[i] * p.control_period
    elapsed = max(time - q.last_time[i], p.control_period)  # more than a period after late ticks
    jump = s.setpoint_jump[i]
    moved = s.setpoint[i] - q.last_setpoint[i] - jump
    if abs(moved) > FASTEST * elapsed:
        jump += moved
        moved = 0.0
    if jump != 0.0:
        offset, rate, acceleration = offset_now(g, q, i, time)
        q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i] = offset - jump, rate, acceleration
        q.jump_time[i] = time
    offset, rate, acceleration = offset_now(g, q, i, time)
    setpoint_rate = moved / elapsed
    q.reference[i] = s.setpoint[i] + offset
    q.reference_rate[i] = setpoint_rate + rate
    q.reference_acceleration[i] = (setpoint_rate - q.last_rate[i]) / elapsed + acceleration
    q.velocity[i] = filtered_derivative(
        q.velocity[i], s.measured_angle[i] - q.last_angle[i], 1.0, g.velocity_filter, elapsed
    )
    q.last_setpoint[i], q.last_rate[i], q.last_time[i] = s.setpoint[i], setpoint_rate, time
    q.last_angle[i] = s.measured_angle[i]
    s.setpoint_jump[i] = 0.0


@compiled
def offset_now(g, q, i, time):
    """Return what is left of the setpoint's jumps, its rate and its acceleration."""
    elapsed = time - q.jump_time[i]
    begun = q.jump_offset[i], q.jump_rate[i], q.jump_acceleration[i]
    return remaining_offset(g.reference_shape, *begun, elapsed, g.reference_time)


@compiled_lanes
def command(p, s, q, m, first, end):
    """Command the drives. A reference has no jump, so that the effort is the whole ISAV."""
    for i in range(first, end):
        command_drives(p, s, m, i, q.biceps[i] + q.trim_biceps[i], q.triceps[i] + q.trim_triceps[i], 0.0, 0.0)


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
    want(p, g, s, q, i, i + np.uint64(1))
    q.trim_biceps[i] = s.command_biceps[i] - q.biceps[i]
    q.trim_triceps[i] = s.command_triceps[i] - q.triceps[i]
    q.integral[i] = q.stiffness_integral[i] = q.stiffness_error[i] = 0.0


@compiled
def hold(p, g, s, q, i, angle, torque):
    """Return the drive angles [rad] that hold a joint angle [rad] with a torque [N m] at the tension setpoint."""
    biceps, triceps = string_forces(torque, s.tension_setpoint[i], p.joint_radius, g.max_force)
    return drive_angles(
        angle,
        find_position(p.force_table, g.position_table, biceps) / p.inverse_max_deflection,
        find_position(p.force_table, g.position_table, triceps) / p.inverse_max_deflection,
        p.drive_radius,
        p.joint_radius,
    )


@compiled_lanes
def run_equilibrium_point(p, g, s, q, first, end):
    """Run `control.equilibrium_point`."""
    for i in range(first, end):
        angle = equilibrium(q.reference[i], q.reference_rate[i], g.lead)
        q.biceps[i], q.triceps[i] = hold(p, g, s, q, i, angle, g.weight * np.sin(q.reference[i]))


@compiled_lanes
def run_co_rotation(p, g, s, q, first, end):
    """Run `control.co_rotation`."""
    for i in range(first, end):
        angle = equilibrium(q.reference[i], q.reference_rate[i], g.lead)
        biceps, triceps = hold(p, g, s, q, i, angle, g.weight * np.sin(q.reference[i]))
        error = q.reference[i] - s.measured_angle[i]
        highest, lowest = max(s.command_biceps[i], s.command_triceps[i]), min(s.command_biceps[i], s.command_triceps[i])
        q.integral[i] = integrate(
            q.integral[i], error, g.ki, p.control_period, highest < p.command_limit, lowest > -p.command_limit
        )
        turn = correction(error, q.reference_rate[i] - q.velocity[i], q.integral[i], g.kp, g.kd)
        q.biceps[i], q.triceps[i] = biceps + turn, triceps + turn


@compiled
def headroom(p, s, i):
    """Return whether both commands may still rise, and whether they may still fall."""
    highest = max(s.command_biceps[i], s.command_triceps[i])
    lowest = min(s.command_biceps[i], s.command_triceps[i])
    return highest < p.command_limit, lowest > -p.command_limit


@compiled
def needed_torque(p, g, s, q, i, angle):
    """Return the torque [N m] that the reference motion needs at a joint angle [rad], with the bare arm."""
    decay = decay_rate(s.tension_setpoint[i], p.damping_a, p.damping_b, p.damping_c, p.damping_d)
    return joint_torque(q.reference_acceleration[i], q.reference_rate[i], angle, g.inertia, decay, g.weight)


@compiled
def hold_stiff(p, g, s, i, angle, torque):
    """Return the drive angles [rad] that hold a joint angle with a torque at the stiffness asked for.

    The tension setpoint asks for the stiffness [N m/rad] that it gives without a torque; `stiffness_setpoint` is set to
    it. Returned as well are the stiffness that the strings can have with the torque, and the antagonist's deflection as
    a share of the table's range.
    """
    start = find_position(p.force_table, g.position_table, s.tension_setpoint[i])
    _, slope, _ = look_up_curve(p.force_table, start)
    by_slope = p.inverse_max_deflection * p.joint_radius * p.joint_radius
    s.stiffness_setpoint[i] = 2.0 * slope * by_slope
    biceps, triceps, slopes = stiff_pair(p.force_table, g.position_table, torque / p.joint_radius, start, g.max_force)
    antagonist, end = min(biceps, triceps), 1.0 / p.inverse_max_deflection
    biceps, triceps = drive_angles(angle, biceps * end, triceps * end, p.drive_radius, p.joint_radius)
    return biceps, triceps, slopes * by_slope, antagonist


@compiled
def move_drives(p, g, q, i, biceps, triceps):
    """Want the commands that bring the drives to given angles [rad], which move with the reference."""
    rate = q.reference_rate[i] * p.joint_radius / p.drive_radius
    factor = min(g.factor, g.highest_factor)
    q.biceps[i] = drive_command(q.model_biceps[i], biceps, factor, rate, g.lead)
    q.triceps[i] = drive_command(q.model_triceps[i], triceps, factor, rate, g.lead)


@compiled_lanes
def run_torque_stiffness(p, g, s, q, first, end):
    """Run `control.torque_stiffness`."""
    most = g.max_force * p.joint_radius
    for i in range(first, end):
        error = q.reference[i] - s.measured_angle[i]
        torque = needed_torque(p, g, s, q, i, s.measured_angle[i])
        torque += g.torque_kp * error + g.torque_kd * (q.reference_rate[i] - q.velocity[i])
        rise, fall = headroom(p, s, i)
        rise, fall = rise and torque + q.integral[i] < most, fall and torque + q.integral[i] > -most
        q.integral[i] = integrate(q.integral[i], error, g.torque_ki, p.control_period, rise, fall)
        biceps, triceps, _, _ = hold_stiff(p, g, s, i, s.measured_angle[i], torque + q.integral[i])
        move_drives(p, g, q, i, biceps, triceps)


@compiled_lanes
def run_feedforward_feedback(p, g, s, q, first, end):
    """Run `control.feedforward_feedback`."""
    for i in range(first, end):
        torque = needed_torque(p, g, s, q, i, q.reference[i])
        biceps, triceps, stiffness, antagonist = hold_stiff(p, g, s, i, q.reference[i], torque)
        rise, fall = headroom(p, s, i)
        error = q.reference[i] - s.measured_angle[i]
        q.integral[i] = integrate(q.integral[i], error, g.ki, p.control_period, rise, fall)
        turn = correction(error, q.reference_rate[i] - q.velocity[i], q.integral[i], g.kp, g.kd)
        apart = control_stiffness(p, g, s, q, i, stiffness, antagonist >= g.floor_position, rise and fall)
        move_drives(p, g, q, i, biceps + turn + apart, triceps + turn - apart)


@compiled
def control_stiffness(p, g, s, q, i, stiffness, measurable, room):
    """Return by how much the PID of the stiffness turns each drive against the other [rad].

    `stiffness` is that of the inverse model [N m/rad], `measurable` if both its strings are above the force floor;
    without `room` a command is at its limit.
    """
    late = low_pass(q.stiffness_reference[i], stiffness, g.lead, p.control_period)
    q.stiffness_reference[i] = choose(q.stiffness_reference[i] < 0.0, stiffness, late)  # below 0: at the begin
    error = choose(measurable, q.stiffness_reference[i] - estimate_stiffness(p, g, s, i), 0.0)
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
