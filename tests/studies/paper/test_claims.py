"""What the paper says about its results is tried on our numbers and on its own, and either can fail."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import yaml

from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.profile import load_profile
from amulett_gym.studies.paper import claims as module
from amulett_gym.studies.paper.claims import (
    CLAIMS,
    WITH_TENSION,
    Within,
    answer_hypotheses,
    check,
    check_claims,
    claims_content,
    hypotheses_content,
    judge,
    our_numbers,
    paper_numbers,
    ratio,
    value,
)
from amulett_gym.studies.paper.motion import UNITS, observe
from amulett_gym.studies.paper.reproduction import MEASUREMENT_TIME, Reproduction, apply_readings, paper_step, reproduce
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES
from amulett_gym.tasks.suites import START

TEXTS = Path(module.__file__).with_name("claims.yaml")
"""The paper's words, and how they are taken."""

CONTRADICTED = {
    "position-ise-simulation",  # variable stiffness: 115.12 after 116.21
    "tension-ise-measured",  # variable stiffness: 2.03 after 0.98
    "tension-ise-more-simulated-each",  # at 5 N the measurements' is reduced more
    "isav-simulation-biceps",  # variable stiffness: 36866.3 of 89042.2 is a decrease of 58.6 %
    "discussion-measured-rise",  # at 5 N 1.84 s after 1.09 s
    "conclusion-rise",  # the simulation's is reduced in all three
    "conclusion-position-ise",  # as the first
}
"""Claims that the paper's own tables contradict."""

MOTIONS = {
    "force-varies",
    "variable-measured-overshoot",
    "switching-no-peaks",
    "switching-force-jumps",
    "switching-force-oscillates",
    "discussion-overshoot",
    "discussion-switching",
    "conclusion-stiffness",
}
"""Claims about motions: the tables have no number about them."""

OBSERVED = {
    ("force_range", "testbed", "position-only", None): 40.0,
    **{("overshoot", "testbed", name, None): 0.3 for name in CONFIGURATIONS},
    ("overshoot", "testbed", "variable", None): 3.0,
    ("swing_back", "testbed", "variable", None): 1.0,
    **{
        (metric, "testbed", name, None): value
        for name in WITH_TENSION
        for metric, value in {
            "switches": 6.0,
            "switch_deviation": 0.5,
            "force_jump": 1.5,
            "force_swings": 4.0,
            "switching_ise": 1010.0,
            "fixed_ise": 1000.0,
        }.items()
    },
    **{
        (f"stiffness_{metric}", device, name, None): 10.0 if name == "tension-10" else 8.0
        for metric in ("at_rest", "flexed", "near", "far")
        for device in DEVICES
        for name in CONFIGURATIONS
    },
    **{("stiffness_far", device, "variable", None): 4.0 for device in DEVICES},
    **{("tension_far", device, "variable", None): 4.5 for device in DEVICES},
    **{("tension_near", device, "variable", None): 9.5 for device in DEVICES},
}
"""Motions as the paper describes them."""


@pytest.fixture(scope="module")
def reproduction() -> Reproduction:
    return reproduce()


@pytest.fixture(scope="module")
def observed(reproduction) -> dict:
    return observe(reproduction)


@pytest.fixture(scope="module")
def claims(reproduction, observed):
    return check_claims(reproduction, observed)


def test_every_claim_says_where_it_stands_and_how_it_is_taken():
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)
    assert {claim.section for claim in CLAIMS} == {"3.1", "3.2", "3.3", "3.4", "3.5", "4", "5.1"}
    assert all(claim.quote and claim.taken_as and claim.statements for claim in CLAIMS)
    assert list(yaml.safe_load(TEXTS.read_text())) == [claim.id for claim in CLAIMS]


def test_every_claim_is_tried_on_our_numbers_and_on_the_papers(claims):
    assert [item.claim for item in claims] == list(CLAIMS)
    assert {item.claim.id for item in claims if item.paper is None} == MOTIONS
    assert all(item.ours.words for item in claims)
    json.dumps(claims_content(claims), allow_nan=False)


def test_the_papers_own_tables_contradict_seven_claims():
    checked = [check(claim, {}) for claim in CLAIMS]
    assert {item.claim.id for item in checked if item.contradicted} == CONTRADICTED
    assert all(item.paper is None or item.paper.holds is not None for item in checked)


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        ("rise-measured-5", "testbed 5 N +0.75 s"),
        ("position-ise-most-measured", "testbed at most +12.3 %"),
        ("position-ise-most-simulated", "simulation at most +2.9 %"),
        ("tension-ise-10", "simulation 10 N -98.7 %"),
        ("isav-measured-10", "testbed 10 N biceps ×2.64; testbed 10 N triceps +20.7 %"),
        ("isav-simulation-biceps", "simulation 5 N biceps -62.6 %"),
    ],
)
def test_the_papers_sentences_follow_from_its_tables(claim, words):
    item = next(check(item, {}) for item in CLAIMS if item.id == claim)
    assert words in item.paper.words


def test_without_a_number_a_claim_is_undecided(claims):
    for claim in CLAIMS:
        assert check(claim, {}).ours.holds is None
    assert "has no number" in check(CLAIMS[0], {}).ours.words


TURNS = {
    "isav-measured-inconsistent": {("isav", "testbed", name, "biceps"): 100.0 for name in ("tension-5", "variable")}
    | {("isav", "testbed", "variable", "triceps"): 6500.0},
    "discussion-measured-rise": {("rise_time", "testbed", name, None): 1.2 for name in ("tension-5", "variable")},
}
"""Numbers that turn a claim which no single number turns."""


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.id)
def test_every_claim_can_hold_and_can_fail(claim):
    """From the paper's own numbers, and motions as it describes them, one number changed is enough for most."""
    numbers = {**paper_numbers(), **OBSERVED}
    holds = judge(claim.statements, numbers).holds
    assert holds is (claim.id not in CONTRADICTED)
    changes = [{key: factor * numbers[key]} for key in numbers for factor in (0.001, 0.2, 0.8, 0.97, 1.03, 1.25, 5.0)]
    turned = {judge(claim.statements, numbers | change).holds for change in [*changes, TURNS.get(claim.id, {})]}
    assert turned == {True, False}


def test_bounds_are_excluded_and_a_missing_number_decides_nothing():
    key, other = ("rise_time", "testbed", "variable", None), ("rise_time", "testbed", "tension-5", None)
    assert judge([Within(value(key), 1.0, 2.0)], {key: 1.5}).holds is True
    assert judge([Within(value(key), 1.0, 2.0)], {key: 1.0}).holds is False
    assert judge([Within(value(key), low=value(other))], {key: 1.0}).holds is None
    assert judge([Within(value(key), 2.0), Within(value(other))], {key: 1.0}).holds is False
    assert math.isnan(ratio(key, other).of({key: 1.0, other: 0.0}))


def test_what_is_observed_has_units_and_is_finite(observed):
    assert {metric for metric, *_ in observed} == set(UNITS)
    assert all(math.isfinite(number) for number in observed.values())


@pytest.mark.parametrize("device", DEVICES)
def test_overshoot_and_stiffness_are_those_that_the_environment_reports(reproduction, observed, device):
    profile = apply_readings(reproduction.profiles[device], reproduction.readings)
    protocol = Protocol(profile, "paper-step", episodes=1, duration=START + MEASUREMENT_TIME)
    episode = record_episode("constant:10", protocol, paper_step(profile, "tension-10"))
    overshoot = observed["overshoot", device, "tension-10", None]
    assert overshoot == pytest.approx(episode.metrics["overshoot"], abs=1e-5)
    resting = observed["stiffness_near", device, "tension-10", None]
    assert resting == pytest.approx(episode.metrics["resting_stiffness"], rel=0.01)


def test_a_device_that_fails_is_not_observed(reproduction):
    frail = load_profile({"name": "frail", "base": "simulation", "plant": {"velocity_limit_deg": 100.0}})
    profiles = {"simulation": frail, "testbed": frail}
    assert observe(Reproduction(profiles, reproduction.readings, (), {})) == {}


def test_by_the_papers_own_numbers_hypothesis_1_is_not_supported():
    answers = answer_hypotheses(paper_numbers())
    assert [answer.verdict for answer in answers] == ["not supported", "open", "open"]


def test_each_hypothesis_can_be_supported_partly_supported_and_not_supported():
    changes = {
        key: (0.5 if key[2] != "position-only" else 1.0)
        for key in paper_numbers()
        if key[0] in ("rise_time", "position_ise")
    }
    numbers = {**changes, **OBSERVED}
    assert [answer.verdict for answer in answer_hypotheses(numbers)] == ["supported"] * 3
    worse = {
        ("rise_time", "testbed", "tension-5", None): 1.5,
        ("stiffness_far", "testbed", "variable", None): 9.0,
        ("switch_deviation", "testbed", "variable", None): 3.0,
    }
    assert [answer.verdict for answer in answer_hypotheses(numbers | worse)] == ["partly supported"] * 3
    contrary = {key: 2.0 for key in changes if key[2] != "position-only"}
    contrary |= {("stiffness_far", device, "variable", None): 12.0 for device in DEVICES}
    contrary |= {("tension_far", device, "variable", None): 10.0 for device in DEVICES}
    contrary |= {("switches", "testbed", name, None): 0.0 for name in WITH_TENSION}
    answers = answer_hypotheses(numbers | contrary)
    assert [answer.verdict for answer in answers] == ["not supported"] * 3


def test_our_answers_name_their_numbers(reproduction, observed):
    answers = answer_hypotheses({**our_numbers(reproduction), **observed})
    assert [answer.number for answer in answers] == [1, 2, 3]
    assert all(item.words for answer in answers for item in answer.criteria)
    json.dumps(hypotheses_content(answers), allow_nan=False)
