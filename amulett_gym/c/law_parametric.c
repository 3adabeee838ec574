/* The richer law with tuned parameters, laws/parametric.py: a sum over error, rate, torque and the time since a move. */

#include "law.h"

#include <math.h>

#include "law_action.h"

static real seen[OBSERVED];
static real error, rate, torque, way, far, early, fast, moving, pushed, pushing, wanted; /* as in laws/parametric.py */
static uint8_t stage;

static real limit(real value, real least, real most) { return value < least ? least : value > most ? most : value; }

static real size_of(real x) { return 1 - (real)EXP(-x * x); }

void law_start(void) { stage = 0; }

void law_begin(const real observation[OBSERVED]) {
    for (uint8_t k = 0; k < OBSERVED; k++) seen[k] = observation[k];
    error = OVER(seen[POSITION_ERROR] * (real)OBSERVED_ERROR * 180, LAW_PI);
    rate = seen[JOINT_VELOCITY] * (real)OBSERVED_VELOCITY;
    stage = 0;
}

/* The external torque by eq. 1 at constant speed. */
static real external_torque(void) {
    real biceps = seen[ESTIMATED_TENSION_BICEPS] * (real)OBSERVED_TENSION;
    real triceps = seen[ESTIMATED_TENSION_TRICEPS] * (real)OBSERVED_TENSION;
    real preload = (real)0.5 * (biceps + triceps);
    real decay = LAW_DECAY_A * (real)EXP(LAW_DECAY_B * preload + LAW_DECAY_C) + LAW_DECAY_D;
    if (decay < 0) decay = 0;
    return 2 * decay * LAW_INERTIA * rate - (biceps - triceps) * LAW_JOINT_RADIUS;
}

/* The wanted tension within the law's range. */
static real squash(real tension) {
    const real middle = (real)0.5 * (LAW_LEAST + LAW_MOST), half = (real)0.5 * (LAW_MOST - LAW_LEAST);
    real x = OVER(tension - middle, half), square = x * x, fourth = square * square;
    return middle + half * x / EIGHTH_ROOT(1 + fourth * fourth);
}

static real sum(void) {
    real rate_deg_way = way * moving;
    real turned = -seen[AGONIST] * way;
    return LAW_BASE + LAW_ERROR_GAIN * far + LAW_DIRECTION_GAIN * way + LAW_SWITCH_GAIN * (turned > 0 ? turned : 0) +
           LAW_SPEED_GAIN * fast + LAW_APPROACH_GAIN * rate_deg_way + LAW_EARLY_GAIN * early +
           LAW_EARLY_ERROR_GAIN * early * far + LAW_TORQUE_GAIN * pushed + LAW_HELP_GAIN * way * pushing +
           OVER(LAW_ANGLE_GAIN * seen[JOINT_ANGLE] * (real)OBSERVED_ANGLE, (real)0.5 * (real)LAW_PI) +
           LAW_EARLY_DIRECTION_GAIN * early * way;
}

/* Three slices, so that an ATmega2560 takes at most 15000 cycles for each. */
uint8_t law_slice(real *tension) {
    switch (stage++) {
    case 0: {
        real rate_deg = OVER(rate * 180, LAW_PI);
        torque = external_torque();
        fast = size_of(OVER(rate_deg, LAW_SPEED_WIDTH));
        return 0;
    }
    case 1: {
        real time = seen[TIME_SINCE_MOVE] > 0 ? seen[TIME_SINCE_MOVE] : 0;
        far = size_of(OVER(error, LAW_ERROR_WIDTH));
        early = (real)EXP(OVER(-time * (real)OBSERVED_TIME, LAW_EARLY_TIME));
        way = (real)TANH(OVER(error, LAW_ERROR_WIDTH));
        return 0;
    }
    default: {
        real rate_deg = OVER(rate * 180, LAW_PI);
        moving = (real)TANH(OVER(rate_deg, LAW_SPEED_WIDTH));
        pushed = size_of(OVER(torque, LAW_TORQUE_WIDTH));
        pushing = (real)TANH(OVER(torque, LAW_TORQUE_WIDTH));
        real last = limit(tension_of_action(seen[TENSION_SETPOINT]), LAW_LEAST, LAW_MOST);
        wanted = squash(sum());
        real time_constant = wanted > last ? LAW_RISE_TIME : LAW_FALL_TIME;
        last += (wanted - last) * LAW_PERIOD / (time_constant + LAW_PERIOD);
        *tension = tension_of_action(action_of_tension(last));
        return 1;
    }
    }
}
