"""The fixed baselines, each tuned with the same number of episodes, its admittance included."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.fitting import Fitting
from amulett_gym.laws.parametric import Parameter, Space
from amulett_gym.laws.worn import WORN_LAWS, Constant, Settings, WornLaw
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.layout import Control
from amulett_gym.studies.wearer.episodes import Act, Devices, Scenarios, Schedule, play, tension_range_of
from amulett_gym.studies.wearer.search import Budget, cross_entropy

Values = NDArray[np.float64]

TRANSPARENT = "transparent"
"""Zero-torque mode: the loop `torque` without virtual spring and damper, at a constant co-contraction."""

TWO_LEVEL = "two-level"
"""A schedule by the wearer's true intention, which no device knows: two levels of co-contraction and of assistance."""

TWO_ASSISTANCES = "two-assistances"
"""The same with a single co-contraction."""

BY_INTENTION = (TWO_ASSISTANCES, TWO_LEVEL)

BASELINES = (*WORN_LAWS, TRANSPARENT)

ADMITTANCE = (
    Parameter("gain", "rad/(s N m)", 0.2, 8.0, 1.9, "gain at full assistance", True),
    Parameter("carry", "1", 0.0, 1.4, 0.8, "share of the joint's rate at full assistance"),
    Parameter("lead", "s", 0.0, 0.4, 0.14, "lead time of the torque"),
    Parameter("dead_band", "N m", 0.0, 0.15, 0.06, "torque that is ignored"),
    Parameter("rate_filter", "s", 0.005, 0.06, 0.02, "time constant of the torque's rate", True),
)
_REST_GAIN = Parameter("rest_gain", "rad/(s N m)", 0.001, 0.3, 0.012, "gain without assistance", True)
_TORQUE_TIME = Parameter("torque_time", "s", 0.01, 0.1, 0.03, "time constant of the torque", True)


def _tension(name: str, low: float, high: float, start: float) -> Parameter:
    return Parameter(name, "N", low, high, min(max(start, low), high), "co-contraction")


def space_of(kind: str, control: Control) -> Space:
    """Return what is tuned of a baseline or of the two-level schedule: parameters of law and admittance.

    An assistance that is constant is 1: the admittance's gain is tuned instead.
    """
    ends = tension_range_of(control)
    levels = _tension("moving_tension", *ends, 1.0), _tension("holding_tension", *ends, 10.0)
    at_rest = Parameter("holding_assistance", "1", 0.0, 1.0, 0.1, "assistance while holding"), _REST_GAIN
    parameters: dict[str, tuple[Parameter, ...]] = {
        "constant": (_tension("co_contraction", *ends, 6.0), *ADMITTANCE),
        "eq6": (
            _tension("nominal_tension", *ends, 10.0),
            _tension("minimum_tension", *ends, 4.0),
            Parameter("error_offset", "deg", 0.5, 60.0, 10.0, "error from which the tension is the minimum", True),
            *ADMITTANCE,
        ),
        "switched": (
            *levels,
            *at_rest,
            Parameter("speed", "deg/s", 1.0, 60.0, 10.0, "rate that counts as moving", True),
            Parameter("torque", "N m", 0.05, 5.0, 0.6, "torque that counts as moving", True),
            Parameter("width", "1", 0.01, 0.5, 0.1, "width of the switch", True),
            Parameter("hold", "s", 0.02, 0.6, 0.15, "time until a motion counts as over", True),
            *ADMITTANCE,
        ),
        "latched": (
            *levels,
            _REST_GAIN,
            Parameter("speed", "deg/s", 1.0, 40.0, 6.0, "rate below which the arm is still", True),
            Parameter("still", "s", 0.0, 0.3, 0.05, "time for which it has to be still"),
            Parameter("least_motion", "s", 0.05, 0.6, 0.4, "least time for which it is free"),
            Parameter("settling", "s", 0.05, 1.2, 0.5, "least time for which it is locked"),
            Parameter("torque", "N m", 0.03, 1.0, 0.25, "change of the cuff torque that frees it", True),
            Parameter("forgetting", "s", 0.05, 2.0, 0.4, "time constant of the cuff torque's mean", True),
            *ADMITTANCE,
        ),
        TRANSPARENT: (_tension("co_contraction", *ends, 6.0), _TORQUE_TIME),
        TWO_LEVEL: (*levels, *at_rest, *ADMITTANCE),
        TWO_ASSISTANCES: (_tension("co_contraction", *ends, 6.0), *at_rest, *ADMITTANCE),
    }
    return Space(kind, "a baseline of a worn device", parameters[kind])


def device_of(profile: Profile, values: Mapping[str, float]) -> Profile:
    """Return a device with the admittance, and the gain of the loop `torque`, that tuned values name."""
    admittance = dict((profile.wearer or Fitting()).admittance)
    own: dict[str, Any] = {key: value for key, value in values.items() if key in admittance and key != "sources"}
    changes: dict[str, Any] = {"wearer": {"admittance": own}} if own else {}
    if "torque_time" in values:
        gains = {"virtual_stiffness": 0.0, "virtual_damping": 0.0, "torque_time": values["torque_time"]}
        changes["loops"] = {"torque": gains}
    return load_profile(merge(profile.model_dump(), changes)) if changes else profile


@dataclass(frozen=True)
class Tuned:
    """A baseline with tuned parameters.

    Attributes
    ----------
    kind : str
        One of `BASELINES` or `BY_INTENTION`.
    control : str
    values : dict of str to float
        The parameters of `space_of`.
    train, validation : float
        Mean cost where it was tuned, and where it was chosen (NaN: nowhere).
    """

    kind: str
    control: Control
    values: dict[str, float]
    train: float
    validation: float = float("nan")

    @property
    def settings(self) -> Settings:
        """The law with its parameters."""
        law = WORN_LAWS.get(self.kind, Constant)
        return law(**{key: value for key, value in self.values.items() if key in law.model_fields})

    def play(self, profile: Devices, scenarios: Scenarios) -> dict[str, Values]:
        """Play scenarios on a device or several, whose own admittance is replaced; see `episodes.play`."""
        changed: Devices = (
            device_of(profile, self.values)
            if isinstance(profile, Profile)
            else [device_of(each, self.values) for each in profile]
        )
        return play(changed, self.control, scenarios, self.act(scenarios))

    def act(self, scenarios: Scenarios) -> Act:
        """Return the policy; schedules by the true intention know the scenarios."""
        ends = tension_range_of(self.control)
        if self.kind not in BY_INTENTION:
            return WornLaw(self.settings, tension_range=ends)
        of = self.values
        levels = ("co_contraction",) * 2 if self.kind == TWO_ASSISTANCES else ("moving_tension", "holding_tension")
        tensions = np.where(scenarios.moving, of[levels[0]], of[levels[1]])
        return Schedule(tensions, np.where(scenarios.moving, 1.0, of["holding_assistance"]), ends)


def loop_of(kind: str, control: Control) -> Control:
    """Return the loop of a baseline: the transparent one has its own."""
    return "torque" if kind == TRANSPARENT else control


def tune(
    kind: str,
    profile: Profile,
    control: Control,
    scenarios: Scenarios,
    budget: Budget,
    seed: int = 0,
    start: Mapping[str, float] | None = None,
) -> Tuned:
    """Return a baseline that is tuned on scenarios for the least mean cost.

    `start` has values to begin with; without it, the search begins in the middle of all ranges.
    """
    space = space_of(kind, control)
    low = space.from_unit(np.zeros(len(space.parameters)))
    high = space.from_unit(np.ones(len(space.parameters)))

    def named(point: Values) -> dict[str, float]:
        return {p.name: float(f"{x:.4g}") for p, x in zip(space.parameters, space.from_unit(point), strict=True)}

    def costs_of(points: Values) -> Values:
        return np.array([[cost(Tuned(kind, control, named(point), np.nan)) for point in row] for row in points])

    def cost(tuned: Tuned) -> float:
        return float(tuned.play(profile, scenarios)["cost"].mean())

    middle = np.full(len(space.parameters), 0.5)
    if start is not None:
        wanted = [start.get(parameter.name, parameter.start) for parameter in space.parameters]
        middle = space.to_unit(np.clip(wanted, low, high))
    points, costs = cross_entropy(costs_of, middle[None], budget, seed)
    return Tuned(kind, control, named(points[0]), float(costs[0]))


def tune_and_choose(
    kind: str,
    profile: Profile,
    control: Control,
    train: Scenarios,
    validation: Scenarios,
    budget: Budget,
    starts: int,
    report: Callable[[], Any] = lambda: None,
) -> list[Tuned]:
    """Return the results of several searches, the one with the least cost on validation scenarios first.

    The first search begins with the device's admittance, the others in the middle of all ranges.
    """
    found = []
    own = {key: float(value) for key, value in (profile.wearer or Fitting()).admittance if key != "sources"}
    for k in range(starts):
        tuned = tune(kind, profile, loop_of(kind, control), train, budget, seed=k, start=own if k == 0 else None)
        cost = float(tuned.play(profile, validation)["cost"].mean())
        found.append(Tuned(tuned.kind, tuned.control, tuned.values, tuned.train, cost))
        report()
    return sorted(found, key=lambda tuned: tuned.validation)
