/* The tick of amulett_gym/simulation/kernel.py in plain C: a yardstick for its speed, used for nothing else.

   Same names and order of operations as there. layout.h is generated from the dtypes of simulation/layout.py.
   Built plainly, each device runs through the whole tick before the next one: what a C programmer writes first.
   Built with -DLANE_INNER, each stage of the tick runs through the devices of a block, one in each lane of a vector:
   the shape in which a compiler can use SIMD. The equations are the same text in both. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "layout.h"

#define INLINE static inline __attribute__((always_inline))

#ifdef LANE_INNER
/* The C library's vector versions of exp and sin (libmvec). */
__attribute__((simd("notinbranch"))) double exp(double);
__attribute__((simd("notinbranch"))) double sin(double);
#define FOR_LANES _Pragma("omp simd") for (int64_t i = 0; i < LANES; i++)
#define LOCKSTEP true
#else
#define LOCKSTEP false
#endif

typedef const parameters *restrict Parameters;
typedef const scenarios *restrict Scenarios;
typedef states *restrict States;

/* Python's min and max: the first argument unless the second is truly less, more. */
INLINE double least(double a, double b) { return b < a ? b : a; }
INLINE double greatest(double a, double b) { return b > a ? b : a; }
INLINE double square(double a) { return a * a; }

/* ---- simulation/random.py ---- */

INLINE uint64_t random_bits(uint64_t key, uint64_t counter) {
    uint64_t z = key + (counter + 1) * GOLDEN;
    z = (z ^ (z >> 30)) * MIX_1;
    z = (z ^ (z >> 27)) * MIX_2;
    return z ^ (z >> 31);
}

INLINE double noise(uint64_t key, uint64_t counter) {
    uint64_t bits = random_bits(key, counter);
    double total = (double)(int64_t)(bits & 0xFFFF) + (double)(int64_t)((bits >> 16) & 0xFFFF) +
                   (double)(int64_t)((bits >> 32) & 0xFFFF) + (double)(int64_t)(bits >> 48);
    return (total - NOISE_MEAN) / NOISE_DEVIATION;
}

/* ---- model/ and control/ ---- */

INLINE double look_up(const double table[CELLS][4], double position) {
    double scaled = least(greatest(position, 0.0), 1.0) * CELLS;
    int64_t cell = (int64_t)scaled;
    cell = cell < CELLS - 1 ? cell : CELLS - 1;
    double w = scaled - (double)cell;
    return table[cell][0] + w * (table[cell][1] + w * (table[cell][2] + w * table[cell][3]));
}

INLINE double look_up_slope(const double table[CELLS][4], double position) {
    double scaled = least(greatest(position, 0.0), 1.0) * CELLS;
    int64_t cell = (int64_t)scaled;
    cell = cell < CELLS - 1 ? cell : CELLS - 1;
    double w = scaled - (double)cell;
    double slope = (table[cell][1] + w * (2.0 * table[cell][2] + w * 3.0 * table[cell][3])) * CELLS;
    return position < 0.0 || position > 1.0 ? 0.0 : slope;
}

INLINE double estimate_force(Parameters p, double spring_deflection) {
    return look_up(p->estimate_table, sqrt(greatest(spring_deflection, 0.0) / p->max_spring_deflection));
}

INLINE double deflection_biceps(Parameters p, double drive, double joint) {
    return drive * p->drive_radius - joint * p->joint_radius;
}

INLINE double deflection_triceps(Parameters p, double drive, double joint) {
    return joint * p->joint_radius - drive * p->drive_radius;
}

INLINE double decay_rate(Parameters p, double preload) {
    return greatest(p->damping_a * exp(p->damping_b * preload + p->damping_c) + p->damping_d, 0.0);
}

INLINE double drive_rate(Parameters p, double command, double angle) {
    return least(greatest((command - angle) * p->inverse_lag, -p->rate_limit), p->rate_limit);
}

INLINE double quantise(double value, double resolution) {
    return resolution <= 0.0 ? value : floor(value / resolution + 0.5) * resolution;
}

INLINE double filtered_derivative(double derivative, double change, double gain, double time_constant, double period) {
    return (time_constant * derivative + gain * change) / (time_constant + period);
}

INLINE double integrate(double integral, double error, double gain, double period, bool up, bool down) {
    bool held = (error > 0.0 && !up) || (error < 0.0 && !down);
    return held ? integral : integral + gain * error * period;
}

INLINE double select_agonist(Parameters p, double agonist, double deflection_biceps, double deflection_triceps,
                             double error) {
    double difference = deflection_biceps - deflection_triceps;
    bool tie = fabs(difference) <= p->tie_width && fabs(error) >= p->tie_error && error != 0.0;
    double by_error = error > 0.0 ? BICEPS : TRICEPS;
    double selected = tie ? by_error : agonist;
    selected = difference < -p->switch_hysteresis ? TRICEPS : selected;
    return difference > p->switch_hysteresis ? BICEPS : selected;
}

INLINE double scaling_factor(Parameters p, double error) {
    double lowest = p->minimum_tension / p->nominal_tension;
    double distance = greatest(1.0 - fabs(error) / p->error_offset, 0.0);
    return (1.0 - lowest) * square(square(distance)) + lowest;
}

INLINE double scaling_factor_printed(Parameters p, double error) {
    double lowest = p->minimum_tension / p->nominal_tension;
    return least((1.0 - lowest) * square(square(fabs(error) / p->error_offset)) + lowest, 1.0);
}

INLINE double minimum_jerk(double progress) {
    return progress * progress * progress * (10.0 + progress * (6.0 * progress - 15.0));
}

/* ---- simulation/kernel.py ---- */

INLINE void start_counting(Parameters p, Scenarios c, States s, int64_t i) {
    s->counting[i] = (double)s->tick[i] * p->control_period >= c->measure_from[i] - TIME_SLACK ? 1.0 : 0.0;
}

INLINE void control_position(Parameters p, States s, int64_t i, double error) {
    double signal = p->position_on_error ? error : -s->measured_angle[i];
    s->position_derivative[i] = filtered_derivative(s->position_derivative[i], signal - s->position_signal[i],
                                                    p->position_kd, p->position_filter, p->control_period);
    s->position_signal[i] = signal;
    double command = s->agonist[i] == BICEPS ? s->command_biceps[i] : s->command_triceps[i];
    s->position_integral[i] = integrate(s->position_integral[i], error, p->position_ki, p->control_period,
                                        command < p->command_limit, command > -p->command_limit);
    s->position_output[i] = p->position_kp * error + s->position_integral[i] + s->position_derivative[i];
}

INLINE double choose_tension(Parameters p, States s, int64_t i, double error) {
    if (s->law[i] == AGENT) return s->tension_command[i];
    double factor = s->law[i] == EQ6 ? scaling_factor(p, error) : scaling_factor_printed(p, error);
    return factor * p->nominal_tension;
}

INLINE void control_tension(Parameters p, States s, int64_t i, bool restart) {
    bool biceps_is_antagonist = s->agonist[i] == TRICEPS;
    double estimate = biceps_is_antagonist ? s->estimate_biceps[i] : s->estimate_triceps[i];
    bool untrusted = (biceps_is_antagonist ? s->untrusted_biceps[i] : s->untrusted_triceps[i]) != 0;
    double measured = biceps_is_antagonist ? s->measured_biceps[i] : s->measured_triceps[i];
    double command = biceps_is_antagonist ? s->command_biceps[i] : -s->command_triceps[i];
    double error = s->tension_setpoint[i] - estimate;
    error = untrusted && p->below_floor == IGNORE ? 0.0 : error;
    double signal = p->tension_on_error ? error : -estimate;
    double derivative = filtered_derivative(s->tension_derivative[i], signal - s->tension_signal[i], p->tension_kd,
                                            p->tension_filter, p->control_period);
    double integral = integrate(s->tension_integral[i], error, p->tension_ki, p->control_period,
                                command < p->command_limit && measured < p->slider_end,
                                command > -p->command_limit && !untrusted);
    s->tension_derivative[i] = restart ? 0.0 : derivative;
    s->tension_integral[i] = restart ? -p->tension_kp * error : integral;
    s->tension_signal[i] = signal;
    s->tension_output[i] = p->tension_kp * error + s->tension_integral[i] + s->tension_derivative[i];
}

INLINE double setpoint_kick(Parameters p, States s, int64_t i) {
    double decayed = s->kick_derivative[i];
    if (p->position_on_error)
        s->kick_derivative[i] =
            filtered_derivative(decayed, s->setpoint_jump[i], p->position_kd, p->position_filter, p->control_period);
    double kick = p->position_kp * s->setpoint_jump[i] + s->kick_derivative[i] - decayed;
    s->isav_kick[i] += s->counting[i] * kick * kick / p->control_period;
    s->setpoint_jump[i] = 0.0;
    return kick;
}

INLINE void command_drives(Parameters p, States s, int64_t i, double biceps, double triceps, double kick_biceps,
                           double kick_triceps) {
    double limit = p->command_limit;
    double effort_biceps = least(greatest(biceps - kick_biceps, -limit), limit) - s->command_biceps[i];
    double effort_triceps = least(greatest(triceps - kick_triceps, -limit), limit) - s->command_triceps[i];
    s->effort_biceps[i] += s->counting[i] * effort_biceps * effort_biceps / p->control_period;
    s->effort_triceps[i] += s->counting[i] * effort_triceps * effort_triceps / p->control_period;
    biceps = least(greatest(biceps, -limit), limit);
    triceps = least(greatest(triceps, -limit), limit);
    double change_biceps = biceps - s->command_biceps[i];
    double change_triceps = triceps - s->command_triceps[i];
    s->isav_biceps[i] += s->counting[i] * change_biceps * change_biceps / p->control_period;
    s->isav_triceps[i] += s->counting[i] * change_triceps * change_triceps / p->control_period;
    s->iav_biceps[i] += s->counting[i] * fabs(change_biceps);
    s->iav_triceps[i] += s->counting[i] * fabs(change_triceps);
    s->previous_setpoint[i] = s->setpoint[i];
    s->command_biceps[i] = biceps;
    s->command_triceps[i] = triceps;
}

INLINE void control(Parameters p, States s, int64_t i) {
    double error = s->setpoint[i] - s->measured_angle[i];
    double agonist = p->fixed_agonist != 0.0
                         ? p->fixed_agonist
                         : select_agonist(p, s->agonist[i], s->measured_biceps[i], s->measured_triceps[i], error);
    bool switched = agonist != s->agonist[i];
    s->switch_count[i] += switched ? s->counting[i] : 0.0;
    s->agonist[i] = agonist;
    double last_position_output = s->position_output[i];
    control_position(p, s, i, error);
    double biceps_share = 1.0, triceps_share = 1.0;
    if (p->tension_loop) {
        biceps_share = agonist == BICEPS ? 1.0 : p->antagonist_share;
        triceps_share = agonist == BICEPS ? p->antagonist_share : 1.0;
        s->tension_setpoint[i] = choose_tension(p, s, i, error);
        control_tension(p, s, i, switched);
        double offset_biceps = s->command_biceps[i] - biceps_share * last_position_output;
        double offset_triceps = s->command_triceps[i] - triceps_share * last_position_output;
        s->offset_biceps[i] = switched ? offset_biceps : s->offset_biceps[i];
        s->offset_triceps[i] = switched ? offset_triceps : s->offset_triceps[i];
    }
    double pull = s->tension_output[i];
    double biceps =
        s->offset_biceps[i] + biceps_share * s->position_output[i] + (agonist == TRICEPS ? pull : 0.0);
    double triceps =
        s->offset_triceps[i] + triceps_share * s->position_output[i] - (agonist == BICEPS ? pull : 0.0);
    double kick = setpoint_kick(p, s, i);
    command_drives(p, s, i, biceps, triceps, biceps_share * kick, triceps_share * kick);
}

INLINE double obstacle_torque(Scenarios c, int64_t i, double angle, double velocity) {
    double side = c->obstacle_side[i];
    double depth = side * (angle - c->obstacle_angle[i]);
    double resistance = c->obstacle_stiffness[i] * depth + c->obstacle_damping[i] * side * velocity;
    return depth <= 0.0 || c->obstacle_stiffness[i] <= 0.0 ? 0.0 : -side * greatest(resistance, 0.0);
}

INLINE double acceleration(Parameters p, Scenarios c, int64_t i, double angle, double velocity, double drive_biceps,
                           double drive_triceps, double push) {
    double stretch_biceps = deflection_biceps(p, drive_biceps, angle);
    double stretch_triceps = deflection_triceps(p, drive_triceps, angle);
    double force_biceps = look_up(p->force_table, stretch_biceps * p->inverse_max_deflection);
    double force_triceps = look_up(p->force_table, stretch_triceps * p->inverse_max_deflection);
    double preload =
        p->damping_by_mean ? 0.5 * (force_biceps + force_triceps) : least(force_biceps, force_triceps);
    double decay = decay_rate(p, preload);
    decay = p->damping_keeps_torque ? decay * (p->inertia / c->inertia[i]) : decay;
    double external = push + obstacle_torque(c, i, angle, velocity);
    double torque =
        (force_biceps - force_triceps) * p->joint_radius - c->static_torque[i] * sin(angle) + external;
    return torque / c->inertia[i] - 2.0 * decay * velocity;
}

INLINE double pushes(Parameters p, Scenarios c, States s, int64_t i) {
    double time = (double)s->tick[i] * p->control_period, push = 0.0;
    for (int64_t k = 0; k < (LOCKSTEP ? MAX_PUSHES : c->push_count[i]); k++) {
        double elapsed = time - c->push_time[k][i] + TIME_SLACK;
        bool acts = k < c->push_count[i] && 0.0 <= elapsed && elapsed < c->push_duration[k][i];
        push += acts ? c->push_torque[k][i] : 0.0;
    }
    return push;
}

typedef struct {
    double x, v, a, b; /* joint angle and velocity, drive angles */
} motion;

INLINE motion runge_kutta(Parameters p, Scenarios c, int64_t i, motion m, double to_biceps, double to_triceps,
                          double push) {
    double h = p->control_period / (double)p->substeps;
    double x = m.x, v = m.v, a = m.a, b = m.b;
    double a1 = drive_rate(p, to_biceps, a);
    double b1 = drive_rate(p, to_triceps, b);
    double v1 = v;
    double w1 = acceleration(p, c, i, x, v1, a, b, push);
    double a2 = drive_rate(p, to_biceps, a + 0.5 * h * a1);
    double b2 = drive_rate(p, to_triceps, b + 0.5 * h * b1);
    double v2 = v + 0.5 * h * w1;
    double w2 = acceleration(p, c, i, x + 0.5 * h * v1, v2, a + 0.5 * h * a1, b + 0.5 * h * b1, push);
    double a3 = drive_rate(p, to_biceps, a + 0.5 * h * a2);
    double b3 = drive_rate(p, to_triceps, b + 0.5 * h * b2);
    double v3 = v + 0.5 * h * w2;
    double w3 = acceleration(p, c, i, x + 0.5 * h * v2, v3, a + 0.5 * h * a2, b + 0.5 * h * b2, push);
    double a4 = drive_rate(p, to_biceps, a + h * a3);
    double b4 = drive_rate(p, to_triceps, b + h * b3);
    double v4 = v + h * w3;
    double w4 = acceleration(p, c, i, x + h * v3, v4, a + h * a3, b + h * b3, push);
    return (motion){x + h * (v1 + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (w1 + 2.0 * w2 + 2.0 * w3 + w4) / 6.0,
                    a + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0, b + h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0};
}

INLINE motion present_motion(Parameters p, States s, int64_t i) {
    bool ideal = p->inverse_lag == 0.0;
    return (motion){s->angle[i], s->velocity[i], ideal ? s->command_biceps[i] : s->drive_biceps[i],
                    ideal ? s->command_triceps[i] : s->drive_triceps[i]};
}

INLINE void feel_strings(Parameters p, States s, int64_t i) {
    double biceps = deflection_biceps(p, s->drive_biceps[i], s->angle[i]);
    double triceps = deflection_triceps(p, s->drive_triceps[i], s->angle[i]);
    s->force_biceps[i] = look_up(p->force_table, biceps * p->inverse_max_deflection);
    s->force_triceps[i] = look_up(p->force_table, triceps * p->inverse_max_deflection);
}

/* The end of move(), for a finite motion. */
INLINE void arrive(Parameters p, Scenarios c, States s, int64_t i, motion m, double push) {
    double error_before = s->setpoint[i] - s->angle[i];
    int64_t too_fast = fabs(m.v) > p->velocity_limit ? VELOCITY_LIMIT : s->failure[i];
    s->failure[i] = fabs(m.x) > p->angle_limit ? ANGLE_LIMIT : too_fast;
    s->angle[i] = m.x, s->velocity[i] = m.v, s->drive_biceps[i] = m.a, s->drive_triceps[i] = m.b;
    s->push_torque[i] = push;
    s->contact_torque[i] = obstacle_torque(c, i, m.x, m.v);
    feel_strings(p, s, i);
    double error_after = s->setpoint[i] - m.x;
    double counted = s->counting[i] * p->control_period;
    s->position_ise[i] += 0.5 * counted * (error_before * error_before + error_after * error_after);
    s->contact_ise[i] += counted * s->contact_torque[i] * s->contact_torque[i];
    s->contact_peak[i] = greatest(s->contact_peak[i], s->counting[i] * fabs(s->contact_torque[i]));
    double deflection = greatest(s->push_deflection[i], fabs(error_after));
    s->push_deflection[i] = push != 0.0 && s->counting[i] > 0.0 ? deflection : s->push_deflection[i];
    double tension_error = s->tension_setpoint[i] - (s->agonist[i] == BICEPS ? s->force_triceps[i] : s->force_biceps[i]);
    s->tension_ise[i] += counted * tension_error * tension_error;
}

INLINE double trust(Parameters p, double estimate, double last) {
    double distrusted = p->below_floor == CLAMP ? p->force_floor : p->below_floor == HOLD ? last : estimate;
    return estimate >= p->force_floor ? estimate : distrusted;
}

INLINE double low_pass(Parameters p, double last, double force) {
    return last + (force - last) * p->control_period / (p->force_filter + p->control_period);
}

/* Exact sensors do not pay for noise: the caller leaves it out (`noisy` is a constant at every call). */
INLINE void read_sensors(Parameters p, Scenarios c, States s, int64_t i, bool noisy_encoder, bool noisy_slider) {
    uint64_t key = c->noise_key[i], counter = (uint64_t)s->tick[i] * SENSOR_STREAMS;
    double angle_noise = noisy_encoder ? p->encoder_noise * noise(key, counter + ENCODER) : 0.0;
    s->measured_angle[i] = quantise(s->angle[i] + angle_noise, p->encoder_resolution);
    double biceps = deflection_biceps(p, s->drive_biceps[i], s->angle[i]);
    double triceps = deflection_triceps(p, s->drive_triceps[i], s->angle[i]);
    double biceps_noise = noisy_slider ? p->slider_noise * noise(key, counter + SLIDER_BICEPS) : 0.0;
    double triceps_noise = noisy_slider ? p->slider_noise * noise(key, counter + SLIDER_TRICEPS) : 0.0;
    biceps = look_up(p->spring_table, biceps * p->inverse_max_deflection) + biceps_noise;
    triceps = look_up(p->spring_table, triceps * p->inverse_max_deflection) + triceps_noise;
    s->measured_biceps[i] = quantise(least(greatest(biceps, 0.0), p->slider_travel), p->slider_resolution);
    s->measured_triceps[i] = quantise(least(greatest(triceps, 0.0), p->slider_travel), p->slider_resolution);
    double raw = estimate_force(p, s->measured_biceps[i]);
    s->untrusted_biceps[i] = raw < p->force_floor;
    s->estimate_biceps[i] = low_pass(p, s->estimate_biceps[i], trust(p, raw, s->estimate_biceps[i]));
    raw = estimate_force(p, s->measured_triceps[i]);
    s->untrusted_triceps[i] = raw < p->force_floor;
    s->estimate_triceps[i] = low_pass(p, s->estimate_triceps[i], trust(p, raw, s->estimate_triceps[i]));
}

INLINE void begin_step(States s, int64_t i, double time, double target, double change) {
    if (!isnan(s->inside_since[i])) {
        s->settling_sum[i] += s->inside_since[i] - s->step_start[i];
        s->settling_count[i] += 1.0;
    }
    s->inside_since[i] = NAN;
    s->step_start[i] = time;
    s->step_target[i] = target;
    s->step_direction[i] = change != 0.0 ? copysign(1.0, change) : 0.0;
    s->risen[i] = 0;
    if (change != 0.0) s->step_count[i] += 1.0;
}

/* The first half of read_setpoint(): begin the moves that are due, which happens in few ticks. */
INLINE bool move_is_due(Parameters p, Scenarios c, States s, int64_t i) {
    double time = (double)s->tick[i] * p->control_period;
    int64_t next = s->move[i] + 1;
    double begins = c->move_time[next < MAX_MOVES ? next : MAX_MOVES - 1][i];
    return next < c->move_count[i] && begins <= time + TIME_SLACK;
}

INLINE void begin_moves(Parameters p, Scenarios c, States s, int64_t i) {
    double time = (double)s->tick[i] * p->control_period;
    while (move_is_due(p, c, s, i)) {
        int64_t k = ++s->move[i];
        double start = k > 0 ? c->move_angle[k - 1][i] : c->initial_angle[i];
        double change = c->move_angle[k][i] - start;
        bool counts = time >= c->measure_from[i] - TIME_SLACK;
        begin_step(s, i, time, c->move_angle[k][i], counts ? change : 0.0);
    }
}

INLINE void read_setpoint(Parameters p, Scenarios c, States s, int64_t i) {
    double time = (double)s->tick[i] * p->control_period;
    int64_t k = s->move[i];
    if (k < 0) return;
    double start = k > 0 ? c->move_angle[k - 1][i] : c->initial_angle[i];
    double progress = 1.0;
    if (c->move_duration[k][i] > 0.0)
        progress = least((time - c->move_time[k][i]) / c->move_duration[k][i], 1.0);
    double last = s->setpoint[i];
    s->setpoint[i] = start + (c->move_angle[k][i] - start) * minimum_jerk(progress);
    if (c->move_duration[k][i] == 0.0) s->setpoint_jump[i] = s->setpoint[i] - last;
}

/* sense() up to the setpoint. */
INLINE void sense(Parameters p, Scenarios c, States s, int64_t i, bool noisy_encoder, bool noisy_slider) {
    s->tick[i] += 1;
    double last_angle = s->measured_angle[i];
    read_sensors(p, c, s, i, noisy_encoder, noisy_slider);
    s->measured_velocity[i] = filtered_derivative(s->measured_velocity[i], s->measured_angle[i] - last_angle, 1.0,
                                                  p->velocity_filter, p->control_period);
    double error = s->tension_setpoint[i] - (s->agonist[i] == BICEPS ? s->estimate_triceps[i] : s->estimate_biceps[i]);
    s->tension_ise_estimated[i] += s->counting[i] * p->control_period * error * error;
}

INLINE double joint_stiffness(Parameters p, States s, int64_t i) {
    double biceps = deflection_biceps(p, s->drive_biceps[i], s->angle[i]);
    double triceps = deflection_triceps(p, s->drive_triceps[i], s->angle[i]);
    double scale = p->inverse_max_deflection;
    double slopes = look_up_slope(p->force_table, biceps * scale) + look_up_slope(p->force_table, triceps * scale);
    return slopes * scale * p->joint_radius * p->joint_radius;
}

INLINE void track_step(Parameters p, States s, int64_t i) {
    if (s->step_direction[i] != 0.0) {
        double beyond = s->step_direction[i] * (s->angle[i] - s->step_target[i]);
        s->overshoot[i] = greatest(s->overshoot[i], beyond);
        double time = (double)s->tick[i] * p->control_period;
        bool inside = !(fabs(beyond) > p->margin);
        bool rises = inside && !s->risen[i];
        s->inside_since[i] = !inside ? NAN : isnan(s->inside_since[i]) ? time : s->inside_since[i];
        s->risen[i] = rises ? 1 : s->risen[i];
        s->rise_sum[i] += rises ? time - s->step_start[i] : 0.0;
        s->rise_count[i] += rises ? 1.0 : 0.0;
    }
    if (fabs(s->setpoint[i] - s->angle[i]) <= p->margin && s->setpoint[i] == s->previous_setpoint[i]) {
        s->resting_stiffness_sum[i] += s->counting[i] * p->control_period * joint_stiffness(p, s, i);
        s->resting_time[i] += s->counting[i] * p->control_period;
    }
}

static void tick_device(Parameters p, Scenarios c, States s, int64_t i) {
    start_counting(p, c, s, i);
    control(p, s, i);
    double push = pushes(p, c, s, i);
    motion m = present_motion(p, s, i);
    for (int64_t k = 0; k < p->substeps; k++)
        m = runge_kutta(p, c, i, m, s->command_biceps[i], s->command_triceps[i], push);
    if (isfinite(m.x) && isfinite(m.v))
        arrive(p, c, s, i, m, push);
    else
        s->failure[i] = NOT_FINITE;
    sense(p, c, s, i, p->encoder_noise > 0.0, p->slider_noise > 0.0);
    begin_moves(p, c, s, i);
    read_setpoint(p, c, s, i);
    track_step(p, s, i);
}

#ifdef LANE_INNER

static void tick_block(Parameters p, Scenarios c, States s) {
    double x[LANES] VECTOR, v[LANES] VECTOR, a[LANES] VECTOR, b[LANES] VECTOR, push[LANES] VECTOR;
    FOR_LANES start_counting(p, c, s, i);
    FOR_LANES control(p, s, i);
    FOR_LANES {
        push[i] = pushes(p, c, s, i);
        motion m = present_motion(p, s, i);
        x[i] = m.x, v[i] = m.v, a[i] = m.a, b[i] = m.b;
    }
    for (int64_t k = 0; k < p->substeps; k++) FOR_LANES {
        motion m = {x[i], v[i], a[i], b[i]};
        m = runge_kutta(p, c, i, m, s->command_biceps[i], s->command_triceps[i], push[i]);
        x[i] = m.x, v[i] = m.v, a[i] = m.a, b[i] = m.b;
    }
    int64_t finite = 1;
    for (int64_t i = 0; i < LANES; i++) finite &= isfinite(x[i]) && isfinite(v[i]);
    if (finite) {
        FOR_LANES arrive(p, c, s, i, ((motion){x[i], v[i], a[i], b[i]}), push[i]);
    } else {
        for (int64_t i = 0; i < LANES; i++)
            if (isfinite(x[i]) && isfinite(v[i]))
                arrive(p, c, s, i, (motion){x[i], v[i], a[i], b[i]}, push[i]);
            else
                s->failure[i] = NOT_FINITE;
    }
    if (p->encoder_noise > 0.0 && p->slider_noise > 0.0) {
        FOR_LANES sense(p, c, s, i, true, true);
    } else if (p->encoder_noise > 0.0 || p->slider_noise > 0.0) {
        for (int64_t i = 0; i < LANES; i++) sense(p, c, s, i, p->encoder_noise > 0.0, p->slider_noise > 0.0);
    } else {
        FOR_LANES sense(p, c, s, i, false, false);
    }
    int64_t due = 0;
    for (int64_t i = 0; i < LANES; i++) due |= move_is_due(p, c, s, i);
    if (due)
        for (int64_t i = 0; i < LANES; i++) begin_moves(p, c, s, i);
    FOR_LANES read_setpoint(p, c, s, i);
    FOR_LANES track_step(p, s, i);
}

#endif

void advance(Parameters p, const scenarios *c_blocks, states *s_blocks, int64_t num_devices, int64_t ticks) {
    for (int64_t block = 0; block * LANES < num_devices; block++) {
        Scenarios c = c_blocks + block;
        States s = s_blocks + block;
        int64_t filled = num_devices - block * LANES < LANES ? num_devices - block * LANES : LANES;
        for (int64_t k = 0; k < ticks; k++) {
#ifdef LANE_INNER
            int64_t running = filled == LANES;
            for (int64_t i = 0; i < LANES; i++) running &= s->failure[i] == RUNNING;
            if (running) {
                tick_block(p, c, s);
                continue;
            }
#endif
            for (int64_t i = 0; i < filled; i++)
                if (s->failure[i] == RUNNING) tick_device(p, c, s, i);
        }
    }
}
