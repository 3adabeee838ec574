/* The loops that estimate the joint's motion and the string forces themselves: torque.py and feedback_linearisation.py of
   amulett_gym/control, with force_estimate.py and joint_observer.py. */

/* The string force at a position, its slope [N] limited from below; beyond the table's ends there is none. */
INLINE curve force_at(Gains g, real position) {
    curve found = look_up_curve(g, position);
    real slope = position < 0 || position > 1 ? 0 : found.slope;
    found.slope = greatest(slope, g->slope_floor * g->max_force);
    return found;
}

typedef struct {
    real acceleration, decay;
} dynamics;

/* The joint's acceleration [rad/s2] by eq. 1 and the estimates, and the decay rate [1/s]. */
static inline dynamics model_acceleration(Parameters p, Gains g, Memory q) {
    real biceps = q->force_biceps, triceps = q->force_triceps;
    real preload = p->damping_by_mean ? (real)0.5 * (biceps + triceps) : least(biceps, triceps);
    real decay = decay_at(p, g, preload);
    real torque = (biceps - triceps) * p->joint_radius - weight_torque(g, q->observed_angle);
    return (dynamics){over(torque, g->inertia) - 2 * decay * q->observed_velocity, decay};
}

/* For a start at rest: observed_angle and both forces are those of the averaged readings. */
INLINE void begin_estimates(Parameters p, Gains g, Memory q) {
    pair at = predict_positions(p, g, q, q->observed_angle);
    q->correction_biceps = find_position(g, q->force_biceps) - at.biceps;
    q->correction_triceps = find_position(g, q->force_triceps) - at.triceps;
    q->slope_biceps = force_at(g, at.biceps + q->correction_biceps).slope * g->inverse_max_deflection;
    q->slope_triceps = force_at(g, at.triceps + q->correction_triceps).slope * g->inverse_max_deflection;
    q->disturbance = -model_acceleration(p, g, q).acceleration;
    q->load = p->joint_radius * (q->force_biceps - q->force_triceps) - weight_torque(g, q->observed_angle);
}

/* Correct the joint's motion and the disturbance by the measured angle. */
INLINE void observe_joint(Gains g, States s, Memory q, real period) {
    const real kept = 1 / (1 + g->observer_bandwidth * period), lost = 1 - kept;
    real predicted =
        q->observed_angle + period * (q->observed_velocity + (real)0.5 * period * q->observed_acceleration);
    real missed = s->measured_angle[0] - predicted;
    q->observed_angle = predicted + (1 - kept * kept * kept) * missed;
    q->observed_velocity = q->observed_velocity + period * q->observed_acceleration +
                           over((real)1.5 * lost * lost * (1 + kept) * missed, period);
    q->disturbance += over(lost * lost * lost * missed, period * period);
}

/* The next correction of a deflection by the slider's force. */
INLINE real next_correction(Gains g, real correction, real reading, curve estimate, real period) {
    return correction + share((reading - estimate.value) / estimate.slope, period, g->slider_time + period);
}

INLINE void observe_after(Parameters p, Gains g, States s, Memory q, real period) {
    observe_joint(g, s, q, period);
    pair at = predict_positions(p, g, q, q->observed_angle);
    at.biceps += q->correction_biceps, at.triceps += q->correction_triceps;
    curve biceps = force_at(g, at.biceps), triceps = force_at(g, at.triceps);
    q->correction_biceps = next_correction(g, q->correction_biceps, q->slider_biceps, biceps, period);
    q->correction_triceps = next_correction(g, q->correction_triceps, q->slider_triceps, triceps, period);
    q->force_biceps = biceps.value, q->force_triceps = triceps.value;
    q->slope_biceps = biceps.slope * g->inverse_max_deflection;
    q->slope_triceps = triceps.slope * g->inverse_max_deflection;
    q->saturated_biceps = at.biceps >= 1 || s->measured_biceps[0] >= p->slider_end;
    q->saturated_triceps = at.triceps >= 1 || s->measured_triceps[0] >= p->slider_end;
}

/* Estimate the joint's motion and both string forces, and find the strings at their springs' end. */
INLINE void observe_device(Parameters p, Gains g, States s, Memory q) {
    if (q->elapsed == p->control_period) observe_after(p, g, s, q, p->control_period); /* constants, which save time */
    else observe_after(p, g, s, q, q->elapsed);
}

/* How far a command has to be ahead of a drive [rad] for it to turn at a rate [rad/s], within its limits. */
INLINE real turn(Parameters p, Gains g, real rate) {
    real step = least(greatest(rate, -g->most_rate), g->most_rate) * p->control_period;
    return over(least(greatest(step, -g->drive_step), g->drive_step), g->drive_share);
}

#if LOOP == TORQUE

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    real angle = q->observed_angle, velocity = q->observed_velocity;
    q->observed_acceleration = model_acceleration(p, g, q).acceleration + q->disturbance;
    const real most = g->max_force * p->joint_radius;
    real load = weight_torque(g, angle) + q->load;
    real torque = g->virtual_stiffness * (q->reference - angle) + g->virtual_damping * (q->reference_rate - velocity) + load;
    torque = least(greatest(torque, -most), most);
    real missing = torque - p->joint_radius * (q->force_biceps - q->force_triceps);
    if (q->saturated_biceps) missing = least(missing, 0);
    if (q->saturated_triceps) missing = greatest(missing, 0);
    real stiffness = p->joint_radius * p->joint_radius * (q->slope_biceps + q->slope_triceps);
    real rate =
        over((missing / (g->torque_time * stiffness) + velocity) * p->joint_radius, p->drive_radius);
    real middle = (real)0.5 * (q->model_biceps + q->model_triceps) + turn(p, g, rate);
    pair pull = hold_at(p, g, 0, torque, affordable_tension(p, g, torque, s->tension_setpoint[0]));
    real apart = (real)0.5 * (pull.biceps - pull.triceps);
    q->biceps = middle + apart, q->triceps = middle - apart;
}

#else /* FEEDBACK_LINEARISATION */

/* The jerk of what is left of the setpoint's jumps [rad/s3]. */
INLINE real remaining_jerk(Parameters p, Gains g, Memory q) {
    const real duration = g->reference_time;
    if (is_zero(q->jump)) return 0; /* also when the count of ticks begins anew */
    if (g->reference_shape != MINIMUM_JERK) {
        motion left = remaining_offset(p, g, q);
        if (g->reference_shape == FIRST_ORDER) return -TIME_CONSTANTS / duration * left.acceleration;
        const real pace = DOUBLE_TIME_CONSTANTS / duration;
        return -pace * (2 * left.acceleration + pace * left.rate);
    }
    real time = time_between(p, q->jump_tick, q->last_tick);
    if (time >= duration) return 0;
    real t = over(time, duration);
    real curve_rate = 6 * q->third_power + t * (24 * q->fourth_power + t * 60 * q->fifth_power);
    return over(curve_rate, duration * duration * duration);
}

/* The jerk of the joint [rad/s3] at which its error has three poles at -bandwidth. */
INLINE real desired_jerk(Parameters p, Gains g, Memory q) {
    const real w = g->bandwidth;
    real error = q->reference - q->observed_angle, rate = q->reference_rate - q->observed_velocity;
    real acceleration = q->reference_acceleration - q->observed_acceleration;
    return remaining_jerk(p, g, q) + w * (w * (w * error + 3 * rate) + 3 * acceleration);
}

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    real angle = q->observed_angle, velocity = q->observed_velocity;
    real biceps = q->force_biceps, triceps = q->force_triceps;
    dynamics model = model_acceleration(p, g, q);
    real acceleration = q->observed_acceleration = model.acceleration + q->disturbance;
    real jerk = desired_jerk(p, g, q);
    real torque = g->inertia * (q->reference_acceleration + 2 * model.decay * q->reference_rate - q->disturbance);
    torque += weight_torque(g, q->reference);
    pair wanted = string_forces(p, g, torque, affordable_tension(p, g, torque, s->tension_setpoint[0]));
    real tension_rate = g->tension_bandwidth * (real)0.5 * (wanted.biceps + wanted.triceps - biceps - triceps);
    real weight_slope = g->weight != 0 ? g->weight * cosine(angle) : 0;
    real needed = jerk + 2 * model.decay * acceleration + over(weight_slope, g->inertia) * velocity;
    real half = over((real)0.5 * needed * g->inertia, p->joint_radius), wound = p->joint_radius * velocity;
    real rate_biceps = over(wound + (tension_rate + half) / q->slope_biceps, p->drive_radius);
    real rate_triceps = over(wound - (tension_rate - half) / q->slope_triceps, p->drive_radius);
    real still = over(velocity * p->joint_radius, p->drive_radius); /* the drives' rate at which forces stay */
    if (q->saturated_biceps) rate_biceps = least(rate_biceps, still);
    if (q->saturated_triceps) rate_triceps = greatest(rate_triceps, still);
    q->biceps = q->model_biceps + turn(p, g, rate_biceps) - q->trim_biceps;
    q->triceps = q->model_triceps + turn(p, g, rate_triceps) - q->trim_triceps;
    /* Where a string comes near slack, feed-forward takes over. */
    real tautness = least(greatest(over(least(biceps, triceps), g->taut_force), 0), 1);
    if (tautness < 1) {
        pair held = hold_reference(p, g, s, q);
        q->biceps = held.biceps + tautness * (q->biceps - held.biceps);
        q->triceps = held.triceps + tautness * (q->triceps - held.triceps);
    }
}

#endif
