/* What a number is: of one device, or of the devices of a block at a time (WIDTH). For tick.c, and for live_loop.c, of which
   each device is one. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#define INLINE static inline __attribute__((always_inline))

typedef double scalar;
typedef int64_t lane;

#if WIDTH == 1

typedef double real;
typedef int64_t integer;
typedef uint64_t word;
typedef bool mask;
typedef double stored_real; /* storage type of a scenario's fields */
typedef float stored_float;
typedef int8_t stored_byte;
typedef uint64_t stored_word;
#define select(condition, yes, no) ((condition) ? (yes) : (no))
#define either(condition, yes, no) ((condition) ? (yes) : (no)) /* of integers */
#define to_real(a) ((double)(a))
#define to_integer(a) ((int64_t)(a))
#define to_word(a) ((uint64_t)(a))
#define all(a) ((double)(a)) /* the same number in all lanes */
#define all_integers(a) ((int64_t)(a))
#define not(a) (!(a))
#define any(a) (a)
#define at(array, index) array[index][i] /* of the scenario: an element that differs from lane to lane */

#else

typedef double real __attribute__((vector_size(8 * WIDTH)));
typedef int64_t integer __attribute__((vector_size(8 * WIDTH)));
typedef uint64_t word __attribute__((vector_size(8 * WIDTH)));
typedef integer mask; /* all bits of a lane are set, or none */
typedef double row __attribute__((vector_size(32), aligned(8)));
/* Storage types of a scenario's fields: a block of scenarios does not fill whole cache lines. */
typedef double stored_real __attribute__((vector_size(8 * WIDTH), aligned(8)));
typedef float stored_float __attribute__((vector_size(4 * WIDTH), aligned(4)));
typedef int8_t stored_byte __attribute__((vector_size(WIDTH), aligned(1)));
typedef uint64_t stored_word __attribute__((vector_size(8 * WIDTH), aligned(8)));
#define to_real(a) __builtin_convertvector(a, real)
#define to_integer(a) __builtin_convertvector(a, integer)
#define to_word(a) ((word)(a))
#define not(a) (~(a))
#define at(array, index)                                                                         \
    ({                                                                                           \
        real picked;                                                                             \
        for (int lane = 0; lane < WIDTH; lane++) picked[lane] = (array)[(index)[lane]][0][lane]; \
        picked;                                                                                  \
    })
INLINE real all(double a) { return a - (real){0}; }
INLINE integer all_integers(int64_t a) { return a - (integer){0}; }
INLINE integer either(mask condition, integer yes, integer no) { return (yes & condition) | (no & ~condition); }
INLINE real select(mask condition, real yes, real no) {
    return (real)either(condition, (integer)yes, (integer)no);
}
INLINE bool any(mask a) {
    int64_t found = 0;
    for (int lane = 0; lane < WIDTH; lane++) found |= a[lane];
    return found != 0;
}

#endif

#include "layout.h"

typedef const double (*Table)[4];
#define over(a, b) ((a) / (b))
#define share(a, b, c) ((a) * (b) / (c))

/* ---- the C library's functions ---- */

#if WIDTH == 1

INLINE word bits_of(real a) { return ((union { double value; uint64_t bits; }){a}).bits; }
#define absolute fabs
#define floor_of floor
#define root sqrt
#define exponential exp
#define sine sin

#else

INLINE word bits_of(real a) { return (word)a; }
INLINE real absolute(real a) { return (real)(bits_of(a) & 0x7FFFFFFFFFFFFFFFu); }
INLINE real floor_of(real a) {
    real whole = to_real(to_integer(a));
    return select(whole > a, whole - 1.0, whole);
}
INLINE real root(real a) {
    for (int lane = 0; lane < WIDTH; lane++) a[lane] = sqrt(a[lane]);
    return a;
}
#if defined __FAST_MATH__ && defined __AVX512F__ && defined __GLIBC__ && WIDTH == 8
real _ZGVeN8v_exp(real), _ZGVeN8v_sin(real); /* libmvec's, to 4 units in the last place */
#define exponential _ZGVeN8v_exp
#define sine _ZGVeN8v_sin
#else
INLINE real exponential(real a) {
    for (int lane = 0; lane < WIDTH; lane++) a[lane] = exp(a[lane]);
    return a;
}
INLINE real sine(real a) {
    for (int lane = 0; lane < WIDTH; lane++) a[lane] = sin(a[lane]);
    return a;
}
#endif
#endif

/* By their bits, which is valid under fast math too. */
INLINE mask is_nan(real a) { return (bits_of(a) << 1) > 0xFFE0000000000000u; }
INLINE mask is_near(real a) { return (bits_of(a) << 1) <= (bits_of(all(FARTHEST)) << 1); }

/* Read the coefficients of a table's cells. */
INLINE void load_cell(Table table, integer cell, real *k0, real *k1, real *k2, real *k3) {
#if WIDTH == 1
    *k0 = table[cell][0], *k1 = table[cell][1], *k2 = table[cell][2], *k3 = table[cell][3];
#else
    /* Loading whole rows and transposing them is faster than the processor's own gather. */
#define TABLE_ROW(lane) (*(const row *)table[cell[lane]])
#define JOIN(one, other) __builtin_shufflevector(TABLE_ROW(one), TABLE_ROW(other), 0, 1, 2, 3, 4, 5, 6, 7)
    real a = JOIN(0, 4), b = JOIN(1, 5), c = JOIN(2, 6), d = JOIN(3, 7);
    real ab02 = __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
    real ab13 = __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
    real cd02 = __builtin_shufflevector(c, d, 0, 8, 2, 10, 4, 12, 6, 14);
    real cd13 = __builtin_shufflevector(c, d, 1, 9, 3, 11, 5, 13, 7, 15);
    *k0 = __builtin_shufflevector(ab02, cd02, 0, 1, 8, 9, 4, 5, 12, 13);
    *k1 = __builtin_shufflevector(ab13, cd13, 0, 1, 8, 9, 4, 5, 12, 13);
    *k2 = __builtin_shufflevector(ab02, cd02, 2, 3, 10, 11, 6, 7, 14, 15);
    *k3 = __builtin_shufflevector(ab13, cd13, 2, 3, 10, 11, 6, 7, 14, 15);
#endif
}
