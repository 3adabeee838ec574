/* Between tensions [N] and actions, envs/action.py: an action is from -1 to 1, and a 32-bit number. */

#ifndef LAW_ACTION_H
#define LAW_ACTION_H

#include "controller.h"

#ifdef CONTROLLER_DOUBLE
#define EXP exp
#define POWER pow
#define OVER(a, b) ((a) / (b))
#else /* of constants b: an AVR takes three times as long for a division */
#define EXP expf
#define POWER powf
#define OVER(a, b) ((a) * (1 / (real)(b)))
#endif

static inline real tension_of_action(real action) {
    const real low = LAW_LOW, high = LAW_HIGH;
    return low + (real)0.5 * (action + 1) * (high - low);
}

/* A number as a 32-bit one, limited to the range of an action. */
static inline real limit_action(real action) {
    action = (real)(float)action;
    return action < -1 ? -1 : action > 1 ? 1 : action;
}

static inline real action_of_tension(real tension) {
    const real low = LAW_LOW, high = LAW_HIGH;
    return limit_action(OVER(2 * (tension - low), high - low) - 1);
}

#endif
