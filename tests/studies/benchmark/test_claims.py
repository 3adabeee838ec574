"""Claims are judged by the numbers and their intervals, and told as open where nothing was measured."""

import copy

import pytest

from amulett_gym.studies.benchmark.claims import PAPER_METRICS, check_claims
from amulett_gym.studies.benchmark.page import verdict


def estimate(mean, low=None, high=None):
    return {"mean": mean, "low": mean - 0.02 if low is None else low, "high": mean + 0.02 if high is None else high}


def entry(against, ratio=0.6, failed=0, episodes=200):
    metrics = ("position_ise", "isav_biceps", "isav_triceps", "settling_time", "tension_ise")
    return {
        "ratio": {other: estimate(ratio) for other in against},
        "failures": {"count": failed, "total": episodes, "low": 0.0, "high": 0.02, "reasons": {}},
        "seed_ratios": {"parametric": [0.9] * 9 + [1.1]},
        "metrics": {metric: {**estimate(1.0), "ratio_to_eq6": estimate(0.9)} for metric in metrics},
    }


@pytest.fixture
def found():
    """Return results of a policy that shows everything."""
    against = ("eq6", "constant:6", "eq6-tuned", "parametric", "position-only")
    places = {f"mixed/{split}": {"ppo": entry(against), "eq6": entry(())} for split in ("held-out", "shifted")}
    goal = {
        "scenarios": 70,
        "ratio_to_eq6": estimate(0.5),
        "entries_to_eq6": {"ppo": estimate(0.62)},
        "share_from_hand": {"ppo": estimate(0.55)},
    }
    return {
        "best_learned": "ppo",
        "description": {"headline": "mixed"},
        "constants": {"overall": "constant:6"},
        "entries": {"ppo": {"kind": "learned"}, "eq6": {"kind": "law"}},
        "results": {**places, "paper-step/held-out": {"ppo": entry(())}},
        "references": {
            "from": "parametric",
            "clairvoyant": {"mixed": goal},
            "foresight": {"mixed": {**goal, "ratio_to_eq6": estimate(0.55), "share_from_hand": {"ppo": estimate(0.3)}}},
            "causal": {"causal": {"ratio_to_eq6": estimate(0.6), "share_from_hand": {"ppo": estimate(0.5)}}},
        },
        "training": {"ppo": {"runs": {str(seed): {"seconds": 200.0 + seed} for seed in range(10)}}},
    }


def failing(found):
    return [claim.claim for claim in check_claims(found) if claim.holds is False]


def test_a_policy_that_shows_everything_holds_every_claim(found):
    claims = check_claims(found)
    assert failing(found) == []
    assert sum(claim.holds for claim in claims if claim.holds is not None) == len(claims) - 2
    told, foreseen = (claim for claim in claims if claim.holds is None)
    assert "position-only" in told.claim and told.measured == 0.6
    assert "the foresight reference" in foreseen.claim and foreseen.measured == 0.3


def test_the_share_of_eq6_is_told_beside_what_the_references_cost(found):
    claim = check_claims(found)[0]
    beside = "(in 70 scenarios; ppo in these: 0.620)"
    told = f"clairvoyant 0.500 {beside}, foresight 0.550 {beside}, causal 0.600"
    assert claim.note == f"ratio of costs; references: {told}"
    found["references"].update(clairvoyant={}, foresight={}, causal={})
    assert check_claims(found)[0].note == "ratio of costs"


@pytest.mark.parametrize("other", ["constant:6", "eq6-tuned", "parametric"])
def test_it_costs_less_only_if_the_whole_interval_is_below_one(found, other):
    found["results"]["mixed/held-out"]["ppo"]["ratio"][other] = estimate(0.97, 0.93, 1.0)
    (claim,) = failing(found)
    assert claim.startswith("lower cost than")


def test_65_percent_are_the_most_of_eq6s_cost(found):
    found["results"]["mixed/held-out"]["ppo"]["ratio"]["eq6"] = estimate(0.65)
    assert failing(found) == []
    found["results"]["mixed/held-out"]["ppo"]["ratio"]["eq6"] = estimate(0.651)
    assert failing(found) == ["cost at most 0.65 of eq. 6's (as its text describes it)"]


def test_one_failure_more_than_any_contender_is_one_too_many(found):
    found["results"]["mixed/held-out"]["ppo"] = entry(("eq6", "constant:6", "eq6-tuned", "parametric"), failed=1)
    assert failing(found) == ["no more failures than any contender"]
    found["results"]["mixed/held-out"]["eq6"] = entry((), failed=1)
    assert failing(found) == []


def test_eight_seeds_of_ten_are_too_few(found):
    found["results"]["mixed/held-out"]["ppo"]["seed_ratios"]["parametric"] = [0.9] * 8 + [1.0, 1.1]
    assert failing(found) == ["at least 9 of 10 training seeds have a lower cost than parametric"]


def test_the_longest_training_counts(found):
    found["training"]["ppo"]["runs"]["3"]["seconds"] = 301.0
    assert failing(found) == ["one training takes at most 5 minutes on 2 cores"]


@pytest.mark.parametrize("metric", PAPER_METRICS)
def test_a_metric_of_the_papers_may_be_2_percent_worse_or_as_its_interval_says(found, metric):
    results = found["results"]["paper-step/held-out"]["ppo"]["metrics"][metric]
    for ratio, holds in (((1.019, 1.01, 1.03), True), ((1.03, 0.99, 1.07), True), ((1.03, 1.02, 1.04), False)):
        results["ratio_to_eq6"] = estimate(*ratio)
        assert (failing(found) == []) is holds


def test_shifted_scenarios_are_judged_by_their_own_intervals(found):
    found["results"]["mixed/shifted"]["ppo"]["ratio"]["eq6"] = estimate(0.99, 0.97, 1.01)
    (claim,) = [claim for claim in check_claims(found) if claim.holds is False]
    assert (claim.about, claim.claim) == ("mixed, shifted", "lower cost than eq. 6")


def test_what_was_not_measured_is_open_and_not_held(found):
    less = copy.deepcopy(found)
    for place in ("mixed/shifted", "paper-step/held-out"):
        del less["results"][place]
    less["references"].update(clairvoyant={}, foresight={}, causal={})
    opened = [claim for claim in check_claims(less) if claim.holds is None]
    assert {claim.about for claim in opened} == {"mixed, held-out", "mixed, shifted", "paper-step"}
    assert sum("at least half of the gap" in claim.claim for claim in opened) == 2
    assert all(claim.measured is None for claim in opened if claim.about != "mixed, held-out")


def test_without_anything_learned_nothing_is_claimed(found):
    assert check_claims({**found, "best_learned": None}) == []


def test_a_quick_run_judges_no_claim_and_says_on_what_it_stands(found):
    found["description"]["episodes"] = 20
    found["entries"]["ppo"]["seeds"] = [0, 1]
    for run in found["training"]["ppo"]["runs"].values():
        run["steps"] = 131_072
    results = found["results"]["mixed/held-out"]
    results["parametric"] = {"ratio": {"eq6": estimate(0.7)}}
    found["best_by_hand"] = "parametric"
    assert "claims are met" in verdict(found, check_claims(found))
    found["quick"] = True
    assert check_claims(found) == []
    text = verdict(found, [])
    assert "20 scenarios for each suite and 131,072 training steps for each seed. No claim is judged" in text
    assert "claims are met" not in text
