/* Compare the controller with the test vectors: readings of the simulation, and the commands of its own loop. Empty on
   an AVR: the Arduino IDE compiles all files of a folder. */
#ifndef __AVR__

#include <math.h>
#include <stdio.h>

#include "controller.h"
#include "vectors.h"

#ifdef CONTROLLER_DOUBLE
#define NAME "double"
#define MOST VECTORS_MOST_DOUBLE
#else
#define NAME "float"
#define MOST VECTORS_MOST_FLOAT
#endif

int main(void) {
    double command = 0, tension = 0;
    controller_output output;
    controller_start(&vectors_begin);
    for (int k = 0; k < VECTORS; k++) {
        controller_tick(vectors_input + k, &output);
        for (int string = 0; string < 2; string++) {
            double apart = fabs((double)output.command[string] - vectors_output[k][string]);
            if (!(apart <= command)) command = apart;
        }
        double apart = fabs((double)output.tension_setpoint - vectors_output[k][2]);
        if (!(apart <= tension)) tension = apart;
    }
    int good = command <= MOST && tension <= MOST;
    printf("%s: %d ticks; largest difference of a command %.3g rad, of the tension setpoint %.3g N: %s\n", NAME, VECTORS,
           command, tension, good ? "as it should be" : "TOO MUCH");
    return good ? 0 : 1;
}

#endif
