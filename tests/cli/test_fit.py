"""`amulett fit`: from a log's file to a profile, a fleet, numbers and a page."""

from __future__ import annotations

import json

import pytest

from amulett_gym.cli import main
from amulett_gym.fleet import load_fleet
from amulett_gym.logs import write_log
from amulett_gym.profile import load_profile
from amulett_gym.storage.safe_yaml import to_yaml
from tests.identification.from_logs.conftest import COARSE, simulate_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a base and the log of a plausible device with its loop."""
    folder = tmp_path_factory.mktemp("fit")
    (folder / "base.yaml").write_text(to_yaml({"base": "testbed", "name": "base", **COARSE}))
    prior = load_fleet("plausible")[:3]
    (folder / "prior.yaml").write_text(to_yaml([each.model_dump(mode="json") for each in prior]))
    device = prior[1].model_copy(update={"loop": load_profile(folder / "base.yaml").loop})
    write_log(folder / "steps.csv", simulate_log(device, duration=10.0).columns)
    return folder


def arguments(folder, *more):
    options = ["--base", "base.yaml", "--prior", "prior.yaml", "--starts", "1", "--out", "mine.yaml", *more]
    return ["fit", "steps.csv", *options]


def test_a_log_becomes_profile_fleet_numbers_and_page(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(arguments(folder, "--fleet", "fleet.yaml", "--devices", "3")) == 0
    shown = capsys.readouterr().out
    assert "Written: mine.yaml, mine.json, fleet.yaml, mine.html." in " ".join(shown.split())
    assert "radius_ratio" in shown
    assert max(map(len, shown.splitlines())) <= 80
    profile = load_profile(folder / "mine.yaml")
    assert profile.name == "mine"
    assert profile.drives.sources["lag"].startswith("identified: lag 0.1")
    assert [each.name for each in load_fleet(folder / "fleet.yaml")] == ["mine-1", "mine-2", "mine-3"]
    found = json.loads((folder / "mine.json").read_text())
    ratio = next(each for each in found["parameters"] if each["name"] == "radius_ratio")
    assert ratio["low"] < ratio["value"] < ratio["high"]
    assert ratio["determined"]
    held = found["held_out"][0]
    assert held["log"] == "last fifth of steps.csv"
    assert held["fit"]["angle_deg"] < 0.2 < held["base"]["angle_deg"]
    assert found["logs"][0]["loop"] == "open"
    shrinks = [each["shrinks"] for each in found["experiments"]]
    assert len(shrinks) == 5
    assert shrinks == sorted(shrinks)
    assert 0.0 < shrinks[0] < shrinks[-1] <= 1.0
    page = (folder / "mine.html").read_text()
    assert page.count("<svg") == 2
    assert "last fifth of steps.csv" in page
    assert "free oscillation with a weight" in page
    assert page.count("<use") < 2500  # dots; all rows would be 3400


def test_json_is_one_document(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(arguments(folder, "--json", "--out", "again.yaml")) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == json.loads((folder / "again.json").read_text())


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--out", "mine.txt"], "--out 'mine.txt' has to end in .yaml"),
        (["--release", "other.csv"], "--release names 'other.csv'; it has to be one of the logs: steps.csv"),
        (["--payload", "steps.csv", "much", "0.1"], "--payload needs a mass \\[kg\\] and an arm \\[m\\]"),
        (["--hold-out", "steps.csv"], "'steps.csv' is to be fitted and held out; choose one"),
        (["--prior", "none.yaml"], "none.yaml"),
        (["--devices", "0"], "--devices is 0; it has to be at least 1"),
    ],
)
def test_wrong_options_are_refused_before_any_work(folder, monkeypatch, capsys, more, message):
    monkeypatch.chdir(folder)
    assert main(arguments(folder, *more)) == 2
    assert message.replace("\\", "") in capsys.readouterr().err
