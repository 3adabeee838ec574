"""Paired comparisons: the same scenarios for all, honest costs, stable files."""

import csv
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import keep_network

from amulett_gym.cli import Parser
from amulett_gym.cli.evaluate import add_arguments, run
from amulett_gym.envs.prices import divisors
from amulett_gym.envs.reward import DEFAULT_WEIGHTS
from amulett_gym.envs.transition import MAY_BE_MISSING, METRICS, OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation import motion_plots, plots, runner
from amulett_gym.evaluation.comparison import in_words, summarise, table, verdict, write_scenarios
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.metrics import UNITS, failure_cost
from amulett_gym.evaluation.page import write_report
from amulett_gym.evaluation.remarks import device_remarks
from amulett_gym.evaluation.runner import Protocol, Results, evaluate
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.profile import load_profile
from amulett_gym.reporting import style
from amulett_gym.reporting.words import number, pretty, span
from amulett_gym.storage.provenance import COMMAND
from amulett_gym.tasks.suites import families_of

FRAGILE = {"base": "testbed", "name": "fragile", "plant": {"velocity_limit_deg": 135.0}}
"""A device on which eq. 6 fails now and then, and constant:10 never."""

FILES = {"results.json", "scenarios.csv", "report.html", "cost.png", "trade_off.png", "responses.png", "schedule.png"}


@pytest.fixture(scope="module")
def results() -> Results:
    return evaluate(["constant:10", "position-only", "eq6-held"], episodes=6, seed=3)


@pytest.fixture(scope="module")
def fragile() -> Results:
    return evaluate(["eq6", "constant:10"], profile=FRAGILE, episodes=12)


@pytest.fixture
def bundle(tmp_path):
    """Write a policy that always wants 12 N, acts every 40 ms, and was trained from 2 to 14 N."""
    layers = [(np.zeros((1, len(OBSERVATIONS)), np.float32), np.array([2 / 3], np.float32))]
    return str(keep_network(tmp_path / "mine" / "best", layers, tension_range=[2.0, 14.0], agent_period=0.04))


def command(*words: str) -> int:
    parser = Parser()
    add_arguments(parser)
    return run(parser.parse_args(words))


def test_every_policy_meets_the_same_scenarios_and_noise(monkeypatch):
    met = []
    make = runner._make

    def spy(protocol, contender):
        env = make(protocol, contender)
        env.reset(seed=protocol.seed)
        met.append((protocol.suite, [scenario.model_dump() for scenario in env.scenarios]))
        return env

    monkeypatch.setattr(runner, "_make", spy)
    evaluate(["constant:10", "position-only"], episodes=3, duration=0.1)
    for suite in ("steps", "hold-push"):
        scenarios = [scenarios for name, scenarios in met if name == suite]
        assert len(scenarios) == 3
        assert scenarios[0] == scenarios[1] == scenarios[2]
        assert scenarios[0][0] != scenarios[0][1]


def test_eq6_always_runs_and_is_exactly_its_own_yardstick(results):
    summary = summarise(results)
    assert list(summary["policies"]) == ["eq6", "constant:10", "position-only", "eq6-held"]
    assert summary["yardstick"] == {"name": "eq6", "listed": False}
    for metric, entry in summary["policies"]["eq6"].items():
        ratio = entry["ratio_to_eq6"]
        assert ratio in ({"mean": 1.0, "low": 1.0, "high": 1.0}, {"mean": None, "low": None, "high": None}), metric
    assert summary["policies"]["eq6"]["cost"]["ratio_to_eq6"]["mean"] == 1.0


def test_eq6_counts_as_listed_if_a_contender_is_given_for_it():
    found = evaluate(["constant:10", parse_contender("eq6")], episodes=1)
    assert found.listed and [*found.values] == ["constant:10", "eq6"]


def test_a_policy_that_is_listed_twice_runs_once(bundle):
    run = bundle.removesuffix("/best")
    results = evaluate(["eq6", "eq6", "constant:10", "constant:10.0", run, bundle], episodes=1, duration=0.12)
    assert list(results.values) == ["eq6", "constant:10", run]
    assert results.remarks[:2] == [
        "constant:10.0 is the same as constant:10, and ran once",
        f"{bundle} is the same as {run}, and ran once",
    ]


def test_a_policy_from_elsewhere_is_told_apart(bundle):
    assert evaluate([bundle], episodes=1, duration=0.12).remarks == []
    strange = {"base": "testbed", "name": "mine", "loop": {"offset_deg": 25.0}}
    results = evaluate([bundle], suite="reach", profile=strange, episodes=1, duration=0.6, env_id="Amulett/Tension-v0")
    assert results.remarks == [
        "mine was trained on the testbed, not the mine; for steps, not reach",
        *device_remarks(load_profile(strange)),
    ]
    summary = summarise(results)
    assert (summary["cost"]["divisors_of"], summary["cost"]["divisors_are"]) == ("mine", "measured")
    assert summary["cost"]["divisors"]["reach"] == divisors(load_profile(strange), "reach")
    printed = in_words(summary)
    assert max(map(len, printed.splitlines())) <= 80
    assert all(remark in " ".join(printed.split()) for remark in results.remarks)


@pytest.mark.parametrize(
    ("keywords", "note"),
    [
        ({"scenarios": [{"moves": []}]}, "measured on the suite hold-push: these have no pushes."),
        ({"suite": "steps"}, "measured on the suite hold-push: steps has no pushes."),
        ({"suite": "hold-push"}, None),
        ({"scenarios": [{"pushes": [{"time": 0.1, "duration": 0.1, "torque": 0.1}]}]}, None),
    ],
)
def test_where_pushes_were_measured_is_printed(keywords, note):
    printed = " ".join(in_words(summarise(evaluate(["eq6"], episodes=1, duration=0.4, **keywords))).split())
    assert ("push deflection was measured" in printed) == (note is not None)
    assert (note or "") in printed


def test_a_failure_where_pushes_were_measured_is_told(fragile):
    results = replace(fragile, push_failures={"eq6": 0, "constant:10": 3})
    assert "constant:10 failed in 3 of 12 on hold-push" in verdict(results)
    assert "constant:10: 3 of 12 on hold-push" in write_page(results)
    frail = {**FRAGILE, "plant": {"velocity_limit_deg": 20.0}}
    assert evaluate(["eq6"], profile=frail, episodes=4).push_failures["eq6"] > 0


def test_a_ratio_gets_the_digits_that_tell_it_from_1():
    def ratio(mean, low, high):
        return span({"mean": mean, "low": low, "high": high})

    assert ratio(1.0, 1.0, 1.0) == "1.00 [1.00, 1.00]"
    assert ratio(0.9, 0.8, 1.0) == "0.900 [0.800, 1.00]"
    assert ratio(1.0002, 1.0001, 1.0003) == "1.0002 [1.0001, 1.0003]"
    assert ratio(1.0 + 1e-9, 1.0, 1.0 + 2e-9) == "practically 1"
    assert ratio(0.9, None, None) == "0.900"
    assert ratio(None, None, None) == "-"


def test_the_cost_is_the_weighted_sum_of_raw_metrics_over_the_divisors(results):
    paid = divisors(results.protocol.profile, "steps")
    for values in results.values.values():
        expected = (
            DEFAULT_WEIGHTS["position"] * values["position_ise"] / paid["position"]
            + DEFAULT_WEIGHTS["effort"] * (values["effort_biceps"] + values["effort_triceps"]) / paid["effort"]
            + DEFAULT_WEIGHTS["tension"] * values["tension_ise"] / paid["tension"]
            + DEFAULT_WEIGHTS["contact"] * values["contact_ise"] / paid["contact"]
        )
        np.testing.assert_allclose(values["cost"], expected, rtol=1e-12)
        terms = sum(values[f"cost_{term}"] for term in ("position", "effort", "tension", "contact", "failure"))
        np.testing.assert_allclose(values["cost"], terms, rtol=1e-12)


def test_in_a_mix_the_cost_is_that_of_the_scenarios_family_as_in_the_reward():
    mixed = evaluate(["constant:10"], suite="mixed", episodes=20)
    np.testing.assert_allclose(mixed.values["constant:10"]["return"], -mixed.values["constant:10"]["cost"])
    protocol = replace(mixed.protocol, seed=4)
    assert record_episode("constant:10", protocol).metrics["cost"] == mixed.values["constant:10"]["cost"][4]
    told = summarise(mixed)["cost"]
    assert list(told["weights"]) == list(told["divisors"]) == families_of("mixed")
    assert told["weights"]["contact"]["contact"] > told["weights"]["reach"]["contact"] == 0.0


def test_without_a_failure_or_a_capped_step_the_return_is_minus_the_cost(results):
    np.testing.assert_allclose(results.values["constant:10"]["return"], -results.values["constant:10"]["cost"])


@pytest.mark.parametrize("name", ["eq6", "position-only", "eq6-held"])
def test_the_recorded_episode_is_the_compared_one_bit_for_bit(results, name):
    episode = record_episode(name, results.protocol)
    for metric, value in episode.metrics.items():
        if metric != "push_deflection":  # measured on another suite
            assert value == results.values[name][metric][0] or math.isnan(value), metric


def test_a_failure_costs_more_than_any_way_of_going_on(fragile):
    failed = fragile.values["eq6"]["failed"] == 1.0
    assert 0 < failed.sum() < failed.size
    assert [reason != "" for reason in fragile.failures["eq6"]] == failed.tolist()
    assert fragile.failures["constant:10"] == [""] * failed.size
    costs = fragile.values["eq6"]["cost"]
    assert costs[failed].min() > costs[~failed].max()
    assert (fragile.values["eq6"]["position_ise"][failed] > 0.0).all()


def test_a_failure_is_charged_as_by_the_reward(fragile):
    # Nothing else in these episodes is capped, so return and cost differ by nothing.
    np.testing.assert_allclose(fragile.values["eq6"]["return"], -fragile.values["eq6"]["cost"])


def test_failure_cost_counts_the_steps_that_were_left():
    assert failure_cost(9.99, 10.0, 0.02) == 1.0
    assert failure_cost(10.0, 10.0, 0.02) == 1.0
    assert failure_cost(5.0, 10.0, 0.02) == 250.0
    assert failure_cost(5.019, 10.0, 0.02) == 250.0


def test_a_recorded_episode_ends_with_its_failure(fragile):
    seed = fragile.failures["eq6"].index("joint velocity limit")
    episode = record_episode("eq6", Protocol(fragile.protocol.profile, seed=seed))
    assert episode.failure == "joint velocity limit"
    assert episode.metrics["cost"] == fragile.values["eq6"]["cost"][seed]
    ticks = episode.trajectory["tick"]
    assert (np.diff(ticks) == 1).all()
    assert ticks[-1] < 2500


def test_same_seed_same_results_other_seed_other_results(results):
    again = evaluate(["constant:10", "position-only", "eq6-held"], episodes=6, seed=3)
    other = evaluate(["constant:10"], episodes=6, seed=300)
    assert json.dumps(summarise(again)) == json.dumps(summarise(results))
    assert other.values["constant:10"]["cost"].tolist() != results.values["constant:10"]["cost"].tolist()


def test_scenario_i_belongs_to_seed_plus_i(results):
    later = evaluate(["constant:10"], episodes=1, seed=5)
    assert later.values["constant:10"]["cost"][0] == results.values["constant:10"]["cost"][2]


def test_both_environments_mean_the_same_tension(results):
    other = evaluate(["eq6-held"], episodes=6, seed=3, env_id="Amulett/Tension-v0")
    assert other.values["eq6-held"]["cost"].tolist() == results.values["eq6-held"]["cost"].tolist()


@pytest.mark.parametrize("env_id", ["Amulett/Scaling-v0", "Amulett/Tension-v0"])
def test_a_bundle_acts_at_its_own_rate_within_its_own_range(bundle, env_id):
    results = evaluate([bundle, "constant:12"], episodes=2, env_id=env_id)
    np.testing.assert_allclose(results.schedules[bundle].tension, 12.0, rtol=1e-6)
    # A float32's last digit of tension can let the agonist switch a tick sooner or later.
    np.testing.assert_allclose(results.values[bundle]["cost"], results.values["constant:12"]["cost"], rtol=1e-3)
    assert results.schedules[bundle].tension.size == 2 * 250


def test_the_schedule_pairs_a_tension_with_the_error_it_answers(results):
    schedule = results.schedules["eq6-held"]
    law = results.protocol.profile.variable_stiffness
    lowest = law.minimum_tension / law.nominal_tension
    distance = np.maximum(1.0 - schedule.error / law.error_offset_deg, 0.0)
    np.testing.assert_allclose(schedule.tension, law.nominal_tension * ((1 - lowest) * distance**4 + lowest), atol=1e-4)
    assert set(schedule.phase.tolist()) == {-1, 0, 1}
    assert list(results.schedules) == ["constant:10", "eq6-held"]


def test_push_response_is_measured_where_there_are_pushes(results):
    assert results.push_suite == "hold-push"
    assert (results.values["eq6"]["push_deflection"] > 0.1).all()
    own = evaluate(["constant:10"], suite="hold-push", episodes=6, seed=3)
    assert own.push_suite == "hold-push"
    constant = results.values["constant:10"]["push_deflection"]
    assert own.values["constant:10"]["push_deflection"].tolist() == constant.tolist()


def test_results_json_has_its_stable_form(results):
    summary = json.loads(json.dumps(summarise(results), allow_nan=False))
    for key, kind in {"suite": str, "profile": str, "env_id": str, "seed": int, "episodes": int}.items():
        assert type(summary[key]) is kind
    assert set(UNITS) == set(summary["units"]) >= {*METRICS, "cost", "return", "failed"}
    for metrics in summary["policies"].values():
        assert list(metrics) == list(UNITS)
        for metric, entry in metrics.items():
            for numbers in (entry, entry["ratio_to_eq6"]):
                for key in ("mean", "low", "high"):
                    assert numbers[key] is None or type(numbers[key]) is float
            assert ("not_reached" in entry) == (metric in MAY_BE_MISSING)


def test_what_was_never_reached_is_null_with_a_count():
    results = evaluate(["constant:10"], episodes=3, duration=0.4)  # the first step comes at 0.5 s
    rise = summarise(results)["policies"]["constant:10"]["rise_time"]
    nothing = {"mean": None, "low": None, "high": None}
    assert rise == {**nothing, "ratio_to_eq6": nothing, "not_reached": 3}


def test_the_verdict_names_the_cheapest_and_its_interval(results):
    policies = summarise(results)["policies"]
    name = min(policies, key=lambda policy: policies[policy]["cost"]["mean"])
    cost = policies[name]["cost"]["ratio_to_eq6"]
    interval = f"{number(cost['mean'])} [{number(cost['low'])}, {number(cost['high'])}]"
    assert verdict(results).startswith(
        f"{name} has the lowest cost in 6 held-out scenarios of steps on the testbed: {interval} relative to eq6"
    )


def test_the_verdict_admits_what_it_cannot_tell():
    def result(name, costs):
        values = {"eq6": {"cost": np.full(4, 1.0)}, name: {"cost": np.array(costs)}}
        protocol = Protocol(evaluate(["eq6"], episodes=1, duration=0.1).protocol.profile, episodes=4)
        return Results(protocol, values, {"eq6": [""] * 4, name: ["", "", "", "state is not finite"]})

    assert "the interval includes 1" in verdict(result("mine", [0.5, 1.4, 0.9, 1.1]))
    assert "the interval includes 1" not in verdict(result("mine", [0.5, 0.6, 0.7, 0.8]))
    beaten = verdict(result("mine", [2.0, 2.1, 2.2, 2.3]))
    assert beaten.startswith("eq6 has the lowest cost")
    assert "mine failed in 1 of 4" in beaten


def test_the_verdict_of_one_scenario_promises_nothing():
    assert "from one scenario: no interval" in verdict(evaluate(["constant:10"], episodes=1, duration=1.0))


def test_the_table_has_a_line_for_each_policy(results):
    shown = table(summarise(results))
    assert [row[0] for row in shown.rows] == list(results.values)
    lines = shown.text().splitlines()
    assert max(map(len, lines)) <= 80
    assert {"cost", "position ISE [deg2 s]", "resting stiffness [N m/rad]"} <= set(shown.head)


def test_the_csv_holds_every_scenario_exactly(results, tmp_path):
    write_scenarios(results, tmp_path / "scenarios.csv")
    with (tmp_path / "scenarios.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 6
    for row in rows:
        i = int(row["scenario"])
        assert int(row["seed"]) == 3 + i
        for metric in UNITS:
            value = results.values[row["policy"]][metric][i]
            assert row[metric] == "" if math.isnan(value) else float(row[metric]) == value


@pytest.mark.parametrize(
    ("policies", "keywords", "message"),
    [
        (["eq7"], {}, "unknown policy 'eq7'"),
        (["constant:x"], {}, "has to name a tension in N of at least 0"),
        (["constant:40"], {}, "40 N"),
        (["no/such/folder"], {}, "no/such/folder"),
        (["eq6"], {"suite": "step"}, "did you mean 'steps'"),
        (["eq6"], {"profile": "testbet"}, "did you mean 'testbed'"),
        (["eq6"], {"split": "heldout"}, "did you mean 'held-out'"),
        (["eq6"], {"env_id": "Amulett/Scaling-v1"}, "did you mean 'Amulett/Scaling-v0'"),
        (["eq6"], {"episodes": 0}, "episodes is 0"),
        (["eq6"], {"seed": -1}, "seed is -1"),
        (["eq6"], {"agent_period": 0.03}, "the 0.03 s steps of 'eq6'"),
        (["eq6"], {"agent_period": 0.016}, "control period"),
        (["eq6"], {"agent_period": -1.0}, "agent_period is -1.0"),
        (["eq6"], {"duration": 0.13}, "whole number"),
        (["eq6"], {"duration": 0.0}, "duration is 0.0"),
    ],
)
def test_wrong_input_is_named(policies, keywords, message):
    with pytest.raises(AmulettError, match=re.escape(message)):
        evaluate(policies, **keywords)


def test_the_command_writes_its_files_and_prints_only_json(tmp_path, capsys):
    out = tmp_path / "out"
    assert command("--policies", "eq6-held", "--episodes", "2", "--out", str(out), "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == json.loads((out / "results.json").read_text())
    assert printed.err == ""
    assert {path.name for path in out.iterdir()} == FILES | {COMMAND}
    assert json.loads(printed.out)["command"].startswith("amulett evaluate --policies eq6-held --suite steps")


def test_the_command_prints_a_table_and_says_that_eq6_always_runs(capsys):
    assert command("--policies", "constant:10", "--episodes", "2") == 0
    printed = capsys.readouterr().out
    assert "constant:10" in printed
    assert "eq6 was not named" in printed


def test_nothing_is_written_when_something_is_wrong(tmp_path, monkeypatch, results):
    with pytest.raises(AmulettError):
        command("--policies", "eq7", "--out", str(tmp_path / "out"))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(AmulettError, match="is a file"):
        command("--policies", "eq6", "--out", str(tmp_path / "file"))
    with pytest.raises(AmulettError, match="file' is a file"):
        command("--policies", "eq6", "--out", str(tmp_path / "file" / "sub"))
    with pytest.raises(AmulettError, match="is not empty and holds no comparison"):
        command("--policies", "eq6", "--out", str(tmp_path))
    monkeypatch.setattr("amulett_gym.evaluation.page.summarise", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report(results, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_figure_that_fails_loses_no_number(results, tmp_path, monkeypatch):
    monkeypatch.setattr("amulett_gym.evaluation.plots.cost_figure", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError) as failure:
        write_report(results, tmp_path)
    assert f"the results are in results.json and scenarios.csv in {tmp_path}" in failure.value.__notes__[0]
    assert json.loads((tmp_path / "results.json").read_text()) == summarise(results)
    assert {path.name for path in tmp_path.iterdir()} == {"results.json", "scenarios.csv"}


def test_a_comparison_replaces_an_earlier_one_and_nothing_else(tmp_path, monkeypatch, capsys):
    for module, figure in ((plots, "cost"), (plots, "schedule"), (plots, "trade_off"), (motion_plots, "step_response")):
        monkeypatch.setattr(module, f"{figure}_figure", lambda *_: style.Figure(figsize=(0.1, 0.1)))
    assert command("--policies", "eq6-held", "--episodes", "1", "--out", str(tmp_path)) == 0
    assert "instead of the earlier" not in capsys.readouterr().out
    (tmp_path / "notes.txt").write_text("mine")
    assert command("--policies", "eq6", "--episodes", "1", "--out", str(tmp_path)) == 0
    assert "instead of the earlier comparison" in " ".join(capsys.readouterr().out.split())
    assert {path.name for path in tmp_path.iterdir()} == FILES - {"schedule.png"} | {COMMAND, "notes.txt"}


def test_the_report_needs_nothing_else_and_stays_small(results, tmp_path):
    write_report(results, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert len(page) < 1_500_000
    assert not re.search(r"<(script|link|iframe|object|embed)\b", page)
    assert not re.search(r"""(src|href|url\()\s*=?\s*["']?\s*(https?:|//|file:)""", page)
    for target in re.findall(r"""(?:src|href)=["']([^"']*)""", page):
        assert target.startswith(("#", "data:image/png;base64,"))
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(ids)
    assert pretty(verdict(results)) in page


def test_the_report_escapes_names_and_tells_failures(fragile, tmp_path):
    renamed = {name.replace("constant:10", "<b>bold</b>"): values for name, values in fragile.values.items()}
    failures = {name.replace("constant:10", "<b>bold</b>"): why for name, why in fragile.failures.items()}
    results = Results(fragile.protocol, renamed, failures)
    page = write_page(results)
    assert "<b>bold" not in page
    assert "joint velocity limit" in page
    assert "No device left its limits" not in page


def write_page(results: Results) -> str:
    from amulett_gym.evaluation.page import render
    from amulett_gym.evaluation.plots import cost_figure, trade_off_figure

    summary = summarise(results)
    figure = cost_figure(summary)
    return render(results, summary, {"cost": figure, "trade_off": trade_off_figure(summary), "responses": figure})


LIFT = {"initial_angle_deg": 20, "moves": [{"time": 0.1, "angle_deg": 50}], "orientation": "vertical"}
PUSHED = {"pushes": [{"time": 0.2, "duration": 0.2, "torque": 0.1}], "noise_seed": 5}
TOUCH = {"moves": [{"time": 0.1, "angle_deg": 40}], "obstacle": {"angle_deg": 20, "stiffness": 1.0}}


def test_own_scenarios_are_played_in_turn_by_all_contenders():
    results = evaluate(["constant:8"], scenarios=[LIFT, PUSHED], duration=1.0)
    assert (results.protocol.episodes, results.push_suite) == (2, "own scenarios")
    protocol = Protocol(load_profile("testbed"), episodes=1, duration=1.0)
    for name in ("eq6", "constant:8"):
        for k, scenario in enumerate((LIFT, PUSHED)):
            alone = record_episode(name, replace(protocol, seed=k), scenario)
            for metric, value in alone.metrics.items():
                np.testing.assert_equal(results.values[name][metric][k], value, err_msg=metric)


def test_own_scenarios_repeat_with_other_noise_only():
    again = evaluate(["constant:8"], scenarios=[LIFT], episodes=3, duration=0.6)
    assert len(set(again.values["constant:8"]["position_ise"])) == 3
    assert again.push_suite == "hold-push"  # of a scenario without pushes
    with pytest.raises(AmulettError, match="3 episodes would repeat a scenario .* its noise_seed is 5"):
        evaluate(["constant:8"], scenarios=[PUSHED, LIFT], episodes=3)
    with pytest.raises(AmulettError, match="episodes is 1; there are 2 own scenarios"):
        evaluate(["constant:8"], scenarios=[PUSHED, LIFT], episodes=1)


def test_a_summary_of_own_scenarios_says_so_and_names_what_they_are_charged_by():
    results = evaluate(["constant:8"], scenarios=[LIFT, TOUCH], suite="reach", duration=0.5)
    summary = summarise(results)
    assert summary["task"] == "own scenarios"
    assert [scenario["initial_angle_deg"] for scenario in summary["scenarios"]] == [20.0, 0.0]
    assert list(summary["cost"]["divisors"]) == ["reach", "contact"]
    assert "in 2 own scenarios on the testbed" in summary["verdict"]


def test_contenders_in_several_loops_are_ranked_by_the_full_control_cost():
    results = evaluate(["co-rotation/constant:10", "constant:8"], "paper-step", episodes=2, duration=2.0)
    assert results.track == "full-control"
    summary = summarise(results)
    assert summary["track"] == "full-control"
    assert "full-control cost" in verdict(results)
    shown = table(summary)
    assert shown.head[1] == "full-control cost"
    assert "drive effort [deg2/s]" in shown.head
    for values in results.values.values():
        terms = sum(values[f"control_cost_{term}"] for term in ("position", "effort", "contact"))
        np.testing.assert_allclose(terms + values["cost_failure"], values["control_cost"])
    weights = summary["cost"]["weights"]["paper-step"]
    assert weights["tension"] == 0.0


def test_contenders_in_the_papers_loop_are_ranked_by_the_schedules_cost():
    results = evaluate(["constant:8"], "paper-step", episodes=2, duration=1.0)
    assert results.track == "schedule"
    assert table(summarise(results)).head[1] == "cost"
