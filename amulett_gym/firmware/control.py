"""A control loop of the literature as C: which texts it needs, and its numbers, ``loop_tables.h``."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.numbers import array, defines, initialiser
from amulett_gym.firmware.toolchain import FREQUENCY
from amulett_gym.model.damping import decay_rate
from amulett_gym.model.spring import estimate_force, find_position, look_up, look_up_curve
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import CONTROLS, LOOP_PARAMETERS, LOOPS, Control, pack_loop, pack_parameters

TABLES = "loop_tables.h"
"""The generated file."""

_COMMON = ("loops.h", "loop_springs.h", "loop_motion.h")
_OWN: Mapping[Control, str] = {
    "equilibrium-point": "loop_feed_forward.h",
    "co-rotation": "loop_feed_forward.h",
    "torque-stiffness": "loop_stiffness.h",
    "feedforward-feedback": "loop_stiffness.h",
    "feedback-linearisation": "loop_observed.h",
    "torque": "loop_observed.h",
    "cascade": "loop_feed_forward.h",
    "computed-torque": "loop_computed_torque.h",
    "minimal-motion": "loop_computed_torque.h",
}
LOOP_FILES = (*_COMMON, *sorted(set(_OWN.values())), TABLES)
"""All files that a loop may add to a folder."""

APART = 0.1
"""A command of the 32-bit build may differ by this [rad] in a tick: where a motion of the reference begins or ends."""

CYCLES: Mapping[Control, int] = {
    "decentralized": 11_400,
    "position-only": 11_400,
    "equilibrium-point": 22_600,
    "co-rotation": 24_900,
    "torque-stiffness": 61_900,
    "feedforward-feedback": 66_800,
    "feedback-linearisation": 43_200,
    "torque": 44_000,
    "cascade": 26_500,
    "computed-torque": 29_800,
    "minimal-motion": 62_900,
}
"""Cycles of an ATmega2560 in a control tick with eq. 6, the most of those measured with simavr in a run of `mixed`."""

SHARE = 0.8
"""Of a control period that loop and law may take."""

_BY_FORCE: tuple[Control, ...] = ("feedback-linearisation", "torque")  # they estimate string forces themselves
_BY_SLOPE: tuple[Control, ...] = ("feedforward-feedback",)  # it estimates the joint stiffness

FORCE_LINES, POSITION_LINES, DECAY_LINES = 512, 1024, 256
"""Lines of the 32-bit build's tables: off by 2e-5 N and 3e-7 for the shipped springs."""

_DECAYS = "#ifdef CONTROLLER_DOUBLE\n#define DECAYS\n#else\n#define DECAYS .decay_table = decay_table,\n#endif\n\n"

_NO_GAINS = (
    *("loop", "reference_shape", "force_table", "position_table", "slope_table"),
    *("integral_weight", "angle_weight", "rate_weight", "torque_weight"),  # the regulator's gains follow from them
)


def loop_texts(control: Control) -> tuple[str, ...]:
    """Return the files of `amulett_gym.c` that a loop needs beside ``loop.h``; none for the paper's."""
    return (*_COMMON, _OWN[control]) if control in _OWN else ()


def left_for_law(control: Control, period: float) -> int:
    """Return the cycles that a loop leaves for its law in a control period [s], negative if it takes too long alone."""
    return int(SHARE * period * FREQUENCY) - CYCLES[control]


def check_cycles(control: Control, period: float, law: int = 0) -> None:
    """Raise an AmulettError if a loop and `law` cycles more take too long for a control period [s]."""
    if left_for_law(control, period) < law:
        cycles, alone = CYCLES[control] + law, f" and {law} for its law" if law else ""
        raise AmulettError(
            f"the loop '{control}' takes up to {CYCLES[control]} cycles of an ATmega2560 in a control tick{alone}; "
            f"a period of {1000.0 * period:g} ms leaves {SHARE * period * FREQUENCY:.0f}, {SHARE:.0%} of it. Choose a "
            f"faster loop, such as '{CONTROLS[0]}', or a loop.control_period of at least "
            f"{math.ceil(1e5 * cycles / (SHARE * FREQUENCY)) / 100:g} ms"
        )


def loop_numbers(profile: Profile, control: Control) -> str:
    """Return the lines of ``device.h`` with the loop's index and gains; empty for the paper's."""
    if control not in LOOPS:
        return ""
    record = pack_loop(profile, control)[0]
    tables = {"force_table": "string_table", "position_table": "position_table"}
    if control in _BY_FORCE:
        tables["estimate_table"] = "estimate_table"
    gains = {name: float(record[name]) for name in LOOP_PARAMETERS.names or () if name not in _NO_GAINS}
    gains = {name: value for name, value in gains.items() if value != 0.0}  # those left out are 0
    content = initialiser({**tables, **gains, "reference_shape": int(record["reference_shape"])})
    slopes = ""
    if control in _BY_SLOPE:
        slopes = "#ifdef FORCES\n#define SLOPES\n#else\n#define SLOPES .slope_table = slope_table,\n#endif\n\n"
    lines = {"FORCE_LINES": FORCE_LINES, "POSITION_LINES": POSITION_LINES, "DECAY_LINES": DECAY_LINES}
    return (
        f"{defines({'LOOP': int(record['loop']), **lines})}\n{_DECAYS}{slopes}"
        f"#define GAINS \\\n    DECAYS {'SLOPES ' * bool(slopes)}{content}\n\n"
    )


def loop_tables(profile: Profile, control: Control, readings: NDArray[np.float64] | None) -> str:
    """Return ``loop_tables.h``: the springs' force and its inverse, and the slope over a slider's reading.

    `readings` [m] are those of a slider's counts, if the firmware has tables by count.
    """
    loop, device = pack_loop(profile, control)[0], pack_parameters(profile, control)[0]
    force, position = np.asarray(loop["force_table"]), np.asarray(loop["position_table"])
    parts = [
        '/* Generated: the springs for a loop. */\n\n#include "flash.h"\n',
        "/* String force [N] over the deflection's share, and that share over the fourth root of the force's. */",
        "#ifdef CONTROLLER_DOUBLE /* cubics over 256 cells, the constant term first */",
        array("table_real", "string_table", force),
        array("table_real", "position_table", position),
        "#else /* at knots, the force with its slope */",
        array("table_real", "string_table", _force_knots(force)),
        array("table_real", "position_table", _position_knots(force, position)),
        "/* Decay rate [1/s] over the preload's share of the largest force. */",
        array("table_real", "decay_table", _decay_knots(device, float(loop["max_force"]))),
        "#endif\n",
    ]
    if control in _BY_SLOPE:
        slopes = np.asarray(loop["slope_table"])
        cubics = array("table_real", "slope_table", slopes)
        parts.append("/* Slope of the force [N/m] over a slider's reading. */")
        if readings is None:
            parts.append(cubics)
        else:
            end = float(device["max_spring_deflection"])
            counts = np.array([estimate_force(slopes, reading, end) for reading in readings])
            by_count = array("table_real", "slope_table", counts.astype(np.float32))
            parts.append(f"#ifdef FORCES /* by count */\n{by_count}#else\n{cubics}#endif")
    return "\n".join([*parts, ""])


def _force_knots(force: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the force and its slope by position at the knots of the 32-bit build, shape (knots, 2)."""
    rows = [look_up_curve(force, position)[:2] for position in np.linspace(0.0, 1.0, FORCE_LINES + 1)]
    return np.array(rows, dtype=np.float32)


def _position_knots(force: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the position over the fourth root of the force as a share of the largest, at the 32-bit build's knots."""
    forces = np.linspace(0.0, 1.0, POSITION_LINES + 1) ** 4 * look_up(force, 1.0)
    return np.array([find_position(force, position, value) for value in forces], dtype=np.float32)


def _decay_knots(device: np.void, max_force: float) -> NDArray[np.float32]:
    """Return the decay rate at the 32-bit build's knots."""
    constants = [float(device[f"damping_{name}"]) for name in "abcd"]
    preloads = np.linspace(0.0, max_force, DECAY_LINES + 1)
    return np.array([decay_rate(preload, *constants) for preload in preloads], dtype=np.float32)
