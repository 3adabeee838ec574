/* The loops of the literature: amulett_gym/simulation/loops.py for one device.

   Names and order of operations are those of the simulation. LOOP, the index of the loop in `LOOPS` of
   amulett_gym/simulation/layout.py, is a number of the device: the folder has the file of that loop only. */

#define EQUILIBRIUM_POINT 0
#define CO_ROTATION 1
#define TORQUE_STIFFNESS 2
#define FEEDFORWARD_FEEDBACK 3
#define FEEDBACK_LINEARISATION 4
#define TORQUE 5
#define CASCADE 6
#define COMPUTED_TORQUE 7
#define MINIMAL_MOTION 8
#ifdef CONTROLLER_DOUBLE
#define BEGINS_ALONE 0
#else
#define BEGINS_ALONE 1 /* the first tick holds the commands: an AVR has no time to begin the loop and to run it in one */
#endif
#define OBSERVES (LOOP == FEEDBACK_LINEARISATION || LOOP == TORQUE)

/* What the loop reads of a device in addition to `parameters`: LOOP_PARAMETERS of simulation/layout.py. */
typedef struct {
#ifdef CONTROLLER_DOUBLE
    Table force_table, position_table;
#else
    Pairs force_table;
    const table_real *position_table, *decay_table;
#endif
#if LOOP == FEEDFORWARD_FEEDBACK && !defined FORCES
    Table slope_table;
#elif OBSERVES
    Table estimate_table;
#endif
    real inverse_max_deflection, max_force, floor_position, drive_share, highest_factor, drive_step, inertia, weight;
    real torque_kp, torque_ki, torque_kd;
    real bandwidth, factor, kd, kf, ki, kp, lead, least_tension, most_rate, observer_bandwidth, reference_time;
    real slider_time, slope_floor, stiffness_filter, stiffness_kd, stiffness_ki, stiffness_kp, taut_force;
    real tension_bandwidth, torque_time, velocity_filter, virtual_damping, virtual_stiffness;
    uint8_t reference_shape;
} gains;

typedef const gains *Gains;

typedef struct {
    real offset, rate, acceleration; /* [rad], [rad/s], [rad/s2] */
} motion;

/* The loop's memory: LOOP_BLOCK of simulation/layout.py, with times as numbers of control ticks. */
typedef struct {
    uint32_t tick, last_tick, jump_tick;
    real slider_biceps, slider_triceps; /* string force [N] by the slider, or its slope by the deflection [N/m] */
    real setpoint_jump; /* that no motion of the reference was begun for yet [rad] */
    real reference, reference_rate, reference_acceleration, setpoint_acceleration;
    real last_setpoint, last_rate;
    motion jump; /* what was left of the setpoint's jumps at the last one */
    real first_power, second_power, third_power, fourth_power, fifth_power; /* of the motion since then */
    real elapsed, velocity, last_angle, model_biceps, model_triceps;
    real integral, stiffness_integral, stiffness_reference, stiffness_error;
    real force_biceps, force_triceps, slope_biceps, slope_triceps, correction_biceps, correction_triceps;
    real observed_angle, observed_velocity, observed_acceleration, disturbance, load;
    uint8_t saturated_biceps, saturated_triceps, begins;
    real biceps, triceps, trim_biceps, trim_triceps;
} memory;

typedef memory *Memory;

#include "loop_springs.h"
#include "loop_motion.h"

/* ---- parts of several loops ---- */

typedef struct {
    uint8_t rise, fall; /* whether both commands, or the torque, may still rise, fall */
} room;

static inline room headroom(Parameters p, States s) {
    real highest = greatest(s->command_biceps[0], s->command_triceps[0]);
    real lowest = least(s->command_biceps[0], s->command_triceps[0]);
    return (room){highest < p->command_limit, lowest > -p->command_limit};
}

/* Whether turning both drives can still raise, and lower, the torque: a wound string's spring may be at its end. */
INLINE room room_to_turn(Parameters p, States s) {
    room found = headroom(p, s);
    found.rise = found.rise && s->measured_biceps[0] < p->slider_end;
    found.fall = found.fall && s->measured_triceps[0] < p->slider_end;
    return found;
}

/* Integrate the position error, as far as turning both drives changes the torque, and return it [rad]. */
INLINE real integrate_position(Parameters p, Gains g, States s, Memory q) {
    real error = q->reference - s->measured_angle[0];
    room room = room_to_turn(p, s);
    q->integral = integrate(q->integral, error, g->ki, p->control_period, room.rise, room.fall);
    return error;
}

/* control/co_rotation.py: by how much the PID of the position turns both drives [rad]. */
INLINE real correct_position(Parameters p, Gains g, States s, Memory q) {
    real error = integrate_position(p, g, s, q);
    return g->kp * error + q->integral + g->kd * (q->reference_rate - q->velocity);
}

/* control/drive_model.py: want the commands that bring the drives to given angles, which move with the joint. */
INLINE void move_drives(Parameters p, Gains g, Memory q, pair to, real joint_rate) {
    real rate = over(joint_rate * p->joint_radius, p->drive_radius);
    real factor = least(g->factor, g->highest_factor);
    q->biceps = q->model_biceps + factor * (to.biceps - q->model_biceps) + g->lead * rate;
    q->triceps = q->model_triceps + factor * (to.triceps - q->model_triceps) + g->lead * rate;
}

/* control/equilibrium_point.py: the drive angles that hold the joint on its reference. */
static inline pair hold_reference(Parameters p, Gains g, States s, Memory q) {
    real angle = q->reference + g->lead * q->reference_rate, torque = weight_torque(g, q->reference);
    return hold_at(p, g, angle, torque, affordable_tension(p, g, torque, s->tension_setpoint[0]));
}

/* ---- the loop itself: `want` sets what it wants of both drives ---- */

#if LOOP == EQUILIBRIUM_POINT || LOOP == CO_ROTATION || LOOP == CASCADE
#include "loop_feed_forward.h"
#elif LOOP == COMPUTED_TORQUE || LOOP == MINIMAL_MOTION
#include "loop_computed_torque.h"
#elif LOOP == TORQUE_STIFFNESS || LOOP == FEEDFORWARD_FEEDBACK
#include "loop_stiffness.h"
#else
#include "loop_observed.h"
#endif

/* ---- begin and tick ---- */

/* Forget the last episode; the device has averaged its sensors' readings. */
static inline void start_loop(Parameters p, Gains g, Memory q, real angle, const real slider[2]) {
    memset(q, 0, sizeof *q);
#if OBSERVES
    q->observed_angle = angle;
    q->force_biceps = estimate_force(p, g->estimate_table, slider[0]);
    q->force_triceps = estimate_force(p, g->estimate_table, slider[1]);
#else
    (void)p, (void)g, (void)angle, (void)slider;
#endif
}

/* Set the memory for a start at rest, after the first reading: the commands go on from where the drives are. */
static inline void begin_loop(Parameters p, Gains g, States s, Memory q) {
    q->tick = 0, q->last_tick = (uint32_t)-1;
    q->reference = q->last_setpoint = s->setpoint[0]; /* before a jump at the very begin */
    q->last_angle = s->measured_angle[0];
    q->model_biceps = s->command_biceps[0], q->model_triceps = s->command_triceps[0];
    q->stiffness_reference = -1;
#if OBSERVES
    begin_estimates(p, g, q);
#endif
#if LOOP == FEEDBACK_LINEARISATION
    pair held = hold_reference(p, g, s, q); /* its trim is that of the feed-forward */
    q->biceps = held.biceps, q->triceps = held.triceps;
#else
    want(p, g, s, q);
#endif
    q->trim_biceps = s->command_biceps[0] - q->biceps;
    q->trim_triceps = s->command_triceps[0] - q->triceps;
#if LOOP == TORQUE /* what the drives turn together is the feedback's */
    q->trim_biceps = (real)0.5 * (q->trim_biceps - q->trim_triceps);
    q->trim_triceps = -q->trim_biceps;
#endif
    q->integral = q->stiffness_integral = q->stiffness_error = 0;
    q->begins = BEGINS_ALONE;
}

/* Choose agonist and tension setpoint, and read setpoint and joint angle. */
INLINE void prepare(Parameters p, Gains g, States s, Memory q) {
    real error = s->setpoint[0] - s->measured_angle[0];
    real agonist = p->fixed_agonist;
    if (p->fixed_agonist == 0) agonist = select_agonist(p, s->agonist[0], s->measured_difference[0], error);
    s->agonist[0] = agonist; /* reported; these loops treat both drives alike */
    s->tension_setpoint[0] = choose_tension(p, s, 0, error);
    note_setpoint(p, g, s, q);
}

/* Return the commands of a control tick [rad], not yet limited. */
static inline pair run_loop(Parameters p, Gains g, States s, Memory q) {
    prepare(p, g, s, q);
    if (q->begins) {
        q->begins = 0;
        q->last_setpoint -= q->setpoint_jump; /* the motion begins in the next tick: it is no jump back then */
        return (pair){s->command_biceps[0], s->command_triceps[0]};
    }
    begin_motion(p, g, q);
    move_reference(p, g, q);
#if OBSERVES
    observe_device(p, g, s, q);
#endif
    want(p, g, s, q);
    return (pair){q->biceps + q->trim_biceps, q->triceps + q->trim_triceps};
}

INLINE real next_angle(Gains g, real angle, real command) {
    return angle + least(greatest((command - angle) * g->drive_share, -g->drive_step), g->drive_step);
}

/* Advance the model of both drives by a control period, after ticks that the loop missed too. */
INLINE void predict_drives(Gains g, States s, Memory q) {
    q->model_biceps = next_angle(g, q->model_biceps, s->command_biceps[0]);
    q->model_triceps = next_angle(g, q->model_triceps, s->command_triceps[0]);
    q->tick++;
}
