"""All that the paper's study shows on our devices, in one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from amulett_gym.studies.paper.claims import CheckedClaim, check_claims
from amulett_gym.studies.paper.figures import remarks
from amulett_gym.studies.paper.hypotheses import Answer, answer_hypotheses
from amulett_gym.studies.paper.motion import ForceRise, force_rise_times, observe
from amulett_gym.studies.paper.own_study import OwnStudy
from amulett_gym.studies.paper.reproduction import Reproduction, Row, reproduce
from amulett_gym.studies.paper.sensitivity import Sensitivity, vary
from amulett_gym.studies.paper.statements import our_numbers
from amulett_gym.studies.paper.study import cross_check, shipped, spring_laws


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
    springs : dict of str to tuple of Row
        What the best fit with each spring law gives (`study.spring_laws`).
    claims : tuple of CheckedClaim
    hypotheses : tuple of Answer
    remarks : dict of str to str
        What the figures show on these devices, by the figures' names (`figures.remarks`).
    sensitivity : Sensitivity
        What the judgement calls are worth that no table decides (`sensitivity.vary`).
    force_rises : tuple of ForceRise
        The string force's rise times (`motion.force_rise_times`).
    folder : str or None
        Of the study that the devices come from; None for the shipped one.
    """

    reproduction: Reproduction
    identification: dict[str, Any]
    predicted: dict[str, tuple[Row, ...]]
    springs: dict[str, tuple[Row, ...]]
    claims: tuple[CheckedClaim, ...]
    hypotheses: tuple[Answer, ...]
    remarks: dict[str, str]
    sensitivity: Sensitivity
    force_rises: tuple[ForceRise, ...]
    folder: str | None = None


def gather(study: OwnStudy | None = None) -> Evidence:
    """Run the paper's protocol, and try its claims and hypotheses.

    Parameters
    ----------
    study : OwnStudy, optional
        Devices, and how they came about, in the place of the shipped ones (`own_study.read_study`).

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    reproduction = reproduce(None if study is None else study.profiles)
    identification = shipped() if study is None else study.identification
    observed = observe(reproduction)
    return Evidence(
        reproduction,
        identification,
        cross_check(identification, reproduction.readings),
        spring_laws(identification, reproduction.readings),
        check_claims(reproduction, observed),
        answer_hypotheses({**our_numbers(reproduction), **observed}),
        remarks(reproduction.profiles, reproduction.readings),
        vary(reproduction.profiles, reproduction.readings),
        force_rise_times(reproduction.profiles, reproduction.readings),
        None if study is None else study.folder,
    )
