/* The controller of an AMULETT: from what the board measures in a control period to the commands of both drives.

   `real` is float; with -DCONTROLLER_DOUBLE it is double, as in the simulation. One controller per program: its memory is
   static, nothing is allocated. The functions are called from one thread, or one interrupt, only. */

#ifndef CONTROLLER_H
#define CONTROLLER_H

#include <stdint.h>

#include "device.h"

#ifdef CONTROLLER_DOUBLE
typedef double real;
#else
typedef float real;
#endif

/* A reading: counts of the sensor, or where a profile's sensor is exact, the value itself [rad], [m]. */
#if ENCODER_EXACT
typedef real encoder_count;
#else
typedef int32_t encoder_count;
#endif
#if SLIDER_EXACT
typedef real slider_count;
#else
typedef int32_t slider_count;
#endif

static inline uint8_t is_within(real value, real most) { return value >= -most && value <= most; } /* NaN is not */

enum { BICEPS_STRING = 0, TRICEPS_STRING = 1 };

enum {                           /* flags of an input */
    CONTROLLER_MOVE_BEGINS = 1,  /* a move of the setpoint begins with this tick */
    CONTROLLER_LATE = 2          /* the tick is missed: the sensors are read, the commands stay */
};

enum {                           /* bits of a status */
    CONTROLLER_BAD_SETPOINT = 1, /* not finite, or beyond SETPOINT_MOST: the last one is kept */
    CONTROLLER_BAD_SENSOR = 2,   /* a count out of its range: nothing is computed, the commands stay */
    CONTROLLER_LIMITED = 4,      /* a command is at COMMAND_LIMIT */
    CONTROLLER_LETTING_GO = 8,   /* after controller_let_go, until the next controller_start */
    CONTROLLER_SLACK = 16,       /* both strings are let go */
    CONTROLLER_BAD_NUMBER = 32   /* a command is not finite: the last ones are kept */
};

typedef struct {
    encoder_count encoder;  /* joint angle, flexion positive [ENCODER_RESOLUTION rad], at most ENCODER_MOST either way */
    slider_count slider[2]; /* deflections of both linear springs [SLIDER_RESOLUTION m], from 0 to SLIDER_MOST */
    real setpoint;          /* joint angle asked for [rad] */
    real jump;              /* by how much the setpoint has jumped, rather than moved, since the last tick [rad] */
    uint8_t flags;
} controller_input;

typedef struct {
    real command[2];       /* drive angles, biceps and triceps [rad] */
    real tension_setpoint; /* [N] */
    int8_t agonist;        /* +1: biceps, -1: triceps */
    uint8_t status;
} controller_output;

/* Where an episode begins, at rest. */
typedef struct {
    real command[2];        /* at which the drives rest [rad] */
    real angle;             /* setpoint at which the joint rests [rad] */
    real tension;           /* tension setpoint [N] */
    real estimate[2];       /* string forces, estimated from the first reading [N] */
    real difference;        /* filtered difference of both sliders' readings, with the first one [m] */
    real output;            /* of the position controller [rad] */
    real offset[2];         /* of both commands [rad] */
    real tension_integral;  /* [rad] */
    real averaged_angle;    /* joint angle by the encoder, averaged [rad] */
    real averaged_slider[2]; /* readings of the sliders, averaged [m] */
    int8_t agonist;          /* +1: biceps, -1: triceps */
} controller_begin;

/* Find where an episode begins from a reading and the drives' angles [rad] alone. */
void controller_begin_here(const controller_input *first, const real command[2], controller_begin *begin);

/* Begin an episode; the next tick gets the first reading. */
void controller_start(const controller_begin *begin);

/* Do one control period: read the sensors, compute a share of the law, command the drives. */
void controller_tick(const controller_input *input, controller_output *output);

/* Let both strings go for one control period, at most by LET_GO_RATE [rad/s] each, from the last commands, which `output`
   holds: the commands meet at their mean, where no tension is left. No sensor is read. */
void controller_let_go(controller_output *output);

#endif
