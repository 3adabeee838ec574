"""A sample of devices explains the paper with the shipped loop, and every device of it can be played."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import fork_processes

from amulett_gym.cli import main
from amulett_gym.envs import eq6_costs
from amulett_gym.envs.eq6_costs import FLEET_COSTS, device_digest, measure
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import fleet_names, load_fleet
from amulett_gym.identification.parameters import LOOP, UNSEEN, devices, pack, resized, searched
from amulett_gym.profile import load_profile
from amulett_gym.studies.paper import objective, stages, study
from amulett_gym.studies.paper import sample as module
from amulett_gym.studies.paper.reproduction import Readings
from amulett_gym.studies.paper.sample import FLEETS, Recipe, profile_content, sample
from amulett_gym.studies.paper.sample_page import MARKS, block, draw, in_words

SMALL = Recipe(seeds=(1,), spring_laws=(), population=12, generations=1, steps=2, devices=(3, 1, 2))
STALL = Readings(spring_end="stall")


def physics():
    """Return the shipped set of parameters without the loop."""
    return {entry["name"]: entry["value"] for entry in study.shipped()["spread"] if entry["name"] not in LOOP}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return a folder and the content of a small sample around the shipped testbed, run in this process."""
    patch = pytest.MonkeyPatch()
    patch.setattr(eq6_costs, "EPISODES", 2)
    patch.setattr(eq6_costs, "_known", {})
    patch.setattr(module, "SCENARIOS", 2)
    patch.setattr("amulett_gym.studies.paper.stages.run_stages", lambda *arguments: _run(*arguments))
    folder = tmp_path_factory.mktemp("sample")
    try:
        content = sample(folder, SMALL, Readings(), command=["amulett", "identify"])
    finally:
        patch.undo()
    return folder, content


def _run(folder, calls, readings, processes, work=None):
    """Do the stages here, with a start that is near the shipped set."""
    middle = pack(physics())
    population = np.clip(middle + np.random.default_rng(0).normal(0.0, 0.003, (20, middle.size)), 0.0, 1.0)
    start = {"cost": objective.objective(readings, loop=False)(middle), "explained": 33, "parameters": physics()}
    for name, call in calls.items():
        if name.startswith("start-"):
            yield name, {**start, "population": [middle.tolist(), *population.tolist()]}
        else:
            yield name, (work or stages._do_stage)(call, vars(readings))


def test_a_sample_has_the_devices_that_were_asked_for_in_three_fleets(finished):
    folder, content = finished
    assert [device["name"] for device in content["devices"]] == [
        *("plausible-01", "plausible-02", "plausible-03"),
        *("choose-01", "held-out-01", "held-out-02"),
    ]
    fleets = [load_fleet(folder / f"{name}.yaml") for name in FLEETS]
    assert [len(fleet) for fleet in fleets] == list(SMALL.devices)
    for fleet in fleets:
        for profile in fleet:
            assert profile.base == "testbed" and profile.loop == load_profile("testbed").loop
            assert profile.sensors.force_filter == load_profile("testbed").sensors.force_filter
            assert profile.drives.sources["lag"].startswith("identified: ")
    assert len({device_digest(profile) for fleet in fleets for profile in fleet}) == sum(SMALL.devices)
    assert (folder / "plausible.yaml").read_text().splitlines()[0].endswith("Written by: amulett identify")


def test_each_device_explains_the_tables_within_the_bound(finished):
    _, content = finished
    limit = content["least_cost"] + SMALL.bound
    for device in content["devices"]:
        found = devices(device["parameters"])
        assert found["testbed"].loop == load_profile("testbed").loop
        rows = objective.reproduced(device["parameters"], Readings(), 1, objective.SIMULATED)
        weights = [objective.WEIGHTS[row.cell.metric] for row in rows]
        assert objective.cost([objective.residual(row) for row in rows], weights) == pytest.approx(device["cost"])
        assert device["cost"] <= limit
        assert 25 <= device["explained"] <= content["of"] == 40
    refused = content["refused"]
    assert content["tried"] == len(content["devices"]) + sum(refused.values())


def test_the_costs_of_eq6_are_those_of_the_devices(finished):
    folder, _ = finished
    costs = json.loads((folder / FLEET_COSTS).read_text())
    profiles = {device_digest(profile): profile for name in FLEETS for profile in load_fleet(folder / f"{name}.yaml")}
    assert set(costs) == set(profiles)
    assert all(set(suites) == set(module.suite_names()) for suites in costs.values())


def test_a_sample_is_shown_with_its_spread_and_what_it_means_for_a_law(finished):
    _, content = finished
    text = in_words(content)
    assert "6 devices" in text and "`mass_arm`" in text and "best constant tension" in text
    assert "![" in block(content) and MARKS[0] not in block(content)
    [figure] = draw(content).values()
    assert len(figure.axes) == 2
    correlations = np.array(content["correlations"])
    assert np.diag(correlations)[0] == 1.0 and np.abs(correlations).max() <= 1.0


def test_another_recipe_does_not_replace_a_sample_unasked(finished):
    folder, _ = finished
    with pytest.raises(AmulettError, match="holds a study of another recipe"):
        sample(folder, replace(SMALL, steps=3), Readings())


def test_too_few_sets_are_an_error_that_says_what_helps(finished, tmp_path, monkeypatch):
    monkeypatch.setattr("amulett_gym.studies.paper.stages.run_stages", _run)
    monkeypatch.setattr(module, "PASSES", 1)
    with pytest.raises(AmulettError, match=r"only \d+ of 40 devices .* more walkers"):
        sample(tmp_path, replace(SMALL, devices=(20, 10, 10)), Readings())


def test_another_joint_pulley_changes_no_row_but_the_torques():
    parameters = physics()
    wide = resized(parameters, 0.048)
    rows, others = (objective.reproduced(each, Readings(), 2, objective.SIMULATED) for each in (parameters, wide))
    for row, other in zip(rows, others, strict=True):
        if row.cell.metric in ("rise_time", "position_ise") and row.ours is not None:
            assert other.ours == pytest.approx(row.ours, rel=2e-2), row.cell
    one, two = (devices(each)["testbed"] for each in (parameters, wide))
    assert two.plant.joint_pulley_radius == 0.048
    assert two.plant.drive_pulley_radius == pytest.approx(1.2 * one.plant.drive_pulley_radius, rel=1e-4)


def test_each_fleet_has_springs_of_all_kinds():
    rng = np.random.default_rng(5)
    lengths = np.concatenate([rng.uniform(0.9, 1.0, 96), rng.uniform(0.1, 0.4, 16)])
    drawn = [{"parameters": {"length_ratio": value}} for value in rng.permutation(lengths).tolist()]
    named = module._split(drawn, Recipe())
    assert sorted(map(id, named.values())) == sorted(map(id, drawn))
    for begin, size, soft in zip(FLEETS.values(), Recipe().devices, (9, 2, 5), strict=True):
        own = [device["parameters"]["length_ratio"] for name, device in named.items() if name.startswith(f"{begin}-")]
        assert len(own) == size and abs(sum(value < 0.5 for value in own) - soft) <= 1
        assert own != sorted(own)
    assert module._split(drawn, Recipe()) == named


def test_a_start_has_a_law_of_the_spring_and_none_walks_from_beyond_the_bound(tmp_path, monkeypatch):
    calls = {}

    def stages(folder, given, readings, processes, work=None):
        calls.update(given)
        for name in given:
            cost, own = (50.0, 0.7) if name == "start-spring-0.7" else (33.0, 0.98)
            start = {"cost": cost, "explained": 30, "parameters": physics(), "population": [[own] * 13] * 12}
            yield name, [] if name.startswith("walk-") else start if work is None else {"devices": []}

    monkeypatch.setattr("amulett_gym.studies.paper.stages.run_stages", stages)
    with pytest.raises(AmulettError, match="only 0 of 6"):
        sample(tmp_path, replace(SMALL, seeds=(1, 2), spring_laws=(0.7,)), STALL)
    assert calls["start-spring-0.7"]["fixed"] == {"length_ratio": 0.7} and "fixed" not in calls["start-2"]
    assert {call["limit"] for name, call in calls.items() if name.startswith("walk-")} == {33.0 + SMALL.bound}
    assert calls["walk-start-spring-0.7"]["candidates"] == [[0.7] * 13] * 12


def test_the_weights_arm_is_at_the_same_inertia_and_seen_by_no_row():
    parameters = physics()
    other = {**parameters, "mass_arm": 0.18}
    one, two = (devices(each)["testbed"].plant.masses[0] for each in (parameters, other))
    assert two.mass * two.arm**2 == pytest.approx(one.mass * one.arm**2, rel=1e-4)
    rows, others = (objective.reproduced(each, Readings(), 1, objective.SIMULATED) for each in (parameters, other))
    assert [row.ours for row in rows] == pytest.approx([row.ours for row in others], rel=5e-3)


@pytest.mark.parametrize("end", ["held", "stall"])
def test_a_written_device_is_the_one_that_was_judged(end):
    parameters = {**physics(), **{free.name: free.value(0.3) for free in UNSEEN}, "stall_torque": 0.3}
    readings = Readings(spring_end=end, floor="hold")
    content = profile_content("mine", parameters, readings)
    assert content["name"] == "mine" and yaml.safe_load(yaml.safe_dump(content)) == content
    profile, judged = load_profile(content), devices(parameters, end)["testbed"]
    assert profile.sensors.below_floor == "hold"
    for group in ("plant", "spring", "drives", "loop"):
        sourceless = [getattr(each, group).model_dump(exclude={"sources"}) for each in (profile, judged)]
        assert sourceless[0] == sourceless[1]
    assert profile.sensors.encoder_noise_deg == parameters["encoder_noise"]
    assert (profile.drives.stall_torque == 0.3) == (end == "stall")


def test_what_an_environment_cannot_play_is_refused():
    weak = {**physics(), **{free.name: free.value(0.3) for free in UNSEEN}, "max_force": 13.0}
    assert not module._playable(load_profile(profile_content("weak", weak, Readings())))
    value, trouble = module._value({**weak, "max_force": 50.0}, Readings(), 1e9)
    assert trouble == "range" and value == np.inf
    assert module._value(weak, Readings(), 1e9)[1] == "environment"
    assert module._value(weak, Readings(), 1.0)[1] == "cost"


def test_physics_alone_is_searched_with_the_testbeds_loop():
    free = searched("stall", loop=False)
    assert not {item.name for item in free} & set(LOOP) and free[-1].name == "stall_torque"
    call = {"seed": 1, "generations": 0, "population": 5, "loop": False}
    found = stages._do_stage(call, vars(STALL))
    assert list(found["parameters"]) == [item.name for item in free]
    assert stages._inputs(call, STALL) != stages._inputs({**call, "loop": True}, STALL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--fleet", "--refinement", "3"], "--refinement is not for --fleet"),
        (["--fleet", "--bound", "0"], "--bound is 0; it has to be above 0"),
        (["--fleet", "--devices", "3", "0", "1"], "each fleet needs at least 1"),
        (["--devices", "3", "1", "1"], "--devices is for a sample of devices; add --fleet"),
        (
            ["--fleet", "--spring-laws", "0.5", "1.2"],
            "--spring-laws has 1.2; a free length over the half width is from",
        ),
        (["--spring-laws", "0.5"], "--spring-laws is for a sample of devices; add --fleet"),
        (["--below-floor", "hold"], "--below-floor is for a sample of devices; add --fleet"),
        (["--columns", "1"], "--columns is for figures, which are written only with --fleet"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(tmp_path, capsys, options, message):
    assert main(["identify", "--out", str(tmp_path / "out"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_draws_writes_and_continues(tmp_path, capsys, monkeypatch):
    fork_processes(monkeypatch)
    folder, page = tmp_path / "out", tmp_path / "page.md"
    page.write_text("\n\n".join(["# Page", *MARKS]))
    words = ["identify", "--fleet", "--seeds", "1", "--spring-laws", "--population", "16", "--generations", "1"]
    words += ["--steps", "1", "--bound", "1000", "--devices", "1", "1", "1", "--out", str(folder), "--doc", str(page)]
    assert main(words) == 0
    content = (folder / "fleet.json").read_text()
    assert len(json.loads(content)["devices"]) == 3
    assert "What varies" in page.read_text() and (tmp_path / "images" / "plausible_devices.png").is_file()
    stages = {path: path.stat().st_mtime_ns for path in (folder / "stages").iterdir()}
    assert main(words) == 0
    assert (folder / "fleet.json").read_text() == content
    assert {path: path.stat().st_mtime_ns for path in (folder / "stages").iterdir()} == stages


@pytest.mark.skipif(not set(FLEETS) <= set(fleet_names()), reason="no sample is shipped")
def test_the_shipped_fleets_are_whole_and_have_their_costs():
    costs = json.loads((Path(module.__file__).parents[2] / "fleets" / FLEET_COSTS).read_text())
    fleets = [load_fleet(name) for name in FLEETS]
    assert [len(fleet) for fleet in fleets] == list(Recipe().devices)
    assert {device_digest(profile) for fleet in fleets for profile in fleet} == set(costs)
    profile = fleets[2][0]
    again, kept = measure(profile, "reach"), eq6_costs.eq6_costs(profile, "reach")
    assert again is not None and kept is not None
    assert kept.mean.model_dump() == pytest.approx(again.mean.model_dump(), rel=1e-2)
