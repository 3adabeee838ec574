"""All that the paper's study shows on our devices, in one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from amulett_gym.paper.claims import CheckedClaim, check_claims
from amulett_gym.paper.hypotheses import Answer, answer_hypotheses
from amulett_gym.paper.motion import observe
from amulett_gym.paper.reproduction import Reproduction, Row, reproduce
from amulett_gym.paper.statements import our_numbers
from amulett_gym.paper.study import cross_check, shipped


@dataclass(frozen=True)
class Evidence:
    """All that the paper's study shows on our devices.

    Attributes
    ----------
    reproduction : Reproduction
    identification : dict
        How the parameters came about (`study.shipped`).
    predicted : dict of str to tuple of Row
        What the fits to three configurations predict for the fourth (`study.cross_check`).
    claims : tuple of CheckedClaim
    hypotheses : tuple of Answer
    """

    reproduction: Reproduction
    identification: dict[str, Any]
    predicted: dict[str, tuple[Row, ...]]
    claims: tuple[CheckedClaim, ...]
    hypotheses: tuple[Answer, ...]


def gather() -> Evidence:
    """Run the paper's protocol on the shipped devices, and try its claims and hypotheses."""
    reproduction = reproduce()
    identification = shipped()
    observed = observe(reproduction)
    return Evidence(
        reproduction,
        identification,
        cross_check(identification, reproduction.readings),
        check_claims(reproduction, observed),
        answer_hypotheses({**our_numbers(reproduction), **observed}),
    )
