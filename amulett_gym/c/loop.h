/* The loop of section 2.2 of the paper: readings to string forces, and from these to both drives' commands.

   One text for the tick in C (tick.c, of one or several devices at a time) and for the firmware (controller.c). Names and
   order of operations are those of kernel.py and sensors.py in amulett_gym/simulation. The file that includes it defines

     real, scalar, integer, mask, lane   a device's number, a parameter, a whole number, a condition, the place of a device
     select, either, all, all_integers   a choice of numbers, of whole numbers; the same number for all devices
     to_real, to_integer, not, any       conversions and conditions
     absolute, root, exponential         functions of numbers
     Parameters, States                  pointers to records with the fields of simulation/layout.py
     over, share                         a / b and a * b / c with parameters b, c
     Table, load_cell                    a table of cubics, and how its coefficients are read
     CELLS, BICEPS, TRICEPS, ...         the constants of simulation/layout.py and control/agonist.py */

/* Python's min and max: the first argument unless the second is less, greater. */
INLINE real least(real a, real b) { return select(b < a, b, a); }
INLINE real greatest(real a, real b) { return select(b > a, b, a); }
INLINE real squared(real a) { return a * a; }

/* ---- model/spring.py ---- */

typedef struct {
    real w, k0, k1, k2, k3; /* position within its cell, and the cell's coefficients */
} cubic;

INLINE cubic find_cell(Table table, real position) {
    real scaled = least(greatest(position, all(0.0)), all(1.0)) * CELLS;
    integer cell = to_integer(least(scaled, all(CELLS - 1)));
    cubic found;
    found.w = scaled - to_real(cell);
    load_cell(table, cell, &found.k0, &found.k1, &found.k2, &found.k3);
    return found;
}

INLINE real look_up(Table table, real position) {
    cubic at = find_cell(table, position);
    return at.k0 + at.w * (at.k1 + at.w * (at.k2 + at.w * at.k3));
}

INLINE real look_up_slope(Table table, real position) {
    cubic at = find_cell(table, position);
    real slope = (at.k1 + at.w * (2.0 * at.k2 + at.w * 3.0 * at.k3)) * CELLS;
    return select((position < 0.0) | (position > 1.0), all(0.0), slope);
}

INLINE real estimate_force(Parameters p, Table table, real spring_deflection) {
    return look_up(table, root(over(greatest(spring_deflection, all(0.0)), p->max_spring_deflection)));
}

/* ---- model/damping.py ---- */

INLINE real decay_rate(Parameters p, real preload) {
    real rate = p->damping_a * exponential(p->damping_b * preload + p->damping_c) + p->damping_d;
    return greatest(rate, all(0.0));
}

/* ---- control/ ---- */

INLINE real low_pass(Parameters p, real last, real value, real time_constant) {
    return last + share(value - last, p->control_period, time_constant + p->control_period);
}

INLINE real filtered_derivative(real derivative, real change, scalar gain, scalar time_constant, scalar period) {
    return over(time_constant * derivative + gain * change, time_constant + period);
}

INLINE real integrate(real integral, real error, scalar gain, scalar period, mask up, mask down) {
    mask held = ((error > 0.0) & not(up)) | ((error < 0.0) & not(down));
    return select(held, integral, integral + gain * error * period);
}

INLINE real select_agonist(Parameters p, real agonist, real difference, real error) {
    mask tie = (absolute(difference) <= p->tie_width) & (absolute(error) >= p->tie_error) & (error != 0.0);
    real selected = select(tie, select(error > 0.0, all(BICEPS), all(TRICEPS)), agonist);
    selected = select(difference < -p->switch_hysteresis, all(TRICEPS), selected);
    return select(difference > p->switch_hysteresis, all(BICEPS), selected);
}

INLINE real scaling_factor(Parameters p, real error) {
    scalar lowest = p->minimum_tension / p->nominal_tension;
    real distance = greatest(1.0 - over(absolute(error), p->error_offset), all(0.0));
    return (1.0 - lowest) * squared(squared(distance)) + lowest;
}

INLINE real scaling_factor_printed(Parameters p, real error) {
    scalar lowest = p->minimum_tension / p->nominal_tension;
    return least((1.0 - lowest) * squared(squared(over(absolute(error), p->error_offset))) + lowest, all(1.0));
}

INLINE real limit(Parameters p, real command) {
    return least(greatest(command, all(-p->command_limit)), all(p->command_limit));
}

/* ---- the readings: simulation/sensors.py, read_sensors ---- */

/* A force estimate after the treatment of those below the floor (Figure 5b). */
INLINE real trust(Parameters p, real estimate, real last) {
    real distrusted = p->below_floor == CLAMP ? all(p->force_floor) : p->below_floor == HOLD ? last : estimate;
    return select(estimate >= p->force_floor, estimate, distrusted);
}

/* From both sliders' readings, and the string forces that the table gives for them, the filtered values. */
INLINE void estimate_strings(Parameters p, States s, lane i, real force_biceps, real force_triceps) {
    real difference = s->measured_biceps[i] - s->measured_triceps[i];
    s->measured_difference[i] = low_pass(p, s->measured_difference[i], difference, all(p->switch_filter));
    s->untrusted_biceps[i] = either(force_biceps < p->force_floor, all_integers(1), all_integers(0));
    real trusted = trust(p, force_biceps, s->estimate_biceps[i]);
    s->estimate_biceps[i] = low_pass(p, s->estimate_biceps[i], trusted, all(p->force_filter));
    s->untrusted_triceps[i] = either(force_triceps < p->force_floor, all_integers(1), all_integers(0));
    trusted = trust(p, force_triceps, s->estimate_triceps[i]);
    s->estimate_triceps[i] = low_pass(p, s->estimate_triceps[i], trusted, all(p->force_filter));
}

INLINE void estimate_velocity(Parameters p, States s, lane i, real last_angle) {
    s->measured_velocity[i] = filtered_derivative(s->measured_velocity[i], s->measured_angle[i] - last_angle, 1.0,
                                                  p->velocity_filter, p->control_period);
}

/* ---- the commands: simulation/kernel.py, control ---- */

INLINE void control_position(Parameters p, States s, lane i, real error) {
    real signal = p->position_on_error ? error : -s->measured_angle[i];
    s->position_derivative[i] = filtered_derivative(s->position_derivative[i], signal - s->position_signal[i],
                                                    p->position_kd, p->position_filter, p->control_period);
    s->position_signal[i] = signal;
    real command = select(s->agonist[i] == BICEPS, s->command_biceps[i], s->command_triceps[i]);
    s->position_integral[i] = integrate(s->position_integral[i], error, p->position_ki, p->control_period,
                                        command < p->command_limit, command > -p->command_limit);
    s->position_output[i] = p->position_kp * error + s->position_integral[i] + s->position_derivative[i];
}

INLINE real choose_tension(Parameters p, States s, lane i, real error) {
    if (p->law == AGENT) return s->tension_command[i] += s->tension_rate[i];
    real factor = p->law == EQ6 ? scaling_factor(p, error) : scaling_factor_printed(p, error);
    return factor * p->nominal_tension;
}

INLINE void control_tension(Parameters p, States s, lane i, mask restart) {
    mask biceps_is_antagonist = s->agonist[i] == TRICEPS;
    real estimate = select(biceps_is_antagonist, s->estimate_biceps[i], s->estimate_triceps[i]);
    mask untrusted = either(biceps_is_antagonist, s->untrusted_biceps[i], s->untrusted_triceps[i]) != 0;
    real measured = select(biceps_is_antagonist, s->measured_biceps[i], s->measured_triceps[i]);
    real command = select(biceps_is_antagonist, s->command_biceps[i], -s->command_triceps[i]);
    real error = s->tension_setpoint[i] - estimate;
    if (p->below_floor == IGNORE) error = select(untrusted, all(0.0), error);
    real signal = p->tension_on_error ? error : -estimate;
    real derivative = filtered_derivative(s->tension_derivative[i], signal - s->tension_signal[i], p->tension_kd,
                                          p->tension_filter, p->control_period);
    real integral = integrate(s->tension_integral[i], error, p->tension_ki, p->control_period,
                              (command < p->command_limit) & (measured < p->slider_end),
                              (command > -p->command_limit) & not(untrusted));
    s->tension_derivative[i] = select(restart, all(0.0), derivative);
    s->tension_integral[i] = select(restart, -p->tension_kp * error, integral);
    s->tension_signal[i] = signal;
    s->tension_output[i] = p->tension_kp * error + s->tension_integral[i] + s->tension_derivative[i];
}

typedef struct {
    real biceps, triceps;             /* both commands, not yet limited */
    real biceps_share, triceps_share; /* of the position controller's output */
    mask switched;                    /* the agonist */
} commands;

/* Choose agonist and tension setpoint, run both controllers and return the commands. */
INLINE commands control(Parameters p, States s, lane i) {
    real error = s->setpoint[i] - s->measured_angle[i];
    real agonist = all(p->fixed_agonist);
    if (p->fixed_agonist == 0.0)
        agonist = select_agonist(p, s->agonist[i], s->measured_difference[i], error);
    mask switched = agonist != s->agonist[i], biceps_leads = agonist == BICEPS;
    s->agonist[i] = agonist;
    real last_position_output = s->position_output[i];
    control_position(p, s, i, error);
    real biceps_share = all(1.0), triceps_share = all(1.0);
    if (p->tension_loop) {
        biceps_share = select(biceps_leads, all(1.0), all(p->antagonist_share));
        triceps_share = select(biceps_leads, all(p->antagonist_share), all(1.0));
        s->tension_setpoint[i] = choose_tension(p, s, i, error);
        control_tension(p, s, i, switched);
        if (any(switched)) {
            real offset_biceps = s->command_biceps[i] - biceps_share * last_position_output;
            real offset_triceps = s->command_triceps[i] - triceps_share * last_position_output;
            s->offset_biceps[i] = select(switched, offset_biceps, s->offset_biceps[i]);
            s->offset_triceps[i] = select(switched, offset_triceps, s->offset_triceps[i]);
        }
    }
    real pull = s->tension_output[i];
    real biceps = s->offset_biceps[i] + biceps_share * s->position_output[i] + select(biceps_leads, all(0.0), pull);
    real triceps = s->offset_triceps[i] + triceps_share * s->position_output[i] - select(biceps_leads, pull, all(0.0));
    return (commands){biceps, triceps, biceps_share, triceps_share, switched};
}
