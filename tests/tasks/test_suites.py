"""Suites draw different scenarios from different keys; a scenario is data that packs and unpacks without loss."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.cli.config import validate
from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import static_torque
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.tasks import hashes, suites
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack, unpack
from amulett_gym.tasks.suites import (
    CONTACT_SUITES,
    SPLITS,
    WORKSPACE_DEG,
    episode_keys,
    families_of,
    sample,
    suite_names,
)

TESTBED = load_profile("testbed")
DRAWN = [suite for suite in suite_names() if suite != "paper-step"]


def keys(count: int) -> np.ndarray:
    return np.arange(count, dtype=np.uint64)


@pytest.mark.parametrize("split", ["train", "shifted"])
@pytest.mark.parametrize("suite", suite_names())
def test_scenarios_do_not_depend_on_the_batch(suite, split):
    together = sample(suite, keys(50), TESTBED, split=split)
    for i in (0, 17, 49):
        assert sample(suite, keys(50)[i : i + 1], TESTBED, split=split)[0] == together[i]


@pytest.mark.parametrize("suite", DRAWN)
def test_other_keys_give_other_scenarios(suite):
    rows = sample(suite, keys(200), TESTBED)
    assert len({row.tobytes() for row in rows}) == 200


@pytest.mark.parametrize("split", ["train", "shifted"])
@pytest.mark.parametrize("suite", suite_names())
def test_scenarios_replay_exactly_from_json(suite, split):
    for row in sample(suite, keys(40), TESTBED, split=split):
        scenario = Scenario.model_validate_json(unpack(row).model_dump_json())
        assert pack(scenario, TESTBED)[0] == row


@pytest.mark.parametrize("suite", suite_names())
def test_every_scenario_knows_its_family(suite):
    drawn = {unpack(row).family for row in sample(suite, keys(100), TESTBED)}
    assert drawn == set(families_of(suite))


def test_splits_and_episodes_have_keys_of_their_own():
    episodes = np.zeros(1000, dtype=np.uint64)
    found = [episode_keys(keys(1000), episodes + np.uint64(e), split) for split in SPLITS for e in range(3)]
    assert np.unique(np.concatenate(found)).size == 3000 * len(SPLITS)


def test_suites_draw_what_was_frozen():
    frozen = hashes.frozen()
    assert frozen["version"] == hashes.VERSION
    assert hashes.measure() == frozen["hashes"], "if a suite is meant to have changed: a new version, and --write"


def test_a_hash_tells_one_scenario_from_another():
    found = {digest for splits in hashes.frozen()["hashes"].values() for digest in splits.values()}
    # The paper's step is always the same but for its noise; that differs from split to split.
    assert len(found) == len(suite_names()) * len(SPLITS)


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("suite", suite_names())
def test_every_start_can_be_held_and_no_device_fails(suite, split):
    # 10,000 starts; the first 400 are played for 10 s under a slack and a middling tension.
    seeds = keys(10_000)
    rows = sample(suite, episode_keys(seeds, 0 * seeds, split), TESTBED, split=split)
    Simulation(TESTBED, len(rows)).reset(rows)
    played = Simulation(TESTBED, 400)
    for tension in (6.0, 10.0):
        played.reset(rows[:400])
        played.command_tension(tension)
        played.advance(round(10.0 / played.control_period))
        assert not played.read("failure").any()


@pytest.mark.parametrize("suite", ["payload", "mixed"])
def test_suites_with_gravity_can_start_on_the_other_profile(suite):
    profile = load_profile("simulation")
    for split in SPLITS:
        seeds = keys(2000)
        Simulation(profile, 2000).reset(sample(suite, episode_keys(seeds, 0 * seeds, split), profile, split=split))


@pytest.mark.parametrize("split", ["train", "shifted"])
@pytest.mark.parametrize("suite", ["mixed", "payload"])
def test_drives_that_stall_can_hold_every_start(suite, split):
    profile = load_profile({"name": "weak", "base": "testbed", "drives": {"stall_torque": 0.16}})
    keys = np.arange(400, dtype=np.uint64)
    rows = sample(suite, keys, profile, split=split)
    simulation = Simulation(profile, keys.size)
    simulation.reset(rows)
    with pytest.raises(AmulettError, match="stall_torque is 0.16 N m"):
        simulation.reset(sample(suite, keys, load_profile("testbed"), split=split))


def test_mixed_draws_every_family_equally_often():
    rows = sample("mixed", keys(7000), TESTBED)
    share = {
        "track": rows["wave_amplitude"] > 0,
        "payload": rows["payload_mass"] > 0,
        "hold-push": (rows["push_count"] > 0) & (rows["move_count"] == 0),
        "pick-place": (rows["push_count"] > 0) & (rows["move_count"] > 0),
        "contact": rows["obstacle_stiffness"] > 0,
        "steps": (rows["move_count"] > 0) & (rows["move_duration"][:, 0] == 0),
    }
    for name, drawn in share.items():
        assert {unpack(row).family for row in rows[drawn][:50]} == {name}
        assert drawn.mean() == pytest.approx((0.75 if name == "contact" else 1.0) / 7, rel=0.12), name
    varied = ("spring_biceps_factor", "pulley_triceps_factor", "damping_factor", "encoder_bias", "initial_tension")
    assert all(len(np.unique(rows[name])) > 50 for name in varied)


def test_shifted_lies_outside_the_other_ranges():
    def drawn(suite, split):
        return sample(suite, keys(1000), TESTBED, split=split)

    def pulses(split):
        return np.abs(drawn("hold-push", split)["push_torque"])

    assert pulses("shifted").min() > pulses("train").max()
    spring = "spring_biceps_factor"
    assert drawn("mixed", "shifted")[spring].max() < drawn("mixed", "train")[spring].min()
    stiffness = [drawn("contact", split)["obstacle_stiffness"] for split in ("train", "shifted")]
    assert stiffness[1][stiffness[1] > 0].min() > stiffness[0].max()
    lying = [rows[rows["static_torque"] == 0] for rows in (drawn("payload", "train"), drawn("payload", "shifted"))]
    moment = [rows["payload_mass"] * rows["payload_arm"] for rows in lying]
    assert moment[1].min() > moment[0].max()
    frequency = [drawn("track", split)["wave_frequency"] for split in ("train", "shifted")]
    assert frequency[1].min() > frequency[0].max()


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("suite", CONTACT_SUITES)
def test_obstacles_are_on_the_way_and_never_in_the_arm_at_the_start(suite, split):
    rows = sample(suite, keys(2000), TESTBED, split=split)
    rows = rows[rows["obstacle_stiffness"] > 0]
    beyond = rows["obstacle_side"] * (rows["obstacle_angle"] - rows["initial_angle"])
    way = rows["obstacle_side"] * (rows["move_angle"][:, 0] - rows["initial_angle"])
    assert (beyond > 0).all() and (beyond < way).all()


def test_paper_step_is_the_papers_protocol():
    (move,) = unpack(sample("paper-step", keys(1), TESTBED)[0]).moves
    assert (move.angle_deg, move.duration) == (45.0, 0.0)


@pytest.mark.parametrize("suite", ["steps", "reach"])
def test_moves_stay_in_the_workspace_and_go_both_ways(suite):
    low, high = WORKSPACE_DEG
    changes = []
    for row in sample(suite, keys(300), TESTBED):
        scenario = unpack(row)
        angles = [scenario.initial_angle_deg, *(move.angle_deg for move in scenario.moves)]
        assert all(low <= angle <= high for angle in angles)
        changes += list(np.diff(angles))
    assert min(np.abs(changes)) >= 10.0 - 1e-9
    assert max(np.abs(changes)) <= 60.0 + 1e-9
    assert 0.4 < np.mean(np.array(changes) > 0) < 0.6


def test_moves_outlast_the_default_episode():
    rows = sample("steps", keys(300), TESTBED)
    assert rows["move_time"][:, -1].min() > 9.5


def test_pushes_can_be_resisted():
    spare = (build_tables(TESTBED.spring).max_force - 10.0) * TESTBED.plant.joint_pulley_radius
    torque = np.abs(sample("hold-push", keys(300), TESTBED)["push_torque"])
    assert 0.19 * spare < torque.min() < torque.max() < 0.71 * spare


@given(
    angle=st.floats(-149, 149),
    times=st.lists(st.floats(0, 100).map(lambda time: round(time, 4)), max_size=10, unique=True),
    mass=st.floats(0, 2),
    blocks=st.sampled_from(["flexion", "extension"]),
    rise=st.integers(0, 350).map(lambda milliseconds: milliseconds / 1000),
)
def test_packing_keeps_every_scenario(angle, times, mass, blocks, rise):
    scenario = Scenario(
        initial_angle_deg=round(angle, 6),
        initial_tension=9.0,
        moves=[{"time": time, "angle_deg": 30.0} for time in sorted(times)],
        wave={"amplitude_deg": 3.0, "frequency": 0.4, "chirp": -0.01, "time": 0.2, "duration": 3.0},
        pushes=[{"time": time, "duration": 0.7, "torque": -0.5, "rise": rise} for time in times[:4]],
        shake={"rms": 0.1, "bandwidth": 2.5, "time": 0.1, "duration": 7.0},
        orientation="vertical" if rise > 0.2 else "profile",
        device={
            "spring_biceps": 0.87,
            "encoder_bias_deg": -0.123,
            "slider_bias_triceps": 1e-5,
            "late_probability": 0.07,
        },
        obstacle={"angle_deg": 20.0, "blocks": blocks, "stiffness": 5.0, "damping": 0.1},
        payload={"mass": mass, "arm": 0.2} if mass > 0 else None,
        family="contact" if mass > 0 else "steps",
        noise_seed=3,
    )
    assert unpack(pack(scenario, TESTBED)[0]) == scenario


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"intial_angle_deg": 3.0}, "unknown key 'intial_angle_deg'; did you mean 'initial_angle_deg'"),
        ({"moves": [{"time": -1.0, "angle_deg": 0.0}]}, r"'moves.0.time' is -1.0.*greater than or equal to 0"),
        ({"moves": [{"time": 1.0, "angle_deg": 0.0, "duration": 1e-9}]}, "shorter than a millisecond; 0 is a"),
        ({"moves": [{"time": 1.0, "angle_deg": 0.0, "duraton": 1.0}]}, "'moves.0.duraton'; did you mean 'duration'"),
        (
            {"moves": [{"time": 1.0, "angle_deg": 9.0, "duration": 1.0}, {"time": 1.5, "angle_deg": 0.0}]},
            "before the one at 1.0 s has ended",
        ),
        ({"pushes": [{"time": 0.0, "duration": 0.0, "torque": 1.0}]}, "'pushes.0.duration' is 0.0"),
        ({"pushes": [{"time": 0.0, "duration": 0.3, "torque": 1.0, "rise": 0.2}]}, "no room to rise and fall"),
        ({"shake": {"rms": -1.0, "bandwidth": 1.0, "duration": 1.0}}, "'shake.rms' is -1.0"),
        ({"wave": {"amplitude_deg": 1.0, "frequenzy": 1.0, "duration": 1.0}}, "did you mean 'frequency'"),
        ({"family": "hold-pusch"}, "'family' is 'hold-pusch'"),
        ({"device": {"late_probability": 1.0}}, "'device.late_probability' is 1.0"),
        ({"obstacle": {"angle_deg": 3.0, "stiffness": float("inf")}}, "finite"),
    ],
)
def test_wrong_scenarios_are_refused(content, message):
    with pytest.raises(AmulettError, match=message):
        load_scenario(content)


def test_wrong_scenario_files_are_refused(tmp_path: Path):
    with pytest.raises(AmulettError, match="cannot read scenario"):
        load_scenario(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(AmulettError, match="not valid JSON"):
        load_scenario(tmp_path / "broken.json")
    (tmp_path / "scenario.txt").write_text("{}")
    with pytest.raises(AmulettError, match=r"'.*scenario.txt' has to end in .json, .yaml or .yml"):
        load_scenario(tmp_path / "scenario.txt")


@pytest.mark.parametrize("suffix", [".json", ".JSON", ".yaml", ".yml", ".YAML"])
def test_scenarios_are_json_or_yaml(suffix, tmp_path: Path):
    path = tmp_path / f"mine{suffix}"
    content = {"initial_angle_deg": 10.0, "moves": [{"time": 0.5, "angle_deg": 30.0}]}
    path.write_text(json.dumps(content) if "j" in suffix.lower() else yaml.safe_dump(content))
    assert load_scenario(path) == load_scenario(str(path)) == load_scenario(content)
    assert validate(path).kind == "a scenario"
    path.write_text("{}\nwrong")
    with pytest.raises(AmulettError, match=r"scenario '.*mine.*' is not valid (JSON|YAML)"):
        load_scenario(path)


def test_old_names_of_keys_are_accepted_with_a_warning():
    with pytest.warns(DeprecationWarning, match="'device.jitter' is now 'late_probability'"):
        scenario = load_scenario({"device": {"jitter": 0.1}})
    assert scenario == load_scenario({"device": {"late_probability": 0.1}})
    with pytest.warns(DeprecationWarning, match="late_probability"):
        assert scenario.device.jitter == 0.1
    with pytest.raises(AmulettError, match="'jitter' is the old name of 'late_probability'; give one"):
        load_scenario({"device": {"jitter": 0.1, "late_probability": 0.1}})


def test_an_obstacle_is_charged_as_in_the_contact_suite_unless_a_family_is_named():
    wall = {"obstacle": {"angle_deg": 20.0, "stiffness": 5.0}, "moves": [{"time": 0.5, "angle_deg": 45.0}]}

    def family(content):
        return unpack(pack(load_scenario(content), TESTBED)[0]).family

    assert family(wall) == "contact"
    assert family({**wall, "family": "reach"}) == "reach"
    assert family({**wall, "obstacle": None}) is None


def test_figures_in_the_docstrings_are_those_of_the_shipped_devices():
    for name in ("simulation", "testbed"):  # worn has suites of its own
        profile = load_profile(name)
        plant, sigma = profile.plant, profile.variable_stiffness.nominal_tension
        spare = (build_tables(profile.spring).max_force - sigma) * plant.joint_pulley_radius
        assert f"weight's torque, {spare:.3f} N m on simulation and testbed" in suites.__doc__
        soft, hard = (spare / np.radians(deg) for deg in (10.0, 1.5))
        contact = suites._contact.py_func.__doc__
        assert f"{soft:.1f} to {hard:.1f} N m/rad on simulation and testbed" in contact
        assert f"0.25 m {soft / 0.25**2:.0f} to {hard / 0.25**2:.0f} N/m" in " ".join(contact.split())
        weight = static_torque([item.mass for item in plant.masses], [item.arm for item in plant.masses])
        share = weight * np.sin(np.radians(suites._VERTICAL_TOP_DEG)) / spare
        assert f"{share:.0%}".replace("%", " %") in suites._payload.py_func.__doc__
    plant = TESTBED.plant
    gain = TESTBED.loop.position.ki * plant.drive_pulley_radius / plant.joint_pulley_radius
    corner = f"{gain:.1f} 1/s, a time constant of {1 / gain:.1f} s or {gain / (2 * np.pi):.1f} Hz"
    assert corner in " ".join(suites._track.py_func.__doc__.split())


@pytest.mark.parametrize(("key", "value"), [("stiffness", 1000.0), ("damping", 20.0)])
def test_obstacles_that_the_step_cannot_resolve_are_refused(key, value):
    scenario = load_scenario({"obstacle": {"angle_deg": 30.0, "stiffness": 5.0, key: value}})
    with pytest.raises(AmulettError, match=rf"'obstacle.{key}' is {value}.*at most"):
        pack(scenario, TESTBED)


@pytest.mark.parametrize("suite", suite_names())
def test_every_suite_can_start_a_vertical_arm(suite):
    upright = load_profile({"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}})
    simulation = Simulation(upright, 200)
    simulation.reset(sample(suite, keys(200), upright))
    simulation.command_tension(simulation.read("tension_setpoint"))
    start = simulation.read("angle")
    simulation.advance(round(0.45 / simulation.control_period))
    assert np.degrees(np.abs(simulation.read("angle") - start)).max() < 1.0


def test_initial_angle_beyond_the_device_is_refused():
    with pytest.raises(AmulettError, match=r"limit is \+-150"):
        pack(Scenario(initial_angle_deg=150.0), TESTBED)


def test_pushes_leave_room_for_the_weight():
    upright = load_profile({"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}})
    flat, rows = sample("hold-push", keys(300), TESTBED), sample("hold-push", keys(300), upright)
    spare = (build_tables(TESTBED.spring).max_force - 10.0) * TESTBED.plant.joint_pulley_radius
    load = rows["static_torque"] * np.sin(rows["initial_angle"])
    assert (np.abs(rows["push_torque"]).max(axis=1) <= np.maximum(0.7 * (spare - load), 0) + 1e-4).all()
    assert (np.abs(flat["push_torque"]) >= np.abs(rows["push_torque"])).all()


def test_unknown_names_suggest_the_nearest():
    with pytest.raises(AmulettError, match="unknown suite 'step'.*did you mean 'steps'"):
        sample("step", keys(1), TESTBED)
    with pytest.raises(AmulettError, match="unknown split 'heldout'.*did you mean 'held-out'"):
        episode_keys(keys(1), keys(1), "heldout")
