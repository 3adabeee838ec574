"""The cost of a set of parameters in the identification: how far Tables 2-5 are from what its devices do.

The rows of a parameter set become residuals in units of each row's bound, and these a cost that rows out of reach
cannot dominate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from amulett_gym.errors import AmulettError
from amulett_gym.identification.parameters import Values, allowed, devices, pack, searched, unpack
from amulett_gym.identification.search import Cost
from amulett_gym.studies.paper.reproduction import BOUNDS, MEASUREMENT_TIME, Readings, Row, compare, measure
from amulett_gym.studies.paper.tables import PROTOCOL, TABLES_2_TO_5

SIMULATED = {"simulation": 2.0, "testbed": MEASUREMENT_TIME}
"""T in the search [s]: the simulation is at rest after a second."""

WEIGHTS = {"rise_time": 1.0, "position_ise": 2.0, "tension_ise": 1.0, "isav": 0.5}
"""Weight of a row in the cost. Position ISE depends on no margin, estimate or unit; the unit of ISAV is not printed."""

OUT_OF_REACH = 60.0
"""Residual of a row that does not exist, because the device failed."""

ROBUST = 0.1
"""Weight of the part of the cost that grows without bound, so that it has a slope for rows far off."""

SELECTION_KEY, SELECTION_REPETITIONS = 1001, 40
"""First key and number of the noise by which a set is chosen; no reported number uses it."""


def reproduced(
    parameters: Mapping[str, float],
    readings: Readings,
    repetitions: int = PROTOCOL.repetitions_testbed,
    duration: Mapping[str, float] | None = None,
    first_key: int = 1,
) -> tuple[Row, ...]:
    """Return the rows of Tables 2-5 for a set of parameters (see `reproduction.measure`).

    Raises AmulettError if a device cannot hold a posture at which a configuration starts.
    """
    found = devices(parameters, readings.spring_end)
    return compare(measure(found, readings, repetitions, duration, first_key), readings)


def residual(row: Row) -> float:
    """Return log(ours / paper) in units of the row's bound: up to 1 it is explained."""
    bound = math.log(BOUNDS[row.cell.metric, row.cell.profile][1])
    if row.failed:
        return OUT_OF_REACH
    ours = SIMULATED[row.cell.profile] if row.ours is None else max(row.ours, 1e-6)
    return float(np.clip(math.log(ours / row.cell.value) / bound, -OUT_OF_REACH, OUT_OF_REACH))


def cost(residuals: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Return a smooth, weighted count of the rows that are out of their bounds."""
    squares = np.square(residuals)
    costs = np.log1p(squares**2) + ROBUST * np.log1p(squares)
    return float(np.dot(costs, np.ones_like(squares) if weights is None else weights))


def objective(readings: Readings, without: str | None = None, loop: bool = True) -> Cost:
    """Return the cost as a function of the search vector.

    `without` leaves out one configuration, on both devices; without `loop` the testbed's loop is that of its profile.
    """
    free = searched(readings.spring_end, loop)

    def value(vector: Values) -> float:
        worst = cost([OUT_OF_REACH] * len(TABLES_2_TO_5))
        if not allowed(vector, free):
            return worst
        try:
            rows = reproduced(unpack(vector, free), readings, 1, SIMULATED)
        except AmulettError:  # springs too weak for a starting posture
            return worst
        seen = [row for row in rows if row.cell.configuration != without]
        return cost([residual(row) for row in seen], [WEIGHTS[row.cell.metric] for row in seen])

    return value


def most_explained(readings: Readings, members: Sequence[Mapping[str, float]]) -> tuple[int, float, dict[str, float]]:
    """Return the number of rows explained, the cost, and the parameters of the set that explains most rows.

    Among several it is the one of least cost. The rows are means over more repetitions than the reported ones, and over
    other ones, so that the choice does not bias the report.
    """
    value = objective(readings)
    ranked = []
    for member in members:
        rows = reproduced(member, readings, SELECTION_REPETITIONS, first_key=SELECTION_KEY)
        ranked.append((-sum(row.explained for row in rows), value(pack(member)), dict(member)))
    count, least, parameters = min(ranked, key=lambda entry: entry[:2])
    return -count, least, parameters
