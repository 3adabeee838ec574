"""Memory layout of the simulation's records.

Devices are stored in blocks of `LANES`: a *structure of arrays*, so that ``state.angle[lane]`` of neighbouring devices
are neighbours in memory. Everything that changes during an episode is in one array of `STATE_BLOCK` records, so that a
copy of it is a snapshot. Angles are in radians, forces in N, lengths in m, times in s.

A device takes less than a kilobyte. Scenarios are read only, and packed: choices and counts are bytes; times, strengths
and factors are 32-bit floats with 7 digits; angles, frequencies and the arm have 64 bits. Each field of a state is a
64-bit word: with mixed widths the compiler cannot see that lanes do not overlap, and does not vectorise. All arithmetic
is in 64 bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control import reference_motion
from amulett_gym.control.torque_stiffness import regulator_gains
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.gains import Loops, group_name
from amulett_gym.jit.compiled import record
from amulett_gym.model.plant import Numbers, inertia, static_torque
from amulett_gym.model.spring import CELLS, SpringTables, build_tables
from amulett_gym.model.structure import string_tables
from amulett_gym.profile import Pid, Profile
from amulett_gym.settings import Group

Control = Literal[
    "decentralized",
    "position-only",
    "equilibrium-point",
    "co-rotation",
    "torque-stiffness",
    "feedforward-feedback",
    "feedback-linearisation",
    "torque",
    "cascade",
    "computed-torque",
    "minimal-motion",
    "drives",
]
DRIVES: Control = "drives"
"""Direct commands of both drives: the loop of `Amulett/Drives-v0` alone, whose action has another meaning."""

CONTROLS: tuple[Control, ...] = get_args(Control)[:-1]
"""The loops in which an action is a co-contraction."""

LOOPS: tuple[Control, ...] = CONTROLS[2:]
"""The loops with gains in `profile.loops`; the paper's are those before."""

BY_STIFFNESS: tuple[Control, ...] = ("torque-stiffness", "feedforward-feedback")
"""The loops that turn the co-contraction asked for into a joint stiffness."""

LANES = 8
_CACHE_LINE = 64  # bytes
MAX_MOVES = 10
MAX_PUSHES = 4
TIME_SLACK = 1e-5  # [s]; a time that is a multiple of the control period must not miss its tick by rounding. A
# scenario's times are 32-bit floats, off by up to 8 microseconds at 256 s
_DIP = 0.05  # of the largest slope: by so much a measured curve may soften, and by more it has to stiffen in all

AGENT, EQ6, EQ6_PRINTED = 0, 1, 2
TENSION_LAWS = {"agent": AGENT, "eq6": EQ6, "eq6-printed": EQ6_PRINTED}

RUNNING, ANGLE_LIMIT, VELOCITY_LIMIT, NOT_FINITE = 0, 1, 2, 3
"""Indices into `amulett_gym.FAILURES`."""

CLAMP, HOLD, IGNORE = 0, 1, 2
_BELOW_FLOOR = {"clamp": CLAMP, "hold": HOLD, "ignore": IGNORE}
_AGONIST = {"switching": 0.0, "biceps": 1.0, "triceps": -1.0}


def fields(names: str, kind: str = "f8", *shape: int) -> list[tuple[Any, ...]]:
    """Return record fields of one type and shape."""
    return [(name, kind, shape) if shape else (name, kind) for name in names.split()]


PARAMETERS = record(
    fields("drive_radius joint_radius angle_limit velocity_limit")
    + fields("force_table spring_table estimate_table", "f8", CELLS, 4)
    + fields("inverse_max_deflection max_spring_deflection max_force damping_a damping_b damping_c damping_d")
    + fields("damping_by_mean", "i8")
    + fields("extended", "i8")  # whether the next two lines matter: springs go on beyond their table, or drives stall
    + fields("beyond_slope beyond_free_length beyond_width beyond_slider")  # `model.spring.Continuation`
    + fields("stall_torque")
    + fields("inverse_lag rate_limit command_limit")
    + fields("encoder_resolution encoder_noise slider_resolution slider_travel slider_noise slider_end")
    + fields("force_filter force_floor")
    + fields("below_floor", "i8")
    + fields("control_period")
    + fields("substeps", "i8")
    + fields("position_kp position_ki position_kd position_filter")
    + fields("position_on_error", "i8")
    + fields("tension_kp tension_ki tension_kd tension_filter")
    + fields("tension_on_error tension_loop", "i8")
    + fields("antagonist_share position_only_offset fixed_agonist")
    + fields("switch_filter switch_hysteresis tie_width tie_error velocity_filter")
    + fields("nominal_tension minimum_tension error_offset")
    + fields("law", "i8")  # source of the tension setpoint: one of `TENSION_LAWS`
    + fields("margin")  # of rise and settling time
)
"""What the kernel reads of a profile and the control mode.

`force_table` and `spring_table` are those of a string, its structure included: over the string's deflection as a share
of the reciprocal of `inverse_max_deflection`. `max_spring_deflection` and `max_force` are the end of the springs' own
tables, as is the last entry of `estimate_table`.
"""

STRING_FORCES = ("taut_force", "least_tension")
"""Gains that have to be less than the largest force of a spring."""

_GAINS = sorted({name for _, group in Loops() for name, _ in group} - {"reference", "sources"})
_REFERENCES = {
    "minimum-jerk": reference_motion.MINIMUM_JERK,
    "critically-damped": reference_motion.CRITICALLY_DAMPED,
    "first-order": reference_motion.FIRST_ORDER,
}

LOOP_PARAMETERS = record(
    fields("loop reference_shape", "i8")  # index into `LOOPS`, their number for `DRIVES`; one of `_REFERENCES`
    + fields("force_table position_table slope_table", "f8", CELLS, 4)
    + fields("inverse_max_deflection max_force floor_position drive_share highest_factor drive_step inertia weight")
    + fields("torque_kp torque_ki torque_kd")
    + fields(" ".join(_GAINS))
)
"""What the kernel reads of a loop that is not the paper's.

These are: its index; the shape of its reference motion; the springs' table and its inverse
(`model.spring.find_position`), the table of slopes over the slider's reading
(`model.spring.SpringTables.estimated_slope`), the end of the springs' table as a reciprocal deflection [1/m] and as a
force [N], and the position of the sensors' floor in it; the share of the way to its command that a drive turns in a
control period, its inverse, and the largest step in it (`control.drive_model`); J [kg m2] and M_m [N m] of the bare
arm; the gains of `control.torque_stiffness`, 0 in other loops; the gains of `gains.Loops`, 0 where the loop has none of
that name.

A microcontroller's tables are those of the springs, whatever the structure adds (`Profile.structure`). They end at the
spring's `max_deflection`, whatever the string does beyond (`Spring.beyond`): the largest force is that of the tables'
end, so a loop asks neither for a force of the stop nor of the law continued. Its model of the drives is that of drives
without load: it knows no stall torque.
"""

DEVICE_FACTORS = ("spring_biceps", "spring_triceps", "pulley_biceps", "pulley_triceps", "inertia", "damping", "noise")
"""Factors by which a scenario's device may differ from its profile; 1: no difference."""

Orientation = Literal["profile", "horizontal", "vertical"]
ORIENTATIONS: tuple[Orientation, ...] = get_args(Orientation)
"""A packed scenario's `orientation` is an index into these; ``"profile"``: that of the profile."""

Family = Literal["paper-step", "steps", "reach", "track", "pick-place", "contact", "hold-push", "payload"]
FAMILIES: tuple[Family | None, ...] = (None, *get_args(Family))
"""A packed scenario's `family` is an index into these: the suite by whose divisors its reward is scaled."""


def _record(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return a record with the widest fields first: no gaps, and fields of one width form one array of words."""
    return record(sorted(fields, key=lambda field: -np.dtype(field[1]).itemsize))


def block(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return the record of a block of devices, lanes innermost."""
    return _record([(name, kind, (*(shape[0] if shape else ()), LANES)) for name, kind, *shape in fields])


_SCENARIO_FIELDS = [
    *fields("initial_angle initial_tension"),
    # the arm with its load; inertia, static torque and friction follow from the others (`load_arm`)
    *fields("orientation", "i1"),
    *fields("payload_mass payload_arm inertia static_torque friction"),
    # the setpoint
    *fields("move_count", "i1"),
    *fields("move_time", "f4", MAX_MOVES),
    *fields("move_angle", "f8", MAX_MOVES),
    *fields("move_duration", "f4", MAX_MOVES),
    *fields("wave_amplitude wave_frequency wave_chirp"),
    *fields("wave_time wave_duration", "f4"),
    # the disturbances; a push with an inverse rise [1/s] of 0 is a pulse
    *fields("push_count", "i1"),
    *fields("push_time push_duration push_torque push_inverse_rise", "f4", MAX_PUSHES),
    *fields("shake_rms shake_bandwidth shake_time shake_duration", "f4"),
    *fields("obstacle_angle"),
    *fields("obstacle_side", "i1"),
    *fields("obstacle_stiffness obstacle_damping", "f4"),
    # the device's differences from its profile
    *fields(" ".join(f"{name}_factor" for name in DEVICE_FACTORS), "f4"),
    *fields("encoder_bias"),
    *fields("slider_bias_biceps slider_bias_triceps late_probability", "f4"),
    *fields("measure_from", "f4"),
    *fields("family", "i1"),  # for the reward; the simulation does not read it
    *fields("noise_key", "u8"),
]

SCENARIO = _record(_SCENARIO_FIELDS)
"""One device's packed scenario."""

_METRIC_FIELDS = fields(
    "position_ise tension_ise tension_ise_estimated isav_biceps isav_triceps isav_kick effort_biceps effort_triceps "
    "iav_biceps iav_triceps contact_ise contact_peak push_deflection overshoot rise_sum rise_count settling_sum "
    "settling_count resting_stiffness_sum resting_time step_count switch_count drive_effort drive_work"
)
METRICS = tuple(name for name, *_ in _METRIC_FIELDS)

_STATE_FIELDS = [
    *fields("tick failure", "i8"),
    # true values
    *fields("angle velocity drive_biceps drive_triceps force_biceps force_triceps push_torque contact_torque"),
    *fields("shake_inner shake_outer"),
    # what the microcontroller knows
    *fields("setpoint setpoint_wave previous_setpoint setpoint_jump measured_angle measured_velocity"),
    *fields("measured_biceps measured_triceps measured_difference estimate_biceps estimate_triceps"),
    *fields("untrusted_biceps untrusted_triceps", "i8"),
    # the loop's memory; an agent's tension setpoint moves by `tension_rate` [N] a tick
    *fields("tension_command tension_rate tension_setpoint stiffness_setpoint agonist"),
    *fields("position_output position_integral position_derivative position_signal kick_derivative"),
    *fields("tension_output tension_integral tension_derivative tension_signal"),
    *fields("offset_biceps offset_triceps command_biceps command_triceps"),
    # the setpoint's move or part of its path, and the step in progress
    *fields("move", "i8"),
    *fields("step_start step_target step_direction"),
    *fields("risen", "i8"),
    *fields("inside_since"),
    *_METRIC_FIELDS,
]


MINIMUM_JERK, LINEAR, STEPS = 0, 1, 2

PATH = np.dtype([("time", "f8"), ("start", "f8"), ("angle", "f8"), ("duration", "f8"), ("shape", "i8")], align=True)
"""A part of a setpoint path: its begin [s], start and end angle [rad], duration [s] (0: a jump) and shape. Parts of
shape MINIMUM_JERK are moves and count as setpoint steps; LINEAR and STEPS follow samples.

A scenario with more than `MAX_MOVES` moves or a sampled setpoint has a path outside its record (its `move_count` is
`ON_PATH`): one array holds the parts of all paths, blocks of `PLACE_BLOCK` each device's place in that."""

ON_PATH = -1

Paths = tuple[NDArray[np.void], NDArray[np.void]]
"""Parts and places."""

STATE = _record(_STATE_FIELDS)
"""One device's state: the words of a lane of a block."""

STATE_BLOCK = block(_STATE_FIELDS)
SCENARIO_BLOCK = block(_SCENARIO_FIELDS)
PLACE_BLOCK = block([("first", "i8"), ("count", "i8")])
LOOP_BLOCK = block(
    # the reference motion, and the offset of the setpoint that is left of the last jump, as it was at `jump_time`
    fields("reference reference_rate reference_acceleration setpoint_acceleration")
    + fields("last_setpoint last_rate last_time jump_time jump_offset jump_rate jump_acceleration")
    # what the loop knows of joint and drives
    + fields("velocity last_angle model_biceps model_triceps")
    + fields("integral stiffness_integral stiffness_reference stiffness_error")
    # torques [N m] of the arm's weight at the observed or the measured angle, by the loop, and at the reference
    + fields("weight weight_slope reference_weight")
    + fields("elapsed load torque tension drive_rate tautness jump_jerk")
    + fields("force_biceps force_triceps slope_biceps slope_triceps")
    + fields("correction_biceps correction_triceps saturated_biceps saturated_triceps")
    + fields("observed_angle observed_velocity observed_acceleration disturbance")
    # mean drive angle asked for by the agent, which moves by `mean_rate` [rad] a tick
    + fields("mean_command mean_rate")
    # what the loop wants, and what is added to it, so that it starts at rest
    + fields("biceps triceps trim_biceps trim_triceps")
)
"""The memory of loops that are not the paper's."""

Loop = tuple[NDArray[np.void], NDArray[np.void]]
"""`LOOP_PARAMETERS` of each profile, and blocks of `LOOP_BLOCK`."""

MOTION_BLOCK = block(
    fields("counting switched push weight angle velocity biceps triceps")
    + fields("angle_rate velocity_rate biceps_rate triceps_rate angle_sum velocity_sum biceps_sum triceps_sum")
)
"""A block's motion within a tick: 1 if the tick counts in the metrics, else 0; 1 if the agonist has switched, else 0;
the torques of push and weight [N m]; joint and drives, with their last evaluated and their summed rates of change."""
STATE_NAMES = tuple(name for name, *_ in _STATE_FIELDS)


def words(records: NDArray[np.void], lanes: int) -> list[NDArray[Any]]:
    """Return views of records or blocks: for each width of their fields an array, shape (records, words, lanes).

    A scenario's record and a lane of a block of scenarios hold the same words in the same order.
    """
    view = records.view(_of_words(records.dtype, lanes))
    return [view[name] for name in view.dtype.names]


def joined(records: Iterable[NDArray[np.void]], dtype: np.dtype[Any]) -> NDArray[np.void]:
    """Return arrays of records as one, whose dtype is this very object.

    numba looks up an argument's type by the object: an array with an equal one costs microseconds in each call, and
    `np.concatenate` may make one.
    """
    return np.concatenate(list(records), dtype=dtype)


def zeros(count: int, block: np.dtype[Any]) -> NDArray[np.void]:
    """Return empty blocks that begin on a cache line, which makes a tick some percent faster."""
    raw = np.zeros(count * block.itemsize + _CACHE_LINE, dtype=np.uint8)
    start = -raw.ctypes.data % _CACHE_LINE
    return raw[start : start + count * block.itemsize].view(block)


@cache
def _of_words(dtype: np.dtype[Any], lanes: int) -> Any:
    """Return a record of the same size whose fields hold all words of one width, widest first; shape (words, lanes)."""
    sections: dict[int, tuple[int, int]] = {}  # begin and end of each width's fields
    for kind, offset, *_ in (dtype.fields or {}).values():
        width = kind.base.itemsize
        start, _ = sections.get(width, (offset, offset))
        sections[width] = start, offset + kind.itemsize
    return np.dtype(
        {
            "names": [f"i{width}" for width in sections],
            "formats": [
                (f"i{width}", ((end - start) // (width * lanes), lanes)) for width, (start, end) in sections.items()
            ],
            "offsets": [start for start, _ in sections.values()],
            "itemsize": dtype.itemsize,
        }
    )


def pack_parameters(
    profile: Profile, control: Control = "decentralized", tension_law: str = "agent"
) -> NDArray[np.void]:
    """Return a profile as the kernel reads it, in SI units and radians.

    Position-only control has its own gains and a fixed co-contraction instead of the tension loop.

    Returns
    -------
    ndarray of `PARAMETERS`, shape (1,)

    Raises
    ------
    AmulettError
        If a name is unknown.
    """
    if control not in (*CONTROLS, DRIVES):
        raise unknown("control", control, (*CONTROLS, DRIVES))
    if tension_law not in TENSION_LAWS:
        raise unknown("tension law", tension_law, TENSION_LAWS)
    plant, drives, sensors, loop = profile.plant, profile.drives, profile.sensors, profile.loop
    springs, tables = build_tables(profile.spring), string_tables(profile)
    position_only = control == "position-only"
    shifted = profile.damping.b * profile.damping.c if profile.damping.fit == "shifted" else profile.damping.c
    values: dict[str, Any] = {
        **dict(sensors),
        **dict(loop),
        **dict(profile.variable_stiffness),
        **{f"damping_{name}": value for name, value in profile.damping},
        "drive_radius": plant.drive_pulley_radius,
        "joint_radius": plant.joint_pulley_radius,
        "angle_limit": np.radians(plant.angle_limit_deg),
        "velocity_limit": np.radians(plant.velocity_limit_deg),
        "force_table": tables.force,
        "spring_table": tables.spring_deflection,
        "estimate_table": tables.estimated_force,
        "inverse_max_deflection": 1.0 / tables.max_deflection,
        "max_spring_deflection": springs.max_spring_deflection,
        "max_force": springs.max_force,
        "extended": tables.beyond.slope > 0.0 or tables.beyond.slider > 0.0 or drives.stall_torque is not None,
        **{f"beyond_{name}": value for name, value in tables.beyond._asdict().items()},
        "stall_torque": drives.stall_torque or np.inf,
        "damping_c": shifted,
        "damping_by_mean": profile.damping.preload == "mean",
        "inverse_lag": 1.0 / drives.lag if drives.lag > 0 else 0.0,
        "rate_limit": np.radians(drives.rate_limit_deg or np.inf),
        "command_limit": np.radians(drives.command_limit_deg or np.inf),
        "encoder_resolution": 2 * np.pi / 2**sensors.encoder_bits if sensors.encoder_bits else 0.0,
        "encoder_noise": np.radians(sensors.encoder_noise_deg),
        "slider_resolution": _slider_resolution(profile),
        "slider_travel": sensors.potentiometer_travel,
        "slider_noise": sensors.potentiometer_noise,
        "slider_end": slider_end(profile, springs.max_spring_deflection),
        "below_floor": _BELOW_FLOOR[sensors.below_floor],
        **_gains("position", loop.position_only if position_only else loop.position, 1.0),
        **_gains("tension", loop.tension, np.radians(1.0)),
        "tension_loop": not position_only,
        "antagonist_share": 1.0 if position_only or loop.wiring == "sum" else 0.0,
        "position_only_offset": np.radians(loop.offset_deg),
        "fixed_agonist": _AGONIST[loop.agonist],
        "tie_error": np.radians(loop.tie_error_deg),
        "error_offset": np.radians(profile.variable_stiffness.error_offset_deg),
        "law": TENSION_LAWS[tension_law],
        "margin": np.radians(2.0),
    }
    record = np.zeros(1, dtype=PARAMETERS)
    for name in PARAMETERS.names or ():
        record[name] = values[name]
    return record


def pack_loop(profile: Profile, control: Control) -> NDArray[np.void]:
    """Return gains and device of one of `LOOPS`, or of `DRIVES`, as `LOOP_PARAMETERS` of shape (1,).

    Raises
    ------
    AmulettError
        If the springs do not have what the loop needs.
    """
    tables, loop, drives = build_tables(profile.spring), profile.loop, profile.drives
    if control in BY_STIFFNESS:
        _check_stiffening(tables, control)
    masses: list[Numbers] = [item.mass for item in profile.plant.masses]
    arms: list[Numbers] = [item.arm for item in profile.plant.masses]
    packed = np.zeros(1, dtype=LOOP_PARAMETERS)
    packed["loop"] = (*LOOPS, DRIVES).index(control)
    packed["force_table"], packed["position_table"] = tables.force, tables.position
    packed["inverse_max_deflection"], packed["max_force"] = 1.0 / tables.max_deflection, tables.max_force
    packed["drive_share"] = -np.expm1(-loop.control_period / drives.lag) if drives.lag > 0 else 1.0
    packed["highest_factor"] = 1.0 / packed["drive_share"]
    packed["drive_step"] = np.radians(drives.rate_limit_deg or np.inf) * loop.control_period
    packed["inertia"] = inertia(masses, arms)
    packed["weight"] = static_torque(masses, arms) if profile.plant.orientation == "vertical" else 0.0
    packed["slope_table"] = tables.estimated_slope
    floor = min(profile.sensors.force_floor, tables.max_force)
    packed["floor_position"] = tables.deflection_at(floor) / tables.max_deflection if floor > 0.0 else 0.0
    if control == DRIVES:  # it has no gains
        return packed
    gains = getattr(profile.loops, group_name(control))
    _check_forces(gains, tables, control)
    for name in _GAINS:
        packed[name] = getattr(gains, name, 0.0)
    packed["lead"] *= drives.lag  # a profile's is a share of the lag
    packed["reference_shape"] = _REFERENCES[gains.reference]
    if control == "torque-stiffness":
        weights = gains.integral_weight, gains.angle_weight, gains.rate_weight, gains.torque_weight
        found = regulator_gains(*weights, float(packed["inertia"][0]))
        packed["torque_ki"], packed["torque_kp"], packed["torque_kd"] = found
    return packed


def unfit_loops(profile: Profile) -> dict[Control, str]:
    """Return the loops of `LOOPS` whose needs a device does not meet, each with the reason."""
    found = {}
    for loop in LOOPS:
        try:
            pack_loop(profile, loop)
        except AmulettError as error:
            found[loop] = str(error).rstrip(".")
    return found


def _check_forces(gains: Group, tables: SpringTables, control: Control) -> None:
    """Raise an AmulettError if the springs do not reach a string force that a loop needs."""
    for name in STRING_FORCES:
        force = getattr(gains, name, 0.0)
        if force >= tables.max_force:
            raise AmulettError(
                f"control '{control}' needs strings with more than 'loops.{group_name(control)}.{name}', {force:g} N; "
                f"the profile's springs give at most {tables.max_force:.4g} N. Set a smaller {name}, or choose another "
                "control, such as 'co-rotation'"
            )


def _check_stiffening(tables: SpringTables, control: Control) -> None:
    """Raise an AmulettError if a joint stiffness cannot be set: the slope of the springs has to rise."""
    slopes = np.append(tables.force[:, 1], tables.force[-1] @ [0.0, 1.0, 2.0, 3.0]) * (CELLS / tables.max_deflection)
    highest = np.maximum.accumulate(slopes)
    worst = int(np.argmax(highest - slopes))
    tolerated = _DIP * highest[-1]
    needs = f"control '{control}' sets the joint stiffness, so the slope of the springs has to rise with the deflection"
    if highest[worst] - slopes[worst] > tolerated:
        peak = int(np.argmax(slopes[: worst + 1]))
        deflections = 1000.0 * tables.max_deflection * np.array([peak, worst]) / CELLS
        raise AmulettError(
            f"{needs}; those of the profile soften, from {slopes[peak]:.4g} N/m at {deflections[0]:.3g} mm to "
            f"{slopes[worst]:.4g} N/m at {deflections[1]:.3g} mm. Choose another control, such as 'co-rotation'"
        )
    if slopes[-1] - slopes[0] <= tolerated:
        raise AmulettError(
            f"{needs}; that of the profile's springs is {slopes[0]:.4g} N/m at rest and {slopes[-1]:.4g} N/m at their "
            "end. Choose another control, such as 'co-rotation'"
        )


def slider_end(profile: Profile, max_spring_deflection: float) -> float:
    """Return the smallest reading [m] at which a potentiometer may be at its end: the table's or its travel's.

    The margin covers noise, which is bounded (`simulation.random.noise`), and rounding.
    """
    sensors = profile.sensors
    doubt = max(_slider_resolution(profile) + 3.5 * sensors.potentiometer_noise, 1e-6 * max_spring_deflection)
    return min(max_spring_deflection, sensors.potentiometer_travel) - doubt


def _slider_resolution(profile: Profile) -> float:
    """Return a potentiometer's least bit [m], 0 if it is exact."""
    sensors = profile.sensors
    return sensors.potentiometer_travel / 2**sensors.potentiometer_bits if sensors.potentiometer_bits else 0.0


def load_arm(rows: NDArray[np.void], profile: Profile) -> None:
    """Set J and M_m of eqs. 2-3 and the factor of the decay rate from the load of scenarios (`SCENARIO` records).

    M_m is 0 in the horizontal plane. The damping fit holds for the bare arm; if the profile keeps the damping *torque*,
    a payload does not multiply it.
    """
    own_masses = [item.mass for item in profile.plant.masses]
    own_arms = [item.arm for item in profile.plant.masses]
    masses: list[Numbers] = [*own_masses, rows["payload_mass"]]
    arms: list[Numbers] = [*own_arms, np.where(rows["payload_mass"] > 0, rows["payload_arm"], 0.0)]
    rows["inertia"] = inertia(masses, arms) * rows["inertia_factor"]
    rows["static_torque"] = np.where(is_vertical(rows, profile), static_torque(masses, arms), 0.0)
    share = inertia(own_masses, own_arms) / rows["inertia"] if profile.damping.keeps == "torque" else 1.0
    rows["friction"] = rows["damping_factor"] * share


def is_vertical(rows: NDArray[np.void], profile: Profile) -> NDArray[np.bool_]:
    """Return whether the forearm swings in the vertical plane, for each scenario (`SCENARIO` records)."""
    vertical: NDArray[np.bool_] = rows["orientation"] == ORIENTATIONS.index("vertical")
    if profile.plant.orientation == "vertical":
        vertical |= rows["orientation"] == ORIENTATIONS.index("profile")
    return vertical


def _gains(name: str, pid: Pid, unit: float) -> dict[str, float]:
    return {
        f"{name}_kp": pid.kp * unit,
        f"{name}_ki": pid.ki * unit,
        f"{name}_kd": pid.kd * unit,
        f"{name}_filter": pid.derivative_filter,
        f"{name}_on_error": pid.derivative_on == "error",
    }
