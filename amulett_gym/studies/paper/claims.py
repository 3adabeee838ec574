"""Test of the paper's statements (sections 1.2, 3 to 5) against numbers: our own, or the paper's.

A claim is data: its text (``claims.yaml``), and quantities with bounds between which they have to lie. The same bounds
are tested on both sets of numbers, so that a sentence is found that the paper's own tables contradict. What a sentence
leaves open, such as "practically" or "slightly", is fixed by its ``taken_as``. The three hypotheses of section 1.2 are
answered by our numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from typing import Any

from amulett_gym.evaluation import metrics as registry
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.studies.paper.motion import UNITS, Key
from amulett_gym.studies.paper.reproduction import Reproduction
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, DRIVES, FIGURE_6, PROTOCOL, TABLES_2_TO_5

Numbers = Mapping[Key, float]
"""Metric, device, configuration and drive -> a number; missing numbers have no key."""

NAMES = dict(zip(CONFIGURATIONS, ("position only", "5 N", "10 N", "variable"), strict=True))
"""Configurations in words."""

METRICS = {name: registry.METRICS[name].name for name in ("rise_time", "position_ise", "tension_ise")} | {
    "isav": "ISAV"
}
"""Metrics of Tables 2-5 in words, in the order of the tables."""

_UNITS = {cell.metric: cell.unit for cell in TABLES_2_TO_5} | UNITS


@dataclass(frozen=True)
class Quantity:
    """A function of numbers: `of` returns its value, NaN if a number is missing; `say` its label, value and unit."""

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
    """Whether statements hold (None: a deciding number is missing), and the numbers behind that."""

    holds: bool | None
    words: str


def judge(statements: Sequence[Within], numbers: Numbers) -> Verdict:
    """Test statements, all of which have to be true, against numbers."""
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
    """A sentence of the paper, or a part of one: the `quote`, and `taken_as`, the condition under which it holds.

    `statements` are the same condition as data; all of them have to be true.
    """

    id: str
    section: str
    quote: str
    taken_as: str
    statements: Sequence[Within]


@dataclass(frozen=True)
class CheckedClaim:
    """A claim, tested on our numbers and on the paper's; None where its tables have no numbers about it."""

    claim: Claim
    ours: Verdict
    paper: Verdict | None

    @property
    def contradicted(self) -> bool:
        """Whether the paper's own tables contradict it."""
        return self.paper is not None and self.paper.holds is False


def check_claims(reproduction: Reproduction, observed: Numbers) -> tuple[CheckedClaim, ...]:
    """Test all claims on our numbers (`observed`: from `motion.observe`) and on the paper's own."""
    ours = {**our_numbers(reproduction), **observed}
    return tuple(check(claim, ours) for claim in CLAIMS)


def check(claim: Claim, ours: Numbers) -> CheckedClaim:
    """Test a claim on our numbers and on the paper's own."""
    published = paper_numbers()
    printed = not all(math.isnan(statement.quantity.of(published)) for statement in claim.statements)
    return CheckedClaim(claim, judge(claim.statements, ours), judge(claim.statements, published) if printed else None)


def claims_content(claims: Sequence[CheckedClaim]) -> list[dict[str, Any]]:
    """Return checked claims as JSON content; null: cannot be decided."""
    return [
        {
            **{key: getattr(item.claim, key) for key in ("id", "section", "quote", "taken_as")},
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
    """Return the number with variable stiffness over those of other configurations."""
    return tuple(
        ratio(
            _key(metric, device, VARIABLE),
            _key(metric, device, other),
            f"{METRICS[metric]} compared with {NAMES[other]}",
        )
        for other in others
    )


def _near_the_constants(metric: str, drive: str | None = None) -> Within:
    """State that variable stiffness's number in the simulation is within a factor of 2 of what 5 N and 10 N span."""
    name = " ".join([METRICS[metric], *([drive] if drive else [])])
    five, ten, variable = (
        value((metric, SIMULATION, configuration, drive), f"{name} {NAMES[configuration]}")
        for configuration in (FIVE, TEN, VARIABLE)
    )
    low = Quantity(lambda numbers: 0.5 * min(five.of(numbers), ten.of(numbers)), five.say)
    high = Quantity(lambda numbers: 2.0 * max(five.of(numbers), ten.of(numbers)), ten.say)
    return Within(variable, low, high)


def _switching(metric: str, label: str) -> tuple[Quantity, ...]:
    """Return what was observed on the testbed while the agonist switched."""
    return tuple(
        value(_key(metric, TESTBED, configuration), f"{NAMES[configuration]} {label}") for configuration in WITH_TENSION
    )


def _larger(metric: str, device: str, name: str, than: str) -> tuple[Within, ...]:
    """State that a configuration's change is larger than another one's."""
    return (Within(change(metric, device, name), low=change(metric, device, than)),)


def _ise_by_switching(configuration: str, label: str) -> Quantity:
    """Return the testbed's position ISE with the agonist switching over that with the biceps throughout."""
    return ratio(_key("switching_ise", TESTBED, configuration), _key("fixed_ise", TESTBED, configuration), label)


def _stiffness_is_adjustable(device: str) -> tuple[Within, ...]:
    """State that 10 N makes the joint over 5 % stiffer than 5 N, and that its angle changes stiffness by under 5 %."""
    at_rest, flexed = (
        {name: _key(f"stiffness_{where}", device, name) for name in (FIVE, TEN)} for where in ("at_rest", "flexed")
    )
    return (
        Within(ratio(at_rest[TEN], at_rest[FIVE], f"{device}, 10 N compared with 5 N"), low=1.05),
        *(
            Within(
                ratio(flexed[name], at_rest[name], f"{device} {NAMES[name]}, 45 deg compared with 0 deg"), 0.95, 1.05
            )
            for name in (FIVE, TEN)
        ),
    )


_MARGIN = PROTOCOL.position_margin_deg
_SWITCHED = _all(_switching("switches", "switches:"), 0.0)
_MOST = {device: extreme(max, _changes("position_ise", device), f"{device} at most") for device in DEVICES}
_BEST = {device: extreme(min, _changes("tension_ise", device), f"{device} at best") for device in DEVICES}
_RISE_DIFFERENCE = {
    name: difference(_key("rise_time", TESTBED, name), _key("rise_time", TESTBED, PLAIN)) for name in (FIVE, TEN)
}
_OVERSHOOT = {name: value(_key("overshoot", TESTBED, name)) for name in CONFIGURATIONS}
_MEASURED_ISAV = _changes("isav", TESTBED, DRIVES)

_STATEMENTS: dict[str, Sequence[Within]] = {
    "rise-simulation": _all(_changes("rise_time", SIMULATION), 0.85, 1.15),
    "rise-measured": _all(_changes("rise_time", TESTBED), low=UP),
    "rise-measured-5": (Within(_RISE_DIFFERENCE[FIVE], 0.375, 1.125),),
    "rise-measured-10": (Within(_RISE_DIFFERENCE[TEN], 0.05, 0.15),),
    "rise-measured-order": (Within(_RISE_DIFFERENCE[FIVE], low=_RISE_DIFFERENCE[TEN]),),
    "position-ise-simulation": _all(_changes("position_ise", SIMULATION), low=UP),
    "position-ise-measured": _all(_changes("position_ise", TESTBED), low=UP),
    "position-ise-more-measured": (
        Within(_MOST[TESTBED], low=UP),
        Within(_MOST[TESTBED], low=bound(_MOST[SIMULATION], lambda most: 1.0 + 2.0 * (most - 1.0))),
    ),
    "position-ise-most-measured": (Within(_MOST[TESTBED], 1.0615, 1.1845),),
    "position-ise-most-simulated": (Within(_MOST[SIMULATION], 1.0145, 1.0435),),
    "position-ise-measured-order": _larger("position_ise", TESTBED, TEN, FIVE),
    "position-ise-simulation-order": _larger("position_ise", SIMULATION, FIVE, TEN),
    "tension-ise-simulation": _all(_changes("tension_ise", SIMULATION), high=DOWN),
    "tension-ise-measured": _all(_changes("tension_ise", TESTBED), high=DOWN),
    "tension-ise-more-simulated": (Within(_BEST[SIMULATION], high=_BEST[TESTBED]),),
    "tension-ise-more-simulated-each": tuple(
        Within(change("tension_ise", SIMULATION, name), high=change("tension_ise", TESTBED, name))
        for name in WITH_TENSION
    ),
    "tension-ise-10": (Within(change("tension_ise", SIMULATION, TEN), high=0.05),),
    "force-varies": _all([value(_key("force_range", TESTBED, PLAIN))], low=10.0),
    "isav-measured-inconsistent": (
        Within(extreme(min, _MEASURED_ISAV, "least:"), high=DOWN),
        Within(extreme(max, _MEASURED_ISAV, "most:"), low=UP),
    ),
    "isav-measured-5": (
        Within(change("isav", TESTBED, FIVE, "biceps"), 0.85, DOWN),
        Within(change("isav", TESTBED, FIVE, "triceps"), low=UP),
    ),
    "isav-measured-10": (
        Within(change("isav", TESTBED, TEN, "biceps"), 1.82, 3.46),
        Within(change("isav", TESTBED, TEN, "triceps"), 1.1, 1.3),
    ),
    "isav-simulation": _all(_changes("isav", SIMULATION, DRIVES), high=DOWN),
    "isav-simulation-biceps": _all(_changes("isav", SIMULATION, ["biceps"]), high=0.38),
    "isav-simulation-triceps": _all(_changes("isav", SIMULATION, ["triceps"]), high=0.9),
    "variable-simulation-rise": _all(_variable_to("rise_time", SIMULATION), 0.85, DOWN),
    "variable-simulation-position-ise": _all(_variable_to("position_ise", SIMULATION), 0.95, DOWN),
    "variable-simulation-tension-ise": [_near_the_constants("tension_ise")],
    "variable-simulation-isav": [_near_the_constants("isav", drive) for drive in DRIVES],
    "variable-measured-rise": _all(_variable_to("rise_time", TESTBED), low=UP),
    "variable-measured-tension-ise": _all(_variable_to("tension_ise", TESTBED), low=UP),
    "variable-measured-overshoot": [
        Within(_OVERSHOOT[VARIABLE], low=0.5),
        *(Within(_OVERSHOOT[VARIABLE], low=_OVERSHOOT[other]) for other in (PLAIN, FIVE, TEN)),
    ],
    "variable-measured-position-ise": _all(_variable_to("position_ise", TESTBED, (PLAIN, FIVE)), 0.95, 1.05),
    "variable-measured-isav-biceps": (Within(change("isav", TESTBED, VARIABLE, "biceps"), low=2.0),),
    "variable-measured-isav-triceps": tuple(
        Within(
            value(("isav", TESTBED, VARIABLE, "triceps"), NAMES[VARIABLE]),
            high=value(("isav", TESTBED, other, "triceps"), NAMES[other]),
        )
        for other in (PLAIN, FIVE, TEN)
    ),
    "switching-no-peaks": _SWITCHED
    + _all(_switching("switch_deviation", "largest movement by a switch:"), high=_MARGIN),
    "switching-force-jumps": _all(_switching("force_jump", "force jumps by"), low=0.5),
    "switching-force-oscillates": _all(_switching("force_swings", "swings of the force per step:"), low=1.999),
    "discussion-rise": _all([change("rise_time", SIMULATION, name) for name in (FIVE, TEN)], 0.85, DOWN),
    "discussion-position-ise": _all([change("position_ise", SIMULATION, name) for name in (FIVE, TEN)], UP, 1.05),
    "discussion-isav-biceps": tuple(
        Within(change("isav", SIMULATION, name, drive), high=most)
        for name in WITH_TENSION
        for drive, most in (("triceps", DOWN), ("biceps", change("isav", SIMULATION, name, "triceps")))
    ),
    "discussion-tension-ise-setpoint": tuple(
        Within(change("tension_ise", SIMULATION, TEN), high=most)
        for most in (0.5, change("tension_ise", SIMULATION, FIVE))
    ),
    "discussion-variable-simulation": (
        *_all(_variable_to("rise_time", SIMULATION, (FIVE, TEN)), 0.85, 1.15),
        *_all(_variable_to("position_ise", SIMULATION, (FIVE, TEN)), 0.95, 1.05),
    ),
    "discussion-measured-position-ise": _all(_changes("position_ise", TESTBED), 0.95, 1.15),
    "discussion-measured-rise": _all(_changes("rise_time", TESTBED), 0.85, 1.35),
    "discussion-gains-rise": _all(
        [ratio(_key("rise_time", TESTBED, name), _key("rise_time", SIMULATION, name)) for name in CONFIGURATIONS], 1.0
    ),
    "discussion-gains-isav": _all(
        [
            ratio(("isav", TESTBED, name, drive), ("isav", SIMULATION, name, drive))
            for drive in DRIVES
            for name in CONFIGURATIONS
        ],
        high=0.1,
    ),
    "discussion-overshoot": (
        Within(value(_key("overshoot", TESTBED, VARIABLE), "overshoot"), low=0.5),
        Within(value(_key("swing_back", TESTBED, VARIABLE), "then below the setpoint by"), low=0.1),
    ),
    "discussion-switching": _SWITCHED
    + _all([_ise_by_switching(name, f"{NAMES[name]} position ISE") for name in WITH_TENSION], high=1.05),
    "conclusion-rise": _all([*_changes("rise_time", SIMULATION), *_changes("rise_time", TESTBED)], low=DOWN),
    "conclusion-position-ise": _all(
        [*_changes("position_ise", SIMULATION), *_changes("position_ise", TESTBED)], low=DOWN
    ),
    "conclusion-negligible": tuple(
        Within(change(metric, SIMULATION, name, label=f"{METRICS[metric]} {NAMES[name]}"), high=most)
        for metric, most in (("rise_time", 1.15), ("position_ise", 1.05))
        for name in WITH_TENSION
    ),
    "conclusion-stiffness": (*_stiffness_is_adjustable(SIMULATION), *_stiffness_is_adjustable(TESTBED)),
}
"""Id of a claim -> its statements. Changes "as printed" are taken to hold within half of the printed change."""


def _claims() -> tuple[Claim, ...]:
    with resources.as_file(resources.files("amulett_gym") / "studies" / "paper" / "claims.yaml") as path:
        texts = read_yaml(path, "claims")
    return tuple(Claim(name, **texts[name], statements=statements) for name, statements in _STATEMENTS.items())


CLAIMS = _claims()
"""All claims, in the paper's order."""

SUPPORTED, PARTLY, NOT, OPEN = "supported", "partly supported", "not supported", "open"

_NOMINAL, _MINIMUM, _ = (item.value for item in FIGURE_6)


@dataclass(frozen=True)
class Criterion:
    """A part of a hypothesis: the device or configuration, the condition there, whether it holds, and the numbers.

    `holds` is None if a number is missing.
    """

    case: str
    question: str
    holds: bool | None
    words: str


@dataclass(frozen=True)
class Answer:
    """The answer of our numbers to a hypothesis, and `paper`, what the paper concluded.

    The verdict is "supported" if all criteria hold, "partly supported" if only some do, "not supported" if none does,
    "open" if none fails but some lack a number.
    """

    number: int
    hypothesis: str
    verdict: str
    criteria: tuple[Criterion, ...]
    paper: str


def answer_hypotheses(numbers: Numbers) -> tuple[Answer, ...]:
    """Answer the three hypotheses by the numbers of Tables 2-5 (`our_numbers`) and those of `motion.observe`."""
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
            **asdict(answer),
            "criteria": [
                {"question": f"{item.case}: {item.question}", "holds": item.holds, "numbers": item.words}
                for item in answer.criteria
            ],
        }
        for answer in answers
    ]


_Part = tuple[str, str, Sequence[Within]]
"""Device or configuration, the condition there, and the same as data."""


def _reduced(device: str, configuration: str) -> _Part:
    """Return the criterion of hypothesis 1 for a configuration on a device."""
    ratios = (
        ratio(_key(metric, device, configuration), _key(metric, device, PLAIN), METRICS[metric])
        for metric in ("rise_time", "position_ise")
    )
    return (
        f"{device}, {NAMES[configuration]}",
        "rise time and position ISE are both over 1 % lower than with position-only control",
        _all([*ratios], high=0.99),
    )


def _softened(device: str) -> list[_Part]:
    """Return the criteria of hypothesis 2: in motion softer far from the setpoint, and because of eq. 6."""

    def softening(configuration: str) -> Quantity:
        far, near = (_key(f"stiffness_{where}", device, configuration) for where in ("far", "near"))
        label = f"{NAMES[configuration]}: stiffness far from the setpoint, compared with that near it:"
        return ratio(far, near, label)

    def tension(where: str, wanted: float) -> Within:
        label = {"far": "tension far from the setpoint", "near": "tension near it"}[where]
        measured = value(_key(f"tension_{where}", device, VARIABLE), label)
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
            "eq. 6 causes this: the stiffness far from the setpoint, divided by that near it, is over 5 % lower than "
            "with each constant tension",
            [Within(softening(VARIABLE), high=constant) for constant in constants],
        ),
        (
            device,
            f"the stiffness is controlled: the antagonist's tension is within 25 % of the values of eq. 6, "
            f"{_MINIMUM:g} N far from the setpoint and {_NOMINAL:g} N near it",
            [tension("far", _MINIMUM), tension("near", _NOMINAL)],
        ),
    ]


def _switched_smoothly(configuration: str) -> list[_Part]:
    """Return the criteria of hypothesis 3: the same moves, with and without switching."""
    switched = Within(value(_key("switches", TESTBED, configuration), "switches:"), low=0.0)
    moved = value(_key("switch_deviation", TESTBED, configuration), "largest movement by a switch:")
    return [
        (
            NAMES[configuration],
            "in the movements of Figure 9 the agonist switches, and position ISE is less than 5 % larger than if the "
            "biceps is always the agonist",
            [switched, Within(_ise_by_switching(configuration, "position ISE"), high=1.05)],
        ),
        (
            NAMES[configuration],
            "no switch moves the joint by more than the error margin of 2 deg, compared with the same motion without "
            "that switch",
            [switched, Within(moved, high=_MARGIN)],
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
