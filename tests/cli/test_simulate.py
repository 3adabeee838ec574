"""`amulett simulate`: a trajectory, a figure and metrics that belong together."""

import csv
import hashlib
import json

import numpy as np
import pytest
from helpers import make_bundle

from amulett_gym.cli import Parser
from amulett_gym.cli.simulate import add_arguments, run
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.logs import read_log
from amulett_gym.profile import load_profile
from amulett_gym.reporting import progress


def simulate(*words: str) -> int:
    parser = Parser()
    add_arguments(parser)
    return run(parser.parse_args(words))


def read(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_papers_step_ends_on_its_setpoint(tmp_path, capsys):
    out, plot = tmp_path / "step.csv", tmp_path / "step.png"
    words = ("--law", "eq6", "--suite", "paper-step", "--profile", "simulation", "--out", str(out), "--plot", str(plot))
    assert simulate(*words) == 0
    columns = read(out)
    assert columns["time_s"][-1] == pytest.approx(10.0)
    assert columns["setpoint_deg"][[0, -1]].tolist() == pytest.approx([0.0, 45.0])
    assert columns["joint_angle_deg"][-1] == pytest.approx(45.0, abs=1.0)
    assert plot.stat().st_size > 10_000
    assert "position_ise" in capsys.readouterr().out


@pytest.mark.parametrize("law", ["eq6", "eq6-held", "position-only", "constant:8"])
def test_the_csv_adds_up_to_the_metrics(law, tmp_path, capsys):
    out = tmp_path / "x.csv"
    assert simulate("--law", law, "--duration", "3", "--out", str(out), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    metrics = printed["metrics"]
    columns = read(out)
    period = columns["time_s"][1]
    counted = columns["time_s"][:-1] >= printed["scenario"]["measure_from"] - 1e-9
    for drive in ("biceps", "triceps"):
        isav = np.sum(np.diff(columns[f"command_{drive}_deg"])[counted] ** 2) / period
        assert isav == pytest.approx(metrics[f"isav_{drive}"], rel=1e-6)
    # The setpoint of a row is the one that the next tick acts on.
    before = columns["setpoint_deg"][:-1] - columns["joint_angle_deg"][:-1]
    after = columns["setpoint_deg"][:-1] - columns["joint_angle_deg"][1:]
    assert 0.5 * period * np.sum((before**2 + after**2)[counted]) == pytest.approx(metrics["position_ise"], rel=1e-6)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_the_log_holds_what_the_device_would_log(suffix, tmp_path):
    out, path = tmp_path / "x.csv", tmp_path / f"log{suffix}"
    assert simulate("--law", "eq6", "--duration", "1", "--out", str(out), "--log", str(path)) == 0
    columns, log = read(out), read_log(path)
    assert len(log) == len(columns["time_s"]) - 1
    before, after = slice(None, -1), slice(1, None)  # commands and tension setpoint are sent after the sensors are read
    expected = {
        "time": columns["time_s"][before],
        "setpoint": np.radians(columns["setpoint_deg"][before]),
        "angle": np.radians(columns["measured_angle_deg"][before]),
        "slider_biceps": columns["measured_deflection_biceps_mm"][before] / 1000,
        "slider_triceps": columns["measured_deflection_triceps_mm"][before] / 1000,
        "command_biceps": np.radians(columns["command_biceps_deg"][after]),
        "command_triceps": np.radians(columns["command_triceps_deg"][after]),
        "tension_setpoint": columns["tension_setpoint_N"][after],
    }
    assert list(log.columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(log[name], values, rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_log_is_of_one_law(tmp_path):
    with pytest.raises(AmulettError, match="--log is for one law; --law names 2"):
        simulate("--law", "eq6", "constant:6", "--log", str(tmp_path / "log.csv"))


def test_a_held_law_changes_its_mind_at_agent_rate_only(tmp_path):
    assert simulate("--law", "eq6-held", "--duration", "3", "--out", str(tmp_path / "x.csv")) == 0
    setpoint = read(tmp_path / "x.csv")["tension_setpoint_N"]
    ticks = round(0.02 / load_profile("testbed").loop.control_period)
    bends = np.flatnonzero(np.abs(np.diff(setpoint, n=2)) > 1e-4)  # N; the file has six digits
    assert bends.size > 20
    assert set((bends + 1) % ticks) == {0}


def test_it_replays_a_scenario_of_a_comparison(capsys):
    results = evaluate(["constant:10"], episodes=3)
    assert simulate("--law", "constant:10", "--seed", "2", "--json") == 0
    metrics = json.loads(capsys.readouterr().out)["metrics"]
    assert metrics["cost"] == results.values["constant:10"]["cost"][2]


def test_an_own_scenario_is_played_and_can_be_played_again(tmp_path, capsys):
    own = tmp_path / "own.json"
    own.write_text(json.dumps({"initial_angle_deg": 20, "moves": [{"time": 0.1, "angle_deg": 50}]}))
    assert simulate("--scenario", str(own), "--duration", "1", "--json") == 0
    first = json.loads(capsys.readouterr().out)
    assert first["scenario"]["initial_angle_deg"] == 20
    own.write_text(json.dumps(first["scenario"]))
    assert simulate("--scenario", str(own), "--duration", "1", "--seed", "99", "--json") == 0
    assert json.loads(capsys.readouterr().out)["metrics"] == first["metrics"]


OWN = """
def held(observations):
    return [2.0 * (8.0 - 4.0) / 11.0 - 1.0] * len(observations)
"""


def test_several_laws_meet_one_scenario_and_share_their_files(tmp_path, capsys):
    mine = tmp_path / "mine.py"
    mine.write_text(OWN)
    laws = ["eq6", "constant:8", f"{mine}:held", "constant:8"]
    out, plot = tmp_path / "all.csv", tmp_path / "all.png"
    words = ["--duration", "1", "--out", str(out), "--plot", str(plot), "--json"]
    assert simulate("--law", *laws, *words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert list(printed["laws"]) == laws[:3]
    assert printed["sha256"] == {laws[2]: hashlib.sha256(mine.read_bytes()).hexdigest()}
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["law"] for row in rows[:: len(rows) // 3]] == ["eq6", "constant:8", "mine.py:held"]
    columns = [[float(row["joint_angle_deg"]) for row in rows if row["law"] == law] for law in ("eq6", "mine.py:held")]
    assert columns[0] != columns[1]
    assert printed["laws"][laws[2]] == printed["laws"]["constant:8"]  # the law that the file imitates
    assert plot.stat().st_size > 10_000


def test_each_law_of_several_is_the_one_alone(tmp_path, capsys):
    simulate("--law", "eq6", "constant:8", "--duration", "1", "--out", str(tmp_path / "both.csv"), "--json")
    both = json.loads(capsys.readouterr().out)
    with (tmp_path / "both.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for law in ("eq6", "constant:8"):
        simulate("--law", law, "--duration", "1", "--out", str(tmp_path / "one.csv"), "--json")
        alone = json.loads(capsys.readouterr().out)
        assert both["laws"][law] == {"failure": alone["failure"], "metrics": alone["metrics"]}
        assert both["scenario"] == alone["scenario"]
        with (tmp_path / "one.csv").open(newline="") as file:
            assert [{**row, "law": law} for row in csv.DictReader(file)] == [row for row in rows if row["law"] == law]


def test_several_laws_are_printed_side_by_side(capsys):
    simulate("--law", "constant:6", "constant:8", "--duration", "1")
    head, _, cost, *_ = capsys.readouterr().out.splitlines()[1:]
    assert head.split() == ["metric", "constant:6", "constant:8", "unit"]
    assert cost.split()[0] == "cost" and len(cost.split()) == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--law", "eq66"), "unknown policy 'eq66'"),
        (("--suite", "step"), "did you mean 'steps'"),
        (("--duration", "-1"), "--duration"),
        (("--duration", "nan"), "--duration"),
        (("--duration", "0.0201"), "whole number"),
        (("--plot", "figure.jpg"), ".png or .svg"),
        (("--scenario", "missing.json"), "missing.json"),
        (("--out", "x.txt"), "has to end in .csv"),
        (("--plot", "/dev/null/x.png"), "cannot write '/dev/null/x.png'"),
    ],
)
def test_wrong_input_is_named_and_nothing_is_written(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AmulettError) as error:
        simulate("--out", "x.csv", *words)
    assert message in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("json_too", [True, False])
def test_a_figure_that_fails_loses_no_number(json_too, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("amulett_gym.evaluation.motion_plots.trajectory_figure", lambda *_: 1 / 0)
    words = ["--duration", "0.1", "--out", str(tmp_path / "x.csv"), "--plot", str(tmp_path / "x.png")]
    with pytest.raises(ZeroDivisionError):
        simulate(*words, *["--json"] * json_too)
    printed = capsys.readouterr().out
    assert json.loads(printed)["metrics"]["position_ise"] >= 0 if json_too else "position_ise" in printed
    assert [path.name for path in tmp_path.iterdir()] == ["x.csv"]


def test_a_long_episode_shows_how_much_of_it_is_simulated(monkeypatch, capsys):
    monkeypatch.setattr(progress, "FIRST", 0.0)
    monkeypatch.setattr(progress, "BETWEEN", 0.0)
    assert simulate("--law", "eq6", "--duration", "4", "--json") == 0
    output, lines = capsys.readouterr()
    assert json.loads(output)["duration"] == 4
    shown = [line for line in lines.splitlines() if line.startswith("simulate: ")]
    assert [line.split(" (")[0] for line in shown] == [f"simulate: {k} of 4 s" for k in (1, 2, 3)]


def test_a_policy_acts_in_its_own_loop_and_the_command_says_so(tmp_path, capsys):
    mine = make_bundle(tmp_path / "mine", keywords={"control": "cascade"}, tension_range=[0.0, 15.0])
    metrics = []
    for name in (str(mine), f"cascade/{mine}"):
        assert simulate("--law", name, "--duration", "0.5", "--json") == 0
        out, err = capsys.readouterr()
        metrics.append(json.loads(out)["metrics"])
        assert ("acts in its own loop, cascade, as cascade/" in err) == (name == str(mine))
    assert metrics[0] == metrics[1]
