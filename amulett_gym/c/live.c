/* A device that is played live, with a control loop chosen at run time: the tick of tick.c, with the loops of loops.h and
   the hands of a user. It is compiled to WebAssembly for the browser, where amulett_gym/live/core/arm.js uses it.

   An instance is one device. Whoever calls writes its records and knows their layout, which the WebAssembly file holds as
   JSON. Angles are in rad, forces in N, lengths in m, times in s. */

#define WIDTH 1

#include "tick.c"

#include "settle.h"

#include <string.h>

#include "device.h"
#include "live.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(#name), used))
#else /* as a library, to compare speeds */
#define EXPORT(name)
#endif


LOOP_INDICES(DECLARE_LOOP)

typedef struct {
    double time, start, angle, duration;
    int64_t shape;
} part;

static parameters device;
static loop_parameters own; /* of a loop that is not the paper's */
static scenarios scenario;
static states state;
static double memory[MEMORY]; /* of that loop */
static double hand;           /* torque of a hand on the forearm [N m] */
static int chosen;            /* the loop, -1: the paper's, OUTSIDE: one that is not here */
static struct {
    double biceps, triceps, tension, agonist;
} outside; /* what that one commands */
static part path[MOST_PARTS];
static int parts; /* of the path, 0: the setpoint follows moves */
static double readings[READINGS];
static float row[ENTRIES];

/* ---- the loop ---- */

#define BEGIN_OF(k) loop_begin_##k,
#define RUN_OF(k) loop_run_##k,
#define END_OF(k) loop_end_##k,
static void (*const begin_loop[])(const parameters *, const loop_parameters *, states *, double *, double,
                                  const double[2]) = {LOOP_INDICES(BEGIN_OF)};
static void (*const run_own_loop[])(const parameters *, const loop_parameters *, states *, double *,
                                    double[2]) = {LOOP_INDICES(RUN_OF)};
static void (*const end_loop[])(const parameters *, const loop_parameters *, states *, double *) = {LOOP_INDICES(END_OF)};

/* The device has averaged its sensors' readings before it begins: begin_estimates of simulation/loops.py. */
static void begin_own_loop(Parameters p, Scenarios c, States s) {
    double biceps = look_up(p->spring_table, stretch_biceps(p, c, 0, s->drive_biceps[0], s->angle[0]));
    double triceps = look_up(p->spring_table, stretch_triceps(p, c, 0, s->drive_triceps[0], s->angle[0]));
    double slider[2] = {biceps + c->slider_bias_biceps[0], triceps + c->slider_bias_triceps[0]};
    begin_loop[chosen](p, &own, s, memory, s->angle[0] + c->encoder_bias[0], slider);
}

/* Command the drives. A reference has no jump, so that the effort is the whole ISAV. */
static void command_by_own_loop(Parameters p, States s, double counting) {
    double agonist = s->agonist[0], command[2];
    run_own_loop[chosen](p, &own, s, memory, command);
    s->switch_count[0] += s->agonist[0] != agonist ? counting : 0.0;
    /* A number that overflows must not reach the drives. */
    uint8_t sound = fabs(command[0]) <= FARTHEST && fabs(command[1]) <= FARTHEST;
    double biceps = sound ? command[0] : s->command_biceps[0], triceps = sound ? command[1] : s->command_triceps[0];
    command_drives(p, s, 0, counting, biceps, triceps, 0.0, 0.0);
}

/* Command the drives as a loop outside wants: command_device of amulett_gym/firmware/lock_step.py. */
static void command_from_outside(Parameters p, States s, double counting) {
    s->switch_count[0] += outside.agonist != s->agonist[0] ? counting : 0.0;
    s->agonist[0] = outside.agonist, s->tension_setpoint[0] = outside.tension;
    double kick = setpoint_kick(p, s, 0, counting), share = p->tension_loop ? p->antagonist_share : 1.0;
    uint8_t biceps_leads = outside.agonist == BICEPS;
    command_drives(p, s, 0, counting, outside.biceps, outside.triceps, (biceps_leads ? 1.0 : share) * kick,
                   (biceps_leads ? share : 1.0) * kick);
}

/* ---- the setpoint: follow_path of simulation/setpoint.py ---- */

static void follow_path(Parameters p, Scenarios c, States s) {
    double time = s->tick[0] * p->control_period;
    while (s->move[0] + 1 < parts && path[s->move[0] + 1].time <= time + TIME_SLACK) {
        const part *begun = path + ++s->move[0];
        double change = begun->angle - begun->start;
        uint8_t counts = time >= c->measure_from[0] - TIME_SLACK;
        if (begun->shape == PATH_MINIMUM_JERK) begin_step(s, 0, 1, time, begun->angle, counts ? change : 0.0);
        if (begun->duration == 0.0) s->setpoint_jump[0] += change;
    }
    if (s->move[0] < 0) return;
    const part *now = path + s->move[0];
    double progress = 1.0;
    if (now->duration > 0.0) progress = least(greatest((time - now->time) / now->duration, 0.0), 1.0);
    if (now->shape == PATH_MINIMUM_JERK) progress = minimum_jerk(progress);
    s->setpoint[0] = now->start + (now->angle - now->start) * progress;
}

static void find_setpoint(Parameters p, Scenarios c, States s) {
    if (parts > 0) follow_path(p, c, s);
    else read_setpoint(p, c, s, 0);
    add_wave(p, c, s, 0);
}

/* ---- what the page calls ---- */

EXPORT(device_at) void *device_at(void) { return &device; }
EXPORT(loop_at) void *loop_at(void) { return &own; }
EXPORT(scenario_at) void *scenario_at(void) { return &scenario; }
EXPORT(state_at) void *state_at(void) { return &state; }
EXPORT(memory_at) void *memory_at(void) { return memory; }
EXPORT(path_at) void *path_at(void) { return path; }

/* Choose the loop, an index into LOOPS, -1 for the paper's or OUTSIDE, and how many parts of the path are followed. */
EXPORT(choose) void choose(int loop, int count) { chosen = loop, parts = count; }

/* Begin an episode at rest, once the records are written. Return 0, or why the device cannot begin so (settle.h). */
EXPORT(begin) int begin(void) {
    hand = 0.0;
    memset(&state, 0, sizeof state);
    memset(memory, 0, sizeof memory);
    int found = settle_strings(&device, &scenario, &state);
    begin_sensing(&device, &scenario, &state);
    if (chosen >= 0) begin_own_loop(&device, &scenario, &state);
    find_setpoint(&device, &scenario, &state);
    return found;
}

static void play_tick(Parameters p, Scenarios c, States s) {
    double counting = start_counting(p, c, s, 0);
    if (!is_late(c, s, 0)) {
        if (chosen == OUTSIDE) command_from_outside(p, s, counting);
        else if (chosen < 0) run_loop(p, s, 0, counting);
        else command_by_own_loop(p, s, counting);
    }
    if (chosen >= 0) end_loop[chosen](p, &own, s, memory);
    move(p, c, s, 0, counting, shake(p, c, s, 0, pushes(p, c, s, 0)) + hand);
    sense(p, c, s, 0, counting);
    find_setpoint(p, c, s);
    track_step(p, c, s, 0, counting);
}

/* Advance by control ticks; a device that failed keeps its state. Return the failure, 0 for none. */
EXPORT(play) int play(int ticks) {
    for (int k = 0; k < ticks && state.failure[0] == RUNNING; k++) play_tick(&device, &scenario, &state);
    return (int)state.failure[0];
}

/* What a loop outside commands in the next tick: both drives' angles [rad], its tension setpoint [N], its agonist. */
EXPORT(command) void command(double biceps, double triceps, double tension, double agonist) {
    outside.biceps = biceps, outside.triceps = triceps, outside.tension = tension, outside.agonist = agonist;
}

/* Whether the loop misses the next tick. */
EXPORT(misses) int misses(void) { return is_late(&scenario, &state, 0); }

/* Push the forearm with a torque [N m], positive in flexion, until the next call. */
EXPORT(push) void push(double torque) { hand = torque; }

/* Return that torque. */
EXPORT(pushed) double pushed(void) { return hand; }

/* Let a move of the setpoint begin at the end of the next control tick, in place of all moves that are left: a step, or
   over a duration [s]. */
EXPORT(begin_move) void begin_move(double angle, double duration) {
    double time = (state.tick[0] + 1) * device.control_period;
    float begins = (float)time;
    if (begins > time + 0.5 * TIME_SLACK) begins = nextafterf(begins, 0.0f); /* due then, not a tick later */
    scenario.initial_angle[0] = state.setpoint[0] - state.setpoint_wave[0];
    scenario.move_count[0] = 1;
    scenario.move_time[0][0] = begins, scenario.move_angle[0][0] = angle;
    scenario.move_duration[0][0] = (float)duration;
    state.move[0] = -1;
    parts = 0;
}

/* What the device observes, as 32-bit numbers: observe of envs/transition.py. An action of -1 and +1 are the tensions
   `low` and `high` [N], ramps begin `delay` ticks late, and noise of a deviation is added. */
EXPORT(observe) const float *observe(double low, double high, double delay, double deviation) {
    Parameters p = &device;
    States s = &state;
    double tension = s->tension_setpoint[0] + delay * s->tension_rate[0];
    const double values[ENTRIES] = {
        (s->setpoint[0] - s->measured_angle[0]) / OBSERVED_POSITION_ERROR,
        s->measured_angle[0] / OBSERVED_JOINT_ANGLE,
        s->measured_velocity[0] / OBSERVED_JOINT_VELOCITY,
        s->setpoint[0] / OBSERVED_JOINT_ANGLE,
        (s->tick[0] * p->control_period - s->step_start[0]) / OBSERVED_TIME_SINCE_MOVE,
        s->estimate_biceps[0] / OBSERVED_ESTIMATED_TENSION,
        s->estimate_triceps[0] / OBSERVED_ESTIMATED_TENSION,
        s->measured_biceps[0] / p->max_spring_deflection,
        s->measured_triceps[0] / p->max_spring_deflection,
        s->agonist[0],
        s->command_biceps[0] / OBSERVED_COMMAND,
        s->command_triceps[0] / OBSERVED_COMMAND,
        2.0 * (tension - low) / (high - low) - 1.0,
    };
    word key = scenario.noise_key[0] ^ NOISE_STREAM;
    for (int k = 0; k < ENTRIES; k++) {
        row[k] = (float)values[k];
        if (deviation > 0.0) row[k] += deviation * noise(key, (word)(s->tick[0] * ENTRIES + k));
        row[k] = row[k] < -1.0f ? -1.0f : row[k] > 1.0f ? 1.0f : row[k];
    }
    return row;
}

/* The stiffness of the strings about the joint [N m/rad]; and, biceps first, the deflections of both strings and of their
   linear springs [m], and the speeds of both drives [rad/s]. */
EXPORT(read_springs) const double *read_springs(void) {
    Parameters p = &device;
    Scenarios c = &scenario;
    States s = &state;
    double biceps = stretch_biceps(p, c, 0, s->drive_biceps[0], s->angle[0]);
    double triceps = stretch_triceps(p, c, 0, s->drive_triceps[0], s->angle[0]);
    pair to = {s->command_biceps[0], s->command_triceps[0]}, force = {s->force_biceps[0], s->force_triceps[0]};
    pair speed = drive_rates(p, c, 0, to, s->drive_biceps[0], s->drive_triceps[0], force);
    readings[0] = joint_stiffness(p, c, s, 0);
    readings[1] = biceps / p->inverse_max_deflection, readings[2] = triceps / p->inverse_max_deflection;
    readings[3] = slider_deflection(p, biceps), readings[4] = slider_deflection(p, triceps);
    readings[5] = speed.biceps, readings[6] = speed.triceps;
    return readings;
}
