/* The start of an episode at rest: settle of amulett_gym/simulation/equilibrium.py for one device (WIDTH 1). */

/* The position (0 to 1) at which a rising table has a value, by bisection to the last bit. */
static double inverse_look_up(Table table, double value) {
    double low = 0.0, high = 1.0;
    for (int k = 0; k < 60; k++) {
        double middle = 0.5 * (low + high);
        if (look_up(table, middle) < value) low = middle;
        else high = middle;
    }
    return 0.5 * (low + high);
}

/* The turn of both drives beyond the biceps' slack angle [rad] for a difference of the string forces [N]; `apart` is the
   biceps' slack angle minus the triceps' [rad]. */
static double position_only_equilibrium(Parameters p, Scenarios c, double needed, double apart) {
    double reach = 1.0 / (p->inverse_max_deflection * p->drive_radius) + p->position_only_offset;
    double low = -2.0 * reach, high = 2.0 * reach;
    double scale_biceps = p->drive_radius * c->pulley_biceps_factor[0] * p->inverse_max_deflection;
    double scale_triceps = p->drive_radius * c->pulley_triceps_factor[0] * p->inverse_max_deflection;
    for (int k = 0; k < 60; k++) {
        double middle = 0.5 * (low + high);
        double biceps = spring_force(p, (middle + p->position_only_offset) * scale_biceps);
        double triceps = spring_force(p, (p->position_only_offset - middle - apart) * scale_triceps);
        if (c->spring_biceps_factor[0] * biceps - c->spring_triceps_factor[0] * triceps < needed) low = middle;
        else high = middle;
    }
    return 0.5 * (low + high);
}

enum { SETTLED, FORCE_OUT_OF_RANGE, DRIVE_OUT_OF_RANGE, DRIVE_STALLS };

/* Whether strings and drives can hold the device where it begins, as Simulation.reset checks it. */
static int check_start(Parameters p, Scenarios c, States s, double pull_biceps, double pull_triceps) {
    double least_pull = pull_biceps < pull_triceps ? pull_biceps : pull_triceps;
    double most_pull = pull_biceps < pull_triceps ? pull_triceps : pull_biceps;
    double weakest = least(c->spring_biceps_factor[0], c->spring_triceps_factor[0]);
    if (!(least_pull >= 0.0 && most_pull / weakest <= look_up(p->force_table, 1.0))) return FORCE_OUT_OF_RANGE;
    double most_turn = greatest(fabs(s->drive_biceps[0]), fabs(s->drive_triceps[0]));
    if (!(most_turn <= p->command_limit)) return DRIVE_OUT_OF_RANGE;
    double most_load = p->stall_torque * (1.0 - 1e-9) / p->drive_radius;
    uint8_t biceps_rests = s->force_biceps[0] * c->pulley_biceps_factor[0] < most_load;
    uint8_t triceps_rests = s->force_triceps[0] * c->pulley_triceps_factor[0] < most_load;
    return biceps_rests && triceps_rests ? SETTLED : DRIVE_STALLS;
}

/* Set the static equilibrium, and the controllers' memory that holds it. The state is zero before. */
static int settle_strings(Parameters p, Scenarios c, States s) {
    double angle = c->initial_angle[0], tension = c->initial_tension[0];
    double radius_biceps = p->drive_radius * c->pulley_biceps_factor[0];
    double radius_triceps = p->drive_radius * c->pulley_triceps_factor[0];
    double wound_biceps = angle * p->joint_radius / radius_biceps; /* where the strings are just slack */
    double wound_triceps = angle * p->joint_radius / radius_triceps;
    double needed = (c->static_torque[0] * sin(angle) - obstacle_torque(c, 0, angle, 0.0)) / p->joint_radius;
    s->agonist[0] = p->fixed_agonist != 0.0 ? p->fixed_agonist : needed < 0.0 ? TRICEPS : BICEPS;
    uint8_t biceps_leads = s->agonist[0] == BICEPS;
    double common = 0.0, turn_biceps, turn_triceps;
    double pull_biceps = needed > 0.0 ? needed : 0.0, pull_triceps = needed < 0.0 ? -needed : 0.0;
    if (p->tension_loop) {
        /* The antagonist has the tension, the agonist in addition the load, which may be negative. */
        pull_biceps = biceps_leads ? tension + needed : tension;
        pull_triceps = biceps_leads ? tension : tension - needed;
        double biceps = inverse_look_up(p->force_table, pull_biceps / c->spring_biceps_factor[0]);
        double triceps = inverse_look_up(p->force_table, pull_triceps / c->spring_triceps_factor[0]);
        turn_biceps = wound_biceps + biceps / p->inverse_max_deflection / radius_biceps;
        turn_triceps = wound_triceps - triceps / p->inverse_max_deflection / radius_triceps;
    } else {
        common = position_only_equilibrium(p, c, needed, wound_biceps - wound_triceps);
        turn_biceps = wound_biceps + common + p->position_only_offset;
        turn_triceps = wound_biceps + common - p->position_only_offset;
    }
    s->angle[0] = angle;
    s->drive_biceps[0] = s->command_biceps[0] = turn_biceps;
    s->drive_triceps[0] = s->command_triceps[0] = turn_triceps;
    update_string_forces(p, c, s, 0);
    double output;
    if (p->tension_loop) {
        output = biceps_leads ? turn_biceps : turn_triceps;
        s->offset_biceps[0] = turn_biceps - output * (biceps_leads ? 1.0 : p->antagonist_share);
        s->offset_triceps[0] = turn_triceps - output * (biceps_leads ? p->antagonist_share : 1.0);
    } else {
        output = wound_biceps + common;
        s->offset_biceps[0] = p->position_only_offset, s->offset_triceps[0] = -p->position_only_offset;
        tension = biceps_leads ? s->force_triceps[0] : s->force_biceps[0];
    }
    s->position_output[0] = s->position_integral[0] = output;
    s->tension_setpoint[0] = s->tension_command[0] = tension;
    s->stiffness_setpoint[0] = NAN; /* most loops take none */
    double biceps = slider_deflection(p, stretch_biceps(p, c, 0, turn_biceps, angle));
    double triceps = slider_deflection(p, stretch_triceps(p, c, 0, turn_triceps, angle));
    s->measured_difference[0] = biceps - triceps;
    /* The microcontroller knows the profile's springs only. */
    biceps = s->force_biceps[0] / c->spring_biceps_factor[0];
    triceps = s->force_triceps[0] / c->spring_triceps_factor[0];
    s->estimate_biceps[0] = trust(p, biceps, biceps), s->estimate_triceps[0] = trust(p, triceps, triceps);
    /* A tension below the floor is overestimated; the controller starts with output zero nevertheless. */
    double estimate = biceps_leads ? s->estimate_triceps[0] : s->estimate_biceps[0];
    s->tension_integral[0] = p->tension_kp * (estimate - tension);
    s->contact_torque[0] = obstacle_torque(c, 0, angle, 0.0);
    s->inside_since[0] = NAN;
    s->move[0] = -1;
    return check_start(p, c, s, pull_biceps, pull_triceps);
}

/* Read the sensors for the first time, and let the controllers begin with what they read. */
static void begin_sensing(Parameters p, Scenarios c, States s) {
    s->setpoint[0] = s->previous_setpoint[0] = s->angle[0];
    read_sensors(p, c, s, 0);
    s->position_signal[0] = p->position_on_error ? s->setpoint[0] - s->measured_angle[0] : -s->measured_angle[0];
    double estimate = s->agonist[0] == BICEPS ? s->estimate_triceps[0] : s->estimate_biceps[0];
    s->tension_signal[0] = p->tension_on_error ? s->tension_setpoint[0] - estimate : -estimate;
}
