/* Curves by tables of lines, for 32-bit numbers: an AVR reads one in a third of the time that it takes to compute it. */

#ifndef LAW_CURVE_H
#define LAW_CURVE_H

#include "flash.h"

/* The curve at a place from 0 in cells; beyond its last cell, its end. */
static inline real read_curve(const table_real *table, uint16_t cells, real place) {
    if (!(place < cells)) return read_real(table + cells);
    uint16_t cell = (uint16_t)place;
    real here = read_real(table + cell), next = read_real(table + cell + 1);
    return here + (place - cell) * (next - here);
}

/* The same of an odd curve, at a place below 0, too. */
static inline real read_odd_curve(const table_real *table, uint16_t cells, real place) {
    real y = read_curve(table, cells, place < 0 ? -place : place);
    return place < 0 ? -y : y;
}

#endif
