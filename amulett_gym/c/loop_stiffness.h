/* The loops that turn the co-contraction asked for into a joint stiffness: torque_stiffness.py and
   feedforward_feedback.py of amulett_gym/control, with stiff_pair of inverse_statics.py. */

#define STEPS 3 /* of Newton's method */

typedef struct {
    pair position;
    real slopes; /* sum of both springs' slopes by position [N] */
} stiff;

/* The positions that give a difference of forces [N] at the stiffness that both strings have at `start` without. */
INLINE stiff stiff_pair(Gains g, real difference, real start) {
    real apart = least(absolute(difference), g->max_force);
    real highest = find_position(g, g->max_force - apart);
    real slope = look_up_curve(g, start).slope;
    real wanted = 2 * slope;
    /* As if the spring's slope were linear in its deflection. */
    real shift = slope > 0 ? least((real)0.5 * apart / slope, (real)0.5 * start) : (real)0.5 * start;
    real antagonist = least(start - shift, highest), agonist = least(start + shift, 1);
    for (uint8_t k = 0; k < STEPS; k++) {
        curve a = look_up_curve(g, antagonist), b = look_up_curve(g, agonist);
        real lacking = apart - (b.value - a.value), too_soft = wanted - (a.slope + b.slope);
        real determinant = a.bend * b.slope + b.bend * a.slope;
        real step = determinant > 0 ? (b.slope * too_soft - b.bend * lacking) / determinant : 0;
        /* To zero only at last: there a spring without slope has no determinant. */
        real lowest = k < STEPS - 1 ? (real)0.25 * antagonist : 0;
        real found = least(greatest(antagonist + step, lowest), highest);
        real turn = a.slope * (found - antagonist) + lacking;
        agonist = least(greatest(agonist + (b.slope > 0 ? turn / b.slope : 0), found), 1);
        antagonist = found;
    }
    curve a = look_up_curve(g, antagonist);
    agonist = find_position(g, a.value + apart); /* the torque without Newton's remainder */
    real slopes = a.slope + look_up_curve(g, agonist).slope;
    return (stiff){difference >= 0 ? (pair){agonist, antagonist} : (pair){antagonist, agonist}, slopes};
}

/* The positions that hold a torque at the stiffness asked for. */
INLINE stiff hold_stiff(Parameters p, Gains g, States s, real torque) {
    return stiff_pair(g, over(torque, p->joint_radius), find_position(g, s->tension_setpoint[0]));
}

/* The torque [N m] that the reference motion needs, with the bare arm. */
INLINE real needed_torque(Parameters p, Gains g, States s, Memory q, real angle) {
    real decay = decay_at(p, g, s->tension_setpoint[0]);
    return joint_torque(g, q->reference_acceleration, q->reference_rate, angle, decay);
}

#if LOOP == TORQUE_STIFFNESS

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    const real most = g->max_force * p->joint_radius;
    real angle = s->measured_angle[0], error = q->reference - angle;
    real torque = needed_torque(p, g, s, q, angle) +
                  (g->torque_kp * error + g->torque_kd * (q->reference_rate - q->velocity));
    room room = headroom(p, s);
    q->integral = integrate(q->integral, error, g->torque_ki, p->control_period,
                            room.rise && torque + q->integral < most, room.fall && torque + q->integral > -most);
    stiff found = hold_stiff(p, g, s, torque + q->integral);
    move_drives(p, g, q, drives_at(p, g, angle, found.position), q->reference_rate);
}

#else /* FEEDFORWARD_FEEDBACK */

/* The joint stiffness by the sliders [N m/rad]. */
INLINE real estimate_stiffness(Parameters p, Memory q) {
    return (q->slider_biceps + q->slider_triceps) * p->joint_radius * p->joint_radius;
}

/* By how much the PID of the stiffness turns each drive against the other [rad]; `measurable`: whether both strings are
   above the force floor, by the inverse model. Without `room` a command is at its limit. */
INLINE real control_stiffness(Parameters p, Gains g, States s, Memory q, real stiffness, uint8_t measurable,
                              uint8_t room) {
    real late = low_pass(p, q->stiffness_reference, stiffness, g->lead);
    q->stiffness_reference = q->stiffness_reference < 0 ? stiffness : late; /* below 0: at the begin */
    real error = measurable ? q->stiffness_reference - estimate_stiffness(p, q) : 0;
    real last_error = q->stiffness_error;
    q->stiffness_error = low_pass(p, last_error, error, g->stiffness_filter);
    /* A slider at its end does not measure that its string gets tighter. */
    uint8_t seen = greatest(s->measured_biceps[0], s->measured_triceps[0]) < p->slider_end;
    q->stiffness_integral = integrate(q->stiffness_integral, q->stiffness_error, g->stiffness_ki, p->control_period,
                                      room && measurable && seen, room && measurable);
    real rate = over(q->stiffness_error - last_error, p->control_period);
    return g->stiffness_kp * q->stiffness_error + q->stiffness_integral + g->stiffness_kd * rate;
}

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    stiff found = hold_stiff(p, g, s, needed_torque(p, g, s, q, q->reference));
    pair to = drives_at(p, g, q->reference, found.position);
    real stiffness = found.slopes * (g->inverse_max_deflection * p->joint_radius * p->joint_radius);
    real both = correct_position(p, g, s, q);
    room room = headroom(p, s);
    uint8_t measurable = least(found.position.biceps, found.position.triceps) >= g->floor_position;
    real apart = control_stiffness(p, g, s, q, stiffness, measurable, room.rise && room.fall);
    to.biceps = to.biceps + both + apart, to.triceps = to.triceps + both - apart;
    move_drives(p, g, q, to, q->reference_rate);
}

#endif
