/* The controller: the loop of loop.h, or one of loops.h, for one device, with the law at agent rate around it. */

#include "controller.h"

#include <math.h>
#include <string.h>

#include "flash.h"
#include "law.h"
#include "tables.h"

#define INLINE static inline __attribute__((always_inline))

/* ---- what loop.h needs ---- */

typedef real scalar;
typedef int16_t integer;
typedef uint8_t lane;
typedef uint8_t mask;
#define select(condition, yes, no) ((condition) ? (yes) : (no))
#define either(condition, yes, no) ((condition) ? (yes) : (no))
#define to_real(a) ((real)(a))
#define to_integer(a) ((integer)(a))
#define all(a) ((real)(a))
#define all_integers(a) ((integer)(a))
#define not(a) (!(a))
#define any(a) (a)
#ifdef CONTROLLER_DOUBLE
#define absolute fabs
#define root sqrt
#define exponential exp
#define sine sin
#define cosine cos
#define over(a, b) ((a) / (b))
#define share(a, b, c) ((a) * (b) / (c))
#else /* the compiler computes with the parameters: an AVR takes three times as long for a division */
#define absolute fabsf
#define root sqrtf
#define exponential expf
#define sine sinf
#define cosine cosf
#define over(a, b) ((a) * (1 / (real)(b)))
#define share(a, b, c) ((a) * ((b) / (c)))
#endif

#define CELLS 256
#define BICEPS 1
#define TRICEPS (-1)
enum { AGENT, EQ6, EQ6_PRINTED };
enum { CLAMP, HOLD, IGNORE };
#define FARTHEST ((real)1e30) /* [rad] */

typedef struct {
#ifndef FORCES
    Table estimate_table;
#endif
    real max_spring_deflection, command_limit, slider_end, force_filter, force_floor, control_period;
    real position_kp, position_ki, position_kd, position_filter;
    real tension_kp, tension_ki, tension_kd, tension_filter;
    real antagonist_share, position_only_offset, fixed_agonist;
    real switch_filter, switch_hysteresis, tie_width, tie_error, velocity_filter;
    real nominal_tension, minimum_tension, error_offset;
    real drive_radius, joint_radius, damping_a, damping_b, damping_c, damping_d;
    uint8_t below_floor, position_on_error, tension_on_error, tension_loop, law, damping_by_mean;
} parameters;

/* One device. */
typedef struct {
    real setpoint[1], measured_angle[1], measured_velocity[1];
    real measured_biceps[1], measured_triceps[1], measured_difference[1], estimate_biceps[1], estimate_triceps[1];
    integer untrusted_biceps[1], untrusted_triceps[1];
    real tension_command[1], tension_rate[1], tension_setpoint[1], agonist[1];
    real position_output[1], position_integral[1], position_derivative[1], position_signal[1];
    real tension_output[1], tension_integral[1], tension_derivative[1], tension_signal[1];
    real offset_biceps[1], offset_triceps[1], command_biceps[1], command_triceps[1];
} states;

typedef const parameters *Parameters;
typedef states *States;

INLINE void load_cell(Table table, integer cell, real *k0, real *k1, real *k2, real *k3) {
    const table_real *row = table[cell];
    *k0 = read_real(row), *k1 = read_real(row + 1), *k2 = read_real(row + 2), *k3 = read_real(row + 3);
}

#include "loop.h"

#ifdef LOOP /* that of the device is not the paper's */
#include "loops.h"
#include "loop_tables.h"
#endif

/* ---- the device ---- */

static const parameters device = {PARAMETERS};

static states state;
#ifdef LOOP
static const gains own = {GAINS};
static memory loop;
#endif
static real wanted_tension;  /* at the end of the present ramp */
static real next_tension;    /* the same of the next one, once the law is known */
static uint32_t since_move;  /* control ticks since the setpoint began to move */
static uint16_t phase;       /* control ticks since the agent period began */
static uint8_t first, thinking, status;

static uint8_t is_sound(const controller_input *input) {
    return input->encoder >= -(encoder_count)ENCODER_MOST && input->encoder <= (encoder_count)ENCODER_MOST &&
           input->slider[0] >= 0 && input->slider[0] <= (slider_count)SLIDER_MOST && input->slider[1] >= 0 &&
           input->slider[1] <= (slider_count)SLIDER_MOST;
}

static void read_counts(States s, const controller_input *input) {
    s->measured_angle[0] = (real)input->encoder * (real)ENCODER_RESOLUTION;
    s->measured_biceps[0] = (real)input->slider[BICEPS_STRING] * (real)SLIDER_RESOLUTION;
    s->measured_triceps[0] = (real)input->slider[TRICEPS_STRING] * (real)SLIDER_RESOLUTION;
}

/* The string force that the sliders' table gives: by count where that fits, which takes no time. */
#ifdef FORCES
#define force_by(s, name, count) ((void)(s), read_real(force_table + (count)))
#else
#define force_by(s, name, count) ((void)(count), estimate_force(&device, device.estimate_table, (s)->measured_##name[0]))
#endif

#ifdef LOOP /* what the loop reads of a slider: the slope of the force, or the force */
#if LOOP != FEEDFORWARD_FEEDBACK
#define loop_reading(s, name, count, force) (force)
#elif defined FORCES
#define loop_reading(s, name, count, force) read_real(slope_table + (count))
#else
#define loop_reading(s, name, count, force) estimate_force(&device, own.slope_table, (s)->measured_##name[0])
#endif
#endif

void controller_begin_here(const controller_input *first_input, const real command[2], controller_begin *begin) {
    states s;
    memset(&s, 0, sizeof s);
    memset(begin, 0, sizeof *begin);
    read_counts(&s, first_input);
    real biceps = force_by(&s, biceps, first_input->slider[BICEPS_STRING]);
    real triceps = force_by(&s, triceps, first_input->slider[TRICEPS_STRING]);
    begin->command[0] = command[0], begin->command[1] = command[1];
    begin->angle = begin->averaged_angle = s.measured_angle[0];
    begin->averaged_slider[0] = s.measured_biceps[0], begin->averaged_slider[1] = s.measured_triceps[0];
    begin->difference = s.measured_biceps[0] - s.measured_triceps[0];
    begin->estimate[0] = trust(&device, biceps, biceps), begin->estimate[1] = trust(&device, triceps, triceps);
    real agonist = device.fixed_agonist;
    if (agonist == 0) agonist = begin->difference < 0 ? TRICEPS : BICEPS;
    begin->agonist = (int8_t)agonist;
    if (device.tension_loop) {
        real share = device.antagonist_share;
        uint8_t leads = agonist == BICEPS;
        begin->tension = begin->estimate[leads ? 1 : 0];
        begin->output = command[leads ? 0 : 1];
        begin->offset[0] = command[0] - begin->output * (leads ? 1 : share);
        begin->offset[1] = command[1] - begin->output * (leads ? share : 1);
    } else {
        begin->output = (command[0] + command[1]) / 2;
        begin->offset[0] = command[0] - begin->output, begin->offset[1] = command[1] - begin->output;
    }
}

void controller_start(const controller_begin *begin) {
    States s = &state;
    memset(s, 0, sizeof *s);
    s->command_biceps[0] = begin->command[0], s->command_triceps[0] = begin->command[1];
    s->setpoint[0] = begin->angle;
    s->agonist[0] = begin->agonist;
    s->tension_command[0] = s->tension_setpoint[0] = wanted_tension = begin->tension;
    s->estimate_biceps[0] = begin->estimate[0], s->estimate_triceps[0] = begin->estimate[1];
    s->measured_difference[0] = begin->difference;
    s->position_output[0] = s->position_integral[0] = begin->output;
    s->offset_biceps[0] = begin->offset[0], s->offset_triceps[0] = begin->offset[1];
    s->tension_integral[0] = begin->tension_integral;
#ifdef LOOP
    start_loop(&device, &own, &loop, begin->averaged_angle, begin->averaged_slider);
#endif
    since_move = phase = thinking = status = 0;
    first = 1;
    law_start();
}

/* Read the sensors: the first reading is already in the filters. */
static void sense(States s, const controller_input *input) {
    real last_angle = s->measured_angle[0];
    real difference = s->measured_difference[0], biceps = s->estimate_biceps[0], triceps = s->estimate_triceps[0];
    read_counts(s, input);
    real force_biceps = force_by(s, biceps, input->slider[BICEPS_STRING]);
    real force_triceps = force_by(s, triceps, input->slider[TRICEPS_STRING]);
    estimate_strings(&device, s, 0, force_biceps, force_triceps);
#ifdef LOOP
    loop.slider_biceps = loop_reading(s, biceps, input->slider[BICEPS_STRING], force_biceps);
    loop.slider_triceps = loop_reading(s, triceps, input->slider[TRICEPS_STRING], force_triceps);
#endif
    if (!first) {
        estimate_velocity(&device, s, 0, last_angle);
        return;
    }
    s->measured_difference[0] = difference, s->estimate_biceps[0] = biceps, s->estimate_triceps[0] = triceps;
    real error = s->setpoint[0] - s->measured_angle[0];
    real antagonist = s->agonist[0] == BICEPS ? triceps : biceps;
    s->position_signal[0] = device.position_on_error ? error : -s->measured_angle[0];
    s->tension_signal[0] = device.tension_on_error ? s->tension_setpoint[0] - antagonist : -antagonist;
}

static void read_setpoint(States s, const controller_input *input) {
    if (!first && since_move < UINT32_MAX) since_move++;
    if (!is_within(input->setpoint, SETPOINT_MOST) || !is_within(input->jump, 2 * (real)SETPOINT_MOST)) {
        status |= CONTROLLER_BAD_SETPOINT;
        return;
    }
    status &= (uint8_t)~CONTROLLER_BAD_SETPOINT;
    s->setpoint[0] = input->setpoint;
#ifdef LOOP
    loop.setpoint_jump += input->jump;
#endif
    if (input->flags & CONTROLLER_MOVE_BEGINS) since_move = 0;
}

/* An entry of an observation: a 32-bit number from -1 to 1. */
static real entry(real value) {
    value = (real)(float)value;
    return value < -1 ? -1 : value > 1 ? 1 : value;
}

static void observe(States s, real observation[OBSERVED]) {
    const real low = LAW_LOW, high = LAW_HIGH;
    real tension = s->tension_setpoint[0] + LAW_DELAY * s->tension_rate[0]; /* at the end of the present ramp */
    real setpoint = over(2 * (tension - low), high - low) - 1;
    observation[POSITION_ERROR] = entry(over((s->setpoint[0] - s->measured_angle[0]), (real)OBSERVED_ERROR));
    observation[JOINT_ANGLE] = entry(over(s->measured_angle[0], (real)OBSERVED_ANGLE));
    observation[JOINT_VELOCITY] = entry(over(s->measured_velocity[0], (real)OBSERVED_VELOCITY));
    observation[SETPOINT] = entry(over(s->setpoint[0], (real)OBSERVED_ANGLE));
    observation[TIME_SINCE_MOVE] = entry(over((real)since_move * device.control_period, (real)OBSERVED_TIME));
    observation[ESTIMATED_TENSION_BICEPS] = entry(over(s->estimate_biceps[0], (real)OBSERVED_TENSION));
    observation[ESTIMATED_TENSION_TRICEPS] = entry(over(s->estimate_triceps[0], (real)OBSERVED_TENSION));
    observation[SPRING_DEFLECTION_BICEPS] = entry(over(s->measured_biceps[0], device.max_spring_deflection));
    observation[SPRING_DEFLECTION_TRICEPS] = entry(over(s->measured_triceps[0], device.max_spring_deflection));
    observation[AGONIST] = s->agonist[0];
    observation[COMMAND_BICEPS] = entry(over(s->command_biceps[0], (real)OBSERVED_COMMAND));
    observation[COMMAND_TRICEPS] = entry(over(s->command_triceps[0], (real)OBSERVED_COMMAND));
    observation[TENSION_SETPOINT] = entry(setpoint);
}

/* Begin an agent period if one is due, and compute a slice of the law. LAW_DELAY ticks later the tension setpoint goes on
   a ramp over an agent period, as in the simulation; until then the last ramp goes on. */
static void think(States s) {
    if (phase == 0) {
        real observation[OBSERVED];
        s->tension_command[0] = wanted_tension - LAW_DELAY * s->tension_rate[0]; /* without rounding */
        observe(s, observation);
        law_begin(observation);
        thinking = 1;
    }
    do {
        if (thinking) thinking = !law_slice(&next_tension);
    } while (thinking && phase == LAW_DELAY); /* a delay has a tick for each slice; without one all are due */
    if (phase == LAW_DELAY) {
        wanted_tension = next_tension;
        s->tension_rate[0] = (wanted_tension - s->tension_command[0]) / (real)LAW_TICKS;
    }
    if (++phase == LAW_TICKS) phase = 0;
}

static void command(States s, real biceps, real triceps) {
    if (!is_within(biceps, FARTHEST) || !is_within(triceps, FARTHEST)) {
        status |= CONTROLLER_BAD_NUMBER;
        return;
    }
    s->command_biceps[0] = limit(&device, biceps);
    s->command_triceps[0] = limit(&device, triceps);
    uint8_t limited = s->command_biceps[0] != biceps || s->command_triceps[0] != triceps;
    status = (uint8_t)((status & ~CONTROLLER_LIMITED) | (limited ? CONTROLLER_LIMITED : 0));
}

static void report(States s, controller_output *output) {
    output->command[0] = s->command_biceps[0], output->command[1] = s->command_triceps[0];
    output->tension_setpoint = s->tension_setpoint[0];
    output->agonist = s->agonist[0] < 0 ? TRICEPS : BICEPS;
    output->status = status;
}

void controller_tick(const controller_input *input, controller_output *output) {
    States s = &state;
    if (is_sound(input)) {
        status &= (uint8_t)~CONTROLLER_BAD_SENSOR;
        sense(s, input);
#ifdef LOOP
        if (first) begin_loop(&device, &own, s, &loop);
#endif
        read_setpoint(s, input);
        if (device.law == AGENT && device.tension_loop) think(s);
        if (!(input->flags & CONTROLLER_LATE)) {
#ifdef LOOP
            pair wanted = run_loop(&device, &own, s, &loop);
#else
            commands wanted = control(&device, s, 0);
#endif
            command(s, wanted.biceps, wanted.triceps);
        }
        first = 0;
    } else {
        status |= CONTROLLER_BAD_SENSOR;
    }
#ifdef LOOP
    predict_drives(&own, s, &loop);
#endif
    report(s, output);
}

void controller_let_go(controller_output *output) {
    const real most = (real)LET_GO_RATE * device.control_period;
    real mean = (output->command[0] + output->command[1]) / 2, apart = output->command[0] - mean;
    real step = apart > most ? most : apart < -most ? -most : apart;
    state.command_biceps[0] = mean + (apart - step);
    state.command_triceps[0] = mean - (apart - step);
    status |= CONTROLLER_LETTING_GO;
    if (step == apart) status |= CONTROLLER_SLACK;
    report(&state, output);
}
