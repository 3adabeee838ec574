"""Look-up tables of the non-linear spring assembly in each string (Figure 5a).

The string pulls on a node between two equal linear springs. Unloaded, the springs are perpendicular to the string, each
`half_width` long. A string deflection y stretches them to sqrt(half_width^2 + y^2), and their force along the string
is ::

    f(y) = 2 k y (1 - free_length / sqrt(half_width^2 + y^2))

which is progressive: slope 2 k (1 - free_length/half_width) at rest, 2 k for large y. The potentiometer measures the
stretch of a linear spring, sqrt(half_width^2 + y^2) - half_width. Near rest that grows with y squared only, so small
forces can hardly be estimated: the rising error at low forces of Figure 5b.

The tables are uniform and interpolated by monotone cubics (PCHIP). A slack string (y < 0) has no force. Beyond the
table's end the force is constant, or what the profile says (`Spring.beyond`, here `Continuation`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.jit.compiled import compiled
from amulett_gym.model import cubics
from amulett_gym.profile import Spring

CELLS = 256


class Continuation(NamedTuple):
    """What follows the tables' end, x = 1 in units of their range.

    The force rises by g(x) - g(1) with g(x) = slope x (1 - free_length / sqrt(width^2 + x^2)), the linear spring's
    deflection by h(x) - h(1) with h(x) = slider sqrt(width^2 + x^2). That is the geometric model, a straight line where
    `free_length` and `width` are 0, and constant where `slope` and `slider` are.
    """

    slope: float = 0.0  # [N]
    free_length: float = 0.0  # [1]
    width: float = 0.0  # [1]
    slider: float = 0.0  # [m]


HELD = Continuation()
"""The force stays that of the table's end."""


@dataclass(frozen=True)
class SpringTables:
    """Look-up tables of one spring assembly: cubic coefficients of each cell, shape (256, 4).

    Attributes
    ----------
    force, spring_deflection : ndarray
        String force [N] and linear spring's deflection [m], which the potentiometer measures, over the string
        deflection.
    estimated_force : ndarray
        The force over the *square root* of the linear spring's deflection: the microcontroller's table.
    estimated_slope : ndarray
        The slope of the force by the string deflection [N/m] over the same square root.
    max_deflection, max_spring_deflection : float
        String deflection and linear spring's deflection at the tables' end [m].
    beyond : Continuation
        What follows the tables' end.
    """

    force: NDArray[np.float64]
    spring_deflection: NDArray[np.float64]
    estimated_force: NDArray[np.float64]
    estimated_slope: NDArray[np.float64]
    max_deflection: float
    max_spring_deflection: float
    beyond: Continuation = HELD

    @property
    def max_force(self) -> float:
        """Force at the table's end [N], at which the assembly saturates if the force is held beyond."""
        return float(look_up(self.force, 1.0))

    @cached_property
    def position(self) -> NDArray[np.float64]:
        """Coefficients of the inverse of `force`: the position in it, 0 to 1, shape (256, 4).

        It is over the *fourth root* of the force as a share of the largest one: near rest a force may grow with the
        third power of the deflection. Computed when first asked for: the paper's loop does not need it.
        """
        rising = np.linspace(0.0, 1.0, CELLS + 1) ** 4 * look_up(self.force, 1.0)
        table = _coefficients(np.array([0.0, *(inverse_look_up(self.force, value) for value in rising[1:])]))
        table.flags.writeable = False
        return table

    @property
    def max_stiffness(self) -> float:
        """Steepest slope of the force between two of the table's knots, or beyond its end [N/m]."""
        return max(steepest_slope(self.force), self.beyond.slope) / self.max_deflection

    def force_at(self, deflection: float) -> float:
        """Return f(Delta l) [N] at a string deflection [m]."""
        position = deflection / self.max_deflection
        slope, free_length, width, _ = self.beyond
        return float(look_up(self.force, position) + force_beyond(position, slope, free_length, width))

    def stiffness_at(self, deflection: float) -> float:
        """Return the slope of f [N/m] at a string deflection [m]; 0 in a slack string."""
        position = deflection / self.max_deflection
        slope, free_length, width, _ = self.beyond
        slopes = look_up_slope(self.force, position) + slope_beyond(position, slope, free_length, width)
        return float(slopes / self.max_deflection)

    def deflection_at(self, force: float) -> float:
        """Return the string deflection [m] at a force [N]: the inverse of `force_at`.

        Raises
        ------
        AmulettError
            If the force is negative or more than `max_force`, whatever follows the table's end.
        """
        if not 0.0 <= force <= self.max_force:
            raise AmulettError(f"a string force of {force} N is outside what the springs give: 0 to {self.max_force} N")
        return float(inverse_look_up(self.force, force) * self.max_deflection)


def steepest_slope(table: NDArray[np.float64]) -> float:
    """Return the steepest slope of a table's value by position, at its knots."""
    return float(max(table[:, 1].max(), (table @ [0.0, 1.0, 2.0, 3.0]).max())) * len(table)


def assembly_curve(spring: Spring, deflection: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the geometric model's string force [N] and linear spring deflection [m] at string deflections [m]."""
    length = np.hypot(spring.half_width, deflection)
    return 2 * spring.stiffness * deflection * (1 - spring.free_length / length), length - spring.half_width


def build_tables(spring: Spring) -> SpringTables:
    """Build the look-up tables of a spring assembly: from its measured curve if it has one, else from its geometry."""
    if spring.measured_curve is None:
        geometry = spring.stiffness, spring.half_width, spring.free_length, spring.max_deflection
        return _geometric_tables(*geometry, spring.beyond, spring.stop_stiffness)
    curve = spring.measured_curve
    columns = (curve.deflection_m, curve.force_N, curve.spring_deflection_m or curve.deflection_m)
    start = [0.0] if curve.deflection_m[0] > 0.0 else []
    measured, measured_force, measured_spring = (np.array(start + column) for column in columns)
    deflection = np.linspace(0.0, measured[-1], CELLS + 1)
    laws = tuple(cubics.monotone(measured, values) for values in (measured_force, measured_spring))
    tables = _tables(deflection, *(cubics.value(measured, law, deflection) for law in laws))
    slope, slider = (float(measured[-1] * cubics.slope(measured, law, measured[-1:])[0]) for law in laws)
    return replace(tables, beyond=_continuation(spring, tables, Continuation(slope=slope, slider=slider)))


@lru_cache(maxsize=16)  # a step response takes less time than its tables
def _geometric_tables(
    stiffness: float,
    half_width: float,
    free_length: float,
    max_deflection: float,
    beyond: Literal["continued", "hard-stop"] | None,
    stop_stiffness: float | None,
) -> SpringTables:
    spring = Spring(
        stiffness=stiffness,
        half_width=half_width,
        free_length=free_length,
        max_deflection=max_deflection,
        beyond=beyond,
        stop_stiffness=stop_stiffness,
    )
    deflection = np.linspace(0.0, max_deflection, CELLS + 1)
    tables = _tables(deflection, *assembly_curve(spring, deflection))
    law = Continuation(
        2.0 * stiffness * max_deflection, free_length / max_deflection, half_width / max_deflection, max_deflection
    )
    return replace(tables, beyond=_continuation(spring, tables, law))


def _continuation(spring: Spring, tables: SpringTables, law: Continuation) -> Continuation:
    """Return what follows the tables' end; `law` is the spring's own."""
    if spring.beyond == "continued":
        return law
    return Continuation(slope=(spring.stop_stiffness or 0.0) * tables.max_deflection)


def _tables(
    deflection: NDArray[np.float64], force: NDArray[np.float64], spring_deflection: NDArray[np.float64]
) -> SpringTables:
    root = np.sqrt(spring_deflection)
    uniform_root = np.linspace(0.0, root[-1], CELLS + 1)
    forces = _coefficients(force)
    slope = np.append(forces[:, 1], forces[-1] @ [0.0, 1.0, 2.0, 3.0]) * CELLS / deflection[-1]
    tables = SpringTables(
        force=forces,
        spring_deflection=_coefficients(spring_deflection),
        estimated_force=_coefficients(cubics.value(root, cubics.monotone(root, force), uniform_root)),
        estimated_slope=_coefficients(cubics.value(root, cubics.monotone(root, slope), uniform_root)),
        max_deflection=float(deflection[-1]),
        max_spring_deflection=float(spring_deflection[-1]),
    )
    for table in (tables.force, tables.spring_deflection, tables.estimated_force, tables.estimated_slope):
        table.flags.writeable = False  # shared by all devices with this spring
    return tables


@compiled
def _cell(table: NDArray[np.float64], position: float) -> tuple[np.uint64, float]:
    """Return the cell of a table at `position`, 0 to 1, and the place in the cell, 0 to 1."""
    cells = table.shape[0]
    scaled = position * cells
    cell = min(int(scaled), cells - 1)
    return np.uint64(cell), scaled - cell  # unsigned: numba checks whether a signed index is negative


@compiled
def look_up(table: NDArray[np.float64], position: float) -> float:
    """Return a table's value at `position`, 0 at its start and 1 at its end; constant beyond both."""
    cell, w = _cell(table, min(max(position, 0.0), 1.0))
    return table[cell, 0] + w * (table[cell, 1] + w * (table[cell, 2] + w * table[cell, 3]))


@compiled
def look_up_slope(table: NDArray[np.float64], position: float) -> float:
    """Return the slope of a table's value by `position`; zero beyond both ends."""
    if position < 0.0 or position > 1.0:
        return 0.0
    cell, w = _cell(table, position)
    return (table[cell, 1] + w * (2.0 * table[cell, 2] + w * 3.0 * table[cell, 3])) * table.shape[0]


@compiled
def look_up_curve(table: NDArray[np.float64], position: float) -> tuple[float, float, float]:
    """Return a table's value, its slope and its curvature by `position`; beyond both ends, those at the end."""
    cells = table.shape[0]
    cell, w = _cell(table, min(max(position, 0.0), 1.0))
    value = table[cell, 0] + w * (table[cell, 1] + w * (table[cell, 2] + w * table[cell, 3]))
    slope = table[cell, 1] + w * (2.0 * table[cell, 2] + w * 3.0 * table[cell, 3])
    return value, slope * cells, (2.0 * table[cell, 2] + w * 6.0 * table[cell, 3]) * (cells * cells)


@compiled
def force_beyond(position: float, slope: float, free_length: float, width: float) -> float:
    """Return the force [N] that a string has in addition to the table's value: 0 up to its end (`Continuation`)."""
    x = max(position, 1.0)
    end = slope * (1.0 - free_length / math.sqrt(width * width + 1.0))
    return slope * x * (1.0 - free_length / math.sqrt(width * width + x * x)) - end


@compiled
def slope_beyond(position: float, slope: float, free_length: float, width: float) -> float:
    """Return the slope of `force_beyond` by `position` [N]; 0 up to the table's end."""
    if position <= 1.0:
        return 0.0
    square = width * width + position * position
    return slope * (1.0 - free_length * width * width / (square * math.sqrt(square)))


@compiled
def slider_beyond(position: float, slider: float, width: float) -> float:
    """Return the deflection of a linear spring [m] in addition to the table's value (`Continuation`)."""
    x = max(position, 1.0)
    return slider * (math.sqrt(width * width + x * x) - math.sqrt(width * width + 1.0))


@compiled
def inverse_look_up(table: NDArray[np.float64], value: float) -> float:
    """Return the position (0 to 1) at which a rising table has `value`, by bisection to the last bit."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if look_up(table, middle) < value:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled
def find_position(force_table: NDArray[np.float64], position_table: NDArray[np.float64], force: float) -> float:
    """Return the position (0 to 1) at which the force table has `force` [N], limited to what it has.

    The inverse table's value with one Newton step: to 1e-9 of the range for the shipped springs, in a tenth of the time
    of `inverse_look_up`.
    """
    share = _force_share(force_table, force)
    return _refined(force_table, _rough_position(position_table, share), share)


@compiled
def find_positions(
    force_table: NDArray[np.float64], position_table: NDArray[np.float64], first: float, second: float
) -> tuple[float, float]:
    """Return the positions at two forces [N] (`find_position`).

    Side by side they are found in less time than one after the other: each waits for roots, tables and quotients.
    """
    first_share, second_share = _force_share(force_table, first), _force_share(force_table, second)
    first_position = _rough_position(position_table, first_share)
    second_position = _rough_position(position_table, second_share)
    first_position = _refined(force_table, first_position, first_share)
    return first_position, _refined(force_table, second_position, second_share)


@compiled
def _force_share(force_table: NDArray[np.float64], force: float) -> float:
    """Return a force [N] as a share of the table's largest, limited to what it has."""
    return min(max(force / look_up(force_table, 1.0), 0.0), 1.0)


@compiled
def _rough_position(position_table: NDArray[np.float64], share: float) -> float:
    """Return the inverse table's position at a share of the largest force."""
    return look_up(position_table, math.sqrt(math.sqrt(share)))


@compiled
def _refined(force_table: NDArray[np.float64], position: float, share: float) -> float:
    """Return a position after a Newton step towards a share of the largest force."""
    value, slope, _ = look_up_curve(force_table, position)
    inside = 0.0 <= position <= 1.0  # a table's end can be off by a rounding
    step = (share * look_up(force_table, 1.0) - value) / slope  # not in a branch, in which the value would wait
    step = step if inside and slope > 0.0 else 0.0
    most_step = 1.0 / force_table.shape[0]
    return min(max(position + min(max(step, -most_step), most_step), 0.0), 1.0)


@compiled
def estimate_force(table: NDArray[np.float64], spring_deflection: float, max_spring_deflection: float) -> float:
    """Return the string force [N] that the microcontroller's table gives for a measured spring deflection [m].

    Any table over the square root of the spring deflection can be read so.
    """
    return look_up(table, math.sqrt(max(spring_deflection, 0.0) / max_spring_deflection))


def _coefficients(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return PCHIP coefficients (constant term first) over cells of width 1."""
    return cubics.monotone(np.arange(values.size, dtype=float), values)
