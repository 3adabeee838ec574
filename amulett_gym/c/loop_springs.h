/* Springs and statics: amulett_gym/model/spring.py, control/inverse_statics.py and control/inverse_dynamics.py. */

typedef struct {
    real biceps, triceps;
} pair;

typedef struct {
    real value, slope, bend; /* with its first two derivatives by position */
} curve;

#ifdef CONTROLLER_DOUBLE

/* The string force [N] at a position; beyond both ends of the table: what it has there. */
static inline curve look_up_curve(Gains g, real position) {
    cubic at = find_cell(g->force_table, position);
    curve found;
    found.value = at.k0 + at.w * (at.k1 + at.w * (at.k2 + at.w * at.k3));
    found.slope = (at.k1 + at.w * (2 * at.k2 + at.w * 3 * at.k3)) * CELLS;
    found.bend = (2 * at.k2 + at.w * 6 * at.k3) * CELLS * CELLS;
    return found;
}

/* The position (0 to 1) that has a string force: that of the inverse table, with one Newton step. */
static inline real find_position(Gains g, real force) {
    real part = least(greatest(force / g->max_force, 0), 1);
    real position = look_up(g->position_table, root(root(part)));
    real slope = look_up_slope(g->force_table, position);
    real step = slope > 0 ? (part * g->max_force - look_up(g->force_table, position)) / slope : 0;
    const real most = (real)1 / CELLS;
    return least(greatest(position + least(greatest(step, -most), most), 0), 1);
}

/* The decay rate of the joint's motion [1/s] by the strings' preload [N]. */
INLINE real decay_at(Parameters p, Gains g, real preload) {
    (void)g;
    return decay_rate(p, preload);
}

#else /* straight lines between more knots: an AVR takes a third of the time, and digits are lost in 32 bits anyway */

/* Split a position into a line and the share of the way along it. */
INLINE real along(real position, integer lines, integer *line) {
    real scaled = least(greatest(position, 0), 1) * lines;
    *line = (integer)scaled;
    if (*line == lines) *line = lines - 1;
    return scaled - *line;
}

static inline curve look_up_curve(Gains g, real position) {
    integer line;
    real w = along(position, FORCE_LINES, &line);
    Pairs row = g->force_table + line;
    real value = read_real(row[0]), slope = read_real(row[0] + 1), rise = read_real(row[1] + 1) - slope;
    return (curve){value + w * (read_real(row[1]) - value), slope + w * rise, rise * FORCE_LINES};
}

static inline real on_lines(const table_real *table, real position, integer lines) {
    integer line;
    real w = along(position, lines, &line), value = read_real(table + line);
    return value + w * (read_real(table + line + 1) - value);
}

static inline real find_position(Gains g, real force) {
    return on_lines(g->position_table, root(root(greatest(over(force, g->max_force), 0))), POSITION_LINES);
}

/* The decay rate by a preload from 0 to the largest force. */
static inline real decay_at(Parameters p, Gains g, real preload) {
    (void)p;
    return on_lines(g->decay_table, over(preload, g->max_force), DECAY_LINES);
}

#endif

/* The torque that holds the bare arm's weight [N m]. */
INLINE real weight_torque(Gains g, real angle) { return g->weight != 0 ? g->weight * sine(angle) : 0; }

INLINE real joint_torque(Gains g, real acceleration, real rate, real angle, real decay) {
    return g->inertia * (acceleration + 2 * decay * rate) + weight_torque(g, angle);
}

/* The forces [N] that give a joint torque, the antagonist with a tension. */
static inline pair string_forces(Parameters p, Gains g, real torque, real tension) {
    real antagonist = least(greatest(tension, 0), g->max_force);
    real agonist = least(antagonist + over(absolute(torque), p->joint_radius), g->max_force);
    return torque >= 0 ? (pair){agonist, antagonist} : (pair){antagonist, agonist};
}

/* The tension, lowered as far as the torque needs it. */
static inline real affordable_tension(Parameters p, Gains g, real torque, real tension) {
    return greatest(least(tension, g->max_force - over(absolute(torque), p->joint_radius)), 0);
}

/* The drive angles [rad] at a joint angle for the strings' positions in the force table. */
static inline pair drives_at(Parameters p, Gains g, real angle, pair position) {
    real wound = angle * p->joint_radius;
    real biceps = over(position.biceps, g->inverse_max_deflection);
    real triceps = over(position.triceps, g->inverse_max_deflection);
    return (pair){over(wound + biceps, p->drive_radius), over(wound - triceps, p->drive_radius)};
}

/* The drive angles [rad] that hold a joint angle with a torque at a tension. */
static inline pair hold_at(Parameters p, Gains g, real angle, real torque, real tension) {
    pair force = string_forces(p, g, torque, tension);
    return drives_at(p, g, angle, (pair){find_position(g, force.biceps), find_position(g, force.triceps)});
}

/* Both strings' positions in the force table by the drives' model and a joint angle. */
static inline pair predict_positions(Parameters p, Gains g, Memory q, real angle) {
    real wound = angle * p->joint_radius;
    return (pair){(q->model_biceps * p->drive_radius - wound) * g->inverse_max_deflection,
                  (wound - q->model_triceps * p->drive_radius) * g->inverse_max_deflection};
}
