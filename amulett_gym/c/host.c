/* The controller as a library of a host: several ticks in one call. */

#include <stddef.h>

#include "controller.h"

/* Sizes of the three records, by which the host checks that it lays them out alike. */
size_t host_size(int which) {
    return which == 0 ? sizeof(controller_begin) : which == 1 ? sizeof(controller_input) : sizeof(controller_output);
}

void host_run(const controller_input *inputs, controller_output *outputs, long count) {
    for (long k = 0; k < count; k++) controller_tick(inputs + k, outputs + k);
}
