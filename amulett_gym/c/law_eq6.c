/* Eq. 6 from outside the loop, once in an agent period: as the text describes it, as printed, or with a tuned exponent. */

#include "law.h"

#include <math.h>

#include "law_action.h"

static real error;

void law_start(void) {}

void law_begin(const real observation[OBSERVED]) { error = observation[POSITION_ERROR]; }

uint8_t law_slice(real *tension) {
    real wanted;
#if LAW_EQ6_TUNED
    real distance = 1 - (error < 0 ? -error : error) * LAW_ERROR_SCALE / LAW_ERROR_OFFSET;
    wanted = LAW_MINIMUM + (LAW_NOMINAL - LAW_MINIMUM) * (real)POWER(distance > 0 ? distance : 0, LAW_EXPONENT);
#else
    const real lowest = (real)LAW_MINIMUM / LAW_NOMINAL;
    real share = (error < 0 ? -error : error) * LAW_ERROR_SCALE / LAW_ERROR_OFFSET;
    real distance = LAW_PRINTED ? share : share < 1 ? 1 - share : 0;
    real factor = (1 - lowest) * (distance * distance * (distance * distance)) + lowest;
    wanted = (factor < 1 ? factor : 1) * LAW_NOMINAL;
#endif
    *tension = tension_of_action(action_of_tension(wanted));
    return 1;
}
