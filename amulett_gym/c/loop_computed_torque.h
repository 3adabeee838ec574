/* Computed torque on two levels, and minimal motion: computed_torque.py and minimal_motion.py of amulett_gym/control. */

/* The rate at which the drives follow the joint: the reference's, and the measured one far from it. */
INLINE real followed_rate(real reference_rate, real velocity, real torque, real most) {
    real part = most > 0 ? least(greatest(over(absolute(torque), most) - 1, 0), 1) : 1;
    return reference_rate + part * (velocity - reference_rate);
}

typedef struct {
    real torque, tension, rate; /* [N m], [N], and of the drives with the joint [rad/s] */
} high_level;

INLINE high_level find_torque(Parameters p, Gains g, States s, Memory q) {
    const real lowest = least(g->least_tension, g->max_force);
    real tension = least(greatest(s->tension_setpoint[0], lowest), g->max_force);
    real error = q->reference - s->measured_angle[0];
    real wanted = q->reference_acceleration + g->kd * (q->reference_rate - q->velocity) + g->kp * error + q->integral;
    real torque = joint_torque(g, wanted, q->reference_rate, s->measured_angle[0], decay_at(p, g, tension));
    const real most = p->joint_radius * (g->max_force - lowest);
    room room = headroom(p, s); /* a spring at its end is no limit: the other string can be let go */
    q->integral = integrate(q->integral, error, g->ki, p->control_period, room.rise && torque < most,
                            room.fall && torque > -most);
    real rate = followed_rate(q->reference_rate, q->velocity, g->inertia * g->kp * error, most);
    return (high_level){torque, greatest(affordable_tension(p, g, torque, tension), lowest), rate};
}

#if LOOP == COMPUTED_TORQUE

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    high_level found = find_torque(p, g, s, q);
    move_drives(p, g, q, hold_at(p, g, s->measured_angle[0], found.torque, found.tension), found.rate);
}

#else /* MINIMAL_MOTION */

#define STEPS 3 /* of Newton's method */
#define LEAST_CURVATURE ((real)0.3)
#define LEAST_SQUARE ((real)1e-9) /* [N2] */

/* The positions, nearest to given ones, that give a difference of forces with at least a tension [N]. */
INLINE pair nearest_pair(Gains g, real difference, real lowest, pair near) {
    real apart = least(absolute(difference), g->max_force - lowest);
    uint8_t flexes = difference >= 0;
    real near_agonist = flexes ? near.biceps : near.triceps, near_antagonist = flexes ? near.triceps : near.biceps;
    /* From slack or far beyond the table the middle is nearer to the curve. */
    real middle = (real)0.5 * (near_agonist + near_antagonist);
    real outside =
        greatest(absolute(near_agonist - (real)0.5), absolute(near_antagonist - (real)0.5)) - (real)0.5;
    real part = least(greatest(20 * outside, 0), 1);
    real antagonist = least(greatest(near_antagonist + part * (middle - near_antagonist), 0), 1);
    real agonist = least(greatest(near_agonist + part * (middle - near_agonist), 0), 1);
    real multiplier = 0;
    for (uint8_t k = 0; k < STEPS; k++) {
        curve a = look_up_curve(g, antagonist), b = look_up_curve(g, agonist);
        real by_antagonist = 1 / greatest(1 - multiplier * a.bend, LEAST_CURVATURE);
        real by_agonist = 1 / greatest(1 + multiplier * b.bend, LEAST_CURVATURE);
        real far = antagonist - near_antagonist, agonist_far = agonist - near_agonist;
        real lack = b.value - a.value - apart;
        lack += by_antagonist * a.slope * far - by_agonist * b.slope * agonist_far;
        real square = by_antagonist * a.slope * a.slope + by_agonist * b.slope * b.slope;
        multiplier = lack / greatest(square, LEAST_SQUARE);
        antagonist = least(greatest(antagonist - by_antagonist * (far - multiplier * a.slope), 0), 1);
        agonist = least(greatest(agonist - by_agonist * (agonist_far + multiplier * b.slope), 0), 1);
    }
    real tension = least(greatest(look_up_curve(g, antagonist).value, lowest), g->max_force - apart);
    antagonist = find_position(g, tension);
    agonist = find_position(g, tension + apart);
    return flexes ? (pair){agonist, antagonist} : (pair){antagonist, agonist};
}

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    high_level found = find_torque(p, g, s, q);
    real angle = s->measured_angle[0];
    pair position = nearest_pair(g, over(found.torque, p->joint_radius), found.tension, predict_positions(p, g, q, angle));
    move_drives(p, g, q, drives_at(p, g, angle, position), found.rate);
}

#endif
