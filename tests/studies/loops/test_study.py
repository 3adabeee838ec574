"""The comparison of loops: its numbers against closed forms, and the files of the command."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from amulett_gym.cli import main
from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.profile import load_profile
from amulett_gym.reporting.document import marks
from amulett_gym.settings import configs_folder
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.studies.loops import study
from amulett_gym.studies.loops.figures import draw


@pytest.fixture(scope="module")
def found():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "TIMES", (0.3, 1.0))
        patch.setattr(study, "CONSTANTS", (6.0,))
        done = []
        result = study.measure("testbed", episodes=2, report=done.append)
        assert len(done) == study.parts(load_profile("testbed"))
        return result


def test_every_loop_is_compared(found):
    names = [row[0] for row in study.table(found).rows]
    assert names == ["eq6", "constant:10", *(f"{loop}/constant:10" for loop in LOOPS)]
    assert set(found.fronts) == {"decentralized", *LOOPS}
    assert json.loads(json.dumps(found.content(), allow_nan=False))["episodes"] == 2


def test_the_feed_forward_trades_off_as_the_closed_form_says(found):
    # Minimum jerk: the integrals' product is 0.560 and not 0.25 times the least; at 1 s the joint follows its drives.
    profile = found.results.protocol.profile
    rows = {(row["reference"], row["reference_time"]): row for row in found.fronts["equilibrium-point"]}
    for shape, factor in (("minimum-jerk", 0.560 / 0.25), ("first-order", 1.0)):
        row = rows[shape, 1.0]
        assert row["position_ise"] / study.least_ise(profile, row["drive_effort"]) == pytest.approx(factor, rel=0.05)


def test_a_longer_reference_needs_less_drive_effort(found):
    for loop in LOOPS:
        fast, slow = found.fronts[loop][:2]
        assert slow["drive_effort"] < fast["drive_effort"]
        assert slow["position_ise"] > fast["position_ise"]


def test_figures_show_every_contender(found):
    figures = draw(found)
    labels = {line.get_label() for line in figures["loops_step"].axes[0].get_lines()}
    assert labels == {*study.contenders(), "setpoint"}
    labels = {line.get_label() for line in figures["loops_trade_off"].axes[0].get_lines()}
    assert {*LOOPS, "eq6"} <= labels


def test_the_command_writes_numbers_and_figures(found, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "measure", lambda *arguments: found)
    assert main(["loops", "--out", str(tmp_path / "loops"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"] == "testbed"
    written = {path.name for path in (tmp_path / "loops").iterdir()}
    assert written == {"loops.json", "command.json", "loops_step.png", "loops_trade_off.png"}
    assert main(["loops", "--out", str(tmp_path / "loops"), "--json"]) == 0  # instead of the earlier one
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    assert main(["loops", "--out", str(tmp_path / "other")]) == 2
    assert main(["loops", "--episodes", "0"]) == 2


def test_a_folder_holds_its_device(found, tmp_path, monkeypatch):
    monkeypatch.setattr("amulett_gym.studies.loops.figures.draw", lambda _: {})
    device = tmp_path / "device.yaml"
    device.write_text("name: mine\nbase: testbed\nplant: {masses: [{mass: 0.3, arm: 0.13}]}\n")
    played = []
    monkeypatch.setattr(study, "measure", lambda profile, *others: played.append(profile) or found)
    assert main(["loops", "--profile", str(device), "--out", str(tmp_path / "loops")]) == 0
    device.unlink()
    assert main(["rerun", str(tmp_path / "loops"), "--out", str(tmp_path / "again")]) == 0
    assert [profile.name for profile in played] == ["mine", "mine"]
    assert played[0] == played[1]


def test_a_damped_reference_has_less_than_half_of_the_rewards_cost_of_eq6():
    contender = "equilibrium-point/constant:10"
    profile = configs_folder() / "damped_loops.yaml"
    values = evaluate([contender], "paper-step", profile, episodes=4, duration=5.0).values
    assert values[contender]["cost"].mean() / values["eq6"]["cost"].mean() == pytest.approx(0.416, abs=0.02)
    assert values[contender]["control_cost"].mean() > values["eq6"]["control_cost"].mean()


LINEAR = {"name": "linear", "base": "testbed", "spring": {"free_length": 0.0}}


def test_loops_that_do_not_fit_the_device_are_skipped_with_the_reason(monkeypatch, tmp_path, capsys):
    for name, value in (("TIMES", (1.0,)), ("CONSTANTS", (6.0,)), ("LOOPS", ("equilibrium-point", "torque-stiffness"))):
        monkeypatch.setattr(study, name, value)
    path = tmp_path / "linear.yaml"
    path.write_text(json.dumps(LINEAR))
    (tmp_path / "images").mkdir()
    (tmp_path / "loops.md").write_text("\n".join(marks("amulett loops")) + "\n")
    words = ["loops", "--profile", str(path), "--episodes", "2", "--doc", str(tmp_path / "loops.md")]
    assert main([*words, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [*content["means"]] == ["eq6", "constant:10", "equilibrium-point/constant:10"]
    assert [*content["fronts"]] == ["decentralized", "equilibrium-point"]
    assert "the slope of the springs has to rise" in content["skipped"]["torque-stiffness"]
    document = (tmp_path / "loops.md").read_text()
    assert "Without torque-stiffness, which does not fit this device: control 'torque-stiffness' sets" in document
    assert main(words) == 0
    assert "Without torque-stiffness, which does not fit this device" in " ".join(capsys.readouterr().out.split())


def test_the_table_says_how_many_repetitions_have_a_value(found):
    some = {name: values.copy() for name, values in found.results.values["eq6"].items()}
    some["settling_time"] = np.array([0.4, np.nan])
    some["rise_time"] = np.array([np.nan, np.nan])
    other = replace(found, results=replace(found.results, values={"eq6": some}))
    table = study.table(other)
    cells = dict(zip([*study.COLUMNS], table.rows[0][1:], strict=True))
    assert cells["settling_time"] == f"{METRICS['settling_time'].text(0.4)} (1/2)"
    assert cells["rise_time"].endswith("(0/2)") and "(" not in cells["overshoot"]
    assert "(n/2): the mean of n repetitions" in table.note
    content = other.content()
    assert content["counted"]["eq6"] | {"settling_time": 1, "rise_time": 0} == content["counted"]["eq6"]
    assert content["counted"]["eq6"]["overshoot"] == content["episodes"] == 2
    assert content["means"]["eq6"]["rise_time"] is None
    assert "(n/2)" not in study.table(found).note and "skipped" in found.content()
