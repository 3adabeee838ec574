"""The registry of metrics: the name, unit, definition of every number that is reported of an episode.

``cost`` is computed from the metrics below and ranks contenders within one control loop, the track *schedule*: neither
shaped nor capped. The *capped cost* is minus the return, at most `COST_CAP` for each agent step: training minimises and
validates it. ``control_cost`` ranks any loops with any laws, the track *full control*: its effort is of the drives' own
motion, alike for all loops, and it has no term for the tension, which not every loop controls.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import COST_CAP, COST_TERMS, FULL_CONTROL, SCHEDULE
from amulett_gym.envs.transition import MAY_BE_MISSING
from amulett_gym.profile import Profile
from amulett_gym.reporting.words import number


@dataclass(frozen=True)
class Metric:
    """A number that is reported of every episode.

    Attributes
    ----------
    key : str
        In ``results.json``, CSV files and ``info``.
    name : str
        In tables, figures and text.
    unit : str
        "1": dimensionless.
    meaning : str
        Its definition, with the paper's equation if it has one.
    lower_is_better : bool or None
        None: neither is better.
    digits : int
        Significant digits that are shown.
    paper_name : str
        Its name in the paper's tables, as the reproduction reads them; `name` if empty.
    """

    key: str
    name: str
    unit: str
    meaning: str
    lower_is_better: bool | None = None
    digits: int = 3
    paper_name: str = ""

    @property
    def heading(self) -> str:
        """Name and unit, such as ``"position ISE [deg2 s]"``."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def paper_heading(self) -> str:
        """The paper's name with the unit."""
        return replace(self, name=self.paper_name or self.name).heading

    def text(self, value: float | None) -> str:
        """Return a value as it is shown; a dash if there is none."""
        return number(value, self.digits)


_COST = "share of the cost"
_CONTROL = "position ISE, drive effort and contact ISE, weighted, and the cost of failure"
_TIME = "from a setpoint step to the {} entry into the band around its target; mean over the steps that reached it"


def _of_drives(key: str, name: str, unit: str, meaning: str) -> list[Metric]:
    drives = ("biceps", "triceps")
    return [Metric(f"{key}_{drive}", f"{name} of the {drive}' drive", unit, meaning, True) for drive in drives]


_ALL = (
    Metric("cost", "cost", "1", "sum of the five terms below; that of eq. 6 in training is about 1", True),
    Metric("cost_position", "cost of position", "1", f"position ISE: {_COST}", True),
    Metric("cost_effort", "cost of effort", "1", f"effort: {_COST}", True),
    Metric("cost_tension", "cost of tension", "1", f"tension ISE: {_COST}", True),
    Metric("cost_contact", "cost of contact", "1", f"contact ISE: {_COST}", True),
    Metric("cost_failure", "cost of failure", "1", f"{COST_CAP:g} for each agent step left after a failure", True),
    Metric("control_cost", "full-control cost", "1", f"{_CONTROL}; that of eq. 6 in training is about 1", True),
    *(
        Metric(f"control_cost_{term}", f"full-control cost of {term}", "1", f"{name}: share of the cost", True)
        for term, name in (("position", "position ISE"), ("effort", "drive effort"), ("contact", "contact ISE"))
    ),
    Metric("return", "return", "1", "sum of the rewards: minus the capped cost", False),
    Metric("failed", "failed", "1", "1 if the device left its limits", True),
    Metric("effort", "effort", "deg2/s", "ISAV (eq. 8) of both drives without the setpoint's jump", True),
    Metric("position_ise", "position ISE", "deg2 s", "integrated squared error of the true angle (eq. 7)", True, 4),
    Metric("tension_ise", "tension ISE", "N2 s", "eq. 7 of the antagonist's true force", True),
    *_of_drives("isav", "ISAV", "deg2/s", "eq. 8: squared rate of its command"),
    *_of_drives("iav", "IAV", "deg", "integrated absolute rate of its command"),
    Metric("rise_time", "rise time", "s", _TIME.format("first"), paper_name="first entry"),
    Metric("settling_time", "settling time", "s", _TIME.format("last"), paper_name="rise time (last entry)"),
    Metric("overshoot", "overshoot", "deg", "largest excursion beyond the target of a step", True),
    Metric("tension_ise_estimated", "tension ISE, estimated", "N2 s", "eq. 7 of the antagonist's estimate", True),
    Metric("isav_kick", "ISAV of the jumps", "deg2/s", "eq. 8: contribution of the setpoint's jumps"),
    *_of_drives("effort", "effort", "deg2/s", "eq. 8 without the setpoint's jump"),
    Metric("contact_ise", "contact ISE", "N2 m2 s", "integrated square of the contact torque", True),
    Metric("contact_peak", "peak contact torque", "N m", "largest contact torque", True),
    Metric("push_deflection", "push deflection", "deg", "largest error while a push acts", True),
    Metric("resting_stiffness", "resting stiffness", "N m/rad", "mean joint stiffness in the band of a fixed setpoint"),
    Metric("setpoint_steps", "setpoint steps", "1", "number of steps of the setpoint"),
    Metric("steps_risen", "steps risen", "1", "number of steps that have a rise time"),
    Metric("steps_settled", "steps settled", "1", "number of steps that have a settling time"),
    Metric("resting_time", "resting time", "s", "time in the band of a fixed setpoint"),
    Metric("agonist_switches", "agonist switches", "1", "number of switches of the agonist"),
    Metric("drive_effort", "drive effort", "deg2/s", "eq. 8 of both drives' own motion, after lag and limits", True),
    Metric("drive_work", "drive work", "J", "mechanical work of both drives: integral of max(0, torque x rate)", True),
)

METRICS = {metric.key: metric for metric in _ALL}
"""All metrics by key, in the order of reports."""

UNITS = {key: metric.unit for key, metric in METRICS.items()}
"""Unit of each metric."""

COSTS = (*COST_TERMS, "failure")
"""Terms of the cost; ``"cost_" + term`` is reported for each."""

CONTROL_TERMS = {"position": "position_ise", "effort": "drive_effort", "contact": "contact_ise"}
"""Terms of the full-control cost, with their metrics; ``"control_cost_" + term`` is reported for each."""

COST_OF = {SCHEDULE: "cost", FULL_CONTROL: "control_cost"}
"""The metric that ranks contenders on a track."""

EFFORT_OF = {SCHEDULE: "effort", FULL_CONTROL: "drive_effort"}
"""The effort in that cost."""

Values = NDArray[np.float64]


def control_prices(profile: Profile, suite: str, families: ArrayLike | None = None) -> Values:
    """Return weight / divisor of each family and term of the full-control cost in a suite.

    Returns
    -------
    ndarray, shape (N, len(CONTROL_TERMS))
        The rows of `envs.reward.prices` on the track *full control*: one for each of `families`, by default for each
        of `simulation.layout.FAMILIES`; per deg2 s, deg2/s and N2 m2 s.
    """
    table = prices(profile, suite, track=FULL_CONTROL, families=families)
    return table[:, [COST_TERMS.index(term) for term in CONTROL_TERMS]]


def control_cost(raw: Mapping[str, Values], charge: Values, prices: Values) -> Values:
    """Return the full-control cost of episodes, shape (N,).

    Parameters
    ----------
    raw : mapping of str to ndarray, shape (N,)
        Final values of the metrics in ``info``.
    charge : ndarray, shape (N,)
        `failure_cost` of the devices that failed, 0 for the others.
    prices : ndarray, shape (N, len(CONTROL_TERMS))
        Of each scenario: `control_prices` of its family.
    """
    return np.asarray(np.sum([*_control_shares(raw, prices).values(), charge], axis=0))


def _control_shares(raw: Mapping[str, Values], prices: Values) -> dict[str, Values]:
    """Return the terms of the full-control cost but that of failure, by the metrics' keys."""
    return {
        f"control_cost_{term}": prices[:, k] * raw[metric] for k, (term, metric) in enumerate(CONTROL_TERMS.items())
    }


def derive(raw: Mapping[str, Values], charge: Values, prices: Values, control_prices: Values) -> dict[str, Values]:
    """Return all of `METRICS` but ``return``: `raw`, both costs, the cost's terms, failures and effort.

    The cost is the sum of each raw metric times its price: its weight over its divisor, both of the scenario's
    family.

    Parameters
    ----------
    raw : mapping of str to ndarray, shape (N,)
        Final values of the metrics in ``info``.
    charge : ndarray, shape (N,)
        `failure_cost` of the devices that failed, 0 for the others.
    prices : ndarray, shape (N, len(COST_TERMS))
        Of each scenario: `envs.reward.prices` of its family.
    control_prices : ndarray, shape (N, len(CONTROL_TERMS))
        Of each scenario: `control_prices` of its family.
    """
    effort = raw["effort_biceps"] + raw["effort_triceps"]
    terms = {"effort": effort} | {term: raw[f"{term}_ise"] for term in ("position", "tension", "contact")}
    costs = {f"cost_{term}": prices[:, k] * terms[term] for k, term in enumerate(COST_TERMS)}
    costs["cost_failure"] = charge
    failed = np.asarray(charge > 0.0, dtype=np.float64)
    cost, control = np.sum(list(costs.values()), axis=0), control_cost(raw, charge, control_prices)
    costs |= _control_shares(raw, control_prices)
    return {"cost": cost, **costs, "control_cost": control, "failed": failed, "effort": effort, **or_nan(raw)}


def or_nan(raw: Mapping[str, ArrayLike]) -> dict[str, Values]:
    """Return metrics as ``info`` has them, but NaN where one does not exist yet: ``info`` has 0 there."""
    missing = {name: np.asarray(raw[count]) == 0.0 for name, count in MAY_BE_MISSING.items()}
    return {name: np.where(missing.get(name, False), np.nan, values) for name, values in raw.items()}


def capped_cost(values: Mapping[str, Values]) -> Values:
    """Return minus the return, which training minimises, also when it chooses a policy on validation scenarios."""
    return -values["return"]


def failure_cost(time: float, duration: float, agent_period: float) -> float:
    """Return the cost of a failure at `time` [s], as in the reward: `COST_CAP` for each agent step left.

    Without it a failure would lower the cost: the other metrics end there. `agent_period` [s] is the comparison's, not
    the contender's, so that a failure costs all contenders the same; `duration` [s] is that of a whole episode.
    """
    steps_done = math.floor(time / agent_period + 1e-9)
    return COST_CAP * max(round(duration / agent_period) - steps_done, 1)
