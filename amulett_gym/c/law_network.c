/* A network: inputs from an observation, features of it, means over the episode; layers; a share of the way to its output.

   In 64 bits it is the policy bundle's network. Else its weights and activations are whole numbers of NETWORK_BITS bits,
   each layer with its own scales, and sums have 32 bits; NETWORK_BITS 0 keeps 32-bit floating-point numbers. Tanh is read
   from tables where numbers have 32 bits. */

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
#elif NETWORK_BITS == 8
typedef int8_t number;
#define read_weight read_byte
#else
typedef int16_t number;
#define read_weight read_word
#endif

enum { FEATURES = 21, MEANS = 16, SPANS = 2 };
enum { FIRST_FEATURE = OBSERVED, FIRST_MEAN = FIRST_FEATURE + (NETWORK_FEATURES ? FEATURES : 0) };

static real seen[OBSERVED];
static real inputs[NETWORK_SIZE];                      /* of this agent step */
static number history[NETWORK_HISTORY * NETWORK_SIZE]; /* inputs of the first layer, the newest step last */
static number activations[2][NETWORK_WIDEST];
static real output;
static real error, velocity, since, other, setpoint; /* [deg], [deg/s], [s], the antagonist's force and its setpoint [N] */
static uint16_t job; /* the next one: features, means, inputs, then neurons */
static uint8_t layer;
static uint16_t neuron;
static uint32_t offset; /* of the neuron's weights */
static uint16_t bias;   /* index of the neuron's bias */
uint16_t network_saturated; /* activations at the end of their range since law_start */

#if NETWORK_MEMORY
static real means[SPANS * MEANS], last[OBSERVED];
static uint16_t steps; /* of the episode, at most NETWORK_LONG */
#endif

static real magnitude(real x) { return x < 0 ? -x : x; }

static real tanh_of(real x) {
#ifdef CONTROLLER_DOUBLE
    return tanh(x);
#else
    /* Lines over cells of 1/64 up to 8. */
    real scaled = magnitude(x) * 64;
    if (!(scaled < 512)) return x < 0 ? -1 : 1;
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
    for (uint8_t k = 0; k < OBSERVED; k++) seen[k] = inputs[k] = observation[k];
    error = (real)LAW_ERROR_DEG * seen[POSITION_ERROR];
    velocity = (real)LAW_VELOCITY_DEG * seen[JOINT_VELOCITY];
    since = seen[TIME_SINCE_MOVE] > 0 ? (real)OBSERVED_TIME * seen[TIME_SINCE_MOVE] : 0;
    other = (real)OBSERVED_TENSION * seen[seen[AGONIST] > 0 ? ESTIMATED_TENSION_TRICEPS : ESTIMATED_TENSION_BICEPS];
    setpoint = tension_of_action(seen[TENSION_SETPOINT]);
    job = layer = 0, neuron = 0, offset = 0, bias = 0;
}

/* ---- laws/features.py ---- */

#if NETWORK_FEATURES
static real add_feature(uint8_t k) {
    const real agonist = seen[AGONIST];
    const real *f = inputs + FIRST_FEATURE;
    switch (k) {
    case 0: return tanh_of(OVER(error, (real)1.5));
    case 1: return tanh_of(OVER(error, 5));
    case 2: return tanh_of(OVER(error, 15));
    case 3: return tanh_of(OVER(velocity, 8));
    case 4: return tanh_of(OVER(velocity, 30));
    case 5: return tanh_of(OVER(velocity, 100));
    case 6: return (real)EXP(OVER(-since, (real)0.1));
    case 7: return (real)EXP(OVER(-since, (real)0.4));
    case 8: return agonist * f[0];
    case 9: return agonist * f[1];
    case 10: return agonist * f[4];
    case 11: return f[0] * f[3];
    case 12: return f[1] * f[4];
    case 13: return seen[agonist > 0 ? ESTIMATED_TENSION_BICEPS : ESTIMATED_TENSION_TRICEPS];
    case 14: return seen[agonist > 0 ? ESTIMATED_TENSION_TRICEPS : ESTIMATED_TENSION_BICEPS];
    case 15: return tanh_of(OVER((other - (real)5.3), (real)0.5));
    case 16: return tanh_of(OVER((other - 7), 2));
    case 17: return tanh_of(OVER((other - setpoint), (real)0.5));
    case 18: return tanh_of(OVER((other - setpoint), 2));
    case 19: return tanh_of(OVER((other - setpoint), 6));
    default: return tanh_of(setpoint - (real)5.3);
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
            inputs[FIRST_MEAN + span * MEANS + k] = *mean;
        }
        if (span + 1 == SPANS) {
            memcpy(last, seen, sizeof last);
            if (steps < NETWORK_LONG) steps++;
        }
    }
}
#endif

/* ---- the layers ---- */

#if NETWORK_BITS == 0

static number as_input(real value) { return value; }

static void fire(void) {
    const uint16_t size = network_sizes[layer];
    const number *from = layer == 0 ? history : activations[layer & 1];
    real sum = 0;
    for (uint16_t k = 0; k < size; k++) sum += from[k] * read_real(network_weights + offset + k);
    sum += read_real(network_bias + bias);
    if (layer + 1 == NETWORK_LAYERS)
        output = sum;
    else
        activations[(layer + 1) & 1][neuron] = NETWORK_TANH ? tanh_of(sum) : sum > 0 ? sum : 0;
}

#else

#define NUMBER_MOST ((1 << NETWORK_DIGITS) - 1)

/* Inputs are from -1 to 1. */
static number as_input(real value) {
    value *= NUMBER_MOST;
    return (number)(value < 0 ? value - (real)0.5 : value + (real)0.5);
}

#if NETWORK_TANH
/* Tanh of a whole number with 11 binary places, as a share of NUMBER_MOST: lines between the table's values, 1/32 apart. */
static number tanh_number(int16_t x) {
    uint8_t negative = x < 0;
    if (negative) x = (int16_t)-x;
    uint16_t cell = (uint16_t)x >> 6;
    int16_t here = read_word(tanh_numbers + cell), next = read_word(tanh_numbers + cell + 1);
    int16_t y = (int16_t)(here + (int16_t)(((int32_t)(next - here) * (x & 63)) >> 6));
    return (number)(negative ? -y : y);
}
#endif

/* The sum of products; on an AVR by its instructions, since the compiler's code takes twice to three times as long. */
#if defined __AVR__ && NETWORK_BITS == 8
static int32_t dot(const int8_t *from, const int8_t *weight, uint16_t count) {
    int32_t sum = 0; /* in 24 digits, for which the weights are scaled */
    uint8_t a, b;
    __asm__ volatile("1: lpm %[b], Z+ \n\t"
                     "ld %[a], X+ \n\t"
                     "muls %[a], %[b] \n\t"
                     "clr %[b] \n\t"
                     "sbrc r1, 7 \n\t"
                     "com %[b] \n\t"
                     "add %A[sum], r0 \n\t"
                     "adc %B[sum], r1 \n\t"
                     "adc %C[sum], %[b] \n\t"
                     "sbiw %[count], 1 \n\t"
                     "brne 1b \n\t"
                     "clr %D[sum] \n\t"
                     "sbrc %C[sum], 7 \n\t"
                     "com %D[sum] \n\t"
                     "clr __zero_reg__ \n\t"
                     : [sum] "+r"(sum), [a] "=&d"(a), [b] "=&d"(b), [count] "+w"(count), "+x"(from), "+z"(weight)
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

static void fire(void) {
    const uint16_t size = network_sizes[layer];
    const number *from = layer == 0 ? history : activations[layer & 1];
    const network_weight *weight = network_numbers + offset;
    int32_t sum = read_long(network_biases + bias);
    sum += dot(from, weight, size);
    if (layer + 1 == NETWORK_LAYERS) {
        output = (real)sum * (real)NETWORK_SCALE;
        return;
    }
    /* To the next layer's numbers, at most those at the sum's end: 15 digits of it times a factor. */
    const int32_t most = network_most[layer];
    if (sum > most || sum < -most) {
        if ((sum > 0 || NETWORK_TANH) && network_saturated < UINT16_MAX) network_saturated++;
        sum = sum > 0 ? most : -most;
    }
    const uint8_t shift = network_shift[layer];
    const int16_t upper = (int16_t)(shift == 8 ? sum >> 8 : shift == 16 ? sum >> 16 : sum >> shift); /* 8, 16: fast */
    int16_t next = (int16_t)(((int32_t)upper * network_factor[layer] + 16384) >> 15);
#if NETWORK_TANH
    activations[(layer + 1) & 1][neuron] = tanh_number(next);
#else
    activations[(layer + 1) & 1][neuron] = (number)(next > 0 ? next : 0);
#endif
}

#endif

/* Add an input to the newest step of the history. */
static void fill(uint16_t k) {
    if (k == 0) memmove(history, history + NETWORK_SIZE, (NETWORK_HISTORY - 1) * NETWORK_SIZE * sizeof(number));
    history[(NETWORK_HISTORY - 1) * NETWORK_SIZE + k] = as_input(inputs[k]);
}

/* The tension setpoint [N]: a share of the way from the present one to the output. */
static real finish(void) {
    real action = NETWORK_OUTPUT_TANH ? tanh_of(output) : output < -1 ? -1 : output > 1 ? 1 : output;
    action = (real)(float)action;
    const real present = seen[TENSION_SETPOINT];
    if (NETWORK_FOLLOW != 1) action = present + (real)NETWORK_FOLLOW * (action - present);
    return tension_of_action(limit_action(action));
}

enum {
    MEMORY_JOBS = NETWORK_FEATURES ? FEATURES : 0,
    FILL_JOB = MEMORY_JOBS + (NETWORK_MEMORY ? 4 : 0),
    LAYERS_JOB = FILL_JOB + NETWORK_SIZE
};

static uint16_t neuron_cost; /* in this layer */

static void begin_layer(void) { neuron_cost = (uint16_t)(NETWORK_COST_NEURON + network_sizes[layer] * NETWORK_COST_WEIGHT); }

/* About how many cycles of an ATmega2560 the next job takes. */
static uint16_t cost(void) {
    if (job == LAYERS_JOB) return neuron_cost;
    if (job < MEMORY_JOBS) {
        if (job == 6 || job == 7) return NETWORK_COST_EXP;
        return job > 7 && job < 15 ? NETWORK_COST_SUM : NETWORK_COST_TANH;
    }
    if (job < FILL_JOB) return job == MEMORY_JOBS + 1 ? NETWORK_COST_QUANTITIES : NETWORK_COST_MEANS;
    return NETWORK_COST_FILL;
}

static void work(void) {
#if NETWORK_FEATURES
    if (job < MEMORY_JOBS) {
        inputs[FIRST_FEATURE + job] = add_feature((uint8_t)job);
        job++;
        return;
    }
#endif
#if NETWORK_MEMORY
    if (job < FILL_JOB) {
        remember((uint8_t)(job - MEMORY_JOBS));
        job++;
        return;
    }
#endif
    if (job < LAYERS_JOB) {
        fill(job - FILL_JOB);
        if (++job == LAYERS_JOB) begin_layer();
        return;
    }
    fire();
    offset += network_sizes[layer], bias++;
    if (++neuron < network_sizes[layer + 1]) return;
    neuron = 0;
    if (++layer < NETWORK_LAYERS) begin_layer();
}

/* As many jobs as fit into NETWORK_SLICE cycles, at least one. */
uint8_t law_slice(real *tension) {
    uint16_t next = cost(), spent = job == 0 ? NETWORK_COST_OBSERVATION : 0;
    do {
        spent = (uint16_t)(spent + next);
        work();
        if (layer == NETWORK_LAYERS) {
            *tension = finish();
            return 1;
        }
        next = cost();
    } while (spent + (uint32_t)next <= NETWORK_SLICE);
    return 0;
}
