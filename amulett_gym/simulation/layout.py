"""How parameters, scenarios and states lie in memory.

Devices are stored in blocks of `LANES`: a *structure of arrays*, so that ``state.angle[lane]`` of neighbouring devices
are neighbours in memory. Everything that changes during an episode is in one array of `STATE_BLOCK` records: copying it
is a snapshot. Angles are radians here, forces N, lengths m, times s.

A device takes less than a kilobyte. Scenarios are read only, and packed: what is chosen or counted is a byte; moments,
durations, strengths and factors are 32-bit floats, which keep 7 digits; angles, frequencies and the arm keep 64 bits.
States are written, and each field is a 64-bit word: where widths mix, the compiler cannot see that lanes do not
overlap, and takes them one by one. What is calculated is calculated in 64 bits in any case.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import unknown
from amulett_gym.jit.compiled import record
from amulett_gym.model.plant import Numbers, inertia, static_torque
from amulett_gym.model.spring import CELLS, build_tables
from amulett_gym.profile import Pid, Profile

Control = Literal["decentralized", "position-only"]
CONTROLS: tuple[Control, ...] = get_args(Control)

LANES = 8
_CACHE_LINE = 64  # bytes
MAX_MOVES = 10
MAX_PUSHES = 4

AGENT, EQ6, EQ6_PRINTED = 0, 1, 2
TENSION_LAWS = {"agent": AGENT, "eq6": EQ6, "eq6-printed": EQ6_PRINTED}

RUNNING, ANGLE_LIMIT, VELOCITY_LIMIT, NOT_FINITE = 0, 1, 2, 3
FAILURES = ("", "joint angle limit", "joint velocity limit", "state is not finite")

CLAMP, HOLD, IGNORE = 0, 1, 2
_BELOW_FLOOR = {"clamp": CLAMP, "hold": HOLD, "ignore": IGNORE}
_AGONIST = {"switching": 0.0, "biceps": 1.0, "triceps": -1.0}

PARAMETERS = record(
    [
        # plant
        ("drive_radius", "f8"),
        ("joint_radius", "f8"),
        ("angle_limit", "f8"),
        ("velocity_limit", "f8"),
        # spring assembly
        ("force_table", "f8", (CELLS, 4)),
        ("spring_table", "f8", (CELLS, 4)),
        ("estimate_table", "f8", (CELLS, 4)),
        ("inverse_max_deflection", "f8"),
        ("max_spring_deflection", "f8"),
        # damping
        ("damping_a", "f8"),
        ("damping_b", "f8"),
        ("damping_c", "f8"),
        ("damping_d", "f8"),
        ("damping_by_mean", "i8"),
        # drives
        ("inverse_lag", "f8"),
        ("rate_limit", "f8"),
        ("command_limit", "f8"),
        # sensors
        ("encoder_resolution", "f8"),
        ("encoder_noise", "f8"),
        ("slider_resolution", "f8"),
        ("slider_travel", "f8"),
        ("slider_noise", "f8"),
        ("slider_end", "f8"),
        ("force_filter", "f8"),
        ("force_floor", "f8"),
        ("below_floor", "i8"),
        # loop
        ("control_period", "f8"),
        ("substeps", "i8"),
        ("position_kp", "f8"),
        ("position_ki", "f8"),
        ("position_kd", "f8"),
        ("position_filter", "f8"),
        ("position_on_error", "i8"),
        ("tension_kp", "f8"),
        ("tension_ki", "f8"),
        ("tension_kd", "f8"),
        ("tension_filter", "f8"),
        ("tension_on_error", "i8"),
        ("tension_loop", "i8"),
        ("antagonist_share", "f8"),
        ("position_only_offset", "f8"),
        ("fixed_agonist", "f8"),
        ("switch_filter", "f8"),
        ("switch_hysteresis", "f8"),
        ("tie_width", "f8"),
        ("tie_error", "f8"),
        ("velocity_filter", "f8"),
        # eq. 6
        ("nominal_tension", "f8"),
        ("minimum_tension", "f8"),
        ("error_offset", "f8"),
        ("law", "i8"),  # who sets the tension: one of `TENSION_LAWS`
        # error margin of rise and settling time
        ("margin", "f8"),
    ]
)

DEVICE_FACTORS = ("spring_biceps", "spring_triceps", "pulley_biceps", "pulley_triceps", "inertia", "damping", "noise")
"""By which a scenario's device may differ from its profile: 1 leaves it as it is."""

Orientation = Literal["profile", "horizontal", "vertical"]
ORIENTATIONS: tuple[Orientation, ...] = get_args(Orientation)
"""What a packed scenario's `orientation` stands for; ``"profile"`` leaves it to the profile."""

Family = Literal["paper-step", "steps", "reach", "track", "pick-place", "contact", "hold-push", "payload"]
FAMILIES: tuple[Family | None, ...] = (None, *get_args(Family))
"""What a packed scenario's `family` stands for: the suite whose task it is, by which its reward is scaled."""


def _record(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return a record with the widest fields first: no gaps, and all fields of one width are one array of words."""
    return record(sorted(fields, key=lambda field: -np.dtype(field[1]).itemsize))


def _block(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return the record of a block's devices, lanes innermost."""
    return _record([(name, kind, (*(shape[0] if shape else ()), LANES)) for name, kind, *shape in fields])


_SCENARIO_FIELDS: list[tuple[Any, ...]] = [
    ("initial_angle", "f8"),
    ("initial_tension", "f8"),
    # the arm: eqs. 2-3 and the friction's share follow from its load, its plane and the device
    ("orientation", "i1"),
    ("payload_mass", "f8"),
    ("payload_arm", "f8"),
    ("inertia", "f8"),
    ("static_torque", "f8"),
    ("friction", "f8"),
    # what the setpoint does
    ("move_count", "i1"),
    ("move_time", "f4", (MAX_MOVES,)),
    ("move_angle", "f8", (MAX_MOVES,)),
    ("move_duration", "f4", (MAX_MOVES,)),
    ("wave_amplitude", "f8"),
    ("wave_frequency", "f8"),
    ("wave_chirp", "f8"),
    ("wave_time", "f4"),
    ("wave_duration", "f4"),
    # what disturbs the arm
    ("push_count", "i1"),
    ("push_time", "f4", (MAX_PUSHES,)),
    ("push_duration", "f4", (MAX_PUSHES,)),
    ("push_torque", "f4", (MAX_PUSHES,)),
    ("push_inverse_rise", "f4", (MAX_PUSHES,)),  # [1/s]; 0: a pulse
    ("shake_rms", "f4"),
    ("shake_bandwidth", "f4"),
    ("shake_time", "f4"),
    ("shake_duration", "f4"),
    ("obstacle_angle", "f8"),
    ("obstacle_side", "i1"),
    ("obstacle_stiffness", "f4"),
    ("obstacle_damping", "f4"),
    # how the device differs from its profile: factors and offsets
    *[(f"{name}_factor", "f4") for name in DEVICE_FACTORS],
    ("encoder_bias", "f8"),
    ("slider_bias_biceps", "f4"),
    ("slider_bias_triceps", "f4"),
    ("late_probability", "f4"),
    ("measure_from", "f4"),
    ("family", "i1"),  # for the reward; the simulation does not read it
    ("noise_key", "u8"),
]

SCENARIO = _record(_SCENARIO_FIELDS)
"""One device's scenario, packed: what a suite samples and `tasks.scenario.pack` makes."""

METRICS = (
    "position_ise",
    "tension_ise",
    "tension_ise_estimated",
    "isav_biceps",
    "isav_triceps",
    "isav_kick",
    "effort_biceps",
    "effort_triceps",
    "iav_biceps",
    "iav_triceps",
    "contact_ise",
    "contact_peak",
    "push_deflection",
    "overshoot",
    "rise_sum",
    "rise_count",
    "settling_sum",
    "settling_count",
    "resting_stiffness_sum",
    "resting_time",
    "step_count",
    "switch_count",
)

_STATE_FIELDS: list[tuple[str, str]] = [
    ("tick", "i8"),
    ("failure", "i8"),
    # the truth
    ("angle", "f8"),
    ("velocity", "f8"),
    ("drive_biceps", "f8"),
    ("drive_triceps", "f8"),
    ("force_biceps", "f8"),
    ("force_triceps", "f8"),
    ("push_torque", "f8"),
    ("contact_torque", "f8"),
    ("shake_inner", "f8"),
    ("shake_outer", "f8"),
    # what the microcontroller knows
    ("setpoint", "f8"),
    ("setpoint_wave", "f8"),
    ("previous_setpoint", "f8"),
    ("setpoint_jump", "f8"),
    ("measured_angle", "f8"),
    ("measured_velocity", "f8"),
    ("measured_biceps", "f8"),
    ("measured_triceps", "f8"),
    ("measured_difference", "f8"),
    ("estimate_biceps", "f8"),
    ("estimate_triceps", "f8"),
    ("untrusted_biceps", "i8"),
    ("untrusted_triceps", "i8"),
    # the loop's memory
    ("tension_command", "f8"),
    ("tension_rate", "f8"),  # [N] a tick: an agent's setpoint moves to where it wants it
    ("tension_setpoint", "f8"),
    ("agonist", "f8"),
    ("position_output", "f8"),
    ("position_integral", "f8"),
    ("position_derivative", "f8"),
    ("position_signal", "f8"),
    ("kick_derivative", "f8"),
    ("tension_output", "f8"),
    ("tension_integral", "f8"),
    ("tension_derivative", "f8"),
    ("tension_signal", "f8"),
    ("offset_biceps", "f8"),
    ("offset_triceps", "f8"),
    ("command_biceps", "f8"),
    ("command_triceps", "f8"),
    # the setpoint's move or part of its path, and the step in progress
    ("move", "i8"),
    ("step_start", "f8"),
    ("step_target", "f8"),
    ("step_direction", "f8"),
    ("risen", "i8"),
    ("inside_since", "f8"),
    # the costs in the rewards given so far; checkpoints compare these names
    ("paid_position", "f8"),
    ("paid_effort", "f8"),
    ("paid_tension", "f8"),
    ("paid_contact", "f8"),
    *[(name, "f8") for name in METRICS],
]


MINIMUM_JERK, LINEAR, STEPS = 0, 1, 2

PATH = np.dtype([("time", "f8"), ("start", "f8"), ("angle", "f8"), ("duration", "f8"), ("shape", "i8")], align=True)
"""A part of a setpoint path: when it begins [s], from where to where it goes [rad], how long it takes [s] (0: a jump)
and how. Those of shape MINIMUM_JERK are moves and count as setpoint steps; LINEAR and STEPS follow samples.

Paths stand beside the scenarios that have more than `MAX_MOVES` moves or a sampled setpoint (their `move_count` is
`ON_PATH`): the parts of all of them in one array, and each device's place in that, in blocks of `PLACE_BLOCK`."""

ON_PATH = -1

Paths = tuple[NDArray[np.void], NDArray[np.void]]
"""Parts and places."""

_MOVING = ("angle", "velocity", "biceps", "triceps")


STATE_BLOCK = _block(_STATE_FIELDS)
SCENARIO_BLOCK = _block(_SCENARIO_FIELDS)
PLACE_BLOCK = _block([("first", "i8"), ("count", "i8")])
MOTION_BLOCK = _block(
    [("counting", "f8"), ("push", "f8")]
    + [(f"{name}{part}", "f8") for part in ("", "_rate", "_sum") for name in _MOVING]
)
"""A block's motion within a tick: 1 if the tick counts in the metrics, else 0; the push; and what moves, with its last
evaluated and its summed rate of change."""
STATE_NAMES = tuple(name for name, _ in _STATE_FIELDS)


def words(records: NDArray[np.void], lanes: int) -> list[NDArray[Any]]:
    """View records or blocks as one array of words for each width of their fields, shape (records, words, lanes).

    What a scenario's record holds and what a lane of a block of scenarios holds are the same words in the same order.
    """
    raw = records.view(np.uint8).reshape(records.size, records.dtype.itemsize)
    return [
        raw[:, start:end].view(f"i{width}").reshape(records.size, (end - start) // (width * lanes), lanes)
        for width, start, end in _sections(records.dtype)
    ]


def zeros(count: int, block: np.dtype[Any]) -> NDArray[np.void]:
    """Return empty blocks that begin on a cache line, which saves some percent of a tick."""
    raw = np.zeros(count * block.itemsize + _CACHE_LINE, dtype=np.uint8)
    start = -raw.ctypes.data % _CACHE_LINE
    return raw[start : start + count * block.itemsize].view(block)


@cache
def _sections(dtype: np.dtype[Any]) -> list[tuple[int, int, int]]:
    """Return the widths of a record's fields [bytes], widest first, and where those of each begin and end."""
    sections: dict[int, tuple[int, int, int]] = {}
    for kind, offset, *_ in (dtype.fields or {}).values():
        width = kind.base.itemsize
        start = sections[width][1] if width in sections else offset
        sections[width] = width, start, offset + kind.itemsize
    return list(sections.values())


def pack_parameters(
    profile: Profile, control: Control = "decentralized", tension_law: str = "agent"
) -> NDArray[np.void]:
    """Turn a profile into the record that the kernel reads, in SI units and radians.

    Parameters
    ----------
    profile : Profile
    control : {"decentralized", "position-only"}
        Position-only control has its own gains and a fixed co-contraction instead of the tension loop.
    tension_law : {"agent", "eq6", "eq6-printed"}

    Returns
    -------
    ndarray of `PARAMETERS`, shape (1,)

    Raises
    ------
    AmulettError
        If a name is unknown.
    """
    if control not in CONTROLS:
        raise unknown("control", control, CONTROLS)
    if tension_law not in TENSION_LAWS:
        raise unknown("tension law", tension_law, TENSION_LAWS)
    plant, drives, sensors, loop = profile.plant, profile.drives, profile.sensors, profile.loop
    tables = build_tables(profile.spring)
    position_only = control == "position-only"
    shifted = profile.damping.b * profile.damping.c if profile.damping.fit == "shifted" else profile.damping.c
    values = {
        "drive_radius": plant.drive_pulley_radius,
        "joint_radius": plant.joint_pulley_radius,
        "angle_limit": np.radians(plant.angle_limit_deg),
        "velocity_limit": np.radians(plant.velocity_limit_deg),
        "force_table": tables.force,
        "spring_table": tables.spring_deflection,
        "estimate_table": tables.estimated_force,
        "inverse_max_deflection": 1.0 / tables.max_deflection,
        "max_spring_deflection": tables.max_spring_deflection,
        "damping_a": profile.damping.a,
        "damping_b": profile.damping.b,
        "damping_c": shifted,
        "damping_d": profile.damping.d,
        "damping_by_mean": profile.damping.preload == "mean",
        "inverse_lag": 1.0 / drives.lag if drives.lag > 0 else 0.0,
        "rate_limit": np.inf if drives.rate_limit_deg is None else np.radians(drives.rate_limit_deg),
        "command_limit": np.inf if drives.command_limit_deg is None else np.radians(drives.command_limit_deg),
        "encoder_resolution": 2 * np.pi / 2**sensors.encoder_bits if sensors.encoder_bits else 0.0,
        "encoder_noise": np.radians(sensors.encoder_noise_deg),
        "slider_resolution": sensors.potentiometer_travel / 2**sensors.potentiometer_bits
        if sensors.potentiometer_bits
        else 0.0,
        "slider_travel": sensors.potentiometer_travel,
        "slider_noise": sensors.potentiometer_noise,
        "slider_end": slider_end(profile, tables.max_spring_deflection),
        "force_filter": sensors.force_filter,
        "force_floor": sensors.force_floor,
        "below_floor": _BELOW_FLOOR[sensors.below_floor],
        "control_period": loop.control_period,
        "substeps": loop.substeps,
        **_gains("position", loop.position_only if position_only else loop.position, 1.0),
        **_gains("tension", loop.tension, np.radians(1.0)),
        "tension_loop": not position_only,
        "antagonist_share": 1.0 if position_only or loop.wiring == "sum" else 0.0,
        "position_only_offset": np.radians(loop.offset_deg),
        "fixed_agonist": _AGONIST[loop.agonist],
        "switch_filter": loop.switch_filter,
        "switch_hysteresis": loop.switch_hysteresis,
        "tie_width": loop.tie_width,
        "tie_error": np.radians(loop.tie_error_deg),
        "velocity_filter": loop.velocity_filter,
        "nominal_tension": profile.variable_stiffness.nominal_tension,
        "minimum_tension": profile.variable_stiffness.minimum_tension,
        "error_offset": np.radians(profile.variable_stiffness.error_offset_deg),
        "law": TENSION_LAWS[tension_law],
        "margin": np.radians(2.0),
    }
    record = np.zeros(1, dtype=PARAMETERS)
    for name in PARAMETERS.names or ():
        record[name] = values[name]
    return record


def slider_end(profile: Profile, max_spring_deflection: float) -> float:
    """Return the reading [m] from which on a potentiometer may be at its end: that of the table or of its travel.

    Noise, which is bounded (`simulation.random.noise`), and rounding may let it read that much less.
    """
    sensors = profile.sensors
    resolution = sensors.potentiometer_travel / 2**sensors.potentiometer_bits if sensors.potentiometer_bits else 0.0
    doubt = max(resolution + 3.5 * sensors.potentiometer_noise, 1e-6 * max_spring_deflection)
    return min(max_spring_deflection, sensors.potentiometer_travel) - doubt


def load_arm(rows: NDArray[np.void], profile: Profile) -> None:
    """Set what follows from a scenario's load: J and M_m of eqs. 2-3 and how much friction decelerates.

    M_m is 0 in the horizontal plane. The damping fit holds for the bare arm; where the profile keeps the damping
    *torque*, a payload does not multiply it.

    Parameters
    ----------
    rows : ndarray of `SCENARIO`
        `orientation`, the payload and the device's factors are read.
    profile : Profile
    """
    carried = rows["payload_mass"] > 0
    masses: list[Numbers] = [item.mass for item in profile.plant.masses]
    arms: list[Numbers] = [item.arm for item in profile.plant.masses]
    bare = inertia(masses, arms)
    masses.append(rows["payload_mass"])
    arms.append(np.where(carried, rows["payload_arm"], 0.0))
    vertical = rows["orientation"] == ORIENTATIONS.index("vertical")
    if profile.plant.orientation == "vertical":
        vertical |= rows["orientation"] == ORIENTATIONS.index("profile")
    loaded = inertia(masses, arms)
    rows["inertia"] = loaded * rows["inertia_factor"]
    rows["static_torque"] = np.where(vertical, static_torque(masses, arms), 0.0)
    share = bare / rows["inertia"] if profile.damping.keeps == "torque" else 1.0
    rows["friction"] = rows["damping_factor"] * share


def _gains(name: str, pid: Pid, unit: float) -> dict[str, float]:
    return {
        f"{name}_kp": pid.kp * unit,
        f"{name}_ki": pid.ki * unit,
        f"{name}_kd": pid.kd * unit,
        f"{name}_filter": pid.derivative_filter,
        f"{name}_on_error": pid.derivative_on == "error",
    }
