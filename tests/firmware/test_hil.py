"""A firmware beside the simulation's own loop."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.firmware import hil, hil_page
from amulett_gym.firmware.chip import Measurement
from amulett_gym.firmware.hil import compare
from amulett_gym.laws.copies import FOLDER
from amulett_gym.logs import read_log
from amulett_gym.profile import load_profile
from amulett_gym.reporting.figure_files import figures_as
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.storage.provenance import read_provenance


def test_the_host_costs_what_the_simulation_costs(firmware):
    found = compare(firmware("eq6").folder, ["host", "host-float"], episodes=3, duration=1.0)
    host, narrow = found.played
    assert host.costs == pytest.approx(found.kernel.costs, rel=1e-12)
    assert found.difference(host) == pytest.approx((0.0, 0.0), abs=1e-12)
    mean, largest = found.difference(narrow)
    assert 0.0 < abs(mean) <= largest < 0.05


def test_the_simulation_has_the_firmwares_delay_and_is_shown_without_it(firmware):
    folder = firmware("parametric").folder
    found = compare(folder, ["host"], episodes=2, duration=1.0)
    assert found.played[0].costs == pytest.approx(found.kernel.costs, rel=1e-12)
    in_time = evaluate(["parametric"], "mixed", episodes=2, duration=1.0).values["parametric"]["cost"]
    assert found.own is not None and found.own.costs.tolist() == in_time.tolist() != found.kernel.costs.tolist()
    interval = found.interval(found.own)
    assert interval is not None and interval[0] <= found.difference(found.own)[0] <= interval[1]
    assert list(found.content()["results"]) == ["simulation", "simulation, action_delay 0", "host"]
    assert "action_delay 0" in hil_page.table(found).text()


def test_a_firmware_s_log_is_that_of_the_simulated_device(firmware, tmp_path: Path):
    folder, written = str(firmware("eq6").folder), tmp_path / "steps.npz"
    words = ["hil", folder, "--suite", "steps", "--seed", "3", "--episodes", "1", "--duration", "2", "--log"]
    assert main([*words, str(written)]) == 0
    simulated = tmp_path / "simulated.npz"
    assert main(["simulate", "--law", "eq6", "--seed", "3", "--duration", "2", "--log", str(simulated)]) == 0
    log, expected = read_log(written), read_log(simulated)
    assert list(log.columns) == list(expected.columns)
    for name, values in expected.columns.items():
        np.testing.assert_array_equal(log[name], values)


def test_a_log_of_another_kind_is_refused_before_the_run(firmware, capsys: pytest.CaptureFixture[str]):
    assert main(["hil", str(firmware("eq6").folder), "--log", "steps.txt"]) == 2
    assert "--log 'steps.txt' has to end in .csv or .npz" in capsys.readouterr().err


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


HIL = ["hil", "--suite", "steps", "--episodes", "2", "--duration", "1"]


@pytest.fixture
def played(firmware, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a result's folder, whose firmware is gone."""
    shutil.copytree(firmware("eq6").folder, tmp_path / "fw")
    monkeypatch.chdir(tmp_path)
    assert main([*HIL, "fw", "--transport", "host", "host-float", "--out", "hil"]) == 0
    shutil.rmtree(tmp_path / "fw")
    return tmp_path / "hil"


def test_a_wrong_transport_is_refused_before_anything_runs(firmware, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hil, "play_alone", None)
    for wrong, message in (("chips", "did you mean 'chip'"), ("serial:", "names no port"), ("serial", "unknown")):
        with pytest.raises(AmulettError, match=message):
            compare(firmware("eq6").folder, ["host", wrong], episodes=1)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(AmulettError, match="there is no avr-gcc"):
        compare(firmware("eq6").folder, ["host", "chip"], episodes=1)


def test_json_alone_is_printed(firmware, capsys: pytest.CaptureFixture[str]):
    assert main([*HIL, str(firmware("eq6").folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["results"]) == {"simulation", "host"}


def test_a_result_can_be_repeated_from_its_own_copy(played: Path, capsys: pytest.CaptureFixture[str]):
    words = ["rerun", "hil", "--out", "again"]
    assert main(words) == 2
    assert "C sources, which are compiled and run; if you trust them, give --trust-c" in capsys.readouterr().err
    assert main([*words, "--trust-c"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    again = json.loads((played.parent / "again" / "hil.json").read_text())
    assert again == json.loads((played / "hil.json").read_text())
    note = read_provenance(played)
    assert (note.kind, note.seeds, note.command[:3]) == ("hil", [0, 1], ["amulett", "hil", "fw"])
    assert note.config["transport"] == ["host", "host-float"]


def test_another_number_and_a_changed_copy_are_noticed(played: Path, capsys: pytest.CaptureFixture[str]):
    content = json.loads((played / "hil.json").read_text())
    content["results"]["host"]["costs"][1] += 1e-9
    (played / "hil.json").write_text(json.dumps(content))
    assert main(["rerun", "hil", "--out", "again", "--trust-c"]) == 1
    assert "results.host.costs.1 was " in capsys.readouterr().out
    (played / FOLDER / "0" / "device.h").write_text("#define COMMAND_LIMIT system()")
    assert main(["rerun", "hil", "--out", "third", "--trust-c"]) == 2
    assert "was changed: its SHA-256 is not as in command.json" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["playing", "writing"])
def test_ctrl_c_leaves_nothing_half_written(firmware, played: Path, place: str, monkeypatch: pytest.MonkeyPatch):
    def stop(*arguments: object, **keywords: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(*((hil, "play") if place == "playing" else (hil_page, "fill_page")), stop)
    before = {path: path.read_bytes() for path in played.rglob("*") if path.is_file()}
    words = [*HIL, str(firmware("constant:8").folder)]
    assert main([*words, "--out", "new"]) == 130
    assert [path for path in played.parent.rglob("new*") if not path.is_dir() or any(path.iterdir())] == []
    assert main([*words, "--out", "hil"]) == 130
    assert {path: path.read_bytes() for path in played.rglob("*") if path.is_file()} == before


def test_another_folder_is_not_written_to(firmware, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "thesis.tex").write_text("")
    assert main([*HIL, str(firmware("eq6").folder), "--out", str(tmp_path)]) == 2
    assert "is not empty and holds no firmware in the loop" in capsys.readouterr().err


def test_the_page_has_all_loops_side_by_side(firmware, tmp_path: Path):
    found = compare(firmware("eq6").folder, ["host", "host-float"], episodes=3, duration=0.4)
    chip = Measurement(1, 480, 9000, 11_000, 9000.0, 16_000, 700, 400)
    found = replace(found, played=[found.played[0], replace(found.played[1], label="chip", measurement=chip)])
    table = hil_page.chip_table(found)
    assert table.rows == [("chip", "11,000", "28 %", "9,000", "480", "16,000", "700", "400")]
    families = hil_page.family_table(found)
    assert families.head == ("family", "scenarios", "simulation", "host", "difference", "chip", "difference")
    assert sum(int(row[1]) for row in families.rows) == 3
    mean = sum(float(row[1]) * float(row[5]) for row in families.rows) / 3
    assert mean == pytest.approx(found.played[1].costs.mean(), rel=1e-3)
    hil_page.write_comparison(found, tmp_path, ["amulett", "hil", "my folder"])
    page = (tmp_path / "index.html").read_text()
    for text in ("11,000", "By family", "Cycles and memory", "<svg", "amulett hil &#39;my folder&#39;"):
        assert text in page
    assert {path.name for path in tmp_path.iterdir()} == {*hil_page.FILES}
    with figures_as("pdf", 1):
        hil_page.write_comparison(found, tmp_path)
    assert (tmp_path / "hil.pdf").read_bytes().startswith(b"%PDF")


def test_the_figure_has_each_scenario_in_the_row_of_its_family():
    families = np.array([1, 3, 1])
    kernel = hil.Played(hil.KERNEL, np.array([1.0, 2.0, 3.0]), families, 0)
    played = [hil.Played("host", np.array([1.0, 2.2, 3.0]), families, 0)]
    about = hil.Protocol(load_profile("testbed"), "mixed", episodes=3)
    [panel] = hil_page._figure(hil.Comparison(None, about, kernel, played)).axes
    names = dict(zip(panel.get_yticks(), (label.get_text() for label in panel.get_yticklabels()), strict=True))
    [dots] = [line for line in panel.get_lines() if line.get_label() == "host"]
    shown = [(names[round(y)], x) for x, y in zip(dots.get_xdata(), dots.get_ydata(), strict=True)]
    expected = [(FAMILIES[family], apart) for family, apart in zip(families, (0.0, 10.0, 0.0), strict=True)]
    assert [name for name, _ in shown] == [name for name, _ in expected]
    assert [apart for _, apart in shown] == pytest.approx([apart for _, apart in expected])


def test_small_differences_are_no_powers_of_ten():
    assert [hil_page._percent(share) for share in (0.0, 1e-9, -3e-7, 2e-5, -0.0123)] == [
        *("0 %", "0.000 %", "0.000 %", "0.002 %", "-1.2 %")
    ]


def test_episodes_that_end_before_they_count_differ_by_nothing(firmware):
    found = compare(firmware("eq6").folder, suite="steps", episodes=1, duration=0.02)
    assert found.kernel.costs.tolist() == [0.0]
    assert found.difference(found.played[0]) == (0.0, 0.0)
    assert found.interval(found.played[0]) is None  # nor has one scenario an interval


def test_the_command_refuses_what_is_no_firmware(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["hil", str(tmp_path)]) == 2
    assert "is no firmware: it has no manifest.json; make one with 'amulett export'" in capsys.readouterr().err


def test_a_law_that_is_gone_is_named(firmware, tmp_path: Path):
    source = firmware("eq6").folder
    content = json.loads((source / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps({**content, "law": "no/such/policy"}))
    with pytest.raises(AmulettError, match="no/such/policy"):
        compare(tmp_path, episodes=1)
