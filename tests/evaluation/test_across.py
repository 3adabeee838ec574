"""Comparisons over a fleet: what a comparison on each device gives, put together."""

import json

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation import remarks
from amulett_gym.evaluation.across import (
    device_table,
    evaluate_fleet,
    family_table,
    fleet_in_words,
    fleet_table,
    summarise_fleet,
)
from amulett_gym.evaluation.page import write_fleet_report, write_report
from amulett_gym.evaluation.remarks import device_remarks, fleet_remarks
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.contenders import Own
from amulett_gym.profile import load_profile

FLEET = ["testbed", {"name": "heavy", "base": "testbed", "plant": {"masses": [{"mass": 0.4, "arm": 0.13}]}}]
KEYWORDS = {"suite": "mixed", "episodes": 10, "duration": 2.0}


@pytest.fixture(scope="module")
def results():
    return evaluate_fleet(["constant:5", "constant:12"], FLEET, **KEYWORDS)


@pytest.fixture(scope="module")
def summary(results):
    return summarise_fleet(results)


def test_each_device_has_the_results_of_a_comparison_on_it(results):
    assert list(results.devices) == ["testbed", "heavy"]
    for device, profile in zip(results.devices, FLEET, strict=True):
        alone = evaluate(["constant:5", "constant:12"], profile=profile, **KEYWORDS)
        for name, metrics in alone.values.items():
            for metric, values in metrics.items():
                np.testing.assert_array_equal(results.devices[device].values[name][metric], values)
    assert (results.values("eq6", "cost")[0] != results.values("eq6", "cost")[1]).any()


def test_a_summary_is_of_sums_over_devices_and_scenarios(results, summary):
    costs = {name: results.values(name, "cost") for name in results.contenders}
    for name, cost in costs.items():
        found = summary["policies"][name]["cost"]
        assert found["mean"] == pytest.approx(cost.mean())
        assert found["ratio_to_eq6"]["mean"] == pytest.approx(cost.sum() / costs["eq6"].sum())
        for index, device in enumerate(results.devices):
            ratio = summary["devices"][device][name]["ratio_to_eq6"]
            assert ratio["mean"] == pytest.approx(cost[index].sum() / costs["eq6"][index].sum())
        ratios = [summary["devices"][device][name]["ratio_to_eq6"]["mean"] for device in results.devices]
        assert summary["worst_device"][name]["ratio_to_eq6"]["mean"] == max(ratios)
        assert summary["lower_than"][name]["eq6"] == sum(ratio < 1.0 for ratio in ratios)
    best = min(("constant:5", "constant:12"), key=lambda name: costs[name].sum())
    assert summary["constant"] == best
    assert summary["policies"]["eq6"]["cost"]["ratio_to_constant"]["mean"] == pytest.approx(
        costs["eq6"].sum() / costs[best].sum()
    )
    assert sum(family["scenarios"] for family in summary["families"].values()) == 10
    sums = [family["scenarios"] * family["policies"]["constant:5"]["mean"] for family in summary["families"].values()]
    assert sum(sums) == pytest.approx(10 * costs["constant:5"].mean())


def test_the_tables_name_every_device_family_and_contender(summary):
    assert [row[0] for row in device_table(summary).rows] == ["testbed", "heavy"]
    assert [row[0] for row in family_table(summary).rows] == list(summary["families"])
    assert [row[0] for row in fleet_table(summary).rows] == ["eq6", "constant:5", "constant:12"]
    words = " ".join(fleet_in_words(summary).split())
    assert "on 2 devices, in 10 held-out scenarios of mixed on each" in words
    assert "eq6 was not named" in words


def test_the_files_of_a_fleet_replace_those_of_one_device(results, tmp_path):
    write_report(evaluate(["eq6"], **{**KEYWORDS, "episodes": 1}), tmp_path)
    assert (tmp_path / "trade_off.png").exists()
    write_fleet_report(results, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"results.json", "scenarios.csv", "report.html", "devices.png"}
    assert json.loads((tmp_path / "results.json").read_text())["fleet"] == ["testbed", "heavy"]
    head, *rows = (tmp_path / "scenarios.csv").read_text().splitlines()
    assert head.startswith("policy,device,scenario,seed,failure,cost,")
    assert len(rows) == 3 * 2 * 10 and rows[10].startswith("eq6,heavy,0,0,")
    page = (tmp_path / "report.html").read_text()
    assert "2 devices" in page and "<svg" in page and "heavy" in page


def test_eq6_alone_and_functions_of_your_own_are_compared(tmp_path):
    short = {"suite": "steps", "episodes": 2, "duration": 1.0}
    write_fleet_report(evaluate_fleet(["eq6"], FLEET, **short), tmp_path)
    assert not (tmp_path / "devices.png").exists()
    seen = []
    own = Own("mine", act=lambda observations: seen.append(len(observations)) or np.zeros(len(observations)))
    assert summarise_fleet(evaluate_fleet([own], FLEET, **short))["constant"] is None
    assert len(seen) >= 2 * 50


def test_a_wrong_fleet_or_policy_is_refused():
    with pytest.raises(AmulettError, match="unknown fleet"):
        evaluate_fleet(["eq6"], "plausibel")
    with pytest.raises(AmulettError, match="unknown policy"):
        evaluate_fleet(["eq7"], FLEET)


def test_remarks_that_are_alike_on_several_devices_are_one():
    remarks = {
        "a-1": ["x ran once", "on the a-1, it swings by 2.5 deg", "on the a-1, it is slow"],
        "a-2": ["x ran once", "on the a-2, it swings by 3 deg"],
        "a-3": ["x ran once", "it is odd"],
    }
    assert fleet_remarks(remarks) == [
        "x ran once",
        "on the a-1, it swings by 2.5 deg (and 1 of the other devices: a-2)",
        "on the a-1, it is slow",
        "a-3: it is odd",
    ]


def test_what_of_each_device_is_outside_the_ranges_of_training_is_named_on_the_first():
    where = {"a-1": "within their ranges", "a-2": "outside their ranges in mass 2 (0 to 1)"}
    where |= {"a-3": "within their ranges", "a-4": "outside their ranges in mass 3 (0 to 1), lag 0.3 (0 to 0.2)"}
    remarks = {device: [f"p was trained without the {device}, which is {which}"] for device, which in where.items()}
    assert fleet_remarks(remarks) == [
        f"{remarks['a-1'][0]} (and 1 of the other devices: a-3)",
        f"{remarks['a-2'][0]} (and 1 of the other devices: a-4)",
    ]


def test_a_law_tuned_over_a_fleet_is_named_on_other_devices(monkeypatch):
    monkeypatch.setattr(remarks, "tuned_over", lambda name: "ours" if name == "parametric" else "")
    monkeypatch.setattr(remarks, "load_fleet", lambda name: load_fleet(["testbed"]))
    assert device_remarks(load_profile("testbed"), ["parametric", "eq6-tuned"]) == []
    for profile in (load_profile("simulation"), load_profile(FLEET[1])):
        found = device_remarks(profile, ["parametric"])
        remark = f"parametric acts with the parameters tuned over the fleet ours, not on the {profile.name}"
        assert [each for each in found if "parametric" in each] == [remark]
