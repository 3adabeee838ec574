"""The registry of metrics covers all that is reported, and all lists of metrics read from it."""

import numpy as np
import pytest

from amulett_gym.envs.prices import divisors
from amulett_gym.envs.transition import METRICS as RAW
from amulett_gym.evaluation.metrics import (
    CONTROL_TERMS,
    COST_OF,
    COSTS,
    EFFORT_OF,
    METRICS,
    UNITS,
    capped_cost,
    control_cost,
    control_prices,
    derive,
)
from amulett_gym.evaluation.page import _DETAILS
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.studies.benchmark.claims import PAPER_METRICS
from amulett_gym.studies.benchmark.results import REPORTED


def test_every_metric_of_the_environment_and_every_derived_one_is_registered():
    raw = {key: np.ones(2) for key in RAW}
    derived = derive(raw, np.zeros(2), np.ones((2, len(COSTS) - 1)), np.ones((2, len(CONTROL_TERMS))))
    assert {*derived, "return"} == set(METRICS) == set(UNITS)
    assert [metric.key for metric in METRICS.values()] == list(METRICS)


def test_names_are_unique_and_everything_is_defined():
    assert len({metric.name for metric in METRICS.values()}) == len(METRICS)
    assert all(metric.meaning and metric.unit for metric in METRICS.values())


@pytest.mark.parametrize(
    "keys", [_DETAILS, REPORTED, PAPER_METRICS, COST_OF.values(), EFFORT_OF.values(), CONTROL_TERMS.values()]
)
def test_lists_of_metrics_hold_keys_of_the_registry(keys):
    assert set(keys) <= set(METRICS)


def test_a_metric_is_shown_with_its_unit_and_digits():
    assert METRICS["position_ise"].heading == "position ISE [deg2 s]"
    assert METRICS["position_ise"].text(2268.94) == "2269"
    assert METRICS["effort"].text(2268.94) == "2270"
    assert METRICS["settling_time"].paper_heading == "rise time (last entry) [s]"
    assert METRICS["failed"].heading == "failed"


def test_the_two_costs_are_two():
    raw = {key: np.array([3.0]) for key in RAW}
    values = derive(raw, np.zeros(1), np.full((1, len(COSTS) - 1), 0.5), np.full((1, 3), 0.2)) | {
        "return": np.array([-1.0])
    }
    assert values["cost"] == pytest.approx(0.5 * (3.0 + 6.0 + 3.0 + 3.0))
    assert capped_cost(values) == 1.0
    assert values["control_cost"] == pytest.approx(0.2 * (3.0 + 3.0 + 3.0))


@pytest.mark.parametrize("suite", ["paper-step", "contact", "mixed"])
def test_eq6_costs_about_1_in_full_control(suite):
    values = evaluate(["eq6"], suite=suite, split="train", episodes=300).values["eq6"]
    assert values["control_cost"].mean() == pytest.approx(1.0, abs=0.12)


def test_the_full_control_cost_is_of_position_drive_effort_contact_and_failure():
    profile = load_profile("testbed")
    table = control_prices(profile, "mixed")
    row = dict(zip(CONTROL_TERMS, table[FAMILIES.index("contact")], strict=True))
    assert row["effort"] * divisors(profile, "mixed", "contact", "full-control")["effort"] == pytest.approx(0.3 / 0.95)
    assert row["contact"] * divisors(profile, "mixed", "contact")["contact"] == pytest.approx(0.3 / 0.95)
    raw = {"position_ise": np.array([2.0]), "drive_effort": np.array([3.0]), "contact_ise": np.array([5.0])}
    assert control_cost(raw, np.array([7.0]), np.array([[1.0, 10.0, 100.0]])) == 2.0 + 30.0 + 500.0 + 7.0
