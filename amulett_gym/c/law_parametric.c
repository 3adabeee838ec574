/* The richer law with tuned parameters, laws/parametric.py: a sum over error, rate, torque and the time since a move. */

#include "law.h"

#include <math.h>

#include "law_action.h"

#ifndef CONTROLLER_DOUBLE
#include "curves.h"
#include "law_curve.h"
#endif

static real seen[OBSERVED];
static real error, rate, by_rate, torque, way, far, early, fast, moving, pushed, pushing; /* as in laws/parametric.py */
static uint8_t stage;

static real limit(real value, real least, real most) { return value < least ? least : value > most ? most : value; }

#ifdef CONTROLLER_DOUBLE
static real size_of(real x) { return 1 - exp(-x * x); }
static real tanh_of(real x) { return tanh(x); }
#else
static real size_of(real x) { return read_curve(size_curve, CURVE_CELLS, (x < 0 ? -x : x) * (CURVE_CELLS / SIZE_END)); }
static real tanh_of(real x) { return read_odd_curve(tanh_curve, CURVE_CELLS, x * (CURVE_CELLS / TANH_END)); }
#endif

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
    real x = OVER(tension - middle, half);
#ifdef CONTROLLER_DOUBLE
    real square = x * x, fourth = square * square;
    return middle + half * x / pow(1 + fourth * fourth, 0.125);
#else
    return middle + half * read_odd_curve(squash_curve, CURVE_CELLS, x * (CURVE_CELLS / SQUASH_END));
#endif
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

/* One agent step of a low-pass with two time constants. */
static real follow(real last, real tension) {
    const real rise = LAW_RISE_TIME, fall = LAW_FALL_TIME, period = LAW_PERIOD;
#ifdef CONTROLLER_DOUBLE
    return last + (tension - last) * period / ((tension > last ? rise : fall) + period);
#else
    return last + (tension - last) * (tension > last ? period / (rise + period) : period / (fall + period));
#endif
}

/* Two slices, so that an ATmega2560 takes at most 15000 cycles for each. */
uint8_t law_slice(real *tension) {
    if (stage++ == 0) {
        real time = seen[TIME_SINCE_MOVE] > 0 ? seen[TIME_SINCE_MOVE] : 0;
        by_rate = OVER(OVER(rate * 180, LAW_PI), LAW_SPEED_WIDTH);
        torque = external_torque();
        early = (real)EXP(OVER(-time * (real)OBSERVED_TIME, LAW_EARLY_TIME));
        fast = size_of(by_rate);
        return 0;
    }
    real by_error = OVER(error, LAW_ERROR_WIDTH), by_torque = OVER(torque, LAW_TORQUE_WIDTH);
    far = size_of(by_error), way = tanh_of(by_error);
    pushed = size_of(by_torque), pushing = tanh_of(by_torque);
    moving = tanh_of(by_rate);
    real last = limit(tension_of_action(seen[TENSION_SETPOINT]), LAW_LEAST, LAW_MOST);
    *tension = tension_of_action(action_of_tension(follow(last, squash(sum()))));
    return 1;
}
