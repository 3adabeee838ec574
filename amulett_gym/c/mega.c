/* The hardware's part for the Arduino Mega 2560; see mega.h and board.h. Empty for any other processor. */
#ifdef __AVR_ATmega2560__

#include "mega.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <string.h>
#include <util/delay.h>

#include "board.h"

#define RING 128u /* bytes, a power of two */
#define TWI_PATIENCE 2000
#define TWI_BYTE_US 25 /* 9 bits at 400 kHz, and some */

static volatile uint8_t received[RING], receive_head, receive_tail, lost;
static volatile uint8_t sent[RING], send_head, send_tail;
static volatile uint8_t periods;

/* The last commands, kept over a reset while the drives are on: then they are let go from there. */
static struct {
    controller_output output;
    uint16_t crc;
} kept __attribute__((section(".noinit")));

static uint16_t crc_of_kept(void) {
    return (uint16_t)(protocol_crc((const uint8_t *)&kept.output, sizeof kept.output) ^ 0x5A17);
}

/* After a reset by the watchdog it runs on, at its shortest time. */
void mega_stop_watchdog(void) __attribute__((naked, used, section(".init3")));
void mega_stop_watchdog(void) {
    MCUSR = 0;
    wdt_disable();
}

/* ---- serial port ---- */

ISR(USART0_RX_vect) {
    uint8_t broken = UCSR0A & (_BV(FE0) | _BV(DOR0)), byte = UDR0, next = (receive_head + 1) & (RING - 1);
    if (broken & _BV(DOR0)) lost = 1;
    if (next == receive_tail) {
        lost = 1;
        return;
    }
    received[receive_head] = byte;
    receive_head = next;
}

ISR(USART0_UDRE_vect) {
    if (send_head == send_tail) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = sent[send_tail];
    send_tail = (send_tail + 1) & (RING - 1);
}

void board_write(const uint8_t *bytes, uint8_t count) {
    while (count--) {
        uint8_t next = (send_head + 1) & (RING - 1);
        while (next == send_tail) {} /* the transmitter empties it; the watchdog watches */
        sent[send_head] = *bytes++;
        send_head = next;
        UCSR0B |= _BV(UDRIE0);
    }
}

/* ---- time ---- */

ISR(TIMER1_OVF_vect) {
    if (periods < 255) periods++;
}

uint32_t board_clock(void) { return TCNT3; }

void board_mark(uint8_t busy) {
    if (busy) PORTB |= _BV(PB7);
    else PORTB &= (uint8_t)~_BV(PB7);
}

/* ---- sensors ---- */

static uint8_t twi(uint8_t control) {
    uint16_t patience = TWI_PATIENCE;
    TWCR = control | _BV(TWINT) | _BV(TWEN);
    _delay_us(TWI_BYTE_US); /* simavr 1.6 does not clear TWINT: it would say at once that the byte is done */
    while (!(TWCR & _BV(TWINT)))
        if (--patience == 0) return 0;
    return TWSR & 0xF8;
}

static uint8_t twi_begin(void) { /* or begin again */
    uint8_t status = twi(_BV(TWSTA));
    return status == 0x08 || status == 0x10;
}

static uint8_t twi_send(uint8_t byte) { /* return whether an address or a byte was acknowledged */
    TWDR = byte;
    uint8_t status = twi(0);
    return status == 0x18 || status == 0x28 || status == 0x40; /* in writing, of data, in reading */
}

/* Read the encoder's diagnostics, magnitude and angle, registers 0xFB to 0xFF. */
static uint8_t read_encoder(uint16_t *angle) {
    uint8_t bytes[5], sound = 0;
    if (twi_begin() && twi_send(ENCODER_ADDRESS << 1) && twi_send(0xFB) && twi_begin() &&
        twi_send(ENCODER_ADDRESS << 1 | 1)) {
        sound = 1;
        for (uint8_t k = 0; k < 5 && sound; k++) {
            sound = twi(k < 4 ? _BV(TWEA) : 0) == (k < 4 ? 0x50 : 0x58);
            bytes[k] = TWDR;
        }
    }
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    if (!sound) {
        TWCR = 0; /* releases the bus */
        return 0;
    }
    /* Offset compensation finished, no overflow, the magnet neither too near nor too far. */
    if ((bytes[0] & 0x0F) != 0x01) return 0;
    *angle = (uint16_t)((uint16_t)bytes[3] << 6 | (bytes[4] & 0x3F));
    return 1;
}

static uint16_t read_analog(uint8_t channel) {
    ADMUX = _BV(REFS0) | channel;
    ADCSRA |= _BV(ADSC);
    while (ADCSRA & _BV(ADSC)) {}
    return ADC;
}

uint8_t board_can_run(void) {
    /* The firmware counts as these sensors do, and the drives' range is known. */
    return !ENCODER_EXACT && !SLIDER_EXACT && ENCODER_RESOLUTION > 3.834e-4 && ENCODER_RESOLUTION < 3.836e-4 &&
           SLIDER_MOST >= 1023 && SLIDER_MOST <= 1024 && COMMAND_LIMIT < 1000;
}

uint8_t board_sense(controller_input *input) {
    uint16_t raw;
    if (!read_encoder(&raw)) return 0;
    int16_t count = (int16_t)((raw - ENCODER_ZERO) & 0x3FFF);
    if (count >= 0x2000) count -= 0x4000;
    input->encoder = ENCODER_SIGN * count;
    for (uint8_t k = 0; k < 2; k++) {
        int16_t slider = (int16_t)(read_analog(k) - SLIDER_ZERO);
        input->slider[k] = slider < 0 ? 0 : slider;
    }
    return 1;
}

/* ---- drives ---- */

static uint16_t pulse(real command) { /* in halves of a microsecond */
    real share = command / (real)COMMAND_LIMIT;
    if (!(share > -1)) share = -1; /* not a number: as far as it is slack, and never computed with */
    if (share > 1) share = 1;
    return (uint16_t)(2 * (PULSE_MIDDLE_US + (real)PULSE_REACH_US * share));
}

void board_drive(const real command[2]) {
    if (!board_can_run()) return;
    OCR1A = pulse(command[0]), OCR1B = pulse(command[1]);
    TCCR1A |= _BV(COM1A1) | _BV(COM1B1);
    kept.output = *board_output();
    kept.crc = crc_of_kept();
    if (kept.output.status & CONTROLLER_SLACK) kept.crc ^= 1; /* nothing left to let go */
}

/* ---- the program ---- */

void mega_begin(void) {
    uint8_t was_driving = kept.crc == crc_of_kept();
    controller_output last = kept.output;
    kept.crc = crc_of_kept() ^ 1;
    DDRB |= _BV(PB5) | _BV(PB6) | _BV(PB7);
    UCSR0A = _BV(U2X0);
    UBRR0 = F_CPU / 8 / BAUD_RATE - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    TWSR = 0, TWBR = (F_CPU / 400000UL - 16) / 2;
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    TCCR3A = 0, TCCR3B = _BV(CS30); /* counts CPU cycles */
    /* Counts halves of a microsecond up to a control period, and gives the drives' pulses. */
    TCCR1A = _BV(WGM11), TCCR1B = _BV(WGM13) | _BV(WGM12);
    ICR1 = 2UL * CONTROL_TICKS_US - 1;
    TCCR1B |= _BV(CS11);
    TIMSK1 = _BV(TOIE1);
    board_begin(was_driving, was_driving ? &last : 0);
    set_sleep_mode(SLEEP_MODE_IDLE);
    wdt_enable(WDTO_120MS);
    sei();
}

void mega_loop(void) {
    wdt_reset();
    if (lost) {
        cli();
        lost = 0, receive_tail = receive_head;
        sei();
        board_full();
    }
    while (receive_tail != receive_head && !lost) {
        uint8_t byte = received[receive_tail];
        receive_tail = (receive_tail + 1) & (RING - 1);
        board_receive(byte);
        wdt_reset();
    }
    if (periods) {
        cli();
        periods--;
        sei();
        board_period();
    }
    cli();
    if (!periods && receive_tail == receive_head && !lost) {
        sleep_enable();
        sei(); /* takes effect after the next instruction: no interrupt is missed */
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

#ifndef ARDUINO
int main(void) {
    mega_begin();
    for (;;) mega_loop();
}
#endif

#endif
