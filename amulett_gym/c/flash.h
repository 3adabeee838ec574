/* Tables in flash: on an AVR they are read with its own instruction, elsewhere they are plain constants. */

#ifndef FLASH_H
#define FLASH_H

#include "controller.h"

#ifdef __AVR__
#include <avr/pgmspace.h>
#define FLASH PROGMEM
#define read_real(address) ((real)pgm_read_float(address))
#define read_byte(address) ((int8_t)pgm_read_byte(address))
#define read_word(address) ((int16_t)pgm_read_word(address))
#define read_long(address) ((int32_t)pgm_read_dword(address))
#else
#define FLASH
#define read_real(address) (*(address))
#define read_byte(address) (*(address))
#define read_word(address) (*(address))
#define read_long(address) (*(address))
#endif

typedef real table_real;
typedef const table_real (*Table)[4]; /* cells of cubics, the constant term first */
typedef const table_real (*Pairs)[2]; /* a value and its slope at each knot */

#endif
