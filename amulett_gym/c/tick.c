/* The tick of amulett_gym/simulation/kernel.py in plain C: a yardstick for its speed, and with other loops than that of
   loop.h the simulation in a browser (live.c).

   Names and order of operations are those of the kernel. layout.h is generated from the dtypes of simulation/layout.py.
   A `real` holds WIDTH devices: with WIDTH 1 it is a double, and each device does the whole tick before the next one;
   with WIDTH 8 it is a vector, and the block's devices do it together, with both sides of each choice computed. The
   equations are the same text in both. */

#include "lanes.h"

#if WIDTH > 1
typedef integer field __attribute__((may_alias)); /* the lanes of any field of a block */

/* Restore some lanes of a block. */
INLINE void keep(states *s, const states *before, mask lanes) {
    const field *then = (const field *)before;
    field *now = (field *)s;
    for (uint64_t k = 0; k < sizeof(states) / sizeof(field); k++) now[k] = either(lanes, then[k], now[k]);
}
#endif

typedef const parameters *restrict Parameters;
typedef const scenarios *restrict Scenarios;
typedef states *restrict States;

#include "loop.h"

/* ---- simulation/random.py ---- */

INLINE word random_bits(word key, word counter) {
    word z = key + (counter + 1) * GOLDEN;
    z = (z ^ (z >> 30)) * MIX_1;
    z = (z ^ (z >> 27)) * MIX_2;
    return z ^ (z >> 31);
}

INLINE real noise(word key, word counter) {
    word bits = random_bits(key, counter);
    real total = to_real(bits & 0xFFFF) + to_real((bits >> 16) & 0xFFFF) + to_real((bits >> 32) & 0xFFFF) +
                 to_real(bits >> 48);
    return (total - NOISE_MEAN) / NOISE_DEVIATION;
}

/* ---- model/ ---- */

/* model/spring.py: what a string has beyond the tables' end. */
INLINE real spring_force(Parameters p, real position) {
    real force = look_up(p->force_table, position);
    if (!p->extended) return force;
    double width = p->beyond_width * p->beyond_width;
    double end = p->beyond_slope * (1.0 - p->beyond_free_length / sqrt(width + 1.0));
    real x = greatest(position, all(1.0));
    return force + (p->beyond_slope * x * (1.0 - p->beyond_free_length / root(width + x * x)) - end);
}

INLINE real spring_slope(Parameters p, real position) {
    real slope = look_up_slope(p->force_table, position);
    if (!p->extended) return slope;
    double width = p->beyond_width * p->beyond_width;
    real square = width + position * position;
    real beyond = p->beyond_slope * (1.0 - p->beyond_free_length * width / (square * root(square)));
    return slope + select(position <= 1.0, all(0.0), beyond);
}

INLINE real slider_deflection(Parameters p, real position) {
    real deflection = look_up(p->spring_table, position);
    if (!p->extended) return deflection;
    double width = p->beyond_width * p->beyond_width;
    real x = greatest(position, all(1.0));
    return deflection + p->beyond_slider * (root(width + x * x) - sqrt(width + 1.0));
}

INLINE real stretch_biceps(Parameters p, Scenarios c, int64_t i, real drive, real joint) {
    real radius = p->drive_radius * to_real(c->pulley_biceps_factor[i]);
    return (drive * radius - joint * p->joint_radius) * p->inverse_max_deflection;
}

INLINE real stretch_triceps(Parameters p, Scenarios c, int64_t i, real drive, real joint) {
    real radius = p->drive_radius * to_real(c->pulley_triceps_factor[i]);
    return (joint * p->joint_radius - drive * radius) * p->inverse_max_deflection;
}

INLINE real drive_rate(Parameters p, real command, real angle, double sense, real load) {
    if (!p->extended) return least(greatest((command - angle) * p->inverse_lag, all(-p->rate_limit)), all(p->rate_limit));
    if (p->inverse_lag == 0.0) return all(0.0);
    real winding = least(sense * (command - angle) * p->inverse_lag, p->rate_limit * (1.0 - load));
    return sense * greatest(winding, all(-p->rate_limit));
}

INLINE real quantise(real value, double resolution) {
    if (resolution <= 0.0) return value;
    return floor_of(value / resolution + 0.5) * resolution;
}

INLINE real minimum_jerk(real progress) {
    return progress * progress * progress * (10.0 + progress * (6.0 * progress - 15.0));
}

/* ---- simulation/kernel.py, and of its stages metrics.py, dynamics.py, sensors.py and setpoint.py ---- */

/* 1 if this tick counts in the metrics, else 0. */
INLINE real start_counting(Parameters p, Scenarios c, States s, int64_t i) {
    mask counts = to_real(s->tick[i]) * p->control_period >= to_real(c->measure_from[i]) - TIME_SLACK;
    return select(counts, all(1.0), all(0.0));
}

INLINE real setpoint_kick(Parameters p, States s, int64_t i, real counting) {
    real decayed = s->kick_derivative[i];
    if (p->position_on_error) {
        real derivative =
            filtered_derivative(decayed, s->setpoint_jump[i], p->position_kd, p->position_filter, p->control_period);
        s->kick_derivative[i] = select(absolute(derivative) < NEGLIGIBLE, all(0.0), derivative);
    }
    real kick = p->position_kp * s->setpoint_jump[i] + s->kick_derivative[i] - decayed;
    s->isav_kick[i] += counting * kick * kick / p->control_period;
    s->setpoint_jump[i] = all(0.0);
    return kick;
}

INLINE void command_drives(Parameters p, States s, int64_t i, real counting, real biceps, real triceps,
                           real kick_biceps, real kick_triceps) {
    real effort_biceps = limit(p, biceps - kick_biceps) - s->command_biceps[i];
    real effort_triceps = limit(p, triceps - kick_triceps) - s->command_triceps[i];
    s->effort_biceps[i] += counting * effort_biceps * effort_biceps / p->control_period;
    s->effort_triceps[i] += counting * effort_triceps * effort_triceps / p->control_period;
    biceps = limit(p, biceps);
    triceps = limit(p, triceps);
    real change_biceps = biceps - s->command_biceps[i];
    real change_triceps = triceps - s->command_triceps[i];
    s->isav_biceps[i] += counting * change_biceps * change_biceps / p->control_period;
    s->isav_triceps[i] += counting * change_triceps * change_triceps / p->control_period;
    s->iav_biceps[i] += counting * absolute(change_biceps);
    s->iav_triceps[i] += counting * absolute(change_triceps);
    s->previous_setpoint[i] = s->setpoint[i];
    s->command_biceps[i] = biceps;
    s->command_triceps[i] = triceps;
}

/* The loop of loop.h, with the metrics of its commands. */
INLINE void run_loop(Parameters p, States s, int64_t i, real counting) {
    commands wanted = control(p, s, i);
    s->switch_count[i] += select(wanted.switched, counting, all(0.0));
    real kick = setpoint_kick(p, s, i, counting);
    command_drives(p, s, i, counting, wanted.biceps, wanted.triceps, wanted.biceps_share * kick,
                   wanted.triceps_share * kick);
}

INLINE real obstacle_torque(Scenarios c, int64_t i, real angle, real velocity) {
    real side = to_real(c->obstacle_side[i]), stiffness = to_real(c->obstacle_stiffness[i]);
    real depth = side * (angle - c->obstacle_angle[i]);
    mask touching = (depth > 0.0) & (stiffness > 0.0);
    if (!any(touching)) return all(0.0);
    real resistance = stiffness * depth + to_real(c->obstacle_damping[i]) * side * velocity;
    return select(touching, -side * greatest(resistance, all(0.0)), all(0.0));
}

typedef struct {
    real biceps, triceps;
} pair;

INLINE pair string_forces(Parameters p, Scenarios c, int64_t i, real angle, real drive_biceps, real drive_triceps) {
    real biceps = stretch_biceps(p, c, i, drive_biceps, angle);
    real triceps = stretch_triceps(p, c, i, drive_triceps, angle);
    pair force = {to_real(c->spring_biceps_factor[i]) * spring_force(p, biceps),
                  to_real(c->spring_triceps_factor[i]) * spring_force(p, triceps)};
    if (p->extended && p->inverse_lag == 0.0) {
        force.biceps = least(force.biceps, p->stall_torque / (p->drive_radius * to_real(c->pulley_biceps_factor[i])));
        force.triceps = least(force.triceps, p->stall_torque / (p->drive_radius * to_real(c->pulley_triceps_factor[i])));
    }
    return force;
}

INLINE pair drive_rates(Parameters p, Scenarios c, int64_t i, pair command, real biceps, real triceps, pair force) {
    double load = p->drive_radius / p->stall_torque;
    real load_biceps = force.biceps * to_real(c->pulley_biceps_factor[i]) * load;
    real load_triceps = force.triceps * to_real(c->pulley_triceps_factor[i]) * load;
    pair rates = {drive_rate(p, command.biceps, biceps, 1.0, load_biceps),
                  drive_rate(p, command.triceps, triceps, -1.0, load_triceps)};
    return rates;
}

/* By how much a position is beyond the one with a string force, by bisection; 0 if it is not. */
INLINE real slip(Parameters p, real position, real force) {
    mask slips = spring_force(p, position) > force;
    if (!any(slips)) return all(0.0);
    real low = all(0.0), high = position;
    for (int k = 0; k < 60; k++) {
        real middle = 0.5 * (low + high);
        mask below = spring_force(p, middle) < force;
        low = select(below, middle, low);
        high = select(below, high, middle);
    }
    return select(slips, position - 0.5 * (low + high), all(0.0));
}

INLINE real acceleration(Parameters p, Scenarios c, int64_t i, real angle, real velocity, pair force, real push) {
    real force_biceps = force.biceps, force_triceps = force.triceps;
    real preload = p->damping_by_mean ? 0.5 * (force_biceps + force_triceps) : least(force_biceps, force_triceps);
    real decay = c->friction[i] * decay_rate(p, preload);
    real external = push + obstacle_torque(c, i, angle, velocity);
    real weight = all(0.0);
    if (any(c->static_torque[i] != 0.0)) weight = c->static_torque[i] * sine(angle);
    real torque = (force_biceps - force_triceps) * p->joint_radius - weight + external;
    return torque / c->inertia[i] - 2.0 * decay * velocity;
}

INLINE real pushes(Parameters p, Scenarios c, States s, int64_t i) {
    real time = to_real(s->tick[i]) * p->control_period, push = all(0.0);
    for (int64_t k = 0; k < MAX_PUSHES && any(k < to_integer(c->push_count[i])); k++) {
        real elapsed = time - to_real(c->push_time[k][i]), slope = to_real(c->push_inverse_rise[k][i]);
        real remaining = to_real(c->push_duration[k][i]) - elapsed;
        mask acts = (k < to_integer(c->push_count[i])) & (elapsed >= -TIME_SLACK) & (remaining > TIME_SLACK);
        if (!any(acts)) continue;
        real ramp = least(greatest(least(elapsed, remaining), all(0.0)) * slope, all(1.0));
        real strength = select(slope > 0.0, ramp, all(1.0));
        push += select(acts, strength * to_real(c->push_torque[k][i]), all(0.0));
    }
    return push;
}

INLINE real shake(Parameters p, Scenarios c, States s, int64_t i, real push) {
    real rms = to_real(c->shake_rms[i]);
    mask shakes = rms > 0.0;
    if (!any(shakes)) return push;
    real elapsed = to_real(s->tick[i]) * p->control_period - to_real(c->shake_time[i]);
    shakes = shakes & (elapsed >= -TIME_SLACK) & (elapsed < to_real(c->shake_duration[i]) - TIME_SLACK);
    if (!any(shakes)) return push;
    real lag = 1.0 / (2.0 * M_PI * select(shakes, to_real(c->shake_bandwidth[i]), all(1.0)));
    real white = noise(c->noise_key[i] ^ SHAKE_STREAM, to_word(s->tick[i]));
    real inner = low_pass(p, s->shake_inner[i], white, lag);
    real outer = low_pass(p, s->shake_outer[i], inner, lag);
    s->shake_inner[i] = select(shakes, inner, s->shake_inner[i]);
    s->shake_outer[i] = select(shakes, outer, s->shake_outer[i]);
    real q = lag / (lag + p->control_period), rest = 1.0 - q * q;
    real deviation = squared(1.0 - q) * root((1.0 + q * q) / (rest * rest * rest));
    return select(shakes, push + rms * outer / deviation, push);
}

INLINE void update_string_forces(Parameters p, Scenarios c, States s, int64_t i) {
    pair force = string_forces(p, c, i, s->angle[i], s->drive_biceps[i], s->drive_triceps[i]);
    s->force_biceps[i] = force.biceps, s->force_triceps[i] = force.triceps;
}

/* Move the device for a tick, under an external torque [N m]. */
INLINE void move(Parameters p, Scenarios c, States s, int64_t i, real counting, real push) {
    pair to = {s->command_biceps[i], s->command_triceps[i]};
    real x = s->angle[i], v = s->velocity[i];
    real a = s->drive_biceps[i], b = s->drive_triceps[i];
    if (p->inverse_lag == 0.0) a = to.biceps, b = to.triceps;
    real error_before = s->setpoint[i] - x;
    double h = p->control_period / (double)p->substeps;
    for (int64_t k = 0; k < p->substeps; k++) {
        pair f1 = string_forces(p, c, i, x, a, b), r1 = drive_rates(p, c, i, to, a, b, f1);
        real v1 = v;
        real w1 = acceleration(p, c, i, x, v1, f1, push);
        real x2 = x + 0.5 * h * v1, a2 = a + 0.5 * h * r1.biceps, b2 = b + 0.5 * h * r1.triceps;
        pair f2 = string_forces(p, c, i, x2, a2, b2), r2 = drive_rates(p, c, i, to, a2, b2, f2);
        real v2 = v + 0.5 * h * w1;
        real w2 = acceleration(p, c, i, x2, v2, f2, push);
        real x3 = x + 0.5 * h * v2, a3 = a + 0.5 * h * r2.biceps, b3 = b + 0.5 * h * r2.triceps;
        pair f3 = string_forces(p, c, i, x3, a3, b3), r3 = drive_rates(p, c, i, to, a3, b3, f3);
        real v3 = v + 0.5 * h * w2;
        real w3 = acceleration(p, c, i, x3, v3, f3, push);
        real x4 = x + h * v3, a4 = a + h * r3.biceps, b4 = b + h * r3.triceps;
        pair f4 = string_forces(p, c, i, x4, a4, b4), r4 = drive_rates(p, c, i, to, a4, b4, f4);
        real v4 = v + h * w3;
        real w4 = acceleration(p, c, i, x4, v4, f4, push);
        a += h * (r1.biceps + 2.0 * r2.biceps + 2.0 * r3.biceps + r4.biceps) / 6.0;
        b += h * (r1.triceps + 2.0 * r2.triceps + 2.0 * r3.triceps + r4.triceps) / 6.0;
        x += h * (v1 + 2.0 * v2 + 2.0 * v3 + v4) / 6.0;
        v += h * (w1 + 2.0 * w2 + 2.0 * w3 + w4) / 6.0;
    }
    if (p->extended && p->inverse_lag == 0.0 && p->stall_torque < INFINITY) {
        real radius_biceps = p->drive_radius * to_real(c->pulley_biceps_factor[i]);
        real radius_triceps = p->drive_radius * to_real(c->pulley_triceps_factor[i]);
        real most_biceps = p->stall_torque / (radius_biceps * to_real(c->spring_biceps_factor[i]));
        real most_triceps = p->stall_torque / (radius_triceps * to_real(c->spring_triceps_factor[i]));
        real slip_biceps = slip(p, stretch_biceps(p, c, i, a, x), most_biceps);
        real slip_triceps = slip(p, stretch_triceps(p, c, i, b, x), most_triceps);
        a -= slip_biceps / (p->inverse_max_deflection * radius_biceps);
        b += slip_triceps / (p->inverse_max_deflection * radius_triceps);
    }
    mask near = is_near(x) & is_near(v);
#if WIDTH == 1
    if (!near) {
        s->failure[i] = NOT_FINITE;
        return;
    }
#else
    bool all_near = !any(not(near));
    states before;
    if (!all_near) before = *s;
#endif
    integer failure = either(absolute(v) > p->velocity_limit, all_integers(VELOCITY_LIMIT), s->failure[i]);
    s->failure[i] = either(absolute(x) > p->angle_limit, all_integers(ANGLE_LIMIT), failure);
    real turn_biceps = a - s->drive_biceps[i], turn_triceps = b - s->drive_triceps[i];
    real pull_biceps = s->force_biceps[i], pull_triceps = s->force_triceps[i];
    s->angle[i] = x, s->velocity[i] = v, s->drive_biceps[i] = a, s->drive_triceps[i] = b;
    s->push_torque[i] = push;
    s->contact_torque[i] = obstacle_torque(c, i, x, v);
    update_string_forces(p, c, s, i);
    real squares = turn_biceps * turn_biceps + turn_triceps * turn_triceps;
    s->drive_effort[i] += counting * squares / p->control_period;
    real work_biceps = to_real(c->pulley_biceps_factor[i]) * (pull_biceps + s->force_biceps[i]) * turn_biceps;
    real work_triceps = to_real(c->pulley_triceps_factor[i]) * (pull_triceps + s->force_triceps[i]) * -turn_triceps;
    real work = 0.5 * p->drive_radius * (greatest(work_biceps, all(0.0)) + greatest(work_triceps, all(0.0)));
    s->drive_work[i] += counting * work;
    real error_after = s->setpoint[i] - x;
    real counted = counting * p->control_period;
    s->position_ise[i] += 0.5 * counted * (error_before * error_before + error_after * error_after);
    s->contact_ise[i] += counted * s->contact_torque[i] * s->contact_torque[i];
    s->contact_peak[i] = greatest(s->contact_peak[i], counting * absolute(s->contact_torque[i]));
    mask pushed = (push != 0.0) & (counting > 0.0);
    s->push_deflection[i] = select(pushed, greatest(s->push_deflection[i], absolute(error_after)), s->push_deflection[i]);
    real force = select(s->agonist[i] == BICEPS, s->force_triceps[i], s->force_biceps[i]);
    real tension_error = s->tension_setpoint[i] - force;
    s->tension_ise[i] += counted * tension_error * tension_error;
#if WIDTH > 1
    if (!all_near) {
        keep(s, &before, not(near));
        s->failure[i] = either(near, s->failure[i], all_integers(NOT_FINITE));
    }
#endif
}

INLINE real sensor_noise(double deviation, word key, word counter) {
    if (deviation > 0.0) return deviation * noise(key, counter);
    return all(0.0);
}

INLINE real read_slider(Parameters p, real deflection, real noise) {
    real end = all(p->slider_travel);
    return quantise(least(greatest(deflection + noise, all(0.0)), end), p->slider_resolution);
}

INLINE void read_sensors(Parameters p, Scenarios c, States s, int64_t i) {
    word key = c->noise_key[i], counter = to_word(s->tick[i]) * SENSOR_STREAMS;
    real more = to_real(c->noise_factor[i]);
    real angle_error = c->encoder_bias[i] + more * sensor_noise(p->encoder_noise, key, counter + ENCODER);
    s->measured_angle[i] = quantise(s->angle[i] + angle_error, p->encoder_resolution);
    real biceps = stretch_biceps(p, c, i, s->drive_biceps[i], s->angle[i]);
    real triceps = stretch_triceps(p, c, i, s->drive_triceps[i], s->angle[i]);
    real biceps_noise = sensor_noise(p->slider_noise, key, counter + SLIDER_BICEPS);
    real biceps_error = to_real(c->slider_bias_biceps[i]) + more * biceps_noise;
    real triceps_noise = sensor_noise(p->slider_noise, key, counter + SLIDER_TRICEPS);
    real triceps_error = to_real(c->slider_bias_triceps[i]) + more * triceps_noise;
    s->measured_biceps[i] = read_slider(p, slider_deflection(p, biceps), biceps_error);
    s->measured_triceps[i] = read_slider(p, slider_deflection(p, triceps), triceps_error);
    real force_biceps = estimate_force(p, p->estimate_table, s->measured_biceps[i]);
    real force_triceps = estimate_force(p, p->estimate_table, s->measured_triceps[i]);
    estimate_strings(p, s, i, force_biceps, force_triceps);
}

INLINE void begin_step(States s, int64_t i, mask begins, real time, real target, real change) {
    mask settled = begins & not(is_nan(s->inside_since[i]));
    s->settling_sum[i] += select(settled, s->inside_since[i] - s->step_start[i], all(0.0));
    s->settling_count[i] += select(settled, all(1.0), all(0.0));
    s->inside_since[i] = select(begins, all(NAN), s->inside_since[i]);
    s->step_start[i] = select(begins, time, s->step_start[i]);
    s->step_target[i] = select(begins, target, s->step_target[i]);
    real direction = select(change > 0.0, all(1.0), select(change < 0.0, all(-1.0), all(0.0)));
    s->step_direction[i] = select(begins, direction, s->step_direction[i]);
    s->risen[i] = either(begins, all_integers(0), s->risen[i]);
    s->step_count[i] += select(begins & (change != 0.0), all(1.0), all(0.0));
}

/* Start angle of a scenario's move k; a k of -1 is no move. */
INLINE real start_of(Scenarios c, int64_t i, integer k) {
    integer last = either(k > 0, k - 1, all_integers(0));
    return select(k > 0, at(c->move_angle, last), c->initial_angle[i]);
}

INLINE void add_wave(Parameters p, Scenarios c, States s, int64_t i) {
    mask waves = c->wave_amplitude[i] > 0.0;
    if (!any(waves)) return;
    real elapsed = to_real(s->tick[i]) * p->control_period - to_real(c->wave_time[i]);
    mask acts = (elapsed >= 0.0) & (elapsed < to_real(c->wave_duration[i]) - TIME_SLACK);
    real cycles = elapsed * (c->wave_frequency[i] + 0.5 * c->wave_chirp[i] * elapsed);
    real wave = select(acts, c->wave_amplitude[i] * sine(2.0 * M_PI * cycles), all(0.0));
    real base = select(s->move[i] < 0, c->initial_angle[i], s->setpoint[i]);
    s->setpoint[i] = select(waves, wave + base, s->setpoint[i]);
    s->setpoint_wave[i] = select(waves, wave, s->setpoint_wave[i]);
}

INLINE void read_setpoint(Parameters p, Scenarios c, States s, int64_t i) {
    real time = to_real(s->tick[i]) * p->control_period;
    for (;;) {
        integer next = s->move[i] + 1;
        integer k = either(next < MAX_MOVES, next, all_integers(MAX_MOVES - 1));
        mask begins = (next < to_integer(c->move_count[i])) & (at(c->move_time, k) <= time + TIME_SLACK);
        if (!any(begins)) break;
        s->move[i] = either(begins, next, s->move[i]);
        real target = at(c->move_angle, k);
        mask counts = time >= to_real(c->measure_from[i]) - TIME_SLACK;
        begin_step(s, i, begins, time, target, select(counts, target - start_of(c, i, k), all(0.0)));
    }
    mask moves = s->move[i] >= 0;
    if (!any(moves)) return;
    integer k = either(moves, s->move[i], all_integers(0));
    real start = start_of(c, i, k), angle = at(c->move_angle, k), duration = at(c->move_duration, k);
    mask lasts = duration > 0.0;
    real progress = all(1.0);
    if (any(lasts)) progress = select(lasts, least((time - at(c->move_time, k)) / duration, all(1.0)), all(1.0));
    real last = s->setpoint[i] - s->setpoint_wave[i];
    s->setpoint[i] = select(moves, start + (angle - start) * minimum_jerk(progress), s->setpoint[i]);
    mask jumps = moves & (duration == 0.0);
    s->setpoint_jump[i] += select(jumps, s->setpoint[i] - last, all(0.0));
}

INLINE void sense(Parameters p, Scenarios c, States s, int64_t i, real counting) {
    s->tick[i] += 1;
    real last_angle = s->measured_angle[i];
    read_sensors(p, c, s, i);
    estimate_velocity(p, s, i, last_angle);
    real force = select(s->agonist[i] == BICEPS, s->estimate_triceps[i], s->estimate_biceps[i]);
    real error = s->tension_setpoint[i] - force;
    s->tension_ise_estimated[i] += counting * p->control_period * error * error;
}

INLINE real joint_stiffness(Parameters p, Scenarios c, States s, int64_t i) {
    real biceps = stretch_biceps(p, c, i, s->drive_biceps[i], s->angle[i]);
    real triceps = stretch_triceps(p, c, i, s->drive_triceps[i], s->angle[i]);
    real slope_biceps = to_real(c->spring_biceps_factor[i]) * spring_slope(p, biceps);
    real slope_triceps = to_real(c->spring_triceps_factor[i]) * spring_slope(p, triceps);
    return (slope_biceps + slope_triceps) * p->inverse_max_deflection * p->joint_radius * p->joint_radius;
}

INLINE void track_step(Parameters p, Scenarios c, States s, int64_t i, real counting) {
    mask tracked = s->step_direction[i] != 0.0;
    if (any(tracked)) {
        real beyond = s->step_direction[i] * (s->angle[i] - s->step_target[i]);
        s->overshoot[i] = select(tracked, greatest(s->overshoot[i], beyond), s->overshoot[i]);
        real time = to_real(s->tick[i]) * p->control_period;
        mask outside = absolute(beyond) > p->margin;
        real since = select(is_nan(s->inside_since[i]), time, s->inside_since[i]);
        s->inside_since[i] = select(tracked, select(outside, all(NAN), since), s->inside_since[i]);
        mask rises = tracked & not(outside) & (s->risen[i] == 0);
        if (any(rises)) {
            s->risen[i] = either(rises, all_integers(1), s->risen[i]);
            s->rise_sum[i] += select(rises, time - s->step_start[i], all(0.0));
            s->rise_count[i] += select(rises, all(1.0), all(0.0));
        }
    }
    mask rests = (absolute(s->setpoint[i] - s->angle[i]) <= p->margin) & (s->setpoint[i] == s->previous_setpoint[i]);
    if (any(rests)) {
        real counted = select(rests, counting * p->control_period, all(0.0));
        s->resting_stiffness_sum[i] += counted * joint_stiffness(p, c, s, i);
        s->resting_time[i] += counted;
    }
}

/* Whether a device misses its control tick: its commands are held for one more period. */
INLINE mask is_late(Scenarios c, States s, int64_t i) {
    real probability = to_real(c->late_probability[i]);
    mask may_be = probability > 0.0;
    if (!any(may_be)) return may_be;
    word bits = random_bits(c->noise_key[i], to_word(s->tick[i]) * SENSOR_STREAMS + LATENESS);
    return may_be & (to_real(bits) * 0x1p-64 < probability);
}

INLINE void act(Parameters p, Scenarios c, States s, int64_t i, real counting) {
    mask late = is_late(c, s, i);
#if WIDTH == 1
    if (!late) run_loop(p, s, i, counting);
#else
    bool some_late = any(late);
    states before;
    if (some_late) before = *s;
    run_loop(p, s, i, counting);
    if (some_late) keep(s, &before, late);
#endif
}

INLINE void tick(Parameters p, Scenarios c, States s, int64_t i) {
    real counting = start_counting(p, c, s, i);
    act(p, c, s, i, counting);
    move(p, c, s, i, counting, shake(p, c, s, i, pushes(p, c, s, i)));
    sense(p, c, s, i, counting);
    read_setpoint(p, c, s, i);
    add_wave(p, c, s, i);
    track_step(p, c, s, i, counting);
}

void advance(Parameters p, const scenarios *c_blocks, states *s_blocks, int64_t num_devices, int64_t ticks) {
    for (int64_t block = 0; block * LANES < num_devices; block++) {
        Scenarios c = c_blocks + block;
        States s = s_blocks + block;
        int64_t filled = num_devices - block * LANES < LANES ? num_devices - block * LANES : LANES;
        for (int64_t k = 0; k < ticks; k++) {
#if WIDTH == 1
            for (int64_t i = 0; i < filled; i++)
                if (s->failure[i] == RUNNING) tick(p, c, s, i);
#else
            integer lanes = {0, 1, 2, 3, 4, 5, 6, 7};
            mask idle = (s->failure[0] != RUNNING) | (lanes >= filled);
            states before;
            bool some_idle = any(idle);
            if (some_idle) before = *s;
            tick(p, c, s, 0);
            if (some_idle) keep(s, &before, idle);
#endif
        }
    }
}
