/* Limits of one core: floating-point operations, divisions and memory traffic per second. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define CHAINS 16 /* independent, so that no operation waits for the previous one */
#define ROUNDS 2000000
#define BYTES (64u << 20) /* beyond any cache's share of a core */

typedef double vector __attribute__((vector_size(64)));

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#define HIDE(a) __asm__ volatile("" : "+m"(a)) /* the compiler must not know the value */

#define MEASURE(name, type, operation)                                        \
    double name(void) {                                                       \
        type a[CHAINS];                                                       \
        double factor = 0.999, term = 1e-3;                                   \
        HIDE(factor);                                                         \
        HIDE(term);                                                           \
        for (int k = 0; k < CHAINS; k++) a[k] = (type){0} + 1.0;              \
        double start = seconds();                                             \
        for (int64_t round = 0; round < ROUNDS; round++) {                    \
            _Pragma("GCC unroll 16") for (int k = 0; k < CHAINS; k++) operation; \
        }                                                                     \
        double taken = seconds() - start;                                     \
        HIDE(a);                                                              \
        return (double)ROUNDS * CHAINS * (sizeof(type) / 8) / taken;          \
    }

/* A multiplication and an addition each; the SIMD build may contract them. */
MEASURE(scalar_pairs, double, a[k] = a[k] * factor + term)
MEASURE(vector_pairs, vector, a[k] = a[k] * factor + term)
MEASURE(scalar_divisions, double, a[k] = term / a[k])
MEASURE(vector_divisions, vector, a[k] = term / a[k])

/* Bytes read and written back a second, as the kernel does with its states. */
double bandwidth(void) {
    double *numbers = malloc(BYTES);
    if (!numbers) return 0.0;
    memset(numbers, 1, BYTES);
    double start = seconds();
    for (int turn = 0; turn < 4; turn++) {
        for (uint64_t k = 0; k < BYTES / 8; k++) numbers[k] *= 1.0000001;
        __asm__ volatile("" ::: "memory"); /* one turn after the other */
    }
    double taken = seconds() - start;
    HIDE(numbers[17]);
    free(numbers);
    return 4.0 * 2.0 * BYTES / taken;
}
