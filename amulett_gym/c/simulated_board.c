/* The board's program on the host, with a pipe or a pseudo-terminal instead of the serial port: no sensors of its own. */
#ifndef __AVR__

#define _POSIX_C_SOURCE 200809L
#include <poll.h>
#include <stdint.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

static int out = 1;

void board_write(const uint8_t *bytes, uint8_t count) {
    while (count) {
        ssize_t written = write(out, bytes, count);
        if (written <= 0) _exit(1);
        bytes += written, count -= (uint8_t)written;
    }
}

void board_mark(uint8_t busy) { (void)busy; }
uint32_t board_clock(void) { return 0; }
uint8_t board_sense(controller_input *input) { return (void)input, 0; }
uint8_t board_can_run(void) { return 0; }
void board_drive(const real command[2]) { (void)command; }

static int64_t now_us(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (int64_t)time.tv_sec * 1000000 + time.tv_nsec / 1000;
}

int main(void) {
    int64_t due = now_us() + CONTROL_TICKS_US;
    board_begin(0, 0);
    for (;;) {
        struct pollfd in = {.fd = 0, .events = POLLIN};
        int64_t left = due - now_us();
        if (poll(&in, 1, left > 0 ? (int)(left / 1000) : 0) > 0) {
            uint8_t bytes[256];
            ssize_t count = read(0, bytes, sizeof bytes);
            if (count <= 0) return 0;
            for (ssize_t k = 0; k < count; k++) board_receive(bytes[k]);
        }
        for (; now_us() >= due; due += CONTROL_TICKS_US) board_period();
    }
}

#endif
