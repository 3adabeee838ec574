// The controller's firmware for the Arduino Mega 2560. Pins, zeros and signs are in mega.h, the program in mega.c and
// board.c, the controller in controller.c and law.c.
extern "C" {
#include "mega.h"
}

void setup() { mega_begin(); }

void loop() { mega_loop(); }
