/* A network: inputs from an observation, features of it, means over the episode; layers; a share of the way to its output.

   In 64 bits it is the policy bundle's network. Else its inputs, weights and activations are whole numbers of NETWORK_BITS
   bits, each layer with its own scales, and sums have 32 bits; NETWORK_BITS 0 keeps 32-bit floating-point numbers. Tanh and
   the features' exponential are read from tables where numbers have 32 bits. */

#include "law.h"

#include <math.h>
#include <string.h>

#include "flash.h"
#include "law_action.h"
#include "weights.h"

#ifdef CONTROLLER_DOUBLE
#undef NETWORK_BITS
#define NETWORK_BITS 0
#endif

#if NETWORK_BITS == 0
typedef real number; /* of an input or activation */
typedef table_real network_weight, network_bias;
#define network_numbers network_weights
#elif NETWORK_BITS == 8
typedef int8_t number;
#define read_weight read_byte
#else
typedef int16_t number;
#define read_weight read_word
#endif

enum { FEATURES = 21, MEANS = 16, SPANS = 2 };
enum { FIRST_FEATURE = OBSERVED, FIRST_MEAN = FIRST_FEATURE + (NETWORK_FEATURES ? FEATURES : 0) };

/* Rows of weights are filled up with zeros, so that `dot` takes several at a time. */
enum { TOGETHER = NETWORK_BITS == 8 ? NETWORK_TOGETHER : 1 };

static real seen[OBSERVED];
static number history[NETWORK_HISTORY * NETWORK_SIZE + TOGETHER - 1]; /* inputs of the first layer, the newest step last */
static number *const newest = history + (NETWORK_HISTORY - 1) * NETWORK_SIZE;
static number activations[2][NETWORK_WIDEST + TOGETHER - 1];
static real output;
static real error, velocity, since, other, setpoint; /* [deg], [deg/s], [s], the antagonist's force and its setpoint [N] */
static uint8_t job; /* the next one: an observation's entries, features, means, then the layers */
static uint8_t layer;
static uint16_t neuron;
static const network_weight *weight; /* of this neuron */
static const network_bias *bias;
uint16_t network_saturated; /* activations at the end of their range since law_start */

#if NETWORK_MEMORY
static real means[SPANS * MEANS], last[OBSERVED];
static uint16_t steps; /* of the episode, at most NETWORK_LONG */
#endif

static uint16_t row(uint16_t size) { return (uint16_t)((size + TOGETHER - 1) / TOGETHER * TOGETHER); }

static real magnitude(real x) { return x < 0 ? -x : x; }

static real tanh_of(real x) {
#ifdef CONTROLLER_DOUBLE
    return tanh(x);
#else
    real scaled = magnitude(x) * (NETWORK_TANH_CELLS / (real)NETWORK_TANH_END); /* lines over equal cells */
    if (!(scaled < NETWORK_TANH_CELLS)) return x < 0 ? -1 : 1;
    uint16_t cell = (uint16_t)scaled;
    real here = read_real(tanh_table + cell), next = read_real(tanh_table + cell + 1);
    real y = here + (scaled - cell) * (next - here);
    return x < 0 ? -y : y;
#endif
}

void law_start(void) {
    memset(history, 0, sizeof history);
#if NETWORK_MEMORY
    memset(means, 0, sizeof means);
    memset(last, 0, sizeof last);
    steps = 0;
#endif
    network_saturated = 0;
}

void law_begin(const real observation[OBSERVED]) {
    for (uint8_t k = 0; k < OBSERVED; k++) seen[k] = observation[k];
    error = (real)LAW_ERROR_DEG * seen[POSITION_ERROR];
    velocity = (real)LAW_VELOCITY_DEG * seen[JOINT_VELOCITY];
    since = seen[TIME_SINCE_MOVE] > 0 ? (real)OBSERVED_TIME * seen[TIME_SINCE_MOVE] : 0;
    other = (real)OBSERVED_TENSION * seen[seen[AGONIST] > 0 ? ESTIMATED_TENSION_TRICEPS : ESTIMATED_TENSION_BICEPS];
    setpoint = tension_of_action(seen[TENSION_SETPOINT]);
    job = layer = 0, neuron = 0, weight = network_numbers, bias = network_biases;
}

/* ---- inputs as numbers ---- */

#if NETWORK_BITS == 0

static number as_input(real value) { return value; }

#define tanh_over(value, width) tanh_of(OVER(value, (real)(width)))
#define exp_over(value, width) ((real)EXP(OVER(-(value), (real)(width))))
#define product(a, b) ((a) * (b))

#else

#define NUMBER_MOST ((1 << NETWORK_DIGITS) - 1)

/* Inputs are from -1 to 1. */
static number as_input(real value) {
    value *= NUMBER_MOST;
    return (number)(value < 0 ? value - (real)0.5 : value + (real)0.5);
}

/* A table's value as a share of NUMBER_MOST, at x in 11 binary places from 0 on: lines between values 1/32 apart. */
static number look_up(const int16_t *table, int16_t x) {
    const int16_t *cell = table + ((uint16_t)x >> 6);
    const int16_t here = read_word(cell), next = read_word(cell + 1);
    return (number)(here + (int16_t)(((int32_t)(next - here) * (x & 63)) >> 6));
}

static number tanh_number(int16_t x) { return x < 0 ? (number)-look_up(tanh_numbers, (int16_t)-x) : look_up(tanh_numbers, x); }

#if NETWORK_FEATURES
/* A number in 11 binary places, at most the tables' end. */
static int16_t places(real value) {
    const real end = 16383;
    return (int16_t)(value > end ? end : value < -end ? -end : value);
}

#define tanh_over(value, width) tanh_number(places((value) * (real)(2048.0 / (width))))
#define exp_over(value, width) look_up(exp_numbers, places((value) * (real)(2048.0 / (width))))

/* a * b / NUMBER_MOST, rounded */
static number product(number a, number b) {
    int32_t both = (int32_t)a * b;
    both += both >> NETWORK_DIGITS;
    return (number)((both + (1 << (NETWORK_DIGITS - 1))) >> NETWORK_DIGITS);
}
#endif

#endif

/* Add the present observation's entry to the inputs; the first one moves the history on. */
static void add_entry(uint8_t k) {
    if (k == 0) memmove(history, history + NETWORK_SIZE, (NETWORK_HISTORY - 1) * NETWORK_SIZE * sizeof(number));
    newest[k] = as_input(seen[k]);
}

/* ---- laws/features.py ---- */

#if NETWORK_FEATURES
static number add_feature(uint8_t k) {
    const uint8_t flexes = seen[AGONIST] > 0;
    const number *f = newest + FIRST_FEATURE;
    switch (k) {
    case 0: return tanh_over(error, 1.5);
    case 1: return tanh_over(error, 5.0);
    case 2: return tanh_over(error, 15.0);
    case 3: return tanh_over(velocity, 8.0);
    case 4: return tanh_over(velocity, 30.0);
    case 5: return tanh_over(velocity, 100.0);
    case 6: return exp_over(since, 0.1);
    case 7: return exp_over(since, 0.4);
    case 8: return (number)(flexes ? f[0] : -f[0]);
    case 9: return (number)(flexes ? f[1] : -f[1]);
    case 10: return (number)(flexes ? f[4] : -f[4]);
    case 11: return product(f[0], f[3]);
    case 12: return product(f[1], f[4]);
    case 13: return newest[flexes ? ESTIMATED_TENSION_BICEPS : ESTIMATED_TENSION_TRICEPS];
    case 14: return newest[flexes ? ESTIMATED_TENSION_TRICEPS : ESTIMATED_TENSION_BICEPS];
    case 15: return tanh_over(other - (real)5.3, 0.5);
    case 16: return tanh_over(other - 7, 2.0);
    case 17: return tanh_over(other - setpoint, 0.5);
    case 18: return tanh_over(other - setpoint, 2.0);
    case 19: return tanh_over(other - setpoint, 6.0);
    default: return tanh_over(setpoint - (real)5.3, 1.0);
    }
}
#endif

/* ---- laws/memory.py ---- */

#if NETWORK_MEMORY
static real change(uint8_t entry, real unit) { return unit * (seen[entry] - last[entry]); }

/* In four calls: what changed, the averaged quantities, the short and the long means. */
static void remember(uint8_t part) {
    static real pulled, followed, grows, changed; /* limited */
    static real values[MEANS];
    const real agonist = seen[AGONIST];
    const uint8_t flexes = agonist > 0;
    if (part == 0) {
        if (steps == 0) memcpy(last, seen, sizeof last);
        real biceps = change(COMMAND_BICEPS, (real)LAW_COMMAND_DEG);
        real triceps = change(COMMAND_TRICEPS, (real)LAW_COMMAND_DEG);
        pulled = tanh_of(OVER((flexes ? biceps : triceps), 8));
        followed = tanh_of(OVER((flexes ? triceps : biceps), 8));
        biceps = change(ESTIMATED_TENSION_BICEPS, (real)OBSERVED_TENSION);
        triceps = change(ESTIMATED_TENSION_TRICEPS, (real)OBSERVED_TENSION);
        grows = tanh_of(OVER((flexes ? biceps : triceps), (real)0.7));
        changed = tanh_of(OVER((flexes ? triceps : biceps), (real)0.7));
    } else if (part == 1) {
        real jolt = velocity - (real)LAW_VELOCITY_DEG * last[JOINT_VELOCITY];
        real share = tanh_of(OVER(error, 3));
        values[0] = magnitude(share);
        values[1] = agonist * share;
        values[2] = tanh_of(OVER(magnitude(velocity), 30));
        values[3] = tanh_of(OVER(magnitude(jolt), 30));
        values[4] = magnitude(pulled), values[5] = magnitude(followed);
        values[6] = seen[flexes ? ESTIMATED_TENSION_BICEPS : ESTIMATED_TENSION_TRICEPS];
        values[7] = seen[flexes ? ESTIMATED_TENSION_TRICEPS : ESTIMATED_TENSION_BICEPS];
        values[8] = magnitude(grows), values[9] = magnitude(changed);
        values[10] = pulled * grows, values[11] = followed * changed;
        values[12] = agonist * tanh_of(OVER(jolt, 15)) * pulled;
        values[13] = seen[flexes ? SPRING_DEFLECTION_BICEPS : SPRING_DEFLECTION_TRICEPS];
        values[14] = values[7] * (real)OBSERVED_TENSION < (real)5.05 ? 1 : 0;
        values[15] = seen[TENSION_SETPOINT];
    } else {
        const uint16_t spans[SPANS] = {NETWORK_SHORT, NETWORK_LONG};
        uint8_t span = (uint8_t)(part - 2);
        uint16_t count = steps + 1 < spans[span] ? steps + 1 : spans[span];
        real share = 1 / (real)count;
        for (uint8_t k = 0; k < MEANS; k++) {
            real *mean = means + span * MEANS + k;
            *mean += share * (values[k] - *mean);
            newest[FIRST_MEAN + span * MEANS + k] = as_input(*mean);
        }
        if (span + 1 == SPANS) {
            memcpy(last, seen, sizeof last);
            if (steps < NETWORK_LONG) steps++;
        }
    }
}
#endif

/* ---- the layers ---- */

/* Compute some neurons of a layer. */
#if NETWORK_BITS == 0

static void fire(uint16_t count) {
    const uint16_t size = network_sizes[layer];
    const number *from = layer == 0 ? history : activations[layer & 1];
    number *to = activations[(layer + 1) & 1] + neuron;
    while (count--) {
        real sum = 0;
        for (uint16_t k = 0; k < size; k++) sum += from[k] * read_real(weight++);
        sum += read_real(bias++);
        if (layer + 1 == NETWORK_LAYERS) output = sum;
        else *to++ = NETWORK_TANH ? tanh_of(sum) : sum > 0 ? sum : 0;
    }
}

#else

/* The sum of products; on an AVR by its instructions, since the compiler's code takes twice to three times as long. */
#if defined __AVR__ && NETWORK_BITS == 8
#if NETWORK_TOGETHER != 4
#error "dot takes four weights at a time"
#endif
#define TWO_PRODUCTS               \
    "lpm %[b], Z+ \n\t"            \
    "ld %[a], X+ \n\t"             \
    "muls %[a], %[b] \n\t"         \
    "movw %[both], r0 \n\t"        \
    "lpm %[b], Z+ \n\t"            \
    "ld %[a], X+ \n\t"             \
    "muls %[a], %[b] \n\t"         \
    "add %A[both], r0 \n\t"        \
    "adc %B[both], r1 \n\t"        \
    "add %A[sum], %A[both] \n\t"   \
    "adc %B[sum], %B[both] \n\t"   \
    "adc %C[sum], %[zero] \n\t"    \
    "sbrc %B[both], 7 \n\t"        \
    "dec %C[sum] \n\t"
static int32_t dot(const int8_t *from, const int8_t *weight, uint16_t count) {
    int32_t sum = 0; /* in 24 digits, for which the weights are scaled; two products have 16 */
    int16_t both;
    uint8_t a, b, zero;
    __asm__ volatile("clr %[zero] \n\t"
                     "1: \n\t" TWO_PRODUCTS TWO_PRODUCTS /* TOGETHER */
                     "sbiw %[count], 4 \n\t"
                     "brne 1b \n\t"
                     "clr %D[sum] \n\t"
                     "sbrc %C[sum], 7 \n\t"
                     "com %D[sum] \n\t"
                     "clr __zero_reg__ \n\t"
                     : [sum] "+r"(sum), [both] "=&r"(both), [a] "=&d"(a), [b] "=&d"(b), [zero] "=&r"(zero),
                       [count] "+w"(count), "+x"(from), "+z"(weight)
                     :
                     : "r0", "memory");
    return sum;
}
#elif defined __AVR__
static int32_t dot(const int16_t *from, const int16_t *weight, uint16_t count) {
    int32_t sum = 0;
    uint8_t al, ah, bl, bh, zero;
    __asm__ volatile("clr %[zero] \n\t"
                     "1: lpm %[bl], Z+ \n\t"
                     "lpm %[bh], Z+ \n\t"
                     "ld %[al], X+ \n\t"
                     "ld %[ah], X+ \n\t"
                     "mul %[al], %[bl] \n\t" /* low by low */
                     "add %A[sum], r0 \n\t"
                     "adc %B[sum], r1 \n\t"
                     "adc %C[sum], %[zero] \n\t"
                     "adc %D[sum], %[zero] \n\t"
                     "muls %[ah], %[bh] \n\t" /* high by high */
                     "add %C[sum], r0 \n\t"
                     "adc %D[sum], r1 \n\t"
                     "mulsu %[ah], %[bl] \n\t" /* the sign of a mixed product is in the carry */
                     "sbc %D[sum], %[zero] \n\t"
                     "add %B[sum], r0 \n\t"
                     "adc %C[sum], r1 \n\t"
                     "adc %D[sum], %[zero] \n\t"
                     "mulsu %[bh], %[al] \n\t"
                     "sbc %D[sum], %[zero] \n\t"
                     "add %B[sum], r0 \n\t"
                     "adc %C[sum], r1 \n\t"
                     "adc %D[sum], %[zero] \n\t"
                     "sbiw %[count], 1 \n\t"
                     "brne 1b \n\t"
                     "clr __zero_reg__ \n\t"
                     : [sum] "+r"(sum), [al] "=&a"(al), [ah] "=&a"(ah), [bl] "=&a"(bl), [bh] "=&a"(bh),
                       [zero] "=&r"(zero), [count] "+w"(count), "+x"(from), "+z"(weight)
                     :
                     : "r0", "memory");
    return sum;
}
#else
static int32_t dot(const number *from, const network_weight *weight, uint16_t count) {
    int32_t sum = 0;
    while (count--) sum += (int32_t)*from++ * read_weight(weight++);
    return sum;
}
#endif

static void fire(uint16_t count) {
    const uint16_t size = row(network_sizes[layer]);
    const number *from = layer == 0 ? history : activations[layer & 1];
    if (layer + 1 == NETWORK_LAYERS) {
        output = (real)((int32_t)read_long(bias) + dot(from, weight, size)) * (real)NETWORK_SCALE;
        return;
    }
    /* To the next layer's numbers, at most those at the sum's end: 15 digits of it times a factor. */
    number *to = activations[(layer + 1) & 1] + neuron;
    const int32_t most = network_most[layer];
    const int8_t shift = network_shift[layer];
    const uint16_t factor = network_factor[layer];
    while (count--) {
        int32_t sum = (int32_t)read_long(bias++) + dot(from, weight, size);
        weight += size;
        if (sum > most || sum < -most) {
            if ((sum > 0 || NETWORK_TANH) && network_saturated < UINT16_MAX) network_saturated++;
            sum = sum > 0 ? most : -most;
        }
        const int16_t upper = (int16_t)(shift == 8    ? sum >> 8 /* fast */
                                        : shift == 16 ? sum >> 16
                                        : shift < 0   ? sum * ((int32_t)1 << -shift)
                                                      : sum >> shift);
        const int16_t next = (int16_t)(((int32_t)upper * factor + 32768) >> 16);
        *to++ = NETWORK_TANH ? tanh_number(next) : (number)(next > 0 ? next : 0);
    }
}

#endif

/* The tension setpoint [N]: a share of the way from the present one to the output. */
static real finish(void) {
    real action = NETWORK_OUTPUT_TANH ? tanh_of(output) : output < -1 ? -1 : output > 1 ? 1 : output;
    action = (real)(float)action;
    const real present = seen[TENSION_SETPOINT];
    if (NETWORK_FOLLOW != 1) action = present + (real)NETWORK_FOLLOW * (action - present);
    return tension_of_action(limit_action(action));
}

enum {
    FEATURES_JOB = OBSERVED,
    MEMORY_JOB = FEATURES_JOB + (NETWORK_FEATURES ? FEATURES : 0),
    LAYERS_JOB = MEMORY_JOB + (NETWORK_MEMORY ? 4 : 0)
};

/* About how many cycles of an ATmega2560 the next job before the layers takes. */
static uint16_t cost(void) {
    if (job < FEATURES_JOB) return NETWORK_COST_ENTRY + (job == 0 ? NETWORK_COST_BEFORE : 0);
    if (job < MEMORY_JOB) {
        uint8_t k = (uint8_t)(job - FEATURES_JOB);
        if (k == 6 || k == 7) return NETWORK_COST_EXP;
        return k > 7 && k < 15 ? NETWORK_COST_PRODUCT : NETWORK_COST_TANH;
    }
    return job == MEMORY_JOB + 1 ? NETWORK_COST_QUANTITIES : NETWORK_COST_MEANS;
}

static void work(void) {
    if (job < FEATURES_JOB) add_entry(job);
#if NETWORK_FEATURES
    else if (job < MEMORY_JOB) newest[job] = add_feature((uint8_t)(job - FEATURES_JOB));
#endif
#if NETWORK_MEMORY
    else remember((uint8_t)(job - MEMORY_JOB));
#endif
}

/* As many jobs as fit into NETWORK_SLICE cycles, at least one: the inputs, the neurons, the end. */
uint8_t law_slice(real *tension) {
    uint16_t left = NETWORK_SLICE;
    uint8_t is_first = 1;
    for (; job < LAYERS_JOB; job++, is_first = 0) {
        const uint16_t next = cost();
        if (next > left && !is_first) return 0;
        work();
        left = next < left ? left - next : 0;
    }
    for (; layer < NETWORK_LAYERS; layer++, neuron = 0, is_first = 0) {
        const uint16_t each = (uint16_t)(NETWORK_COST_NEURON + row(network_sizes[layer]) * NETWORK_COST_WEIGHT);
        const uint16_t due = network_sizes[layer + 1] - neuron;
        uint16_t count = left / each;
        if (count == 0) {
            if (!is_first) return 0;
            count = 1;
        }
        if (count > due) count = due;
        fire(count);
        left = count * (uint32_t)each < left ? (uint16_t)(left - count * each) : 0;
        if (count < due) {
            neuron += count;
            return 0;
        }
    }
    if (left < NETWORK_COST_END && !is_first) return 0;
    *tension = finish();
    return 1;
}
