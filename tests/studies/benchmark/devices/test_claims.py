"""Claims about devices are judged by counts, intervals and families."""

import copy

import pytest

from amulett_gym.studies.benchmark.devices.claims import check_claims


def estimate(mean, width=0.02):
    return {"mean": mean, "low": mean - width, "high": mean + width}


@pytest.fixture
def found():
    """Return results of a policy that holds every claim."""
    others = {"eq6": 0.8, "best-constant": 0.9, "eq6-tuned": 0.95, "parametric": 0.96, "own-constant": 0.93}
    ratios = {**others, "specialist": 1.03}
    mine = {
        "ratio": {name: estimate(ratio) for name, ratio in ratios.items()},
        "lower_on": {name: {"count": 26, "devices": 32} for name in others} | {"eq6": {"count": 32, "devices": 32}},
        "devices": 32,
        "worst": {"device": "held-out-07", "ratio_to_eq6": 0.97},
    }
    laws = ["eq6", "best-constant", "eq6-tuned", "parametric"]
    adapted = {
        f"held-out-0{k}": {"start": 1.0, "adapted": 0.9, "own-constant": 0.95, "seconds": 60.0, "best_steps": 1000}
        for k in range(8)
    }
    for k in (2, 5):
        adapted[f"held-out-0{k}"]["adapted"] = 0.97
    return {
        "best_learned": "robust",
        "laws": laws,
        "constants": {"tuned": 5.25},
        "results": {"robust": mine, "specialist": {"devices": 4}},
        "families": {
            family: {"ratio_of_learned": dict.fromkeys(laws, estimate(0.99))} for family in ("reach", "track")
        },
        "adaptation": adapted,
        "training": {"robust": {"runs": {str(seed): {"seconds": 600.0 + seed} for seed in range(10)}}},
    }


def failing(found):
    return [claim.claim for claim in check_claims(found) if claim.holds is False]


def test_a_policy_that_shows_everything_holds_every_claim(found):
    claims = check_claims(found)
    assert failing(found) == []
    assert sum(claim.holds is True for claim in claims) == 10
    assert [claim.claim for claim in claims if claim.holds is None] == [
        "cost relative to eq. 6, overall",
        "cost relative to eq6-tuned, tuned on the training devices, overall",
    ]


def test_eq6_with_other_gains_is_reported(found):
    found["eq6_gains"] = "testbed-tuned"
    found["results"]["robust"]["ratio"]["eq6-with-gains"] = estimate(0.96)
    found["results"]["best-constant"] = {"ratio": {"eq6-with-gains": estimate(0.97)}}
    reported = [(claim.claim, claim.measured) for claim in check_claims(found) if claim.holds is None][-2:]
    text = "relative to eq. 6 in the paper's loop with the gains of testbed-tuned, overall"
    assert reported == [(f"cost {text}", 0.96), (f"the best constant (5.25 N), {text}", 0.97)]


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        (("results", "robust", "lower_on", "eq6", "count"), 31, "on every device"),
        (("results", "robust", "lower_on", "parametric", "count"), 25, "on at least 26 devices"),
        (
            ("results", "robust", "lower_on", "best-constant", "count"),
            25,
            "(5.25 N), tuned on the training devices, on",
        ),
        (("results", "robust", "ratio", "parametric"), estimate(0.99), "the richer law"),
        (("results", "robust", "ratio", "own-constant"), estimate(0.99), "of that very device, overall"),
        (("results", "robust", "ratio", "specialist"), estimate(1.06), "a specialist"),
        (("families", "track", "ratio_of_learned", "parametric"), estimate(1.03), "no family"),
        (("adaptation", "held-out-01", "adapted"), 0.96, "adapted within 60 s"),
        (("adaptation", "held-out-01", "best_steps"), 0, "adapted within 60 s"),
        (("adaptation", "held-out-01", "seconds"), 61.0, "adapted within 60 s"),
        (("training", "robust", "runs", "3", "seconds"), 901.0, "15 minutes"),
    ],
)
def test_each_number_decides_its_claim(found, path, value, text):
    changed = copy.deepcopy(found)
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    (claim,) = failing(changed)
    assert text in claim


def test_a_family_is_lost_only_beyond_the_interval(found):
    found["families"]["reach"]["ratio_of_learned"]["eq6-tuned"] = estimate(1.01)
    assert failing(found) == []
    found["families"]["reach"]["ratio_of_learned"]["eq6-tuned"] = estimate(1.03)
    claim = next(claim for claim in check_claims(found) if claim.about == "families")
    assert claim.measured == 1.0 and "reach to eq6-tuned (1.030 [1.010, 1.050])" in claim.note


def test_nothing_is_judged_on_a_quick_run(found):
    assert check_claims({**found, "quick": True}) == []
