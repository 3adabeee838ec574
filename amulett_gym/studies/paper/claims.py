"""What sections 1.2 and 3 to 5 say about the results, tried on our numbers and on the paper's own.

A claim is data: quantities, and bounds between which they have to lie. The same statements are tried on both sets of
numbers, so that a sentence which the paper's own tables contradict shows as one. What a sentence leaves open, such as
"practically" or "slightly", is settled beside it. The three hypotheses of section 1.2 are answered by our numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from amulett_gym.evaluation import metrics as registry
from amulett_gym.studies.paper.motion import UNITS, Key
from amulett_gym.studies.paper.reproduction import Reproduction
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, DRIVES, FIGURE_6, PROTOCOL, TABLES_2_TO_5

Numbers = Mapping[Key, float]
"""Metric, device, configuration and drive -> a number; one that does not exist is not there."""

NAMES = dict(zip(CONFIGURATIONS, ("position only", "5 N", "10 N", "variable"), strict=True))
"""Configurations in words."""

METRICS = {name: registry.METRICS[name].name for name in ("rise_time", "position_ise", "tension_ise")} | {
    "isav": "ISAV"
}
"""Metrics of Tables 2-5 in words, in the order of the tables."""

_UNITS = {cell.metric: cell.unit for cell in TABLES_2_TO_5} | UNITS


@dataclass(frozen=True)
class Quantity:
    """Something that numbers give.

    Attributes
    ----------
    of : callable
        Numbers -> its value, NaN if a number is missing.
    say : callable
        Numbers -> what it is, and its value with a unit.
    """

    of: Callable[[Numbers], float]
    say: Callable[[Numbers], str]


@dataclass(frozen=True)
class Within:
    """The statement that a quantity lies between two bounds, both excluded."""

    quantity: Quantity
    low: float | Quantity = -math.inf
    high: float | Quantity = math.inf


@dataclass(frozen=True)
class Verdict:
    """Whether statements hold (None: a number that decides it is missing), and the numbers that say so."""

    holds: bool | None
    words: str


def judge(statements: Sequence[Within], numbers: Numbers) -> Verdict:
    """Try statements, all of which have to be true, on a set of numbers."""
    true = [_is_true(statement, numbers) for statement in statements]
    said: dict[str, None] = {}  # an ordered set: a quantity may be bounded twice
    for statement in statements:
        for part in (statement.quantity, statement.low, statement.high):
            if isinstance(part, Quantity):
                said[part.say(numbers)] = None
    return Verdict(False if False in true else None if None in true else True, "; ".join(said))


def our_numbers(reproduction: Reproduction) -> dict[Key, float]:
    """Return our numbers of Tables 2-5."""
    return {
        (row.cell.metric, row.cell.profile, row.cell.configuration, row.cell.drive): row.ours
        for row in reproduction.rows
        if row.ours is not None
    }


def paper_numbers() -> dict[Key, float]:
    """Return the paper's numbers of Tables 2-5."""
    return {(cell.metric, cell.profile, cell.configuration, cell.drive): cell.value for cell in TABLES_2_TO_5}


def _key(metric: str, device: str, configuration: str, drive: str | None = None) -> Key:
    return metric, device, configuration, drive


def value(key: Key, label: str = "") -> Quantity:
    """Return a number as it is; the label replaces device, configuration and drive."""
    unit = _UNITS[key[0]].replace("^2", "²")
    suffix = "" if unit in ("", "1") else f" {unit}"
    return _quantity(label or _label(key), lambda numbers: numbers.get(key, math.nan), lambda x: f"{x:.3g}{suffix}")


def ratio(top: Key, bottom: Key, label: str = "") -> Quantity:
    """Return one number over another."""

    def of(numbers: Numbers) -> float:
        below = numbers.get(bottom, math.nan)
        return numbers.get(top, math.nan) / below if below else math.nan

    return _quantity(label or _label(top), of, _ratio_in_words)


def difference(one: Key, other: Key, label: str = "") -> Quantity:
    """Return one number minus another of the same metric."""
    unit = _UNITS[one[0]].replace("^2", "²")
    return _quantity(
        label or _label(one),
        lambda numbers: numbers.get(one, math.nan) - numbers.get(other, math.nan),
        lambda x: f"{x:+.2g} {unit}",
    )


def extreme(pick: Callable[[list[float]], float], quantities: Sequence[Quantity], label: str) -> Quantity:
    """Return the largest or smallest (`max` or `min`) of several ratios; NaN if one is missing."""

    def of(numbers: Numbers) -> float:
        values = [quantity.of(numbers) for quantity in quantities]
        return math.nan if any(map(math.isnan, values)) else pick(values)

    return _quantity(label, of, _ratio_in_words)


def bound(quantity: Quantity, transform: Callable[[float], float]) -> Quantity:
    """Return a bound that depends on a quantity, and names that quantity."""
    return Quantity(lambda numbers: transform(quantity.of(numbers)), quantity.say)


def _is_true(statement: Within, numbers: Numbers) -> bool | None:
    low, middle, high = (
        part.of(numbers) if isinstance(part, Quantity) else part
        for part in (statement.low, statement.quantity, statement.high)
    )
    return None if any(map(math.isnan, (low, middle, high))) else low < middle < high


def _quantity(label: str, of: Callable[[Numbers], float], words: Callable[[float], str]) -> Quantity:
    def say(numbers: Numbers) -> str:
        result = of(numbers)
        return f"{label} {'has no number' if math.isnan(result) else words(result)}"

    return Quantity(of, say)


def _label(key: Key) -> str:
    _, device, configuration, drive = key
    return " ".join([device, NAMES[configuration], *([drive] if drive else [])])


def _ratio_in_words(ratio: float) -> str:
    """Return a ratio as a change in percent, or as a factor if percents would not show it."""
    return f"{100.0 * (ratio - 1.0):+.1f} %" if ratio == 0.0 or 0.01 <= ratio < 2.0 else f"×{ratio:.3g}"


PLAIN, FIVE, TEN, VARIABLE = CONFIGURATIONS
WITH_TENSION = (FIVE, TEN, VARIABLE)
SIMULATION, TESTBED = DEVICES

UP, DOWN = 1.005, 0.995
"""What increases or decreases by half a percent or less counts as unchanged."""


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, or a part of one.

    Attributes
    ----------
    id, section : str
    quote : str
        The paper's words.
    taken_as : str
        What has to be the case for it to hold.
    statements : tuple of Within
        The same as data; all of them have to be true.
    """

    id: str
    section: str
    quote: str
    taken_as: str
    statements: tuple[Within, ...]


@dataclass(frozen=True)
class CheckedClaim:
    """A claim, tried on our numbers and on the paper's; None where its tables have no numbers about it."""

    claim: Claim
    ours: Verdict
    paper: Verdict | None

    @property
    def contradicted(self) -> bool:
        """Whether the paper's own tables contradict it."""
        return self.paper is not None and self.paper.holds is False


def check_claims(reproduction: Reproduction, observed: Numbers) -> tuple[CheckedClaim, ...]:
    """Try all claims on our numbers and on the paper's own.

    Parameters
    ----------
    reproduction : Reproduction
    observed : mapping
        What we read off motions (`motion.observe`).
    """
    ours = {**our_numbers(reproduction), **observed}
    return tuple(check(claim, ours) for claim in CLAIMS)


def check(claim: Claim, ours: Numbers) -> CheckedClaim:
    """Try a claim on our numbers and on the paper's own."""
    published = paper_numbers()
    printed = not all(math.isnan(statement.quantity.of(published)) for statement in claim.statements)
    return CheckedClaim(claim, judge(claim.statements, ours), judge(claim.statements, published) if printed else None)


def claims_content(claims: Sequence[CheckedClaim]) -> list[dict[str, Any]]:
    """Return checked claims as JSON content; null stands for what cannot be said."""
    return [
        {
            "id": item.claim.id,
            "section": item.claim.section,
            "quote": item.claim.quote,
            "taken_as": item.claim.taken_as,
            "holds": item.ours.holds,
            "ours": item.ours.words,
            "paper_holds": None if item.paper is None else item.paper.holds,
            "paper": None if item.paper is None else item.paper.words,
        }
        for item in claims
    ]


def change(metric: str, device: str, configuration: str, drive: str | None = None, label: str = "") -> Quantity:
    """Return a configuration's number over that of position-only control."""
    return ratio((metric, device, configuration, drive), (metric, device, PLAIN, drive), label)


def _changes(metric: str, device: str, drives: Sequence[str | None] = (None,)) -> tuple[Quantity, ...]:
    """Return the changes by tension control, in all configurations that have it."""
    return tuple(change(metric, device, configuration, drive) for drive in drives for configuration in WITH_TENSION)


def _all(quantities: Sequence[Quantity], low: float = -math.inf, high: float = math.inf) -> tuple[Within, ...]:
    return tuple(Within(quantity, low, high) for quantity in quantities)


def _variable_to(metric: str, device: str, others: Sequence[str] = (PLAIN, FIVE, TEN)) -> tuple[Quantity, ...]:
    """Return variable stiffness's number over those of other configurations."""
    return tuple(
        ratio(_key(metric, device, VARIABLE), _key(metric, device, other), f"{METRICS[metric]} against {NAMES[other]}")
        for other in others
    )


def _near_the_constants(metric: str, drive: str | None = None) -> tuple[Within, ...]:
    """State that the simulation's number of variable stiffness is within a factor of 2 of what 5 N and 10 N span."""
    name = " ".join([METRICS[metric], *([drive] if drive else [])])
    five, ten, variable = (
        value((metric, SIMULATION, configuration, drive), f"{name} {NAMES[configuration]}")
        for configuration in (FIVE, TEN, VARIABLE)
    )
    low = Quantity(lambda numbers: 0.5 * min(five.of(numbers), ten.of(numbers)), five.say)
    high = Quantity(lambda numbers: 2.0 * max(five.of(numbers), ten.of(numbers)), ten.say)
    return (Within(variable, low, high),)


def _switching(metric: str, label: str) -> tuple[Quantity, ...]:
    """Return what was observed on the testbed while the agonist switched."""
    return tuple(
        value(_key(metric, TESTBED, configuration), f"{NAMES[configuration]} {label}") for configuration in WITH_TENSION
    )


_SWITCHED = _all(_switching("switches", "switches:"), 0.0)
_MOST = {device: extreme(max, _changes("position_ise", device), f"{device} at most") for device in DEVICES}
_BEST = {device: extreme(min, _changes("tension_ise", device), f"{device} at best") for device in DEVICES}
_RISE_DIFFERENCE = {
    name: difference(_key("rise_time", TESTBED, name), _key("rise_time", TESTBED, PLAIN)) for name in (FIVE, TEN)
}
_MEASURED_ISAV = _changes("isav", TESTBED, DRIVES)
_HALF = "within half of the printed change"

CLAIMS: tuple[Claim, ...] = (
    Claim(
        "rise-simulation",
        "3.1",
        "In the simulations, the rise time remains practically the same with and without the proposed control "
        "approach.",
        "it changes by less than 15 %, in each configuration",
        _all(_changes("rise_time", SIMULATION), 0.85, 1.15),
    ),
    Claim(
        "rise-measured",
        "3.1",
        "In the measurements however, the rise time increases.",
        "in each configuration",
        _all(_changes("rise_time", TESTBED), low=UP),
    ),
    Claim(
        "rise-measured-5",
        "3.1",
        "With a tension setpoint of 5 N, the average increase is 0.75 s",
        _HALF,
        (Within(_RISE_DIFFERENCE[FIVE], 0.375, 1.125),),
    ),
    Claim("rise-measured-10", "3.1", "with 10 N, it's 0.1 s.", _HALF, (Within(_RISE_DIFFERENCE[TEN], 0.05, 0.15),)),
    Claim(
        "rise-measured-order",
        "3.1",
        "With a tension setpoint of 5 N, the average increase is 0.75 s, with 10 N, it's 0.1 s.",
        "5 N increases it more than 10 N",
        (Within(_RISE_DIFFERENCE[FIVE], low=_RISE_DIFFERENCE[TEN]),),
    ),
    Claim(
        "position-ise-simulation",
        "3.1",
        "For position control, the proposed control approach increases the ISE",
        "in each configuration of the simulation",
        _all(_changes("position_ise", SIMULATION), low=UP),
    ),
    Claim(
        "position-ise-measured",
        "3.1",
        "For position control, the proposed control approach increases the ISE",
        "in each configuration of the measurements",
        _all(_changes("position_ise", TESTBED), low=UP),
    ),
    Claim(
        "position-ise-more-measured",
        "3.1",
        "This effect is much more prominent in the measurements (maximum increase 12.3%) as compared to the simulation "
        "results (maximum increase 2.9%).",
        "the measurements' largest increase is at least twice the simulation's",
        (
            Within(_MOST[TESTBED], low=UP),
            Within(_MOST[TESTBED], low=bound(_MOST[SIMULATION], lambda most: 1.0 + 2.0 * (most - 1.0))),
        ),
    ),
    Claim(
        "position-ise-most-measured",
        "3.1",
        "measurements (maximum increase 12.3%)",
        _HALF,
        (Within(_MOST[TESTBED], 1.0615, 1.1845),),
    ),
    Claim(
        "position-ise-most-simulated",
        "3.1",
        "simulation results (maximum increase 2.9%)",
        _HALF,
        (Within(_MOST[SIMULATION], 1.0145, 1.0435),),
    ),
    Claim(
        "position-ise-measured-order",
        "3.1",
        "The increase is also bigger for measurements with a higher string force setpoint (12.3% vs. 1.5%).",
        "10 N increases it more than 5 N",
        (Within(change("position_ise", TESTBED, TEN), low=change("position_ise", TESTBED, FIVE)),),
    ),
    Claim(
        "position-ise-simulation-order",
        "3.1",
        "For simulations, the ISE increases more with a lower string force setpoint (2.9% vs. 0.77%).",
        "5 N increases it more than 10 N",
        (Within(change("position_ise", SIMULATION, FIVE), low=change("position_ise", SIMULATION, TEN)),),
    ),
    Claim(
        "tension-ise-simulation",
        "3.2",
        "For tension control, the ISE decreases when using our control system",
        "in each configuration of the simulation",
        _all(_changes("tension_ise", SIMULATION), high=DOWN),
    ),
    Claim(
        "tension-ise-measured",
        "3.2",
        "For tension control, the ISE decreases when using our control system",
        "in each configuration of the measurements",
        _all(_changes("tension_ise", TESTBED), high=DOWN),
    ),
    Claim(
        "tension-ise-more-simulated",
        "3.2",
        "Here, the reduction is more pronounced in the simulation results.",
        "the largest reduction is",
        (Within(_BEST[SIMULATION], high=_BEST[TESTBED]),),
    ),
    Claim(
        "tension-ise-more-simulated-each",
        "3.2",
        "Here, the reduction is more pronounced in the simulation results.",
        "it is in each configuration",
        tuple(
            Within(simulated, high=measured)
            for simulated, measured in zip(
                _changes("tension_ise", SIMULATION), _changes("tension_ise", TESTBED), strict=True
            )
        ),
    ),
    Claim(
        "tension-ise-10",
        "3.2",
        "For a force setpoint of 10 N, the tension ISE is reduced by 98.7%.",
        "in the simulation, by more than 95 %",
        (Within(change("tension_ise", SIMULATION, TEN), high=0.05),),
    ),
    Claim(
        "force-varies",
        "3.2",
        "Without tension control, the string force varies throughout the course of the measurement.",
        "over steps to 45 deg and back, the force of the triceps' string varies by more than the 10 % of its mean that "
        "its error margin is wide",
        _all([value(_key("force_range", TESTBED, PLAIN))], low=10.0),
    ),
    Claim(
        "isav-measured-inconsistent",
        "3.3",
        "For the measurements, the change of ISAV values compared to the configuration without tension control is not "
        "consistent.",
        "some of the six increase and some decrease",
        (
            Within(extreme(min, _MEASURED_ISAV, "least:"), high=DOWN),
            Within(extreme(max, _MEASURED_ISAV, "most:"), low=UP),
        ),
    ),
    Claim(
        "isav-measured-5",
        "3.3",
        "With tension control and a force setpoint of 5 N, the ISAV for the biceps decreases slightly while it "
        "increases for the triceps.",
        "the biceps' by up to 15 %",
        (
            Within(change("isav", TESTBED, FIVE, "biceps"), 0.85, DOWN),
            Within(change("isav", TESTBED, FIVE, "triceps"), low=UP),
        ),
    ),
    Claim(
        "isav-measured-10",
        "3.3",
        "For 10 N, the biceps' ISAV increases by a factor of 2.64 and the triceps' ISAV by 1.2",
        _HALF,
        (
            Within(change("isav", TESTBED, TEN, "biceps"), 1.82, 3.46),
            Within(change("isav", TESTBED, TEN, "triceps"), 1.1, 1.3),
        ),
    ),
    Claim(
        "isav-simulation",
        "3.3",
        "The simulations however show a decrease with the proposed control system for both",
        "for both drives, in each configuration",
        _all(_changes("isav", SIMULATION, DRIVES), high=DOWN),
    ),
    Claim(
        "isav-simulation-biceps",
        "3.3",
        "the biceps (relative decrease > 62%) [...]. This is consistent for all three control configurations with "
        "tension control.",
        "in each configuration",
        _all(_changes("isav", SIMULATION, ["biceps"]), high=0.38),
    ),
    Claim(
        "isav-simulation-triceps",
        "3.3",
        "the triceps drive's signal (relative decrease > 10%). This is consistent for all three control configurations "
        "with tension control.",
        "in each configuration",
        _all(_changes("isav", SIMULATION, ["triceps"]), high=0.9),
    ),
    Claim(
        "variable-simulation-rise",
        "3.4",
        "Simulations with variable joint stiffness showed a slight decrease in rise time [...], when compared to the "
        "other control configurations.",
        "by up to 15 %, against each",
        _all(_variable_to("rise_time", SIMULATION), 0.85, DOWN),
    ),
    Claim(
        "variable-simulation-position-ise",
        "3.4",
        "Simulations with variable joint stiffness showed a slight decrease in [...] position ISE, when compared to "
        "the other control configurations.",
        "by up to 5 %, against each",
        _all(_variable_to("position_ise", SIMULATION), 0.95, DOWN),
    ),
    Claim(
        "variable-simulation-tension-ise",
        "3.4",
        "It performed comparably to configurations with tension control regarding tension ISE",
        "within a factor of 2 of what 5 N and 10 N span",
        _near_the_constants("tension_ise"),
    ),
    Claim(
        "variable-simulation-isav",
        "3.4",
        "It performed comparably to configurations with tension control regarding [...] ISAV values.",
        "within a factor of 2 of what 5 N and 10 N span, for both drives",
        tuple(statement for drive in DRIVES for statement in _near_the_constants("isav", drive)),
    ),
    Claim(
        "variable-measured-rise",
        "3.4",
        "Measurements with variable stiffness showed an increase in rise time",
        "against each other configuration",
        _all(_variable_to("rise_time", TESTBED), low=UP),
    ),
    Claim(
        "variable-measured-tension-ise",
        "3.4",
        "Measurements with variable stiffness showed an increase in [...] tension ISE",
        "against each other configuration",
        _all(_variable_to("tension_ise", TESTBED), low=UP),
    ),
    Claim(
        "variable-measured-overshoot",
        "3.4",
        "which appeared due to larger overshoot.",
        "the joint overshoots visibly, by more than 0.5 deg, and more than in each other configuration",
        (
            Within(value(_key("overshoot", TESTBED, VARIABLE)), low=0.5),
            *(
                Within(value(_key("overshoot", TESTBED, VARIABLE)), low=value(_key("overshoot", TESTBED, other)))
                for other in (PLAIN, FIVE, TEN)
            ),
        ),
    ),
    Claim(
        "variable-measured-position-ise",
        "3.4",
        "Position ISE showed an average value comparable to the configurations without tension control and with "
        "tension control and a force setpoint of 5 N.",
        "within 5 % of both",
        _all(_variable_to("position_ise", TESTBED, (PLAIN, FIVE)), 0.95, 1.05),
    ),
    Claim(
        "variable-measured-isav-biceps",
        "3.4",
        "Biceps ISAV showed a large increase",
        "it more than doubles",
        (Within(change("isav", TESTBED, VARIABLE, "biceps"), low=2.0),),
    ),
    Claim(
        "variable-measured-isav-triceps",
        "3.4",
        "while triceps ISAV showed the lowest value of all compared configurations",
        "lower than in each other",
        tuple(
            Within(
                value(("isav", TESTBED, VARIABLE, "triceps"), NAMES[VARIABLE]),
                high=value(("isav", TESTBED, other, "triceps"), NAMES[other]),
            )
            for other in (PLAIN, FIVE, TEN)
        ),
    ),
    Claim(
        "switching-no-peaks",
        "3.5",
        "The position signal shows no visible peaks indicating that the alternating agonist would have a negative "
        "effect.",
        "the agonist switches, and within 0.2 s no switch moves the joint by more than the error margin of 2 deg away "
        "from where it would be without that switch",
        (*_SWITCHED, *_all(_switching("switch_deviation", "moved by"), high=PROTOCOL.position_margin_deg)),
    ),
    Claim(
        "switching-force-jumps",
        "3.5",
        "However, the force signal shows discontinuities when switching.",
        "what the tension controller is fed with jumps by more than 0.5 N, its error margin at 10 N",
        _all(_switching("force_jump", "jumps by"), low=0.5),
    ),
    Claim(
        "switching-force-oscillates",
        "3.5",
        "Note also the oscillatory behavior of the force signal.",
        "per step, it goes twice or more from one side of its error margin to the other",
        _all(_switching("force_swings", "swings per step:"), low=1.999),
    ),
    Claim(
        "discussion-rise",
        "4",
        "The addition of tension control [...]. Rise time is reduced slightly",
        "in the simulation, at 5 N and at 10 N, by up to 15 %",
        _all([change("rise_time", SIMULATION, name) for name in (FIVE, TEN)], 0.85, DOWN),
    ),
    Claim(
        "discussion-position-ise",
        "4",
        "The addition of tension control [...] position ISE is increased slightly.",
        "in the simulation, at 5 N and at 10 N, by up to 5 %",
        _all([change("position_ise", SIMULATION, name) for name in (FIVE, TEN)], UP, 1.05),
    ),
    Claim(
        "discussion-isav-biceps",
        "4",
        "ISAV for both the biceps and triceps drives is reduced [...]. The effect is more prominent in the biceps' "
        "ISAV.",
        "in the simulation, in each configuration",
        tuple(
            Within(change("isav", SIMULATION, name, drive), high=most)
            for name in WITH_TENSION
            for drive, most in (("triceps", DOWN), ("biceps", change("isav", SIMULATION, name, "triceps")))
        ),
    ),
    Claim(
        "discussion-tension-ise-setpoint",
        "4",
        "Especially with a higher tension setpoint, tension ISE was greatly decreased.",
        "in the simulation, 10 N more than halves it, and reduces it more than 5 N",
        (
            Within(change("tension_ise", SIMULATION, TEN), high=0.5),
            Within(change("tension_ise", SIMULATION, TEN), high=change("tension_ise", SIMULATION, FIVE)),
        ),
    ),
    Claim(
        "discussion-variable-simulation",
        "4",
        "Changing the joint stiffness dynamically is performed without any prominent changes in system behavior.",
        "in the simulation, against 5 N and 10 N, rise time within 15 % and position ISE within 5 %",
        (
            *_all(_variable_to("rise_time", SIMULATION, (FIVE, TEN)), 0.85, 1.15),
            *_all(_variable_to("position_ise", SIMULATION, (FIVE, TEN)), 0.95, 1.05),
        ),
    ),
    Claim(
        "discussion-measured-position-ise",
        "4",
        "In our measurements, [...] results are comparable or slightly worse than without tension control.",
        "position ISE up to 5 % smaller or 15 % larger",
        _all(_changes("position_ise", TESTBED), 0.95, 1.15),
    ),
    Claim(
        "discussion-measured-rise",
        "4",
        "In our measurements, [...] results are comparable or slightly worse than without tension control.",
        "rise time up to 15 % shorter or 35 % longer",
        _all(_changes("rise_time", TESTBED), 0.85, 1.35),
    ),
    Claim(
        "discussion-gains-rise",
        "4",
        "the controller gains cannot be set as high in the experimental setup as in the simulation [...], which leads "
        "to higher rise times",
        "in each configuration, against the simulation",
        _all(
            [ratio(_key("rise_time", TESTBED, name), _key("rise_time", SIMULATION, name)) for name in CONFIGURATIONS],
            1.0,
        ),
    ),
    Claim(
        "discussion-gains-isav",
        "4",
        "but also much lower ISAV values, when compared to simulation.",
        "less than a tenth, in each configuration, for both drives",
        _all(
            [
                ratio(("isav", TESTBED, name, drive), ("isav", SIMULATION, name, drive))
                for drive in DRIVES
                for name in CONFIGURATIONS
            ],
            high=0.1,
        ),
    ),
    Claim(
        "discussion-overshoot",
        "4",
        "Overshoot in the position signal followed by slight oscillations",
        "measured, with variable stiffness: more than 0.5 deg beyond the setpoint, then more than 0.1 deg short of it",
        (
            Within(value(_key("overshoot", TESTBED, VARIABLE), "beyond by"), low=0.5),
            Within(value(_key("swing_back", TESTBED, VARIABLE), "then short by"), low=0.1),
        ),
    ),
    Claim(
        "discussion-switching",
        "4",
        "Switching has only minor effects on the performance of position control.",
        "the agonist switches, and over the same moves position ISE is less than 5 % larger than with the biceps as "
        "agonist throughout",
        (
            *_SWITCHED,
            *_all(
                [
                    ratio(
                        _key("switching_ise", TESTBED, name),
                        _key("fixed_ise", TESTBED, name),
                        f"{NAMES[name]} position ISE",
                    )
                    for name in WITH_TENSION
                ],
                high=1.05,
            ),
        ),
    ),
    Claim(
        "conclusion-rise",
        "5.1",
        "Neither the simulation results nor the measurements exhibit reduced rise time",
        "on neither device, in no configuration",
        _all([*_changes("rise_time", SIMULATION), *_changes("rise_time", TESTBED)], low=DOWN),
    ),
    Claim(
        "conclusion-position-ise",
        "5.1",
        "Neither the simulation results nor the measurements exhibit reduced [...] position ISE",
        "on neither device, in no configuration",
        _all([*_changes("position_ise", SIMULATION), *_changes("position_ise", TESTBED)], low=DOWN),
    ),
    Claim(
        "conclusion-negligible",
        "5.1",
        "However, negative effects were negligible in simulations.",
        "rise time less than 15 % longer and position ISE less than 5 % larger, in each configuration",
        tuple(
            Within(change(metric, SIMULATION, name, label=f"{METRICS[metric]} {NAMES[name]}"), high=most)
            for metric, most in (("rise_time", 1.15), ("position_ise", 1.05))
            for name in WITH_TENSION
        ),
    ),
    Claim(
        "conclusion-stiffness",
        "5.1",
        "This allows for controlled, adjustable joint stiffness, independent of joint position.",
        "at rest, 10 N makes the joint more than 5 % stiffer than 5 N does, and at 45 deg its stiffness is within 5 % "
        "of that at 0 deg",
        tuple(
            statement
            for device in DEVICES
            for statement in (
                Within(
                    ratio(
                        _key("stiffness_at_rest", device, TEN),
                        _key("stiffness_at_rest", device, FIVE),
                        f"{device}, 10 N against 5 N",
                    ),
                    low=1.05,
                ),
                *_all(
                    [
                        ratio(
                            _key("stiffness_flexed", device, name),
                            _key("stiffness_at_rest", device, name),
                            f"{device} {NAMES[name]}, 45 deg against 0 deg",
                        )
                        for name in (FIVE, TEN)
                    ],
                    0.95,
                    1.05,
                ),
            )
        ),
    ),
)
"""All claims, in the paper's order."""


SUPPORTED, PARTLY, NOT, OPEN = "supported", "partly supported", "not supported", "open"

_NOMINAL, _MINIMUM, _ = (item.value for item in FIGURE_6)


@dataclass(frozen=True)
class Criterion:
    """A part of a hypothesis.

    Attributes
    ----------
    case : str
        Device, configuration or both that it is about.
    question : str
        What has to be the case there.
    holds : bool or None
        None if a number is missing.
    words : str
        The numbers that say so.
    """

    case: str
    question: str
    holds: bool | None
    words: str


@dataclass(frozen=True)
class Answer:
    """What our numbers say about a hypothesis.

    Attributes
    ----------
    number : int
    hypothesis : str
        The paper's words.
    verdict : {"supported", "partly supported", "not supported", "open"}
        All of the criteria hold; some do and some do not; none does; none fails, but some lack a number.
    criteria : tuple of Criterion
    paper : str
        What the paper concluded.
    """

    number: int
    hypothesis: str
    verdict: str
    criteria: tuple[Criterion, ...]
    paper: str


def answer_hypotheses(numbers: Numbers) -> tuple[Answer, ...]:
    """Answer the three hypotheses.

    Parameters
    ----------
    numbers : mapping
        Those of Tables 2-5 (`our_numbers`) and what was observed (`motion.observe`).
    """
    answers = []
    for number, (hypothesis, parts, paper) in enumerate(_HYPOTHESES, start=1):
        verdicts = [judge(statements, numbers) for *_, statements in parts]
        criteria = (
            Criterion(case, question, found.holds, found.words)
            for (case, question, _), found in zip(parts, verdicts, strict=True)
        )
        answers.append(Answer(number, hypothesis, _overall({found.holds for found in verdicts}), (*criteria,), paper))
    return tuple(answers)


def _overall(holds: set[bool | None]) -> str:
    if False in holds:
        return PARTLY if True in holds else NOT
    return OPEN if None in holds else SUPPORTED


def hypotheses_content(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """Return answers as JSON content."""
    return [
        {
            "number": answer.number,
            "hypothesis": answer.hypothesis,
            "verdict": answer.verdict,
            "criteria": [
                {"question": f"{item.case}: {item.question}", "holds": item.holds, "numbers": item.words}
                for item in answer.criteria
            ],
            "paper": answer.paper,
        }
        for answer in answers
    ]


_Part = tuple[str, str, Sequence[Within]]
"""Device or configuration, what has to be the case there, and the same as data."""


def _reduced(device: str, configuration: str) -> _Part:
    """Return what hypothesis 1 asks of a configuration on a device."""
    ratios = (
        ratio(_key(metric, device, configuration), _key(metric, device, PLAIN), METRICS[metric])
        for metric in ("rise_time", "position_ise")
    )
    return f"{device}, {NAMES[configuration]}", "both are reduced by more than 1 %", _all([*ratios], high=0.99)


def _softened(device: str) -> list[_Part]:
    """Return what hypothesis 2 asks of a device: in motion softer far from the setpoint, and because of eq. 6."""

    def softening(configuration: str) -> Quantity:
        far, near = (_key(f"stiffness_{where}", device, configuration) for where in ("far", "near"))
        return ratio(far, near, f"{NAMES[configuration]}: stiffness far against near")

    def tension(where: str, wanted: float) -> Within:
        measured = value(_key(f"tension_{where}", device, VARIABLE), f"tension {where}")
        return Within(measured, 0.75 * wanted, 1.25 * wanted)

    constants = [bound(softening(other), lambda softened: 0.95 * softened) for other in (FIVE, TEN)]
    return [
        (
            device,
            "with variable stiffness the joint is over 5 % softer far from the setpoint (error above d_offset) than "
            "near it (within 2 deg)",
            [Within(softening(VARIABLE), high=0.95)],
        ),
        (
            device,
            "eq. 6 causes that: at constant tensions the joint softens less, by 5 % or more",
            [Within(softening(VARIABLE), high=constant) for constant in constants],
        ),
        (
            device,
            f"it is controlled: the antagonist's tension is within 25 % of eq. 6's {_MINIMUM:g} N far from the "
            f"setpoint, and of its {_NOMINAL:g} N near it",
            [tension("far", _MINIMUM), tension("near", _NOMINAL)],
        ),
    ]


def _switched_smoothly(configuration: str) -> list[_Part]:
    """Return what hypothesis 3 asks of a configuration: the same moves, with and without switching."""
    switches, ise, fixed_ise, deviation = (
        _key(metric, TESTBED, configuration)
        for metric in ("switches", "switching_ise", "fixed_ise", "switch_deviation")
    )
    switched = Within(value(switches, "switches:"), low=0.0)
    return [
        (
            NAMES[configuration],
            "the agonist switches, and position ISE is less than 5 % larger than with the biceps as agonist throughout",
            [switched, Within(ratio(ise, fixed_ise, "position ISE"), high=1.05)],
        ),
        (
            NAMES[configuration],
            "no switch moves the joint by more than the error margin of 2 deg away from where it would be without that "
            "switch",
            [switched, Within(value(deviation, "moved by"), high=PROTOCOL.position_margin_deg)],
        ),
    ]


_HYPOTHESES: tuple[tuple[str, list[_Part], str], ...] = (
    (
        "Controlling the string tension has positive effects on position control: Rise time and position error are "
        "reduced",
        [_reduced(device, configuration) for device in DEVICES for configuration in WITH_TENSION],
        "\"Our results don't support hypothesis 1\": section 5.1. Yet in Tables 2 and 3 the simulation's variable "
        "stiffness reduces both a little.",
    ),
    (
        "Stiffness control allows for more biomimetic behavior: Joint stiffness is variable and controlled during "
        "motion, depending on the difference between desired and actual joint position",
        [item for device in DEVICES for item in _softened(device)],
        '"we don\'t see hypotheses 2 or 3 falsified": section 5.1. Figure 8 shows string forces; the paper gives '
        "no stiffness.",
    ),
    (
        "The proposed control allows for smooth switching of the agonistically acting drive: The switch does not "
        "negatively impact position control performance",
        [item for configuration in WITH_TENSION for item in _switched_smoothly(configuration)],
        '"we don\'t see hypotheses 2 or 3 falsified": section 5.1. Figure 9 shows no visible peaks of the '
        "position, and a force signal that jumps.",
    ),
)
