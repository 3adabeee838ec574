/* A loop of the literature for live.c: the one with the index LOOP. Its numbers are those of `loop_parameters`, chosen at
   run time, where the firmware has constants (GAINS of device.h). */

#define WIDTH 1
#define CONTROLLER_DOUBLE

#include "lanes.h"

#include <string.h>

#include "device.h"
#include "live.h"

typedef const parameters *Parameters;
typedef states *States;
#define cosine cos

#include "loop.h"
#include "loops.h"

static_assert(sizeof(memory) <= MEMORY * sizeof(double), "the loop's memory");

#if LOOP == FEEDFORWARD_FEEDBACK
#define NUMBERS {.slope_table = l->slope_table, GAINS}
#elif OBSERVES
#define NUMBERS {.estimate_table = p->estimate_table, GAINS}
#else
#define NUMBERS {GAINS}
#endif

#define JOIN(name, k) name##k
#define OF_LOOP(name, k) JOIN(name, k)

DECLARE_LOOP(LOOP)

/* What the loop reads of the sliders: the slope of the string force, or the force. */
static void read_sliders(Parameters p, const loop_parameters *l, States s, Memory q) {
    Table table = LOOP == FEEDFORWARD_FEEDBACK ? l->slope_table : p->estimate_table;
    q->slider_biceps = estimate_force(p, table, s->measured_biceps[0]);
    q->slider_triceps = estimate_force(p, table, s->measured_triceps[0]);
}

void OF_LOOP(loop_begin_, LOOP)(Parameters p, const loop_parameters *l, States s, double *kept, double angle,
                                const double slider[2]) {
    const gains g = NUMBERS;
    Memory q = (Memory)kept;
    start_loop(p, &g, q, angle, slider);
    read_sliders(p, l, s, q);
    begin_loop(p, &g, s, q);
}

void OF_LOOP(loop_run_, LOOP)(Parameters p, const loop_parameters *l, States s, double *kept, double command[2]) {
    const gains g = NUMBERS;
    Memory q = (Memory)kept;
    q->setpoint_jump += s->setpoint_jump[0];
    s->setpoint_jump[0] = 0.0;
    read_sliders(p, l, s, q);
    pair wanted = run_loop(p, &g, s, q);
    command[0] = wanted.biceps, command[1] = wanted.triceps;
#if LOOP == TORQUE_STIFFNESS || LOOP == FEEDFORWARD_FEEDBACK /* reported: what hold_stiff was asked for */
    double slope = look_up_curve(&g, find_position(&g, s->tension_setpoint[0])).slope;
    s->stiffness_setpoint[0] = 2.0 * slope * (g.inverse_max_deflection * p->joint_radius * p->joint_radius);
#endif
}

void OF_LOOP(loop_end_, LOOP)(Parameters p, const loop_parameters *l, States s, double *kept) {
    (void)p;
    const gains g = NUMBERS;
    predict_drives(&g, s, (Memory)kept);
}
