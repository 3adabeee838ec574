/* The board: what it does with frames of the host, and when it lets the strings go. No hardware is in here.

   Idle until the host says START (lock step: the host sends sensor readings, the board answers with commands) or RUN
   (own sensors, own timer). Both end, at most LET_GO_RATE per control period, with slack strings if a reading is out of
   its range, if a command is not finite, if the host says STOP, or if no sound frame came for HOST_TIMEOUT_US. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#include "controller.h"
#include "protocol.h"

#ifndef HOST_TIMEOUT_US
#define HOST_TIMEOUT_US 1000000
#endif

typedef enum { MODE_IDLE = 0, MODE_LOCK_STEP = 1, MODE_RUN = 2, MODE_LETTING_GO = 3 } board_mode;

typedef enum { /* why the strings are let go */
    REASON_NONE = 0,
    REASON_STOP = 1,    /* the host said so */
    REASON_SENSOR = 2,  /* a reading out of its range, or none */
    REASON_SILENCE = 3, /* no sound frame for HOST_TIMEOUT_US */
    REASON_WATCHDOG = 4, /* a reset while the drives were on: by the watchdog if the board hung, or by its button */
    REASON_NUMBER = 5    /* the controller's numbers are not finite any more; the last commands are kept until then */
} board_reason;

/* ---- called by the hardware's part ---- */

/* Begin; after a watchdog's reset (1) with `last`, the commands kept in memory, or NULL if there are none. */
void board_begin(uint8_t after_watchdog, const controller_output *last);
void board_receive(uint8_t byte);
void board_full(void);   /* bytes were lost */
void board_period(void); /* once in each control period */
board_mode board_state(void);
const controller_output *board_output(void);

/* ---- given by the hardware's part ---- */

void board_write(const uint8_t *bytes, uint8_t count);
void board_mark(uint8_t busy);                /* the controller's tick begins (1), ends (0): a pin for measurements */
uint32_t board_clock(void);                   /* CPU cycles, modulo 2^16 or 2^32; 0 where nothing counts them */
uint8_t board_sense(controller_input *input); /* read encoder and sliders; 0 if a sensor does not answer */
uint8_t board_can_run(void);                  /* whether there are sensors and drives of its own */
void board_drive(const real command[2]);      /* of MODE_RUN, and of letting go after it */

#endif
