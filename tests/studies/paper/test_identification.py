"""The search finds what it is given, the same way every time, and the shipped profiles are what it found."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections import namedtuple
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import inertia
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.studies.paper import identification, reproduction, study
from amulett_gym.studies.paper.identification import (
    EQUAL,
    PARAMETERS,
    allowed,
    cost,
    devices,
    ensemble,
    most_explained,
    objective,
    pack,
    reproduced,
    residual,
    search,
    unpack,
)
from amulett_gym.studies.paper.reproduction import Readings
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES

ROOT = Path(__file__).parents[3]
SHORT = study.Recipe(seeds=(1, 2), population=8, generations=1, refinement=1, steps=1)
Explained = namedtuple("Explained", "explained")
vectors = st.lists(st.floats(0, 1), min_size=len(PARAMETERS), max_size=len(PARAMETERS)).map(np.array)


@pytest.fixture(scope="module")
def content():
    return study.shipped()


@pytest.fixture(scope="module")
def parameters(content):
    return {entry["name"]: entry["value"] for entry in content["spread"]}


@given(vectors)
def test_a_search_vector_turns_into_parameters_and_back(vector):
    parameters = unpack(vector)
    assert unpack(pack(parameters)) == pytest.approx(parameters)
    for free in PARAMETERS:
        assert free.low * (1 - 1e-9) <= parameters[free.name] <= free.high * (1 + 1e-9)


def test_the_whole_box_holds_devices_that_a_profile_allows():
    """All corners of every two parameters, the others in the middle or at either end, and what is between.

    An integration step of the longest control period is too long for the shortest lag.
    """
    size = len(PARAMETERS)
    corners = {(base,) * size for base in (0.0, 0.5, 1.0)}
    for base in (0.0, 0.5, 1.0):
        for i, j in itertools.combinations(range(size), 2):
            for one, other in itertools.product((0.0, 1.0), repeat=2):
                corner = [base] * size
                corner[i], corner[j] = one, other
                corners.add(tuple(corner))
    between = np.random.default_rng(0).uniform(size=(100, size))
    for vector in [*map(np.array, sorted(corners)), *between]:
        parameters = unpack(vector)
        devices(parameters)


def test_what_no_device_can_be_costs_most_and_is_not_simulated(monkeypatch):
    names = [free.name for free in PARAMETERS]
    corner = np.full(len(names), 0.5)
    corner[names.index("testbed.lag")], corner[names.index("testbed.control_period")] = 0.0, 1.0
    assert not allowed(corner)
    assert unpack(corner)["testbed.lag"] == 0.004
    value = objective(Readings())
    most = cost([identification.OUT_OF_REACH] * 40)
    monkeypatch.setattr(identification, "reproduced", lambda *_: pytest.fail("simulated"))
    assert value(corner) == most
    corner[names.index("testbed.control_period")] = 0.0
    assert allowed(corner)


@given(vectors)
@settings(max_examples=25)
def test_both_devices_get_the_same_mechanics_and_these_mean_what_they_say(vector):
    parameters = unpack(vector)
    found = devices(parameters)
    assert found["simulation"].spring == found["testbed"].spring
    assert found["simulation"].damping == found["testbed"].damping
    plant = found["testbed"].plant
    assert found["simulation"].plant == plant
    assert inertia([plant.masses[0].mass], [plant.masses[0].arm]) == pytest.approx(parameters["inertia"], rel=1e-4)
    assert plant.drive_pulley_radius / plant.joint_pulley_radius == pytest.approx(parameters["radius_ratio"], rel=1e-4)
    # Where the springs are almost in line, the force is a small difference of numbers with five digits.
    assert build_tables(found["testbed"].spring).max_force == pytest.approx(parameters["max_force"], rel=5e-2)


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
    rows = reproduced({entry["name"]: entry["value"] for entry in content["spread"]}, Readings(), 10)
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
    truth = reproduced(parameters, Readings())
    cells = tuple(replace(row.cell, value=row.ours) for row in truth)
    monkeypatch.setattr(reproduction, "TABLES_2_TO_5", cells)
    assert objective(Readings())(pack(parameters)) == 0.0
    fixed = {name: value for name, value in parameters.items() if name not in ("inertia", "max_force")}
    found = search(1, Readings(), generations=12, population=12, fixed=fixed)
    assert found.parameters["inertia"] == pytest.approx(parameters["inertia"], rel=0.05)
    assert found.parameters["max_force"] == pytest.approx(parameters["max_force"], rel=0.05)


def test_a_seed_gives_the_same_search_and_another_one_a_different(parameters):
    first, again, other = (search(seed, Readings(), generations=1, population=6) for seed in (1, 1, 2))
    assert (first.cost, first.parameters) == (again.cost, again.parameters)
    np.testing.assert_array_equal(first.population, again.population)
    assert other.parameters != first.parameters


def test_what_is_left_out_is_not_seen(parameters):
    vector = pack(parameters)
    whole = objective(Readings())(vector)
    parts = [objective(Readings(), without)(vector) for without in CONFIGURATIONS]
    assert sum(whole - part for part in parts) == pytest.approx(whole)
    assert all(part < whole for part in parts)


def test_members_of_the_ensemble_are_as_good_as_the_best(parameters):
    start = pack(parameters)
    rng = np.random.default_rng(0)
    population = np.clip(start + rng.normal(0.0, 0.002, (8, start.size)), 0.0, 1.0)
    value = objective(Readings())
    limit = value(start) + EQUAL
    far = np.clip(start + 0.3, 0.0, 1.0)
    members = ensemble(1, Readings(), np.vstack([start, population, far]), limit=limit, walkers=6, steps=2)
    assert len(members) >= 2
    assert all(value(pack(member)) <= limit + 1e-6 for member in members)
    assert len({member["inertia"] for member in members}) > 1
    assert ensemble(1, Readings(), far[None], limit=limit, walkers=6, steps=2) == []


def test_the_chosen_set_explains_most(parameters):
    worse = {**parameters, "radius_ratio": 0.25}
    explained, least, chosen = most_explained(Readings(), [worse, parameters])
    assert chosen == parameters
    assert least == objective(Readings())(pack(parameters))
    assert explained > most_explained(Readings(), [worse])[0]


def test_rows_count_before_cost_and_cost_among_as_many_rows(monkeypatch, parameters):
    # cost, rows explained
    made_up = {0.001: (5.0, 30), 0.002: (7.0, 33), 0.003: (6.0, 33), 0.004: (9.0, 29)}
    monkeypatch.setattr(identification, "objective", lambda readings: lambda vector: made_up[key(vector)][0])
    monkeypatch.setattr(identification, "devices", lambda member: member)
    monkeypatch.setattr(identification, "measure", lambda member, *rest, **keywords: member)
    monkeypatch.setattr(
        identification, "compare", lambda member, readings: [Explained(True)] * made_up[member["inertia"]][1]
    )

    def key(vector):
        return round(unpack(vector)["inertia"], 6)

    members = [{**parameters, "inertia": inertia} for inertia in made_up]
    assert most_explained(Readings(), members) == (33, 6.0, members[2])


def test_the_walk_covers_what_is_as_good_evenly(monkeypatch):
    """Without the stretch move's factor of the dimension the walkers would drift outwards or contract."""

    def in_box(readings):
        return lambda vector: float(np.abs(vector - 0.5).max() > 0.2)

    monkeypatch.setattr(identification, "objective", in_box)
    begin = 0.5 + 0.15 * np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(PARAMETERS)))
    members = ensemble(1, Readings(), begin, limit=0.5, walkers=60, steps=150)
    places = np.array([pack(member) for member in members])
    continuous = [k for k, free in enumerate(PARAMETERS) if not free.choices]
    late = places[len(places) // 2 :, continuous]
    assert np.abs(places - 0.5).max() <= 0.2 + 0.5 / 5  # `choices` are rounded to the middle of theirs
    assert late.mean() == pytest.approx(0.5, abs=0.02)
    assert late.std() == pytest.approx(0.2 / np.sqrt(3.0), rel=0.1)


def test_a_parameter_is_determined_if_the_sets_are_close_together_and_away_from_the_bounds():
    middle = np.full(len(PARAMETERS), 0.5)
    begin, end = middle.copy(), middle.copy()
    names = [free.name for free in PARAMETERS]
    for name, low, high in (
        ("inertia", 0.4, 0.6),  # close together
        ("radius_ratio", 0.3, 0.6),  # not close
        ("max_force", 0.0, 0.1),  # close, but at the lower bound
        ("max_deflection", 0.9, 1.0),  # and at the upper one
    ):
        begin[names.index(name)], end[names.index(name)] = low, high
    found = study.spread([unpack(begin), unpack(middle), unpack(end)])
    assert [found[name][2] for name in names[:5]] == [True, False, False, False, True]
    assert found["inertia"][:2] == pytest.approx((unpack(begin)["inertia"], unpack(end)["inertia"]), rel=5e-3)


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


def test_a_study_that_was_interrupted_goes_on_where_it_was(tmp_path):
    done = []
    content = study.study(tmp_path, SHORT, Readings(), 2, lambda name, stage: done.append(name))
    assert len(done) == len(set(done)) == 2 + 4 + 1 + len(study.SPRING_LAWS) + len(reproduction.ALTERNATIVES) + 2 + 1
    for name in DEVICES:
        assert load_profile(tmp_path / f"{name}.yaml").name == f"{name}-identified"
    stages = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "stages").iterdir()}
    (tmp_path / "stages" / "chosen.json").unlink()
    (tmp_path / "identification.json").unlink()
    assert study.study(tmp_path, SHORT, Readings(), 1) == content
    again = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "stages").iterdir()}
    assert {name for name in stages if again[name] != stages[name]} == {"chosen.json"}
    assert json.loads((tmp_path / "identification.json").read_text()) == json.loads(json.dumps(content))


def test_another_recipe_does_not_replace_a_study_unasked(tmp_path, capsys):
    study.study(tmp_path, SHORT, Readings(), 2)
    before = (tmp_path / "identification.json").read_text()
    other = ["identify", "--out", str(tmp_path), "--seeds", "1", "2", "--population", "8", "--generations", "2"]
    other += ["--refinement", "1", "--steps", "1"]
    assert main(other) == 2
    assert "holds a study with generations 1, not 2; choose another folder, or replace it" in capsys.readouterr().err
    assert (tmp_path / "identification.json").read_text() == before
    assert main([*other, "--overwrite"]) == 0
    assert json.loads((tmp_path / "recipe.json").read_text())["generations"] == 2


def test_progress_counts_all_stages(tmp_path, capsys):
    sizes = ["--seeds", "1", "--population", "5", "--generations", "1", "--refinement", "1", "--steps", "1"]
    assert main(["identify", "--out", str(tmp_path), *sizes]) == 0
    lines = capsys.readouterr().out.splitlines()
    total = study.stage_count(replace(SHORT, seeds=(1,)))
    assert [line.split()[:3] for line in lines[:total]] == [[str(k), "of", str(total)] for k in range(1, total + 1)]


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="needs process groups")
def test_ctrl_c_ends_all_workers_at_once_and_keeps_finished_stages(tmp_path):
    words = [sys.executable, "-m", "amulett_gym", "identify", "--out", str(tmp_path / "study"), "--processes", "2"]
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
    _, stderr = process.communicate(timeout=60)  # waits for every process that holds the pipe
    assert process.returncode == 130
    assert "Traceback" not in stderr
    kept = {path.name: path.read_text() for path in stages.iterdir()}
    assert "start-1.json" in kept
    assert json.loads(note.read_text())["command"][:2] == ["amulett", "identify"]  # though it is not finished
    for text in kept.values():
        json.loads(text)


def test_a_damaged_stage_is_named(tmp_path):
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages" / "start-1.json").write_text("{")
    with pytest.raises(AmulettError, match="start-1.json' is not valid JSON.*delete it"):
        study.study(tmp_path, SHORT, Readings(), 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--generations", "0"], "--generations is 0; it has to be at least 1"),
        (["--population", "3"], "--population is 3; differential evolution needs at least 5"),
        (["--seeds", "1", "1"], "they have to differ"),
        (["--processes", "0"], "--processes is 0; it has to be at least 1"),
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
        assert study.same_device(load_profile(name), found[name])
        file = ROOT / "configs" / "identified" / f"{name}.yaml"
        assert file.read_text() == study.profile_text(name, content)
        assert study.same_device(load_profile(file), load_profile(name))


def test_the_shipped_parameters_cost_what_the_study_says(content, parameters):
    assert objective(Readings())(pack(parameters)) == pytest.approx(content["cost"], rel=1e-6)
    rows = reproduced(parameters, Readings(), 10)
    assert sum(row.explained for row in rows) == content["explained"]
    least = content["ensemble"]["least_cost"]
    assert least <= min(start["cost"] for start in content["starts"])
    assert least <= content["cost"] <= least + EQUAL


def test_the_ensemble_surrounds_the_shipped_parameters(content):
    for entry in content["spread"]:
        assert entry["low"] <= entry["value"] * 1.01
        assert entry["high"] >= entry["value"] * 0.99
        assert entry["bounds"][0] <= entry["value"] <= entry["bounds"][1]
