/* Frames between host and board; see protocol.h. */
#include "protocol.h"

#include <string.h>

static uint16_t next_crc(uint16_t crc, uint8_t byte) { /* CRC-16/IBM-3740: polynomial 0x1021 */
    uint8_t x = (uint8_t)(crc >> 8) ^ byte;
    x ^= x >> 4;
    return (uint16_t)((uint16_t)(crc << 8) ^ (uint16_t)((uint16_t)x << 12) ^ (uint16_t)((uint16_t)x << 5) ^ x);
}

uint16_t protocol_crc(const uint8_t *bytes, uint8_t count) {
    uint16_t crc = 0xFFFF;
    for (uint8_t k = 0; k < count; k++) crc = next_crc(crc, bytes[k]);
    return crc;
}

/* Decode COBS in place; return the length, 0 if it is none. */
static uint8_t decode(uint8_t *bytes, uint8_t count) {
    uint8_t from = 0, to = 0;
    while (from < count) {
        uint8_t code = bytes[from++];
        if (code - 1 > count - from) return 0;
        for (uint8_t k = 1; k < code; k++) bytes[to++] = bytes[from++];
        if (from < count) bytes[to++] = 0;
    }
    return to;
}

int16_t protocol_receive(protocol_reader *reader, uint8_t byte) {
    if (byte != 0) {
        if (reader->count == sizeof reader->bytes) reader->skipping = 1;
        if (!reader->skipping) reader->bytes[reader->count++] = byte;
        return 0;
    }
    uint8_t count = reader->count, skipping = reader->skipping;
    reader->count = reader->skipping = 0;
    if (skipping) return -1;
    if (count == 0) return 0; /* zeros between frames are allowed: they end a broken one */
    count = decode(reader->bytes, count);
    if (count < 4) return -1;
    uint16_t crc = (uint16_t)(reader->bytes[count - 2] | (uint16_t)(reader->bytes[count - 1] << 8));
    return crc == protocol_crc(reader->bytes, count - 2) ? count - 2 : -1;
}

uint8_t protocol_code(uint8_t kind, uint8_t sequence, const uint8_t *content, uint8_t count,
                      uint8_t coded[PROTOCOL_CODED]) {
    uint8_t frame[PROTOCOL_MOST];
    if (count > PROTOCOL_MOST - 4) count = PROTOCOL_MOST - 4;
    frame[0] = kind, frame[1] = sequence;
    if (count) memcpy(frame + 2, content, count);
    count += 2;
    uint16_t crc = protocol_crc(frame, count);
    frame[count++] = (uint8_t)crc, frame[count++] = (uint8_t)(crc >> 8);
    uint8_t place = 0, to = 1; /* of the code byte */
    for (uint8_t k = 0; k < count; k++) {
        if (frame[k] == 0) {
            coded[place] = to - place;
            place = to++;
        } else {
            coded[to++] = frame[k];
        }
    }
    coded[place] = to - place;
    coded[to++] = 0;
    return to;
}
