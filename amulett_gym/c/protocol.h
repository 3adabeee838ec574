/* Frames between host and board: the same rules as amulett_gym/firmware/protocol.py, which describes them. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdint.h>

#define PROTOCOL_VERSION 1
#define PROTOCOL_MOST 128                  /* bytes of a frame before coding: kind, sequence, content, CRC */
#define PROTOCOL_CODED (PROTOCOL_MOST + 2)  /* with COBS's code byte and the zero at the end */

enum { /* kinds of a frame; a reply has the sequence number of its request */
    PROTOCOL_HELLO = 1,  /* version -> version, size of a real, exact encoder, exact sliders, id, period [us], law's ticks */
    PROTOCOL_START = 2,  /* a `controller_begin` -> empty: lock step begins */
    PROTOCOL_SAMPLE = 3, /* a `controller_input` -> a report: one control tick */
    PROTOCOL_STOP = 4,   /* empty -> a report: the board lets the strings go */
    PROTOCOL_READ = 5,   /* empty -> a report, without a tick */
    PROTOCOL_RUN = 6,    /* empty -> a report: the board runs by its own timer and sensors */
    PROTOCOL_GOAL = 7,   /* a setpoint [rad] for that -> a report and the readings */
    PROTOCOL_REPLY = 0x80,
    PROTOCOL_ERROR = 0xFF /* a `protocol_fault` */
};

typedef enum {
    FAULT_NONE = 0,
    FAULT_GARBLED = 1,  /* a frame that is no COBS, or whose CRC or length is wrong */
    FAULT_VERSION = 2,  /* the host speaks another version */
    FAULT_FULL = 3,     /* the receive buffer was full: bytes are lost */
    FAULT_ORDER = 4,    /* not what has to come now: no START before, or a sequence number was skipped */
    FAULT_KIND = 5,     /* an unknown kind */
    FAULT_VALUE = 6,    /* a number that is not finite, a goal beyond SETPOINT_MOST, or an agonist that is none */
    FAULT_SENSORS = 7   /* a RUN, but the board's own sensors do not answer or its drives have no limit */
} protocol_fault;

typedef struct {
    uint8_t bytes[PROTOCOL_MOST + 1]; /* coded, then decoded in place */
    uint8_t count;
    uint8_t skipping; /* too long: until the next zero */
} protocol_reader;

uint16_t protocol_crc(const uint8_t *bytes, uint8_t count);

/* Take a received byte. Return the length of kind, sequence and content if that ends a sound frame, which is at
   reader->bytes; -1 if it ends a garbled one; else 0. */
int16_t protocol_receive(protocol_reader *reader, uint8_t byte);

/* Code a frame, ended by a zero; `content` may have PROTOCOL_MOST - 4 bytes. Return its length in `coded`. */
uint8_t protocol_code(uint8_t kind, uint8_t sequence, const uint8_t *content, uint8_t count,
                      uint8_t coded[PROTOCOL_CODED]);

#endif
