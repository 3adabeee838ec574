/* The loops on the feed-forward of equilibrium-point control: equilibrium_point.py, co_rotation.py and cascade.py of
   amulett_gym/control. */

#if LOOP == EQUILIBRIUM_POINT

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    pair held = hold_reference(p, g, s, q);
    q->biceps = held.biceps, q->triceps = held.triceps;
}

#elif LOOP == CO_ROTATION

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    pair held = hold_reference(p, g, s, q);
    real both = correct_position(p, g, s, q);
    q->biceps = held.biceps + both, q->triceps = held.triceps + both;
}

#else /* CASCADE */

/* By how much a drive winds its string for the error of the force; an estimate below the floor is no more than it. */
INLINE real winding(Gains g, real wanted, real estimate, integer untrusted) {
    real error = wanted - estimate;
    return untrusted && error < 0 ? 0 : g->kf * error;
}

INLINE void want(Parameters p, Gains g, States s, Memory q) {
    pair held = hold_reference(p, g, s, q);
    real error = integrate_position(p, g, s, q);
    real torque = weight_torque(g, q->reference);
    torque += p->joint_radius * (g->kp * error - g->kd * q->velocity);
    pair force = string_forces(p, g, torque, affordable_tension(p, g, torque, s->tension_setpoint[0]));
    q->biceps = held.biceps + q->integral + winding(g, force.biceps, s->estimate_biceps[0], s->untrusted_biceps[0]);
    q->triceps =
        held.triceps + q->integral - winding(g, force.triceps, s->estimate_triceps[0], s->untrusted_triceps[0]);
}

#endif
