"""`amulett fit`: from a log's file to a profile, a fleet, numbers and a page."""

from __future__ import annotations

import json

import numpy as np
import pytest

from amulett_gym.cli import build_parser, main
from amulett_gym.cli.fit import recordings
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
    columns = simulate_log(device, duration=10.0).columns
    write_log(folder / "steps.csv", columns)
    write_log(folder / "short.csv", {name: values[:100] for name, values in columns.items()})
    write_log(folder / "still.csv", columns | {"angle": np.zeros_like(columns["angle"])})
    return folder


def arguments(folder, *more):
    options = ["--base", "base.yaml", "--prior", "prior.yaml", "--starts", "1", "--out", "mine.yaml", *more]
    return ["fit", "steps.csv", *options]


def test_a_log_becomes_profile_fleet_numbers_and_page(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(arguments(folder, "--fleet", "fleet.yaml", "--devices", "3", "--format", "svg")) == 0
    shown = capsys.readouterr().out
    assert "Written: mine.yaml, mine.json, fleet.yaml, mine.html, mine-0.svg, mine-1.svg." in " ".join(shown.split())
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
        (
            ["--payload", "steps.csv", "-1", "0.1"],
            "--payload: 'mass' is -1.0: Input should be greater than or equal to 0",
        ),
        (["--hold-out", "steps.csv"], "'steps.csv' is to be fitted and held out; choose one"),
        (["--hold-out", "./steps.csv"], "'./steps.csv' is to be fitted and held out; choose one"),
        (["--hold-out", "short.csv"], "short.csv has no rows to compare with a simulation: the first 1.5 s"),
        (["--hold-out", "still.csv"], "still.csv: the angle never changes, so there is nothing to fit"),
        (["--hold-out", "none.csv"], "cannot read log 'none.csv'"),
        (["--base", "tesbed"], "unknown profile 'tesbed'"),
        (["--prior", "none.yaml"], "none.yaml"),
        (["--devices", "0"], "--devices is 0; it has to be at least 1"),
    ],
)
def test_wrong_options_are_refused_before_any_work(folder, monkeypatch, capsys, more, message):
    monkeypatch.chdir(folder)
    assert main(arguments(folder, *more)) == 2
    error = capsys.readouterr().err
    assert message.replace("\\", "") in error
    assert error.count("\n") == 1


def test_logs_with_the_same_file_name_have_different_names(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "b").mkdir()
    (folder / "b" / "steps.csv").write_bytes((folder / "steps.csv").read_bytes())
    found, held_out = recordings(build_parser().parse_args(arguments(folder, "--hold-out", "b/steps.csv")), print)
    assert [each.name for each in (*found, *held_out)] == ["steps.csv", "b/steps.csv"]
    assert main(["fit", "steps.csv", "steps.csv", "--out", "x.yaml"]) == 2
