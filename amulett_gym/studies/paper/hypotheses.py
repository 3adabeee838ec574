"""The three hypotheses of section 1.2, answered by our numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from amulett_gym.studies.paper.claims import FIVE, PLAIN, TEN, TESTBED, VARIABLE, WITH_TENSION
from amulett_gym.studies.paper.motion import Key
from amulett_gym.studies.paper.statements import METRICS, NAMES, Numbers, Quantity, Within, bound, judge, ratio, value
from amulett_gym.studies.paper.tables import DEVICES, FIGURE_6, PROTOCOL

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
        Those of Tables 2-5 (`statements.our_numbers`) and what was observed (`motion.observe`).
    """
    return (
        _answer(
            1,
            "Controlling the string tension has positive effects on position control: Rise time and position error are "
            "reduced",
            [
                _criterion(
                    f"{device}, {NAMES[configuration]}",
                    "both are reduced by more than 1 %",
                    [
                        Within(
                            ratio(_key(metric, device, configuration), _key(metric, device, PLAIN), METRICS[metric]),
                            high=0.99,
                        )
                        for metric in ("rise_time", "position_ise")
                    ],
                    numbers,
                )
                for device in DEVICES
                for configuration in WITH_TENSION
            ],
            "\"Our results don't support hypothesis 1\": section 5.1. Yet in Tables 2 and 3 the simulation's variable "
            "stiffness reduces both a little.",
        ),
        _answer(
            2,
            "Stiffness control allows for more biomimetic behavior: Joint stiffness is variable and controlled during "
            "motion, depending on the difference between desired and actual joint position",
            [item for device in DEVICES for item in _stiffness_criteria(device, numbers)],
            '"we don\'t see hypotheses 2 or 3 falsified": section 5.1. Figure 8 shows string forces; the paper gives '
            "no stiffness.",
        ),
        _answer(
            3,
            "The proposed control allows for smooth switching of the agonistically acting drive: The switch does not "
            "negatively impact position control performance",
            [item for configuration in WITH_TENSION for item in _switching_criteria(configuration, numbers)],
            '"we don\'t see hypotheses 2 or 3 falsified": section 5.1. Figure 9 shows no visible peaks of the '
            "position, and a force signal that jumps.",
        ),
    )


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


def _stiffness_criteria(device: str, numbers: Numbers) -> list[Criterion]:
    """Return what hypothesis 2 asks of a device: in motion softer far from the setpoint, and because of eq. 6."""

    def softening(configuration: str) -> Quantity:
        far, near = (_key(f"stiffness_{where}", device, configuration) for where in ("far", "near"))
        return ratio(far, near, f"{NAMES[configuration]}: stiffness far against near")

    def tension(where: str) -> Quantity:
        return value(_key(f"tension_{where}", device, VARIABLE), f"tension {where}")

    return [
        _criterion(
            device,
            "with variable stiffness the joint is over 5 % softer far from the setpoint (error above d_offset) than "
            "near it (within 2 deg)",
            [Within(softening(VARIABLE), high=0.95)],
            numbers,
        ),
        _criterion(
            device,
            "that is eq. 6's doing: at constant tensions the joint softens less, by 5 % or more",
            [
                Within(softening(VARIABLE), high=bound(softening(other), lambda softened: 0.95 * softened))
                for other in (FIVE, TEN)
            ],
            numbers,
        ),
        _criterion(
            device,
            f"it is controlled: the antagonist's tension is within 25 % of eq. 6's {_MINIMUM:g} N far from the "
            f"setpoint, and of its {_NOMINAL:g} N near it",
            [
                Within(tension("far"), 0.75 * _MINIMUM, 1.25 * _MINIMUM),
                Within(tension("near"), 0.75 * _NOMINAL, 1.25 * _NOMINAL),
            ],
            numbers,
        ),
    ]


def _switching_criteria(configuration: str, numbers: Numbers) -> list[Criterion]:
    """Return what hypothesis 3 asks of a configuration: the same moves, with and without switching."""
    name = NAMES[configuration]
    switched = Within(value(_key("switches", TESTBED, configuration), "switches:"), low=0.0)
    ise = [_key(f"{kind}_ise", TESTBED, configuration) for kind in ("switching", "fixed")]
    return [
        _criterion(
            name,
            "the agonist switches, and position ISE is less than 5 % larger than with the biceps as agonist throughout",
            [switched, Within(ratio(ise[0], ise[1], "position ISE"), high=1.05)],
            numbers,
        ),
        _criterion(
            name,
            "no switch moves the joint by more than the error margin of 2 deg away from where it would be without that "
            "switch",
            [
                switched,
                Within(
                    value(_key("switch_deviation", TESTBED, configuration), "moved by"),
                    high=PROTOCOL.position_margin_deg,
                ),
            ],
            numbers,
        ),
    ]


def _criterion(case: str, question: str, statements: Sequence[Within], numbers: Numbers) -> Criterion:
    verdict = judge(statements, numbers)
    return Criterion(case, question, verdict.holds, verdict.words)


def _answer(number: int, hypothesis: str, criteria: Sequence[Criterion], paper: str) -> Answer:
    holds = [item.holds for item in criteria]
    if False in holds:
        verdict = PARTLY if True in holds else NOT
    else:
        verdict = OPEN if None in holds else SUPPORTED
    return Answer(number, hypothesis, verdict, tuple(criteria), paper)


def _key(metric: str, device: str, configuration: str) -> Key:
    return metric, device, configuration, None
