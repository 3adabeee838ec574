/* The board's answers to the host; see board.h. */
#include "board.h"

#include <stddef.h>
#include <string.h>

#define MOST_SILENT ((uint32_t)(HOST_TIMEOUT_US / CONTROL_TICKS_US) + 1)
#define MOST_MISSED 3 /* periods in a row in which the board's own sensors may fail to answer */

static protocol_reader reader;
static controller_input input; /* of the last tick */
static controller_output output;
static board_mode mode;
static board_reason reason;
static uint8_t driving;  /* RUN: the commands reach the drives, while letting go too */
static uint8_t sequence; /* of the last request that was answered */
static uint8_t asked;    /* of the last request */
static uint8_t missed;
static uint16_t silent;  /* control periods without a sound frame */
static uint16_t cycles;  /* of the last tick */
static uint8_t answer[PROTOCOL_CODED], answered; /* kept, in case that it is lost on the way */

board_mode board_state(void) { return mode; }
const controller_output *board_output(void) { return &output; }

static void let_go(board_reason why) {
    if (mode == MODE_IDLE || mode == MODE_LETTING_GO) return;
    mode = MODE_LETTING_GO;
    reason = why;
}

void board_begin(uint8_t after_watchdog, const controller_output *last) {
    memset(&reader, 0, sizeof reader);
    memset(&output, 0, sizeof output);
    mode = MODE_IDLE, reason = REASON_NONE;
    driving = sequence = asked = missed = answered = 0;
    silent = cycles = 0;
    if (after_watchdog) {
        reason = REASON_WATCHDOG;
        if (last) output = *last, mode = MODE_LETTING_GO, driving = 1;
    }
}

/* ---- numbers on the wire: in the order of the structs, little endian, without gaps ---- */

static const uint8_t *source;

static void take(void *to, uint8_t size) {
    memcpy(to, source, size);
    source += size;
}

static uint8_t *put(uint8_t *to, const void *from, uint8_t size) {
    memcpy(to, from, size);
    return to + size;
}

static uint8_t is_finite(const uint8_t *number) { /* by its bits: little endian */
    uint8_t low = number[sizeof(real) - 2], high = number[sizeof(real) - 1] & 0x7F;
    return sizeof(real) == 8 ? !(high == 0x7F && low >= 0xF0) : !(high == 0x7F && low >= 0x80);
}

#define INPUT_SIZE (sizeof input.encoder + sizeof input.slider + 2 * sizeof(real) + 1)
#define BEGIN_REALS offsetof(controller_begin, agonist) /* bytes: all before the agonist are reals, without gaps */

static void take_input(void) {
    take(&input.encoder, sizeof input.encoder);
    take(input.slider, sizeof input.slider);
    take(&input.setpoint, sizeof(real));
    take(&input.jump, sizeof(real));
    take(&input.flags, 1);
}

/* Return whether all numbers can be used. */
static uint8_t take_begin(controller_begin *begin) {
    for (uint8_t k = 0; k < BEGIN_REALS; k += sizeof(real))
        if (!is_finite(source + k)) return 0;
    take(begin, BEGIN_REALS);
    take(&begin->agonist, 1);
    return begin->agonist == 1 || begin->agonist == -1;
}

/* ---- answers ---- */

static void reply(uint8_t kind, const uint8_t *content, uint8_t count) {
    answered = protocol_code(kind, sequence, content, count, answer);
    board_write(answer, answered);
}

static void refuse(protocol_fault fault) { /* not kept: the request may come again */
    uint8_t content[1] = {fault}, coded[PROTOCOL_CODED];
    board_write(coded, protocol_code(PROTOCOL_ERROR, asked, content, 1, coded));
}

static uint8_t *put_report(uint8_t *end) {
    uint8_t state = mode, why = reason;
    end = put(end, output.command, sizeof output.command);
    end = put(end, &output.tension_setpoint, sizeof(real));
    end = put(end, &output.agonist, 1);
    end = put(end, &output.status, 1);
    end = put(end, &state, 1);
    end = put(end, &why, 1);
    return put(end, &cycles, 2);
}

static void report(uint8_t request) {
    uint8_t content[PROTOCOL_MOST];
    uint8_t *end = put_report(content);
    if (request == PROTOCOL_GOAL) {
        end = put(end, &input.encoder, sizeof input.encoder);
        end = put(end, input.slider, sizeof input.slider);
    }
    reply(PROTOCOL_REPLY | request, content, (uint8_t)(end - content));
}

static void hello(void) {
    uint8_t content[16] = {PROTOCOL_VERSION, sizeof(real), ENCODER_EXACT, SLIDER_EXACT};
    uint32_t id = FIRMWARE_ID, period = CONTROL_TICKS_US;
    uint16_t law = LAW_TICKS;
    uint8_t *end = put(content + 4, &id, 4);
    end = put(end, &period, 4);
    end = put(end, &law, 2);
    reply(PROTOCOL_REPLY | PROTOCOL_HELLO, content, (uint8_t)(end - content));
}

/* ---- one control tick ---- */

/* Whether a period of letting go passes with each control period (1), or with each sample of the host (0). */
static uint8_t lets_go_by(uint8_t period) { return period == (driving || reason == REASON_SILENCE); }

static void tick(void) {
    board_mark(1);
    uint32_t begun = board_clock();
    controller_tick(&input, &output);
    cycles = (uint16_t)(board_clock() - begun);
    board_mark(0);
    if (output.status & CONTROLLER_BAD_SENSOR) let_go(REASON_SENSOR);
    if (output.status & CONTROLLER_BAD_NUMBER) let_go(REASON_NUMBER);
}

/* Whether nothing is to be let go any more, or only in a simulation. */
static uint8_t at_rest(void) {
    return mode == MODE_IDLE || (mode == MODE_LETTING_GO && (!driving || (output.status & CONTROLLER_SLACK)));
}

static void start_own(void) {
    controller_begin begin;
    memset(&input, 0, sizeof input);
    memset(&begin, 0, sizeof begin);
    if (!board_can_run() || !board_sense(&input)) {
        refuse(FAULT_SENSORS);
        return;
    }
    real rest[2] = {output.command[0], output.command[1]};
    controller_begin_here(&input, rest, &begin);
    controller_start(&begin);
    input.setpoint = begin.angle;
    mode = MODE_RUN, reason = REASON_NONE, driving = 1, missed = output.status = 0;
    report(PROTOCOL_RUN);
}

/* Take a sound frame's request: its kind and its content. */
static void obey(uint8_t kind, const uint8_t *content, uint8_t count) {
    controller_begin begin;
    source = content;
    if (kind == PROTOCOL_HELLO) {
        if (count < 1) refuse(FAULT_GARBLED);
        else if (content[0] != PROTOCOL_VERSION) refuse(FAULT_VERSION);
        else hello();
    } else if (kind == PROTOCOL_START) {
        memset(&begin, 0, sizeof begin);
        if (count != BEGIN_REALS + 1) refuse(FAULT_GARBLED);
        else if (!at_rest() && mode != MODE_LOCK_STEP) refuse(FAULT_ORDER); /* the drives are on: STOP first */
        else if (!take_begin(&begin)) refuse(FAULT_VALUE);
        else {
            controller_start(&begin);
            memset(&output, 0, sizeof output);
            output.command[0] = begin.command[0], output.command[1] = begin.command[1];
            output.tension_setpoint = begin.tension, output.agonist = begin.agonist;
            mode = MODE_LOCK_STEP, reason = REASON_NONE, driving = 0;
            reply(PROTOCOL_REPLY | PROTOCOL_START, 0, 0);
        }
    } else if (kind == PROTOCOL_SAMPLE) {
        if (count != INPUT_SIZE) refuse(FAULT_GARBLED);
        else if (driving || !(mode == MODE_LOCK_STEP || mode == MODE_LETTING_GO)) refuse(FAULT_ORDER);
        else {
            take_input();
            if (mode == MODE_LOCK_STEP) tick();
            else if (lets_go_by(0)) controller_let_go(&output);
            report(kind);
        }
    } else if (kind == PROTOCOL_STOP) {
        let_go(REASON_STOP);
        report(kind);
    } else if (kind == PROTOCOL_READ) {
        report(kind);
    } else if (kind == PROTOCOL_RUN) {
        if (!at_rest()) refuse(FAULT_ORDER);
        else start_own();
    } else if (kind == PROTOCOL_GOAL) {
        real goal;
        if (count != sizeof(real)) refuse(FAULT_GARBLED);
        else if (mode != MODE_RUN) refuse(FAULT_ORDER);
        else if (take(&goal, sizeof goal), !is_within(goal, SETPOINT_MOST)) refuse(FAULT_VALUE);
        else { /* the controller will follow it: the next jump begins here */
            input.jump += goal - input.setpoint;
            input.setpoint = goal;
            input.flags |= CONTROLLER_MOVE_BEGINS;
            report(kind);
        }
    } else {
        refuse(FAULT_KIND);
    }
}

void board_receive(uint8_t byte) {
    int16_t length = protocol_receive(&reader, byte);
    if (length == 0) return;
    if (length < 0) {
        refuse(FAULT_GARBLED);
        return;
    }
    uint8_t kind = reader.bytes[0], number = asked = reader.bytes[1];
    silent = 0;
    if (kind != PROTOCOL_HELLO && number == sequence && answered) {
        board_write(answer, answered); /* the answer was lost; the same request must not tick twice */
        return;
    }
    if (kind != PROTOCOL_HELLO && number != (uint8_t)(sequence + 1)) {
        refuse(FAULT_ORDER);
        return;
    }
    uint8_t before = sequence, kept = answered;
    sequence = number;
    answered = 0;
    obey(kind, reader.bytes + 2, (uint8_t)(length - 2));
    if (!answered) sequence = before, answered = kept; /* refused */
}

void board_full(void) {
    memset(&reader, 0, sizeof reader);
    refuse(FAULT_FULL);
}

void board_period(void) {
    if (mode == MODE_LOCK_STEP || mode == MODE_RUN) {
        if (silent < MOST_SILENT) silent++;
        else let_go(REASON_SILENCE);
    }
    if (mode == MODE_RUN) {
        if (board_sense(&input)) {
            missed = 0;
            tick();
            input.jump = 0, input.flags = 0;
        } else if (++missed >= MOST_MISSED) {
            let_go(REASON_SENSOR);
        }
    } else if (mode == MODE_LETTING_GO && lets_go_by(1)) {
        controller_let_go(&output);
    }
    if (driving) board_drive(output.command);
}
