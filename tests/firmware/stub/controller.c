/* A controller for tests of the board alone: fixed gains, no law. */
#include <string.h>
#include "controller.h"

#define HANG 77      /* setpoints [rad] with which it fails */
#define NO_NUMBER 78

static controller_begin begun;
static controller_output last;

void controller_begin_here(const controller_input *first, const real command[2], controller_begin *begin) {
    memset(begin, 0, sizeof *begin);
    begin->angle = (real)first->encoder * (real)ENCODER_RESOLUTION;
    begin->command[0] = command[0] + 1, begin->command[1] = command[1] - 1; /* winds both strings */
    begin->agonist = 1;
}

void controller_start(const controller_begin *begin) {
    begun = *begin;
    memset(&last, 0, sizeof last);
    last.command[0] = begin->command[0], last.command[1] = begin->command[1];
    last.tension_setpoint = begin->tension, last.agonist = begin->agonist;
}

void controller_tick(const controller_input *in, controller_output *out) {
    for (volatile uint8_t hang = in->setpoint == HANG; hang;) {} /* until the watchdog resets */
    last.status = 0;
    if (in->setpoint == NO_NUMBER) {
        last.status = CONTROLLER_BAD_NUMBER;
    } else if (in->encoder > ENCODER_MOST || in->encoder < -ENCODER_MOST || in->slider[0] < 0 || in->slider[0] > SLIDER_MOST ||
        in->slider[1] < 0 || in->slider[1] > SLIDER_MOST) {
        last.status = CONTROLLER_BAD_SENSOR;
    } else if (!(in->flags & CONTROLLER_LATE)) {
        real error = in->setpoint - (real)in->encoder * (real)ENCODER_RESOLUTION;
        last.command[0] = begun.command[0] + (real)2 * error;
        last.command[1] = begun.command[1] + (real)2 * error;
    }
    *out = last;
}

void controller_let_go(controller_output *out) {
    const real step = (real)(LET_GO_RATE * CONTROL_PERIOD), apart = out->command[0] - out->command[1];
    real part = apart > 2 * step ? step : apart / 2;
    out->status |= CONTROLLER_LETTING_GO;
    if (apart <= 0) {
        out->status |= CONTROLLER_SLACK;
        return;
    }
    out->command[0] -= part, out->command[1] += part;
}
