"""The search finds what it is given, the same way every time, and the shipped profiles are what it found."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from contextlib import redirect_stdout
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import fork_processes

from amulett_gym.cli import main
from amulett_gym.identification.ensemble import ensemble
from amulett_gym.identification.parameters import PARAMETERS, devices, pack, same_device, searched, unpack
from amulett_gym.identification.search import search
from amulett_gym.profile import load_profile
from amulett_gym.studies.paper import reproduction, study
from amulett_gym.studies.paper.objective import (
    OUT_OF_REACH,
    SIMULATED,
    cost,
    most_explained,
    objective,
    reproduced,
    residual,
)
from amulett_gym.studies.paper.reproduction import Readings
from amulett_gym.studies.paper.stages import _do_stage
from amulett_gym.studies.paper.study import EQUAL
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES

ROOT = Path(__file__).parents[3]
SHORT = study.Recipe(seeds=(1,), population=5, generations=1, refinement=1, steps=1)
SIZES = ["--seeds", "1", "--population", "5", "--generations", "1", "--refinement", "1", "--steps", "1"]
Explained = namedtuple("Explained", "explained")


@pytest.fixture(scope="module")
def content():
    return study.shipped()


@pytest.fixture(scope="module")
def parameters(content):
    return {entry["name"]: entry["value"] for entry in content["spread"]}


def test_what_no_device_can_be_costs_most_and_is_not_simulated(monkeypatch):
    names = [free.name for free in PARAMETERS]
    corner = np.full(len(names), 0.5)
    corner[names.index("testbed.lag")], corner[names.index("testbed.control_period")] = 0.0, 1.0
    most = cost([OUT_OF_REACH] * 40)
    monkeypatch.setattr("amulett_gym.studies.paper.objective.reproduced", lambda *_: pytest.fail("simulated"))
    assert objective(Readings())(corner) == most


@pytest.mark.parametrize("end", ["continued", "hard-stop", "stall"])
def test_a_fit_of_another_end_of_the_springs_curve_has_its_own_parameter(end):
    """From candidates of the end that was taken, as a study has them."""
    begin = np.random.default_rng(0).uniform(size=(5, len(PARAMETERS))).tolist()
    call = {"seed": 1, "generations": 1, "population": begin, "reading": {"spring_end": end}}
    found = _do_stage(call, asdict(Readings()))
    assert list(found["parameters"]) == [free.name for free in searched(end)]
    assert found["cost"] == objective(Readings(spring_end=end))(pack(found["parameters"]))
    back = _do_stage(call | {"population": found["population"], "reading": {}, "generations": 0}, asdict(Readings()))
    assert list(back["parameters"]) == [free.name for free in PARAMETERS]


def test_stalling_drives_explain_about_as_many_rows_as_a_held_force(parameters):
    """The held force is what an ideal drive with a stall torque does, and nearly what the testbed's drives do."""
    held, stalled = (
        reproduced({**parameters, "stall_torque": 0.3}, Readings(spring_end=end), 2, SIMULATED)
        for end in ("held", "stall")
    )
    assert abs(sum(row.explained for row in held) - sum(row.explained for row in stalled)) <= 2
    moved = [abs(np.log(one.ratio / other.ratio)) for one, other in zip(held, stalled, strict=True) if one.ratio]
    assert 0.0 < max(moved[:16]) < 0.05  # rise times and position ISEs


@pytest.mark.parametrize("end", ["continued", "hard-stop", "stall"])
def test_a_written_profile_has_the_end_of_the_springs_curve_and_its_source(content, parameters, end):
    values = {**parameters, "stall_torque": 0.4, "stop_stiffness": 3e4}
    entries = [
        {"name": free.name, "value": values[free.name], "unit": free.unit, "low": 0.0, "high": 1.0, "determined": True}
        for free in searched(end)
    ]
    found = {**content, "spread": entries, "readings": asdict(Readings(spring_end=end))}
    values = {entry["name"]: entry["value"] for entry in entries}
    for name in DEVICES:
        profile = load_profile(yaml.safe_load(study.profile_text(name, found)))
        assert same_device(profile, devices(values, end)[name])
        assert profile.spring.sources["beyond"].startswith("assumed: ")
        if end == "stall":
            assert profile.drives.sources["stall_torque"].startswith("identified: stall_torque 0.4 N m")
        if end == "hard-stop":
            assert profile.spring.sources["stop_stiffness"].startswith("identified: stop_stiffness 3e+04 N/m")


def test_scaling_all_lengths_and_the_inertia_changes_no_row(parameters):
    """Why R_2 is not searched: no table can see it."""
    found = devices(parameters)

    def scaled(profile, factor):
        plant, spring = profile.plant.model_dump(), profile.spring.model_dump()
        plant["drive_pulley_radius"] *= factor
        plant["joint_pulley_radius"] *= factor
        plant["masses"] = [{"mass": item["mass"] * factor, "arm": item["arm"]} for item in plant["masses"]]
        for key in ("half_width", "free_length", "max_deflection"):
            spring[key] *= factor
        spring["stiffness"] /= factor
        sensors = profile.sensors.model_dump()
        for key in ("potentiometer_travel", "potentiometer_noise"):
            sensors[key] *= factor
        return load_profile(profile.model_dump() | {"plant": plant, "spring": spring, "sensors": sensors})

    rows = reproduction.compare(reproduction.measure(found, Readings(), 2), Readings())
    other = {name: scaled(profile, 1.25) for name, profile in found.items()}
    for row, twin in zip(
        rows, reproduction.compare(reproduction.measure(other, Readings(), 2), Readings()), strict=True
    ):
        assert twin.ours == pytest.approx(row.ours, rel=2e-2), row.cell


def test_a_row_within_its_bound_has_a_residual_below_one(content):
    rows = reproduced({entry["name"]: entry["value"] for entry in content["spread"]}, Readings(), duration=SIMULATED)
    for row in rows:
        assert row.explained or abs(residual(row)) > 0.8, row.cell
        assert abs(residual(row)) > 1.0 or row.explained, row.cell


def test_a_row_out_of_reach_cannot_dominate_the_cost():
    assert cost([0.0] * 10) == 0.0
    assert cost([60.0] + [0.0] * 9) < cost([2.0] * 8 + [0.0] * 2)
    assert cost([0.5]) < cost([1.0]) < cost([5.0]) < cost([50.0])


def test_the_search_comes_back_to_known_parameters(monkeypatch, parameters):
    """A twin experiment: tables that a known set has made are explained by that set, and the search goes there."""
    parameters = unpack(pack(parameters))  # what is written has its digits rounded
    truth = reproduced(parameters, Readings(), 1, SIMULATED)
    cells = tuple(replace(row.cell, value=row.ours) for row in truth)
    monkeypatch.setattr(reproduction, "TABLES_2_TO_5", cells)
    assert objective(Readings())(pack(parameters)) == 0.0
    fixed = {name: value for name, value in parameters.items() if name not in ("inertia", "max_force")}
    found = search(objective(Readings()), 1, generations=12, population=12, fixed=fixed)
    assert found.parameters["inertia"] == pytest.approx(parameters["inertia"], rel=0.05)
    assert found.parameters["max_force"] == pytest.approx(parameters["max_force"], rel=0.05)


def test_members_of_the_ensemble_are_as_good_as_the_best(parameters):
    start = pack(parameters)
    rng = np.random.default_rng(0)
    population = np.clip(start + rng.normal(0.0, 0.002, (8, start.size)), 0.0, 1.0)
    value = objective(Readings())
    limit = value(start) + EQUAL
    far = np.clip(start + 0.3, 0.0, 1.0)
    members = ensemble(value, 1, np.vstack([start, population, far]), limit=limit, walkers=6, steps=2)
    assert len(members) >= 2
    assert all(value(pack(member)) <= limit + 1e-6 for member in members)
    assert len({member["inertia"] for member in members}) > 1
    assert ensemble(value, 1, far[None], limit=limit, walkers=6, steps=2) == []


def test_what_is_left_out_is_not_seen(parameters):
    vector = pack(parameters)
    whole = objective(Readings())(vector)
    parts = [objective(Readings(), without)(vector) for without in CONFIGURATIONS]
    assert sum(whole - part for part in parts) == pytest.approx(whole)
    assert all(part < whole for part in parts)


def test_the_chosen_set_explains_most(parameters):
    worse = {**parameters, "radius_ratio": 0.25}
    explained, least, chosen = most_explained(Readings(), [worse, parameters])
    assert chosen == parameters
    assert least == objective(Readings())(pack(parameters))
    assert explained > most_explained(Readings(), [worse])[0]


def test_rows_count_before_cost_and_cost_among_as_many_rows(monkeypatch, parameters):
    # cost, rows explained
    made_up = {0.001: (5.0, 30), 0.002: (7.0, 33), 0.003: (6.0, 33), 0.004: (9.0, 29)}
    monkeypatch.setattr(
        "amulett_gym.studies.paper.objective.objective", lambda readings: lambda vector: made_up[key(vector)][0]
    )
    monkeypatch.setattr(
        "amulett_gym.studies.paper.objective.reproduced",
        lambda member, *rest, **keywords: [Explained(True)] * made_up[member["inertia"]][1],
    )

    def key(vector):
        return round(unpack(vector)["inertia"], 6)

    members = [{**parameters, "inertia": inertia} for inertia in made_up]
    assert most_explained(Readings(), members) == (33, 6.0, members[2])


def test_a_progressive_spring_is_preferred_where_there_is_one(parameters):
    linear = {**parameters, "length_ratio": 0.0}
    cubic = {**parameters, "length_ratio": 1.0}
    assert study.stiffening(devices(linear)["testbed"]) == pytest.approx(1.0, abs=0.05)
    assert study.progressive([linear, cubic]) == [cubic]
    assert study.progressive([linear]) == [linear]


def test_a_device_that_cannot_start_is_worse_than_any_that_can(parameters):
    value = objective(Readings())
    weak = pack({**parameters, "max_force": 10.05, "max_deflection": 0.03, "width_ratio": 1.5})
    assert value(weak) > value(pack(parameters))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return the folder of a short study and what the command printed."""
    folder, printed = tmp_path_factory.mktemp("short"), io.StringIO()
    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        fork_processes(patch)
        assert main(["identify", "--out", str(folder), *SIZES]) == 0
    return folder, printed.getvalue()


def test_progress_counts_all_stages(finished):
    first, *lines = finished[1].splitlines()
    total = study.stage_count(SHORT)
    assert total == 1 + 4 + 1 + len(study.SPRING_LAWS) + len(reproduction.ALTERNATIVES) + 1 + 1
    assert first.startswith(f"{total} searches, ")
    assert [line.split()[:3] for line in lines[:total]] == [[str(k), "of", str(total)] for k in range(1, total + 1)]
    for name in (free.name for free in PARAMETERS):
        assert any(line.startswith(f"`{name}`") for line in lines[total:])


def test_a_study_that_was_interrupted_goes_on_where_it_was(tmp_path, finished):
    shutil.copytree(finished[0], tmp_path / "study")
    folder, stages = tmp_path / "study", tmp_path / "study" / "stages"
    for name in DEVICES:
        assert load_profile(folder / f"{name}.yaml").name == f"{name}-identified"
    content = json.loads((folder / "identification.json").read_text())
    before = {path.name: path.stat().st_mtime_ns for path in stages.iterdir()}
    (stages / "chosen.json").unlink()
    (stages / "start-1.json").write_text("{")  # damaged: done again
    (folder / "identification.json").unlink()
    done = []
    again = study.study(folder, SHORT, Readings(), report=lambda name, stage: done.append(name))
    assert json.loads(json.dumps(again)) == content == json.loads((folder / "identification.json").read_text())
    assert len(done) == len(set(done)) == study.stage_count(SHORT)
    after = {path.name: path.stat().st_mtime_ns for path in stages.iterdir()}
    assert {name for name in before if after[name] != before[name]} == {"chosen.json", "start-1.json"}


def test_another_recipe_does_not_replace_a_study_unasked(tmp_path, capsys, finished, monkeypatch):
    fork_processes(monkeypatch)
    folder = shutil.copytree(finished[0], tmp_path / "study")
    before = (folder / "identification.json").read_text()
    other = ["identify", "--out", str(folder), *SIZES[:-1], "2"]
    assert main(other) == 2
    message = "holds a study of another recipe (steps was 2 and is 1); choose another folder, or replace it"
    assert message in capsys.readouterr().err
    assert (folder / "identification.json").read_text() == before
    assert main([*other, "--overwrite"]) == 0
    assert json.loads((folder / "recipe.json").read_text())["steps"] == 2


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="needs process groups")
def test_ctrl_c_ends_all_workers_at_once_and_keeps_finished_stages(tmp_path):
    words = [sys.executable, "-m", "amulett_gym", "identify", "--out", str(tmp_path / "study"), "--workers", "2"]
    process = subprocess.Popen(
        [*words, "--seeds", "1", "--population", "5", "--generations", "2"],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # As a terminal does: a group of its own, in which everyone gets the signal.
        preexec_fn=lambda: (os.setsid(), signal.signal(signal.SIGINT, signal.SIG_DFL)),
    )
    stages, note = tmp_path / "study" / "stages", tmp_path / "study" / "command.json"
    while process.poll() is None and not (stages.is_dir() and any(stages.glob("start-*.json"))):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=600)  # waits for every process that holds the pipe
    assert process.returncode == 130
    assert "Traceback" not in stderr
    kept = {path.name: path.read_text() for path in stages.iterdir()}
    assert "start-1.json" in kept
    assert json.loads(note.read_text())["command"][:2] == ["amulett", "identify"]  # though it is not finished
    for text in kept.values():
        json.loads(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--generations", "0"], "--generations is 0; it has to be at least 1"),
        (["--population", "3"], "--population is 3; differential evolution needs at least 5"),
        (["--seeds", "1", "1"], "they have to differ"),
        (["--workers", "0"], "--workers is 0; it has to be at least 1"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(tmp_path, capsys, arguments, message):
    assert main(["identify", "--out", str(tmp_path / "study"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


def test_a_folder_with_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("precious")
    assert main(["identify", "--out", str(tmp_path)]) == 2
    assert "is not empty and holds no study" in capsys.readouterr().err


def test_the_shipped_profiles_are_what_was_identified(content, parameters):
    assert content["recipe"] == json.loads(json.dumps(asdict(study.Recipe())))
    assert content["readings"] == asdict(Readings())
    found = devices(parameters)
    for name in DEVICES:
        assert same_device(load_profile(name), found[name])
        file = ROOT / "configs" / "identified" / f"{name}.yaml"
        assert file.read_text() == study.profile_text(name, content)
        assert same_device(load_profile(file), load_profile(name))


def test_the_shipped_parameters_cost_what_the_study_says(content, parameters):
    assert objective(Readings())(pack(parameters)) == pytest.approx(content["cost"], rel=1e-6)
    rows = reproduced(parameters, Readings(), duration=SIMULATED)
    assert sum(row.explained for row in rows) == content["explained"]
    least = content["ensemble"]["least_cost"]
    assert least <= min(start["cost"] for start in content["starts"])
    assert least <= content["cost"] <= least + EQUAL


def test_the_ensemble_surrounds_the_shipped_parameters(content):
    for entry in content["spread"]:
        assert entry["low"] <= entry["value"] * 1.01
        assert entry["high"] >= entry["value"] * 0.99
        assert entry["bounds"][0] <= entry["value"] <= entry["bounds"][1]
