"""How much there is to gain by a schedule: the best constant, levels by the true intention, and a clairvoyant.

Of two levels by the intention, moving or not, one case has two assistances at one co-contraction: what it costs more
than two levels of both is what stiffness matters.

A clairvoyant knows the whole scenario, its noise included: it has a co-contraction and an assistance of its own in each
phase of the intention, in which the wearer moves or does not. So no policy should be expected to reach it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import Control
from amulett_gym.studies.wearer.baselines import BY_INTENTION, TWO_LEVEL, Tuned, device_of, tune
from amulett_gym.studies.wearer.episodes import Scenarios, Schedule, play, tension_range_of
from amulett_gym.studies.wearer.search import Budget, cross_entropy

Values = NDArray[np.float64]

PHASES = 24
"""Most phases of an intention that have levels of their own; later ones have those of the last."""

PARTS = 4
"""Parts of `measure`, after each of which it reports."""


@dataclass(frozen=True)
class Headroom:
    """Costs in one suite and loop.

    Attributes
    ----------
    suite : str
    control : str
    tuned : dict of str to Tuned
        The best constant, and those of `BY_INTENTION`.
    costs : dict of str to ndarray, shape (N,)
        ``doffed`` and those of `tuned` in held-out scenarios; ``clairvoyant`` of the first of them, shape (M,).
    """

    suite: str
    control: Control
    tuned: dict[str, Tuned]
    costs: dict[str, Values]


def measure(
    profile: Profile,
    control: Control,
    train: Scenarios,
    held_out: Scenarios,
    budget: Budget,
    clairvoyant: Budget,
    foreseen: int,
    report: Callable[[], Any] = lambda: None,
) -> Headroom:
    """Tune the best constant and the schedules by the intention on training scenarios, and search the clairvoyant's.

    Parameters
    ----------
    profile : Profile
        Its admittance is where the searches begin.
    control : str
    train, held_out : Scenarios
        Of one suite.
    budget, clairvoyant : Budget
        Of each of them, and of each of the first `foreseen` held-out scenarios.
    foreseen : int
    report : callable
        Called after each of `PARTS` parts.
    """
    own = {key: float(value) for key, value in profile.wearer.admittance if key != "sources"} if profile.wearer else {}
    found: dict[str, Tuned] = {}
    costs = {"doffed": held_out.doffed["cost"]}
    for kind in ("constant", *BY_INTENTION):
        # A search begins with the result of the one before, which is a case of it.
        start = own | (found[[*found][-1]].values if found else {})
        if kind == TWO_LEVEL:
            start |= dict.fromkeys(("moving_tension", "holding_tension"), start["co_contraction"])
        found[kind] = tune(kind, profile, control, train, budget, start=start)
        costs[kind] = found[kind].play(profile, held_out)["cost"]
        report()
    best = foresee(profile, found[TWO_LEVEL], held_out.first(foreseen), clairvoyant)
    # A clairvoyant may also do what the others do, with their admittance.
    costs["clairvoyant"] = np.min([best, *(costs[kind][:foreseen] for kind in found)], axis=0)
    report()
    return Headroom(train.suite, control, found, costs)


def foresee(profile: Profile, two_level: Tuned, scenarios: Scenarios, budget: Budget) -> Values:
    """Return the least cost that a search finds for each scenario, shape (N,), beginning with the two-level schedule.

    The admittance is the schedule's.
    """
    device, control, ends = device_of(profile, two_level.values), two_level.control, tension_range_of(two_level.control)
    phases = np.minimum(
        np.cumsum(np.diff(scenarios.moving, axis=1, prepend=scenarios.moving[:, :1]), axis=1), PHASES - 1
    )
    kinds = np.zeros((len(scenarios), PHASES), dtype=bool)
    np.put_along_axis(kinds, phases, scenarios.moving, axis=1)
    of = two_level.values
    tension = (np.where(kinds, of["moving_tension"], of["holding_tension"]) - ends[0]) / (ends[1] - ends[0])
    start = np.concatenate([tension, np.where(kinds, 1.0, of["holding_assistance"])], axis=1)
    many, each = scenarios.repeated(budget.population), phases.repeat(budget.population, axis=0)

    def costs_of(points: Values) -> Values:
        levels = points.reshape(len(many), 2, PHASES)
        tensions = ends[0] + (ends[1] - ends[0]) * np.take_along_axis(levels[:, 0], each, axis=1)
        schedule = Schedule(tensions, np.take_along_axis(levels[:, 1], each, axis=1), ends)
        return play(device, control, many, schedule)["cost"].reshape(points.shape[:2])

    return cross_entropy(costs_of, start, budget, seed=0)[1]
