"""Identification: which unprinted parameters reproduce Tables 2-5 on both devices, with one set of mechanics.

A search vector becomes two profiles, these become rows beside the paper's (`reproduction.measure`), and these become
residuals in units of what each row may be off by. Differential evolution from several seeds minimises a cost that rows
out of reach cannot dominate. What the tables do not determine shows in the *ensemble*: a random walk among all
parameter sets that are as good as the best.

R_2 is not searched. The equations stay the same when R_1, R_2, all lengths of the spring and J are scaled together at
the same forces, so no table can see it; it is set, and the others are identified for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import inertia
from amulett_gym.profile import STABLE_STEP, Profile, load_profile
from amulett_gym.studies.paper.reproduction import BOUNDS, MEASUREMENT_TIME, Readings, Row, compare, measure
from amulett_gym.studies.paper.tables import DEVICES, TABLES_2_TO_5

Values = NDArray[np.float64]

JOINT_PULLEY_RADIUS = 0.04
"""R_2 [m]; see above."""

MASS_ARM = 0.13
"""Lever arm of the one mass that stands for the arm [m]; the tables see J alone."""

SIMULATED = {"simulation": 2.0, "testbed": MEASUREMENT_TIME}
"""T in the search [s]: the simulation is at rest after a second."""

WEIGHTS = {"rise_time": 1.0, "position_ise": 2.0, "tension_ise": 1.0, "isav": 0.5}
"""What a row counts in the cost. Position ISE hangs on no margin, estimate or unit; the unit of ISAV is not printed."""

SWITCH_FILTER = 0.03
"""Time constant of the testbed's low-pass over the difference of both springs' readings [s]; no table sees it."""

SELECTION_KEY, SELECTION_REPETITIONS = 1001, 40
"""First key and number of the noise that the chosen set is chosen by: none that is reported."""

CERTAIN = 5.0
"""Standard deviations of its noise by which that difference has to differ from zero before the agonist switches."""

OUT_OF_REACH = 60.0
"""Residual of a row that does not exist, because the device failed."""

ROBUST = 0.1
"""Weight of the part of the cost that goes on growing for a row far off, so that the search knows where to go."""

EQUAL = 2.5
"""Sets whose cost is above the best one's by at most this are as good: independent starts end as far apart."""


@dataclass(frozen=True)
class Free:
    """A parameter to identify.

    Attributes
    ----------
    name : str
    low, high : float
        Bounds of the search.
    unit : str
        Empty if dimensionless.
    source : str
        Where the bounds come from.
    logarithmic : bool
        Whether the search moves in its logarithm.
    choices : tuple of float
        If not empty, the only values between the bounds that are allowed.
    """

    name: str
    low: float
    high: float
    unit: str
    source: str
    logarithmic: bool = True
    choices: tuple[float, ...] = ()


PARAMETERS = (
    Free("inertia", 3e-4, 1e-2, "kg m2", "J: a bare printed beam, to one with half a kilogram of motor and mount"),
    Free("radius_ratio", 0.2, 0.5, "", "R_1/R_2: 0.29 by the measured position ISEs without lag, more with lag"),
    Free("max_force", 10.05, 40.0, "N", "where the springs saturate: 10 N was held"),
    Free("max_deflection", 2e-3, 3e-2, "m", "string deflection there: an assembly the size of a hand"),
    Free(
        "width_ratio",
        0.15,
        1.5,
        "",
        "half width of the assembly over max_deflection: wider, the slider on a spring moves by less than 0.3 of the "
        "string's deflection",
    ),
    Free(
        "length_ratio", 0.0, 1.0, "", "free length of a linear spring over half width: 0 linear, 1 cubic at rest", False
    ),
    Free(
        "simulation.position_filter", 2e-4, 0.03, "s", "derivative filter: up to three times Simulink's default, 10 ms"
    ),
    Free("simulation.tension_filter", 1e-3, 0.05, "s", "derivative filter"),
    Free("simulation.force_filter", 1e-3, 0.3, "s", "the lag without which the tension loop is algebraic"),
    Free("testbed.lag", 3e-3, 0.3, "s", "a servo's, to that of a geared motor under load"),
    Free("testbed.rate_limit", 200.0, 2000.0, "deg/s", "a slow servo's, to that of a fast geared motor"),
    Free(
        "testbed.position_filter",
        2e-4,
        0.03,
        "s",
        "derivative filter: next to none, to what an encoder's noise asks for",
    ),
    Free("testbed.tension_filter", 2e-4, 0.1, "s", "derivative filter: the potentiometers are noisier"),
    Free("testbed.force_filter", 2e-3, 0.3, "s", "low-pass of the estimated force"),
    Free(
        "testbed.slider_noise",
        2e-5,
        2e-4,
        "m",
        "potentiometers: a bit, to a hundredth of their travel, beside two motors",
    ),
    Free(
        "testbed.control_period",
        2e-3,
        1e-2,
        "s",
        "what an Arduino Mega 2560 does with three sensors and two PIDs; an agent acts every 20 ms, a multiple of it",
        choices=(0.002, 0.0025, 0.004, 0.005, 0.01),
    ),
)
"""What the paper does not print and the tables might determine."""


@dataclass(frozen=True)
class Fit:
    """The outcome of one search.

    Attributes
    ----------
    cost : float
    parameters : dict of str to float
        By the names of `PARAMETERS`.
    population : ndarray, shape (candidates, parameters)
        Search vectors of the last generation, from which another search can go on.
    """

    cost: float
    parameters: dict[str, float]
    population: Values


def unpack(vector: Values) -> dict[str, float]:
    """Turn a search vector, whose numbers go from 0 to 1 between the bounds, into named parameters.

    Every vector gives devices that a profile allows: a lag too short for the control period is raised to the least one.
    """
    parameters = _unbounded(vector)
    return {**parameters, "testbed.lag": max(parameters["testbed.lag"], _least_lag(parameters))}


def allowed(vector: Values) -> bool:
    """Return whether `unpack` takes a vector as it is; one that it changes is no candidate of a search."""
    parameters = _unbounded(vector)
    return parameters["testbed.lag"] >= _least_lag(parameters)


def _least_lag(parameters: Mapping[str, float]) -> float:
    """Return the shortest lag of the testbed's drives [s] that its integration steps resolve."""
    return parameters["testbed.control_period"] / load_profile("testbed").loop.substeps / STABLE_STEP


def _unbounded(vector: Values) -> dict[str, float]:
    parameters = {}
    for free, place in zip(PARAMETERS, vector.tolist(), strict=True):
        if free.choices:
            parameters[free.name] = free.choices[min(int(place * len(free.choices)), len(free.choices) - 1)]
        elif free.logarithmic:
            parameters[free.name] = free.low * (free.high / free.low) ** place
        else:
            parameters[free.name] = free.low + (free.high - free.low) * place
    return parameters


def pack(parameters: Mapping[str, float]) -> Values:
    """Turn named parameters into a search vector, which `unpack` turns back."""
    vector = []
    for free in PARAMETERS:
        value = parameters[free.name]
        if free.choices:
            vector.append((free.choices.index(value) + 0.5) / len(free.choices))
        elif free.logarithmic:
            vector.append(math.log(value / free.low) / math.log(free.high / free.low))
        else:
            vector.append((value - free.low) / (free.high - free.low))
    return np.array(vector)


def profile_changes(parameters: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Return what a set of parameters changes in each device's profile, in the profile's own keys.

    Numbers have five significant digits, in the search too: what is written is what was found.
    """
    p = parameters
    deflection, force = p["max_deflection"], p["max_force"]
    half_width = p["width_ratio"] * deflection
    free_length = p["length_ratio"] * half_width
    shared = {
        "plant": {
            "masses": [{"mass": _digits(p["inertia"] / inertia([1.0], [MASS_ARM])), "arm": MASS_ARM}],
            "drive_pulley_radius": _digits(p["radius_ratio"] * JOINT_PULLEY_RADIUS),
            "joint_pulley_radius": JOINT_PULLEY_RADIUS,
        },
        "spring": {
            "stiffness": _digits(force / (2 * deflection * (1 - free_length / math.hypot(half_width, deflection)))),
            "half_width": _digits(half_width),
            "free_length": _digits(free_length),
            "max_deflection": _digits(deflection),
        },
    }
    changes: dict[str, dict[str, Any]] = {}
    for device in DEVICES:
        position = {"derivative_filter": _digits(p[f"{device}.position_filter"])}
        tension = {"derivative_filter": _digits(p[f"{device}.tension_filter"])}
        changes[device] = {
            **shared,
            "sensors": {"force_filter": _digits(p[f"{device}.force_filter"])},
            "loop": {"position": position, "position_only": position, "tension": tension},
        }
    testbed = changes["testbed"]
    testbed["drives"] = {"lag": _digits(p["testbed.lag"]), "rate_limit_deg": _digits(p["testbed.rate_limit"])}
    noise, period = _digits(p["testbed.slider_noise"]), p["testbed.control_period"]
    weight = period / (SWITCH_FILTER + period)
    difference = noise * math.sqrt(2.0 * weight / (2.0 - weight))  # standard deviation, after the low-pass
    testbed["sensors"]["potentiometer_noise"] = noise
    testbed["loop"] |= {
        "control_period": period,
        "switch_filter": SWITCH_FILTER,
        "switch_hysteresis": _digits(CERTAIN * difference),
        "tie_width": _digits(difference),
    }
    return changes


def devices(parameters: Mapping[str, float]) -> dict[str, Profile]:
    """Return both shipped devices with a set of parameters in the place of theirs.

    Raises
    ------
    AmulettError
        If a profile does not allow one of the values.
    """
    return {
        name: load_profile({"base": name, "name": f"{name}-identified", **changes})
        for name, changes in profile_changes(parameters).items()
    }


def reproduced(parameters: Mapping[str, float], readings: Readings, repetitions: int = 1) -> tuple[Row, ...]:
    """Return the rows of Tables 2-5 that a set of parameters gives.

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    return compare(measure(devices(parameters), readings, repetitions, SIMULATED), readings)


def residual(row: Row) -> float:
    """Return log(ours / paper) in units of what the row may be off by: up to 1 it is explained."""
    bound = math.log(BOUNDS[row.cell.metric, row.cell.profile][1])
    if row.ours is None:
        if row.failed:
            return OUT_OF_REACH
        return min(math.log(SIMULATED[row.cell.profile] / row.cell.value) / bound, OUT_OF_REACH)
    return float(np.clip(math.log(max(row.ours, 1e-6) / row.cell.value) / bound, -OUT_OF_REACH, OUT_OF_REACH))


def cost(residuals: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Return a smooth, weighted count of the rows that are out of their bounds."""
    squares = np.square(residuals)
    return float(
        np.dot(np.log1p(squares**2) + ROBUST * np.log1p(squares), np.ones_like(squares) if weights is None else weights)
    )


def objective(readings: Readings, without: str | None = None) -> Callable[[Values], float]:
    """Return the cost as a function of the search vector; `without` leaves out one configuration, on both devices."""

    def value(vector: Values) -> float:
        worst = cost([OUT_OF_REACH] * len(TABLES_2_TO_5))
        if not allowed(vector):
            return worst
        try:
            rows = reproduced(unpack(vector), readings)
        except AmulettError:  # springs too weak for a starting posture
            return worst
        seen = [row for row in rows if row.cell.configuration != without]
        return cost([residual(row) for row in seen], [WEIGHTS[row.cell.metric] for row in seen])

    return value


def search(
    seed: int,
    readings: Readings,
    *,
    generations: int,
    population: int | Values,
    without: str | None = None,
    fixed: Mapping[str, float] | None = None,
) -> Fit:
    """Search by differential evolution.

    Parameters
    ----------
    seed : int
        Of the first generation and of the search.
    readings : Readings
    generations : int
    population : int or ndarray
        Candidates in a generation, which then begins anywhere between the bounds; or the search vectors to begin with.
    without : str, optional
        A configuration whose rows are left out.
    fixed : mapping of str to float, optional
        Parameters that stay as they are.
    """
    rng = np.random.default_rng(seed)
    if isinstance(population, int):
        population = rng.uniform(size=(population, len(PARAMETERS)))
    names = [free.name for free in PARAMETERS]
    free = np.array([name not in (fixed or {}) for name in names])
    template = pack({**unpack(np.full(len(names), 0.5)), **(fixed or {})})
    value = objective(readings, without)

    def whole(part: Values) -> Values:
        vector = template.copy()
        vector[free] = part
        return vector

    found = differential_evolution(
        lambda part: value(whole(part)),
        [(0.0, 1.0)] * int(free.sum()),
        init=population[:, free],
        seed=rng,
        maxiter=generations,
        tol=0.0,
        atol=1e-4,
        polish=False,
    )
    return Fit(float(found.fun), unpack(whole(found.x)), np.array([whole(part) for part in found.population]))


def ensemble(
    seed: int, readings: Readings, candidates: Values, *, limit: float, walkers: int, steps: int
) -> list[dict[str, float]]:
    """Return parameter sets that are as good as the best: a random walk of many walkers where the cost is low enough.

    Each walker moves along the line through another one (the affine-invariant "stretch move" of Goodman and Weare,
    2010); a move is accepted if the cost stays within the limit.

    Parameters
    ----------
    seed : int
    readings : Readings
    candidates : ndarray, shape (candidates, parameters)
        Search vectors; the walkers start from some of those within the limit.
    limit : float
        Largest cost.
    walkers : int
        At most so many.
    steps : int
        Moves that each walker tries.

    Returns
    -------
    list of dict of str to float
        Every place at which a walker was; empty if no candidate is within the limit.
    """
    rng = np.random.default_rng(seed)
    value = objective(readings)
    within = [vector for vector in candidates[rng.permutation(len(candidates))] if value(vector) <= limit]
    places = np.array(within[:walkers]).reshape(-1, len(PARAMETERS))
    members = list(places)
    count, size = places.shape
    for _ in range(steps if count > 1 else 0):
        for k in range(count):
            other = places[(k + rng.integers(1, count)) % count]
            stretch = (1.0 + rng.uniform()) ** 2 / 2.0  # density proportional to 1/sqrt(stretch), 0.5 to 2
            accept = rng.uniform() < stretch ** (size - 1)
            moved = other + stretch * (places[k] - other)
            if accept and ((moved >= 0.0) & (moved <= 1.0)).all() and value(moved) <= limit:
                places[k] = moved
                members.append(moved)
    return [unpack(vector) for vector in members]


def most_explained(readings: Readings, members: Sequence[Mapping[str, float]]) -> tuple[int, float, dict[str, float]]:
    """Return the set that explains most rows; among several the one of least cost.

    The rows are means of other and more repetitions than those that are reported, so that the choice does not flatter
    what is reported.

    Returns
    -------
    tuple of int, float and dict
        Rows explained, cost, parameters.
    """
    value = objective(readings)
    ranked = []
    for member in members:
        rows = compare(measure(devices(member), readings, SELECTION_REPETITIONS, first_key=SELECTION_KEY), readings)
        ranked.append((-sum(row.explained for row in rows), value(pack(member)), dict(member)))
    explained, least, parameters = min(ranked, key=lambda entry: entry[:2])
    return -explained, least, parameters


def _digits(value: float) -> float:
    return float(f"{value:.5g}")
