"""The control tick with a wearer: the device's own stages, and between them those of the wearer's arm.

A tick of the device alone is :mod:`amulett_gym.simulation.kernel`'s, whose stages are used here. The scenario's moves
are the wearer's intention; the device's setpoint follows the torque of the cuff (admittance). Pushes act on the hand.
Besides the device's, functions take `f` (`worn_layout.FITTING`), `h` (a block of persons), `w` (a block of
`worn_layout.WORN_BLOCK`) and `k` (the arm's motion within the tick).
"""

from __future__ import annotations

import math

import numpy as np

from amulett_gym.control.admittance import setpoint_rate
from amulett_gym.control.pid import filtered_derivative
from amulett_gym.jit.compiled import compiled, compiled_in_place, compiled_lanes
from amulett_gym.model.cable import next_loss
from amulett_gym.model.cuff import cuff_torque
from amulett_gym.model.damping import decay_rate, preload_force
from amulett_gym.model.plant import joint_acceleration, weight_torque
from amulett_gym.model.sensors import quantise
from amulett_gym.model.wearer import PASSIVE_DAMPING, activation_rate, excitations, muscle_damping, muscle_torque
from amulett_gym.simulation import layout
from amulett_gym.simulation.commands import FARTHEST, choose, low_pass
from amulett_gym.simulation.dynamics import drive_rates, give_way, string_forces
from amulett_gym.simulation.equilibrium import settle
from amulett_gym.simulation.kernel import act, begin_motion, next_failed, next_late, predict, sense, shake, step, weigh
from amulett_gym.simulation.metrics import start_counting, track_steps
from amulett_gym.simulation.random import noise
from amulett_gym.simulation.sensors import sensor_noise
from amulett_gym.simulation.setpoint import add_waves, find_setpoints
from amulett_gym.simulation.worn_layout import ARM_BLOCK, DELAY

CUFF_STREAM, TREMOR_STREAM = np.uint64(0xC0FF), np.uint64(0x73E3)
TREMOR_DAMPING = 0.1  # ratio, of the tremor's resonance
MOVING = math.radians(5.0)  # [rad/s]; an intention that is faster is a motion


@compiled
def advance(p, which, c_blocks, s_blocks, paths, loop, extended, worn, num_devices, ticks):
    """Advance all devices and their wearers by a number of control ticks; see `kernel.advance`."""
    motion, motion_of_arm = np.empty(1, dtype=layout.MOTION_BLOCK), np.empty(1, dtype=ARM_BLOCK)
    for block in range(s_blocks.shape[0]):
        lanes, own = min(layout.LANES, num_devices - block * layout.LANES), which[block]
        c, s, m, k = c_blocks[block], s_blocks[block], motion[0], motion_of_arm[0]
        advance_block(p[own], c, s, m, k, paths, loop, extended, worn, own, block, lanes, ticks)


@compiled_in_place
def advance_block(p, c, s, m, k, paths, loop, extended, worn, own, block, lanes, ticks):
    """Advance the devices in a block's first lanes by a number of control ticks; `own` is its profile's index."""
    for _ in range(ticks):
        first = 0
        while first < lanes:
            end = next_failed(s, first, lanes)
            tick(p, c, s, m, k, paths, loop, extended, worn, own, block, np.uint64(first), np.uint64(end))
            first = end + 1


@compiled_in_place
def tick(p, c, s, m, k, paths, loop, extended, worn, own, block, first, end):
    """Advance the devices in the lanes from `first` to before `end` by one control tick."""
    f, h, w = worn[0][own], worn[1][block], worn[2][block]
    start_counting(p, c, s, m, first, end)
    lane = first
    while lane < end:
        late = next_late(c, s, lane, end)
        act(p, s, m, loop, own, block, lane, late)
        lane = late + np.uint64(1)
    predict(s, loop, own, block, first, end)
    begin_motion(p, c, s, m, first, end)
    shake(p, c, s, m, first, end)
    weigh_intention(h, w, k, first, end)
    excite(p, c, s, m, h, w, k, first, end)
    move(p, c, s, m, f, h, w, k, first, end, extended)
    end_arm(p, c, s, f, h, w, k, first, end)
    follow(p, c, s, f, w, first, end)
    intend(p, c, s, h, w, paths, block, first, end)
    measure(p, m, w, first, end)
    track_steps(p, c, s, m, first, end)


@compiled_lanes
def excite(p, c, s, m, h, w, k, first, end):
    """Set the muscles' excitations for this tick, and begin the arm's motion."""
    for i in range(first, end):
        now = s.tick[i] % DELAY
        w.error_line[now, i] = w.intention[i] - w.elbow[i]
        w.rate_line[now, i] = w.intention_rate[i] - w.elbow_rate[i]
        then = (s.tick[i] - min(h.delay[i], s.tick[i])) % DELAY
        answer = h.feedback_stiffness[i] * w.error_line[then, i] + h.feedback_damping[i] * w.rate_line[then, i]
        lost = w.correction[i] / h.relaxation_time[i]
        w.correction[i] += p.control_period * (answer / h.correction_time[i] - lost)
        excite_muscles(h, w, i, k.weight_torque[i], answer + w.correction[i])
        loaded = choose(s.tick[i] >= h.load_tick[i], 1.0, 0.0)
        k.inertia[i] = h.inertia[i] + loaded * h.load_inertia[i]
        k.weight[i] = h.weight[i] + loaded * h.load_weight[i]
        k.rest[i] = choose(h.guided[i] > 0.0, h.rest_angle[i], w.intention[i])
        shiver(p, c, s, h, w, i)
        w.hand_torque[i] = m.push[i]
        k.elbow[i], k.elbow_rate[i], k.flexor[i], k.extensor[i] = (
            w.elbow[i],
            w.elbow_rate[i],
            w.flexor[i],
            w.extensor[i],
        )
        clear_slopes(k, i)


@compiled
def excite_muscles(h, w, i, weight, answer):
    """Set the excitations for motion and weight [N m] that the wearer expects, and for the answer to errors.

    A guided wearer is relaxed.
    """
    tone, strength, co_contraction = h.tone[i], h.strength[i], h.co_contraction[i]
    friction = PASSIVE_DAMPING + muscle_damping(co_contraction, co_contraction, tone, strength)
    motion = h.inertia[i] * w.intention_acceleration[i] + friction * w.intention_rate[i]
    torque = weight + h.anticipation[i] * motion + answer
    flexor, extensor = excitations(torque, co_contraction, tone, strength)
    guided = h.guided[i] > 0.0
    w.excitation_flexor[i] = choose(guided, co_contraction, flexor)
    w.excitation_extensor[i] = choose(guided, co_contraction, extensor)


@compiled
def weigh_intention(h, w, k, first, end):
    """Set the torque of the arm's weight at the intended angle, where it has one; see `weigh_arm`.

    An arm without weight has none in the motion either, which leaves its zero as it is.
    """
    for i in range(first, end):
        k.weight_torque[i] = 0.0
    for i in range(first, end):
        if h.weight[i] != 0.0:
            k.weight_torque[i] = weight_torque(h.weight[i], w.intention[i])


@compiled
def weigh_all(c, m, k, first, end, reach):
    """Set the torques of both weights `reach` [s] ahead."""
    weigh(c, m, first, end, reach)
    weigh_arm(k, first, end, reach)


@compiled
def weigh_arm(k, first, end, reach):
    """Set the torque of the arm's weight `reach` [s] ahead, where it has one, in a stage of its own: `kernel.weigh`."""
    for i in range(first, end):
        if k.weight[i] != 0.0:
            k.weight_torque[i] = weight_torque(k.weight[i], k.elbow[i] + reach * k.elbow_slope[i])


@compiled
def shiver(p, c, s, h, w, i):
    """Set the tremor's torque [N m] for this tick: white noise through a resonance (semi-implicit Euler steps).

    The torque is the resonator's rate, which has no slow part; `tremor_lag` follows it by a quarter of a period.
    """
    if h.tremor_torque[i] > 0.0:
        turn = 2.0 * math.pi * h.tremor_frequency[i] * p.control_period
        # Noise of this strength gives the oscillation a standard deviation of tremor_torque.
        kick = h.tremor_torque[i] * math.sqrt(4.0 * TREMOR_DAMPING * turn)
        white = noise(c.noise_key[i] ^ TREMOR_STREAM, np.uint64(s.tick[i]))
        w.tremor[i] += kick * white - turn * (2.0 * TREMOR_DAMPING * w.tremor[i] + w.tremor_lag[i])
        w.tremor_lag[i] += turn * w.tremor[i]


@compiled
def move(p, c, s, m, f, h, w, k, first, end, extended):
    """Integrate device and arm over the tick and read the device's sensors."""
    if extended is not None and p.extended:
        move_as(p, c, s, m, f, h, w, k, first, end, extended)
    else:
        move_as(p, c, s, m, f, h, w, k, first, end, None)


@compiled
def move_as(p, c, s, m, f, h, w, k, first, end, extended):
    """Integrate and read the sensors; `extended` as in `kernel.move_as`."""
    step_time = p.control_period / p.substeps
    for _ in range(p.substeps):
        weigh_all(c, m, k, first, end, 0.0)
        evaluate(p, c, s, m, f, h, w, k, first, end, 0.0, 1.0, extended)
        weigh_all(c, m, k, first, end, 0.5 * step_time)
        evaluate(p, c, s, m, f, h, w, k, first, end, 0.5 * step_time, 2.0, extended)
        weigh_all(c, m, k, first, end, 0.5 * step_time)
        evaluate(p, c, s, m, f, h, w, k, first, end, 0.5 * step_time, 2.0, extended)
        weigh_all(c, m, k, first, end, step_time)
        evaluate(p, c, s, m, f, h, w, k, first, end, step_time, 1.0, extended)
        if f.bend_biceps > 0.0 or f.bend_triceps > 0.0:
            slide(p, c, m, f, w, first, end, step_time)
        step(m, first, end, step_time)
        step_arm(k, first, end, step_time)
    give_way(p, c, m, first, end, extended)
    if f.at_drive and (f.bend_biceps > 0.0 or f.bend_triceps > 0.0):
        add_friction_work(p, c, s, m, w, first, end, extended)
    sense(p, c, s, m, first, end, extended)


@compiled_lanes
def evaluate(p, c, s, m, f, h, w, k, first, end, reach, weight, extended):
    """Evaluate the rates of change of device and arm `reach` [s] ahead, and add them to the step's sums."""
    for i in range(first, end):
        x, v = m.angle[i] + reach * m.angle_rate[i], m.velocity[i] + reach * m.velocity_rate[i]
        a, b = m.biceps[i] + reach * m.biceps_rate[i], m.triceps[i] + reach * m.triceps_rate[i]
        y, u = k.elbow[i] + reach * k.elbow_slope[i], k.elbow_rate[i] + reach * k.elbow_rate_slope[i]
        flexor, extensor = k.flexor[i] + reach * k.flexor_slope[i], k.extensor[i] + reach * k.extensor_slope[i]
        cuff = h.worn[i] * cuff_torque(x - y, v - u, f.stiffness, f.damping, f.slack)
        biceps, triceps = string_forces(p, c, i, x, a, b, extended)
        left_biceps, left_triceps = 1.0 - w.loss_biceps[i], 1.0 - w.loss_triceps[i]
        # The cables are on either side of the springs: at the joint is what they leave of the drive's tension.
        at_biceps = choose(f.at_drive, biceps, biceps * left_biceps)
        at_triceps = choose(f.at_drive, triceps, triceps * left_triceps)
        m.angle_rate[i] = v
        m.velocity_rate[i] = joint_rate(p, c, i, v, at_biceps, at_triceps, m.weight[i], -cuff)
        biceps, triceps = at_biceps / left_biceps, at_triceps / left_triceps
        m.biceps_rate[i], m.triceps_rate[i] = drive_rates(p, c, s, i, a, b, biceps, triceps, extended)
        k.elbow_slope[i] = u
        torque = muscle_torque(flexor, extensor, y - k.rest[i], u, h.tone[i], h.strength[i])
        torque += cuff + w.hand_torque[i] + w.tremor[i] - PASSIVE_DAMPING * u - k.weight_torque[i]
        k.elbow_rate_slope[i] = torque / k.inertia[i]
        k.flexor_slope[i] = activation_rate(flexor, w.excitation_flexor[i])
        k.extensor_slope[i] = activation_rate(extensor, w.excitation_extensor[i])
        add_slopes(m, k, i, weight)


@compiled
def joint_rate(p, c, i, velocity, biceps, triceps, weight, torque):
    """Return the acceleration of the device's joint [rad/s2] by the forces of both strings [N] at it (eq. 1)."""
    preload = preload_force(biceps, triceps, p.damping_by_mean)
    decay = c.friction[i] * decay_rate(preload, p.damping_a, p.damping_b, p.damping_c, p.damping_d)
    return joint_acceleration(velocity, biceps, triceps, decay, weight, torque, c.inertia[i], p.joint_radius)


@compiled
def add_slopes(m, k, i, weight):
    """Add the evaluated rates of change to the step's sums."""
    m.angle_sum[i] += weight * m.angle_rate[i]
    m.velocity_sum[i] += weight * m.velocity_rate[i]
    m.biceps_sum[i] += weight * m.biceps_rate[i]
    m.triceps_sum[i] += weight * m.triceps_rate[i]
    k.elbow_sum[i] += weight * k.elbow_slope[i]
    k.elbow_rate_sum[i] += weight * k.elbow_rate_slope[i]
    k.flexor_sum[i] += weight * k.flexor_slope[i]
    k.extensor_sum[i] += weight * k.extensor_slope[i]


@compiled_lanes
def step_arm(k, first, end, step_time):
    """Integrate the arm over a step [s], as `kernel.step` does the device."""
    for i in range(first, end):
        k.elbow[i] += step_time * k.elbow_sum[i] / 6.0
        k.elbow_rate[i] += step_time * k.elbow_rate_sum[i] / 6.0
        k.flexor[i] += step_time * k.flexor_sum[i] / 6.0
        k.extensor[i] += step_time * k.extensor_sum[i] / 6.0
        clear_slopes(k, i)


@compiled
def clear_slopes(k, i):
    """Begin a Runge-Kutta step with zero rates."""
    k.elbow_slope[i] = k.elbow_rate_slope[i] = k.flexor_slope[i] = k.extensor_slope[i] = -0.0
    k.elbow_sum[i] = k.elbow_rate_sum[i] = k.flexor_sum[i] = k.extensor_sum[i] = -0.0


@compiled_lanes
def slide(p, c, m, f, w, first, end, step_time):
    """Update the cables' losses by the strings' motion in the step that is about to be taken."""
    for i in range(first, end):
        biceps = triceps = m.angle_sum[i] * p.joint_radius
        if f.at_drive:
            biceps = m.biceps_sum[i] * p.drive_radius * c.pulley_biceps_factor[i]
            triceps = m.triceps_sum[i] * p.drive_radius * c.pulley_triceps_factor[i]
        step = step_time / 6.0
        w.loss_biceps[i] = next_loss(w.loss_biceps[i], f.bend_biceps, step * biceps, f.presliding)
        w.loss_triceps[i] = next_loss(w.loss_triceps[i], f.bend_triceps, -step * triceps, f.presliding)


@compiled_lanes
def add_friction_work(p, c, s, m, w, first, end, extended):
    """Add to `drive_work` what the drives do against cables at their side, besides that against the springs.

    A spring's force f takes f / (1 - loss) at the drive. Else as in `kernel.end_motion`, which adds that against f.
    """
    for i in range(first, end):
        if abs(m.angle[i]) <= FARTHEST and abs(m.velocity[i]) <= FARTHEST:
            biceps, triceps = string_forces(p, c, i, m.angle[i], m.biceps[i], m.triceps[i], extended)
            pull_biceps, pull_triceps = s.force_biceps[i] + biceps, s.force_triceps[i] + triceps
            turn_biceps, turn_triceps = m.biceps[i] - s.drive_biceps[i], s.drive_triceps[i] - m.triceps[i]
            work = max(c.pulley_biceps_factor[i] * pull_biceps * turn_biceps, 0.0) * more_work(w.loss_biceps[i])
            work += max(c.pulley_triceps_factor[i] * pull_triceps * turn_triceps, 0.0) * more_work(w.loss_triceps[i])
            s.drive_work[i] += m.counting[i] * 0.5 * p.drive_radius * work


@compiled
def more_work(loss):
    """Return 1 / (1 - loss) - 1: the share by which the tension before a cable is larger than that after it."""
    return loss / (1.0 - loss)


@compiled_lanes
def end_arm(p, c, s, f, h, w, k, first, end):
    """Store the arm's state at the end of the motion, unless it is not finite."""
    for i in range(first, end):
        if not (abs(k.elbow[i]) <= FARTHEST and abs(k.elbow_rate[i]) <= FARTHEST):
            s.failure[i] = layout.NOT_FINITE
        else:
            w.elbow[i], w.elbow_rate[i] = k.elbow[i], k.elbow_rate[i]
            w.flexor[i], w.extensor[i] = k.flexor[i], k.extensor[i]
        apart, apart_rate = s.angle[i] - w.elbow[i], s.velocity[i] - w.elbow_rate[i]
        w.cuff_torque[i] = h.worn[i] * cuff_torque(apart, apart_rate, f.stiffness, f.damping, f.slack)


@compiled_lanes
def follow(p, c, s, f, w, first, end):
    """Read the cuff's sensor, and let the device's setpoint follow it (admittance)."""
    for i in range(first, end):
        error = sensor_noise(f.noise, c.noise_key[i] ^ CUFF_STREAM, np.uint64(s.tick[i]))
        last = w.measured_cuff[i]
        w.measured_cuff[i] = low_pass(
            last, quantise(error - w.cuff_torque[i], f.resolution), f.filter, p.control_period
        )
        w.cuff_rate[i] = filtered_derivative(
            w.cuff_rate[i], w.measured_cuff[i] - last, 1.0, f.rate_filter, p.control_period
        )
        w.assistance[i] += w.assistance_step[i]
        rate = setpoint_rate(
            w.measured_cuff[i] + f.lead * w.cuff_rate[i],
            s.measured_velocity[i],
            w.assistance[i],
            f.gain,
            f.rest_gain,
            f.carry,
            f.dead_band,
        )
        w.followed[i] = min(max(w.followed[i] + p.control_period * rate, -p.angle_limit), p.angle_limit)


@compiled
def intend(p, c, s, h, w, paths, block, first, end):
    """Set the wearer's intention for the next tick by the scenario's moves, and the device's own setpoint."""
    hand_over(s.setpoint, w.intention, first, end)
    find_setpoints(p, c, s, paths, block, first, end)
    add_waves(p, c, s, first, end)
    take_intention(p, s, h, w, first, end)


@compiled_lanes
def hand_over(setpoint, intention, first, end):
    """Let the scenario's moves go on from the intention instead of the device's setpoint."""
    for i in range(first, end):
        setpoint[i] = intention[i]


@compiled_lanes
def take_intention(p, s, h, w, first, end):
    """Take the moves' setpoint as the intention, with its rates, and give the device its own unless it guides."""
    for i in range(first, end):
        rate = (s.setpoint[i] - w.intention[i]) / p.control_period
        w.intention_acceleration[i] = (rate - w.intention_rate[i]) / p.control_period
        w.intention[i], w.intention_rate[i] = s.setpoint[i], rate
        guided = h.guided[i] > 0.0
        w.followed[i] = choose(guided, s.setpoint[i], w.followed[i])
        s.setpoint[i], s.setpoint_jump[i] = w.followed[i], choose(guided, s.setpoint_jump[i], 0.0)


@compiled_lanes
def measure(p, m, w, first, end):
    """Update the wearer's metrics."""
    for i in range(first, end):
        counted = m.counting[i] * p.control_period
        cuff, error = w.cuff_torque[i], w.intention[i] - w.elbow[i]
        moving = choose(abs(w.intention_rate[i]) > MOVING, counted, 0.0)
        w.effort[i] += counted * (w.flexor[i] * w.flexor[i] + w.extensor[i] * w.extensor[i])
        w.cuff_ise[i] += counted * cuff * cuff
        w.cuff_peak[i] = max(w.cuff_peak[i], m.counting[i] * abs(cuff))
        w.tracking_ise[i] += counted * error * error
        w.moving_cuff_ise[i] += moving * cuff * cuff
        w.moving_time[i] += moving
        loaded = w.hand_torque[i] != 0.0 and m.counting[i] > 0.0
        w.load_deflection[i] = max(w.load_deflection[i], choose(loaded, abs(error), 0.0))


@compiled
def settle_worn(p, which, c_blocks, s_blocks, paths, loop, extended, worn, devices):
    """Reset the given devices as `equilibrium.settle`, with their wearers at rest in the same posture."""
    settle(p, which, c_blocks, s_blocks, paths, loop, extended, devices)
    for device in devices:
        block, i = device // layout.LANES, np.uint64(device % layout.LANES)
        s, h, w = s_blocks[block], worn[1][block], worn[2][block]
        w.elbow[i] = w.followed[i] = s.angle[i]
        w.intention[i] = s.setpoint[i]
        excite_muscles(h, w, i, weight_torque(h.weight[i], w.intention[i]), 0.0)
        w.flexor[i], w.extensor[i] = w.excitation_flexor[i], w.excitation_extensor[i]
        s.setpoint[i], s.setpoint_jump[i] = w.followed[i], 0.0
