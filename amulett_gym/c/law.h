/* The law: from an observation at the begin of an agent period to the tension setpoint at its end.

   It is computed in slices, at most one in each of the period's first LAW_DELAY + 1 control ticks. */

#ifndef LAW_H
#define LAW_H

#include "controller.h"

enum { OBSERVED = 13 };

/* The entries of envs/transition.py, in order, all from -1 to 1. */
enum {
    POSITION_ERROR, JOINT_ANGLE, JOINT_VELOCITY, SETPOINT, TIME_SINCE_MOVE, ESTIMATED_TENSION_BICEPS,
    ESTIMATED_TENSION_TRICEPS, SPRING_DEFLECTION_BICEPS, SPRING_DEFLECTION_TRICEPS, AGONIST, COMMAND_BICEPS,
    COMMAND_TRICEPS, TENSION_SETPOINT
};

/* Forget the last episode. */
void law_start(void);

/* Begin an agent period with an observation. */
void law_begin(const real observation[OBSERVED]);

/* Compute the next slice. Return 1 if it was the last one; then `tension` [N] is set. */
uint8_t law_slice(real *tension);

#endif
