/* An ATmega2560 simulated by simavr, that runs a hex file: bytes in and out of its serial port 0, the cycles between
   the edges of pin B7, and how far the stack has grown. Called from amulett_gym/firmware/chip.py by ctypes. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_twi.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_cycle_timers.h>
#include <simavr/sim_hex.h>

#define MARK 0xC5 /* of memory that nothing has written */
#define FIRST_BYTE 0x200 /* of the internal memory, after the registers */
#define WAITING 4096
#define ENCODER_ADDRESS 0x40
#define OCR1A 0x88
#define OCR1B 0x8A
#define TCCR1A 0x80

typedef struct {
    avr_t *avr;
    avr_irq_t *line;
    uint8_t in[WAITING], out[WAITING];
    uint32_t in_head, in_tail, out_count;
    uint64_t cycles_per_byte, begun;
    uint64_t last, most, total, ticks; /* CPU cycles of the marked ticks */
    uint32_t flash;
    avr_irq_t *bus, *analog[2];
    uint8_t encoder[256], encoder_register, encoder_listens, encoder_addressed, encoder_present;
} chip;

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) { (void)avr, (void)cycles; }
static void no_log(avr_t *avr, const int level, const char *format, va_list arguments) {
    (void)avr, (void)level, (void)format, (void)arguments;
}

static void take_byte(struct avr_irq_t *irq, uint32_t value, void *param) {
    chip *c = param;
    (void)irq;
    if (c->out_count < WAITING) c->out[c->out_count++] = (uint8_t)value;
}

static void take_edge(struct avr_irq_t *irq, uint32_t value, void *param) {
    chip *c = param;
    (void)irq;
    if (value) {
        c->begun = c->avr->cycle;
    } else if (c->begun) {
        c->last = c->avr->cycle - c->begun;
        c->begun = 0;
        c->total += c->last, c->ticks++;
        if (c->last > c->most) c->most = c->last;
    }
}

/* The joint encoder, an AS5048B: a register's number is written, then registers are read in turn. */
static void take_bus(struct avr_irq_t *irq, uint32_t value, void *param) {
    chip *c = param;
    avr_twi_msg_irq_t message = {.u.v = value};
    uint8_t what = message.u.twi.msg, address = message.u.twi.addr;
    (void)irq;
    if (what & TWI_COND_STOP) c->encoder_addressed = 0;
    if (what & TWI_COND_START) {
        c->encoder_addressed = c->encoder_present && address >> 1 == ENCODER_ADDRESS;
        c->encoder_listens = c->encoder_addressed && !(address & 1);
        if (c->encoder_addressed) avr_raise_irq(c->bus, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
    }
    if (!c->encoder_addressed) return;
    if (what & TWI_COND_WRITE) {
        if (c->encoder_listens) c->encoder_register = message.u.twi.data;
        c->encoder_listens = 0;
        avr_raise_irq(c->bus, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
    }
    if (what & TWI_COND_READ)
        avr_raise_irq(c->bus, avr_twi_irq_msg(TWI_COND_READ, address, c->encoder[c->encoder_register++]));
}

/* The next byte arrives at the serial port; return when the one after it does, 0 if there is none. */
static avr_cycle_count_t deliver(avr_t *avr, avr_cycle_count_t when, void *param) {
    chip *c = param;
    (void)avr;
    if (c->in_tail == c->in_head) return 0;
    avr_raise_irq(c->line, c->in[c->in_tail]);
    c->in_tail = (c->in_tail + 1) % WAITING;
    return when + c->cycles_per_byte;
}

void chip_close(chip *c) {
    if (!c) return;
    if (c->avr) {
        avr_terminate(c->avr);
        free(c->avr);
    }
    free(c);
}

/* Return NULL if the file cannot be read or simavr does not know the chip. */
chip *chip_open(const char *hex, uint32_t frequency, uint32_t baud) {
    ihex_chunk_p chunks = NULL;
    avr_global_logger_set(no_log);
    int count = read_ihex_chunks(hex, &chunks);
    chip *c = count > 0 ? calloc(1, sizeof *c) : NULL;
    if (c && (c->avr = avr_make_mcu_by_name("atmega2560"))) {
        avr_t *avr = c->avr;
        avr_init(avr);
        avr->log = LOG_NONE;
        avr->frequency = frequency;
        avr->sleep = no_sleep;
        for (int k = 0; k < count; k++) {
            if (chunks[k].baseaddr + chunks[k].size > avr->flashend + 1) {
                chip_close(c);
                free_ihex_chunks(chunks);
                return NULL;
            }
            memcpy(avr->flash + chunks[k].baseaddr, chunks[k].data, chunks[k].size);
            c->flash += chunks[k].size;
        }
        avr->codeend = avr->flashend;
        avr->pc = avr->reset_pc = 0;
        memset(avr->data + FIRST_BYTE, MARK, avr->ramend + 1 - FIRST_BYTE);
        uint32_t flags = 0;
        avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
        flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
        avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
        c->line = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), take_byte, c);
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), IOPORT_IRQ_PIN7), take_edge, c);
        c->cycles_per_byte = (uint64_t)frequency * 10 / baud;
        avr->vcc = avr->avcc = avr->aref = 5000;
        c->bus = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_INPUT);
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT), take_bus, c);
        for (int k = 0; k < 2; k++) c->analog[k] = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + k);
    } else {
        chip_close(c);
        c = NULL;
    }
    if (chunks) free_ihex_chunks(chunks);
    return c;
}

/* Queue bytes for the serial port; return how many. */
uint32_t chip_send(chip *c, const uint8_t *bytes, uint32_t count) {
    uint32_t k = 0;
    bool idle = !avr_cycle_timer_status(c->avr, deliver, c); /* the watchdog's reset stops it, too */
    while (k < count && (c->in_head + 1) % WAITING != c->in_tail) {
        c->in[c->in_head] = bytes[k++];
        c->in_head = (c->in_head + 1) % WAITING;
    }
    if (idle && k) avr_cycle_timer_register(c->avr, c->cycles_per_byte, deliver, c);
    return k;
}

/* Run until the chip has sent a zero, for at most `cycles`; return the number of bytes sent, -1 if it has crashed. */
int32_t chip_run(chip *c, uint64_t cycles, uint8_t out[WAITING]) {
    avr_t *avr = c->avr;
    uint64_t end = avr->cycle + cycles;
    uint32_t seen = 0;
    for (;;) {
        for (; seen < c->out_count; seen++)
            if (seen > 0 && c->out[seen] == 0) end = 0;
        if (avr->cycle >= end) break;
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) return -1;
    }
    int32_t count = (int32_t)c->out_count;
    memcpy(out, c->out, c->out_count);
    c->out_count = 0;
    return count;
}

/* Set what the sensors give: an encoder with a count from 0 to 16383, or none if it is negative; sliders' counts. */
void chip_set_sensors(chip *c, int32_t encoder, uint32_t biceps, uint32_t triceps) {
    c->encoder_present = encoder >= 0;
    c->encoder[0xFB] = 1;
    c->encoder[0xFE] = (uint8_t)(encoder >> 6), c->encoder[0xFF] = encoder & 0x3F;
    /* In millivolts of 5000 for 1023 counts, rounded up, so that the converter rounds down to the count. */
    avr_raise_irq(c->analog[0], (biceps * 5000 + 1022) / 1023);
    avr_raise_irq(c->analog[1], (triceps * 5000 + 1022) / 1023);
}

/* Fill the servo pulses' lengths in halves of a microsecond; return whether the pins give them. */
uint32_t chip_pulses(const chip *c, uint32_t found[2]) {
    const uint8_t *data = c->avr->data;
    found[0] = data[OCR1A] | data[OCR1A + 1] << 8, found[1] = data[OCR1B] | data[OCR1B + 1] << 8;
    return (data[TCCR1A] & 0xA0) == 0xA0;
}

/* Press the reset button: the memory stays, bytes on the line are lost. */
void chip_reset(chip *c) {
    avr_reset(c->avr);
    c->in_tail = c->in_head;
    c->out_count = 0;
    c->begun = 0;
}

/* Fill: cycle, ticks, cycles of the last, the longest and all ticks, bytes of flash, of static memory, of the stack. */
void chip_measure(const chip *c, uint64_t found[8]) {
    const avr_t *avr = c->avr;
    uint32_t best = 0, best_end = avr->ramend + 1, run = 0;
    for (uint32_t k = FIRST_BYTE; k <= avr->ramend; k++) {
        run = avr->data[k] == MARK ? run + 1 : 0;
        if (run > best) best = run, best_end = k + 1;
    }
    found[0] = avr->cycle, found[1] = c->ticks, found[2] = c->last, found[3] = c->most, found[4] = c->total;
    found[5] = c->flash, found[6] = best_end - best - FIRST_BYTE, found[7] = avr->ramend + 1 - best_end;
}

/* Forget the ticks measured so far. */
void chip_restart_measuring(chip *c) { c->last = c->most = c->total = c->ticks = 0; }
