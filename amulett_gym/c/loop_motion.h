/* The reference: the setpoint, whose jumps become smooth motions. amulett_gym/control/reference_motion.py, and
   note_setpoint to add_offset of amulett_gym/simulation/loops.py. */

#define FASTEST 100 /* [rad/s]; a setpoint that moves faster jumps */

enum { MINIMUM_JERK, CRITICALLY_DAMPED, FIRST_ORDER };
#define TIME_CONSTANTS ((real)3.912023005428146) /* log(50): of a first-order answer until 2 % are left */
#define DOUBLE_TIME_CONSTANTS ((real)5.833921)

/* The time between two ticks [s]. In 64 bits it has the rounding of the simulation's clock; a clock in 32 bits would lose
   its digits within minutes. */
INLINE real time_between(Parameters p, uint32_t from, uint32_t to) {
#ifdef CONTROLLER_DOUBLE
    return (real)(int32_t)to * p->control_period - (real)(int32_t)from * p->control_period;
#else
    return (real)(to - from) * p->control_period;
#endif
}

INLINE void note_after(Parameters p, Gains g, States s, Memory q, real elapsed) {
    real moved = s->setpoint[0] - q->last_setpoint - q->setpoint_jump;
    uint8_t jumps = absolute(moved) > FASTEST * elapsed;
    q->setpoint_jump += jumps ? moved : 0;
    real setpoint_rate = over(jumps ? 0 : moved, elapsed);
    real acceleration = over(setpoint_rate - q->last_rate, elapsed);
    uint8_t kinks = absolute(acceleration) * g->inertia > g->max_force * p->joint_radius;
    q->setpoint_acceleration = kinks ? 0 : acceleration;
    q->velocity =
        filtered_derivative(q->velocity, s->measured_angle[0] - q->last_angle, 1, g->velocity_filter, elapsed);
    q->elapsed = elapsed;
    q->last_setpoint = s->setpoint[0], q->last_rate = setpoint_rate, q->last_tick = q->tick;
    q->last_angle = s->measured_angle[0];
}

/* Read the setpoint and the joint angle, and add to the setpoint's jump what is too fast for a motion. */
INLINE void note_setpoint(Parameters p, Gains g, States s, Memory q) {
    real elapsed = greatest(time_between(p, q->last_tick, q->tick), p->control_period);
    if (elapsed == p->control_period) note_after(p, g, s, q, p->control_period); /* a constant, which saves time */
    else note_after(p, g, s, q, elapsed);
}

/* Of the polynomial by which a minimum-jerk motion goes on from an offset. */
static inline void find_powers(Gains g, Memory q) {
    const real duration = g->reference_time;
    real a = q->jump.offset, b = q->jump.rate * duration, c = q->jump.acceleration * duration * duration;
    q->first_power = b, q->second_power = c;
    q->third_power = -10 * a - 6 * b - (real)1.5 * c;
    q->fourth_power = 15 * a + 8 * b + (real)1.5 * c;
    q->fifth_power = -6 * a - 3 * b - (real)0.5 * c;
}

static inline motion minimum_jerk(Gains g, Memory q, real time) {
    const real duration = g->reference_time;
    real t = over(time, duration);
    if (t >= 1) return (motion){0, 0, 0};
    real b = q->first_power, c = q->second_power;
    real c3 = q->third_power, c4 = q->fourth_power, c5 = q->fifth_power;
#ifdef CONTROLLER_DOUBLE
    real value = q->jump.offset + t * (b + t * (0.5 * c + t * (c3 + t * (c4 + t * c5))));
    real slope = b + t * (c + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)));
    real curvature = c + t * (6 * c3 + t * (12 * c4 + t * 20 * c5));
#else /* the same by Horner's rule for the derivatives too: half the multiplications */
    real d4 = c4 + t * c5, d3 = c3 + t * d4, d2 = (real)0.5 * c + t * d3, d1 = b + t * d2;
    real value = q->jump.offset + t * d1;
    real e4 = d4 + t * c5, e3 = d3 + t * e4, e2 = d2 + t * e3, slope = d1 + t * e2;
    real curvature = 2 * (e2 + t * (e3 + t * (e4 + t * c5)));
#endif
    return (motion){value, over(slope, duration), over(curvature, duration * duration)};
}

INLINE motion critically_damped(Gains g, motion begun, real time) {
    const real pace = DOUBLE_TIME_CONSTANTS / g->reference_time;
    real slope = begun.rate + pace * begun.offset, decay = exponential(-pace * time);
    real left = (begun.offset + slope * time) * decay;
    real speed = slope * decay - pace * left;
    return (motion){left, speed, -pace * (slope * decay + speed)};
}

INLINE motion first_order(Gains g, motion begun, real time) {
    const real pace = TIME_CONSTANTS / g->reference_time;
    real left = begun.offset * exponential(-pace * time);
    return (motion){left, -pace * left, pace * pace * left};
}

INLINE uint8_t is_zero(motion a) { return a.offset == 0 && a.rate == 0 && a.acceleration == 0; }

/* What is left of the setpoint's jumps now. */
static inline motion remaining_offset(Parameters p, Gains g, Memory q) {
    real time = time_between(p, q->jump_tick, q->last_tick);
    if (is_zero(q->jump)) return q->jump;
    if (g->reference_shape == FIRST_ORDER) return first_order(g, q->jump, time);
    if (g->reference_shape == CRITICALLY_DAMPED) return critically_damped(g, q->jump, time);
    return minimum_jerk(g, q, time);
}

/* Begin a motion of the reference if the setpoint has jumped. */
INLINE void begin_motion(Parameters p, Gains g, Memory q) {
    if (q->setpoint_jump == 0) return;
    q->jump = remaining_offset(p, g, q);
    q->jump.offset -= q->setpoint_jump;
    q->jump_tick = q->last_tick;
    q->setpoint_jump = 0;
    if (g->reference_shape == MINIMUM_JERK) find_powers(g, q);
}

/* Set the reference for this tick: the setpoint with what is left of its jumps. */
INLINE void move_reference(Parameters p, Gains g, Memory q) {
    motion left = remaining_offset(p, g, q);
    if (is_zero(left)) q->jump = left; /* it has ended for ever, also when the count of ticks begins anew */
    q->reference = q->last_setpoint + left.offset;
    q->reference_rate = q->last_rate + left.rate;
    q->reference_acceleration = q->setpoint_acceleration + left.acceleration;
}
