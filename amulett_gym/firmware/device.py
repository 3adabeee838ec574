"""A profile with its loop as numbers of the firmware: ``device.h`` and ``tables.h``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.control import loop_numbers
from amulett_gym.firmware.numbers import array, defines, initialiser
from amulett_gym.model.spring import estimate_force
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import pack_parameters

MOST_TICKS = 65_535
"""Control ticks of an agent period, which the firmware counts in 16 bits."""

LEAST_RANGE = 0.01
"""Least range of an action [N]."""

MOST_BITS = 24
"""Of a converter: its counts are exact as 32-bit floating-point numbers."""

LET_GO_RATE = 1.0
"""Rate at which the strings are let go [rad/s]: less than half a second for the shipped springs."""

_BEYOND = math.radians(10.0)
"""A joint angle may be read this far beyond the profile's limit [rad]."""

_MOST_COUNTS = 2048  # of a slider for which forces are tabled count by count

_FORCES = """#if {few} && !defined CONTROLLER_DOUBLE /* string forces count by count */
#define FORCES
#define ESTIMATES
#else
#define ESTIMATES .estimate_table = estimate_table,
#endif

"""

FIELDS = (
    "max_spring_deflection",
    "command_limit",
    "slider_end",
    "force_filter",
    "force_floor",
    "control_period",
    "position_kp",
    "position_ki",
    "position_kd",
    "position_filter",
    "tension_kp",
    "tension_ki",
    "tension_kd",
    "tension_filter",
    "antagonist_share",
    "position_only_offset",
    "fixed_agonist",
    "switch_filter",
    "switch_hysteresis",
    "tie_width",
    "tie_error",
    "velocity_filter",
    "nominal_tension",
    "minimum_tension",
    "error_offset",
    "drive_radius",
    "joint_radius",
    "damping_a",
    "damping_b",
    "damping_c",
    "damping_d",
    "below_floor",
    "position_on_error",
    "tension_on_error",
    "tension_loop",
    "law",
    "damping_by_mean",
)
"""What the firmware's loop reads of `layout.PARAMETERS`, by the same names, in addition to the estimates' table."""


def device_header(profile: Profile, settings: Settings, law: Mapping[str, float | int]) -> str:
    """Return ``device.h``: the numbers of sensors, loop and law.

    Raises
    ------
    AmulettError
        If a converter has too many bits, an agent period too many control ticks, or actions too narrow a range.
    """
    record = pack_parameters(profile, settings.control, settings.tension_law)[0]
    low, high = settings.tension_range
    if high - low < LEAST_RANGE:
        raise AmulettError(
            f"tension_range is from {low!r} to {high!r} N; the firmware computes in 32 bits and needs {LEAST_RANGE:g} N"
        )
    ticks = settings.ticks(profile)
    if ticks > MOST_TICKS:
        raise AmulettError(
            f"agent_period is {settings.agent_period} s, {ticks} control ticks; the firmware counts {MOST_TICKS}"
        )
    values = {
        "CONTROL_PERIOD": record["control_period"],
        "CONTROL_TICKS_US": round(1e6 * float(record["control_period"])),
        **sensor_numbers(profile, record),
        "SETPOINT_MOST": record["angle_limit"],
        "COMMAND_LIMIT": record["command_limit"],
        "LET_GO_RATE": LET_GO_RATE,
        **{f"OBSERVED_{name.split('_')[-1].upper()}": scale for name, scale in _scales().items()},
        "LAW_TICKS": ticks,
        "LAW_DELAY": settings.action_delay,
        "LAW_LOW": low,
        "LAW_HIGH": high,
        **law,
    }
    parameters = {name: _plain(record[name]) for name in FIELDS}
    forces = _FORCES.format(few=int(_has_few_counts(record)))
    return (
        "/* Generated: the numbers of device, loop and law in SI units and rad. */\n\n"
        "#ifndef DEVICE_H\n#define DEVICE_H\n\n"
        f"{defines(values)}\n{forces}#define PARAMETERS \\\n    ESTIMATES {initialiser(parameters)}\n\n"
        f"{loop_numbers(profile, settings.control)}#endif\n"
    )


def tables_header(profile: Profile, settings: Settings) -> str:
    """Return ``tables.h``: the string force over the sliders' reading, by cubics or count by count."""
    record = pack_parameters(profile, settings.control, settings.tension_law)[0]
    cubics = array("table_real", "estimate_table", np.asarray(record["estimate_table"]))
    head = '/* Generated: the string force [N] over a slider\'s reading. */\n\n#include "flash.h"\n\n'
    over_root = "/* Cubics over 256 cells of the square root of the reading's share, the constant term first. */\n"
    readings = slider_readings(profile, record)
    if readings is None:
        return f"{head}{over_root}{cubics}"
    table, end = np.asarray(record["estimate_table"]), float(record["max_spring_deflection"])
    forces = np.array([estimate_force(table, reading, end) for reading in readings])
    return (
        f"{head}#ifdef FORCES\n/* By count. */\n{array('table_real', 'force_table', forces.astype(np.float32))}#endif\n"
        f"#if !defined FORCES || defined LOOP\n{over_root}{cubics}#endif\n"
    )


def sensor_numbers(profile: Profile, record: NDArray[np.void] | np.void) -> dict[str, float | int]:
    """Return what a count of each sensor means, and its largest one."""
    sensors = profile.sensors
    for key in ("encoder_bits", "potentiometer_bits"):
        if (bits := getattr(sensors, key)) > MOST_BITS:
            raise AmulettError(f"sensors.{key} is {bits}; the firmware reads converters of at most {MOST_BITS} bit")
    angle, slider = float(record["encoder_resolution"]), float(record["slider_resolution"])
    farthest, travel = float(record["angle_limit"]) + _BEYOND, float(record["slider_travel"])
    return {
        "ENCODER_EXACT": int(angle == 0.0),
        "ENCODER_RESOLUTION": angle or 1.0,
        "ENCODER_MOST": math.ceil(farthest / angle) if angle else farthest,
        "SLIDER_EXACT": int(slider == 0.0),
        "SLIDER_RESOLUTION": slider or 1.0,
        "SLIDER_MOST": math.floor(travel / slider + 0.5) if slider else travel,
    }


def slider_readings(profile: Profile, record: NDArray[np.void] | np.void) -> NDArray[np.float64] | None:
    """Return what a slider's counts mean [m], or None if they are too many for a table."""
    if not _has_few_counts(record):
        return None
    readings: NDArray[np.float64] = np.arange(sensor_numbers(profile, record)["SLIDER_MOST"] + 1, dtype=np.float64)
    return readings * float(record["slider_resolution"])


def _has_few_counts(record: NDArray[np.void] | np.void) -> bool:
    """Return whether the sliders have so few counts that a table has each one's force."""
    resolution = float(record["slider_resolution"])
    return resolution > 0.0 and float(record["slider_travel"]) / resolution <= _MOST_COUNTS


def _scales() -> dict[str, float]:
    names = {"position_error": "error", "joint_angle": "angle", "joint_velocity": "velocity"}
    names |= {"time_since_move": "time", "estimated_tension": "tension", "command": "command"}
    return {names[name]: scale for name, scale in OBSERVATION_SCALES.items()}


def _plain(value: Any) -> float | int:
    return int(value) if isinstance(value, np.integer) else float(value)
