"""A firmware beside the simulation's own loop."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.hil import compare


def test_the_host_costs_what_the_simulation_costs(firmware):
    found = compare(firmware("eq6").folder, ["host", "host-float"], episodes=3, duration=1.0)
    host, narrow = found.played
    assert host.costs == pytest.approx(found.kernel.costs, rel=1e-12)
    assert found.difference(host) == pytest.approx((0.0, 0.0), abs=1e-12)
    mean, largest = found.difference(narrow)
    assert 0.0 < abs(mean) <= largest < 0.05


def test_the_command_prints_and_writes(firmware, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, out = str(firmware("eq6").folder), tmp_path / "hil"
    words = ["hil", folder, "--suite", "steps", "--episodes", "2", "--duration", "1.5", "--out", str(out)]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "simulation" in text
    assert "host" in text
    found = json.loads((out / "hil.json").read_text())
    assert found["results"]["host"]["costs"] == pytest.approx(found["results"]["simulation"]["costs"], rel=1e-12)
    assert found["results"]["host"]["let_go"] == 0
    assert (found["law"], found["suite"], found["episodes"]) == ("eq6", "steps", 2)
    page = (out / "index.html").read_text()
    assert "eq6 as firmware: 2 scenarios of steps" in page


def test_episodes_that_end_before_they_count_differ_by_nothing(firmware):
    found = compare(firmware("eq6").folder, suite="steps", episodes=1, duration=0.02)
    assert found.kernel.costs.tolist() == [0.0]
    assert found.difference(found.played[0]) == (0.0, 0.0)


def test_the_command_refuses_what_is_no_firmware(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["hil", str(tmp_path)]) == 2
    assert "is no firmware: it has no manifest.json; make one with 'amulett export'" in capsys.readouterr().err


def test_a_law_that_is_gone_is_named(firmware, tmp_path: Path):
    source = firmware("eq6").folder
    content = json.loads((source / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps({**content, "law": "no/such/policy"}))
    with pytest.raises(AmulettError, match="no/such/policy"):
        compare(tmp_path, episodes=1)
