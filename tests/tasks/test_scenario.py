"""Setpoints of any length: moves beyond the packed record, and samples from a file or from Python."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml
from helpers import PROFILES, run, start, state_of
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.c.build import build, find_compiler
from amulett_gym.cli import Parser, main
from amulett_gym.cli.evaluate import add_arguments, resolve
from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.simulation import reference
from amulett_gym.simulation.batch import Simulation
from amulett_gym.storage.provenance import read_provenance, write_provenance
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack, pack_path, unpack

TESTBED = load_profile("testbed")
MANY = {
    "initial_angle_deg": 20.0,
    "moves": [
        {"time": 0.1 + 0.07 * k, "angle_deg": 20.0 + 15.0 * (k % 3), "duration": 0.06 * (k % 2)} for k in range(25)
    ],
    "noise_seed": 5,
}
TIMES = np.round(np.arange(0.2, 1.8, 0.0137), 6)
LOG = {
    "setpoint": {
        "time": [*TIMES, 1.9, 1.9, 1.95],
        "angle_deg": [*(40.0 + 15.0 * np.sin(5.0 * TIMES)), 50.0, 30.0, 30.0],
    },
    "noise_seed": 6,
}
HELD = {**LOG, "setpoint": {**LOG["setpoint"], "interpolation": "hold"}}
WAVY = {**MANY, "wave": {"amplitude_deg": 3.0, "frequency": 1.0, "duration": 1.0, "time": 0.2}}


@pytest.mark.parametrize("scenario", [MANY, LOG, HELD], ids=["moves", "linear", "hold"])
@pytest.mark.parametrize("base", PROFILES)
def test_the_setpoint_is_what_the_reference_says(base, scenario):
    motion = run(load_profile(base), scenario, 2.0)
    expected = reference.replay_setpoint(load_scenario(scenario).model_dump(), motion["time"])
    np.testing.assert_allclose(motion["setpoint"], expected, rtol=0, atol=2e-6)
    assert np.ptp(expected) > 0.4


@pytest.mark.parametrize("shipped_moves", [1, 4, 10])
def test_the_reference_says_the_same_of_few_moves(shipped_moves):
    scenario = {**MANY, "moves": MANY["moves"][:shipped_moves]}
    motion = run(TESTBED, scenario, 1.0)
    expected = reference.replay_setpoint(load_scenario(scenario).model_dump(), motion["time"])
    np.testing.assert_allclose(motion["setpoint"], expected, rtol=0, atol=2e-6)


def test_moves_on_a_path_are_moves():
    late = {"time": 50.0, "angle_deg": 0.0}
    few = {**MANY, "moves": MANY["moves"][:10], "measure_from": 0.15}
    many = {**few, "moves": [*few["moves"], late]}
    simulation = start(TESTBED, few, many, {})
    assert simulation.paths is not None and simulation.paths[0].size == 11
    simulation.advance(round(2.0 / simulation.control_period))
    packed, path = state_of(simulation, 0), state_of(simulation, 1)
    assert packed["step_count"] == path["step_count"] == 9
    for name in ("angle", "rise_sum", "overshoot", "isav_kick", "effort_biceps", "step_start"):
        assert path[name] == pytest.approx(packed[name], rel=1e-5, abs=1e-7), name


def test_jumps_of_samples_are_no_effort_and_no_steps():
    at_once = {"moves": [{"time": 0.5, "angle_deg": 30.0}], "noise_seed": 1}
    sampled = {"setpoint": {"time": [0.0, 0.5, 0.5], "angle_deg": [0.0, 0.0, 30.0]}, "noise_seed": 1}
    held = {"setpoint": {"time": [0.0, 0.5], "angle_deg": [0.0, 30.0], "interpolation": "hold"}, "noise_seed": 1}
    simulation = start(TESTBED, at_once, sampled, held)
    simulation.advance(400)
    assert simulation.read("step_count").tolist() == [1, 0, 0]
    for name in ("angle", "isav_kick", "effort_biceps", "effort_triceps"):
        values = simulation.read(name)
        np.testing.assert_allclose(values, values[0], rtol=1e-9, err_msg=name)


def test_a_wave_comes_on_top_of_a_path():
    plain, wavy = run(TESTBED, MANY, 1.5), run(TESTBED, WAVY, 1.5)
    elapsed = wavy["time"] - 0.2
    acts = (elapsed >= 0.0) & (elapsed < 1.0 - 1e-9)
    expected = np.where(acts, np.radians(3.0) * np.sin(2 * np.pi * elapsed), 0.0)
    np.testing.assert_allclose(wavy["setpoint"] - plain["setpoint"], expected, atol=2e-8)


def test_a_path_changes_nothing_for_its_neighbours():
    plain = {"moves": [{"time": 0.1, "angle_deg": 30.0}, {"time": 0.6, "angle_deg": 10.0, "duration": 0.3}]}
    beside, alone = start(TESTBED, *[plain] * 3, LOG, *[plain] * 8), start(TESTBED, *[plain] * 12)
    beside.advance(500)
    alone.advance(500)
    for index in (0, 2, 4, 11):
        np.testing.assert_equal(state_of(beside, index), state_of(alone, index))


@given(
    times=st.lists(st.floats(0, 1e6), min_size=1, max_size=30).map(sorted),
    data=st.data(),
    interpolation=st.sampled_from(["linear", "hold"]),
)
def test_packing_keeps_every_sample(times, data, interpolation):
    angles = data.draw(st.lists(st.floats(-140, 140), min_size=len(times), max_size=len(times)))
    setpoint = {"time": times, "angle_deg": angles, "interpolation": interpolation}
    scenario = load_scenario({"setpoint": setpoint})
    assert scenario.initial_angle_deg == scenario.setpoint.angle_deg[0] == round(angles[0], 9)
    again = unpack(pack(scenario, TESTBED)[0], pack_path(scenario))
    assert again.setpoint == scenario.setpoint
    assert Scenario.model_validate_json(again.model_dump_json()) == again
    assert pack_path(again).tobytes() == pack_path(scenario).tobytes()


def test_packing_keeps_every_move():
    scenario = load_scenario(MANY)
    assert unpack(pack(scenario, TESTBED)[0], pack_path(scenario)).moves == scenario.moves
    with pytest.raises(AmulettError, match="unpack needs both"):
        unpack(pack(scenario, TESTBED)[0])
    with pytest.raises(AmulettError, match="has to be reset with it"):
        Simulation(TESTBED, 1).reset(pack(scenario, TESTBED))


def actions(count):
    return np.random.default_rng(0).uniform(-1, 1, (60, count, 1)).astype(np.float32)


def test_single_and_vector_play_paths_bit_for_bit_and_go_on_without():
    keywords = {"suite": "steps", "max_episode_steps": 40}
    vector = gym.make_vec("Amulett/Scaling-v0", num_envs=10, **keywords)
    scenarios = [LOG, MANY, *[{"moves": MANY["moves"][:2]}] * 7, HELD]
    seen = [vector.reset(seed=3, options={"scenario": scenarios})[0]]
    assert [scenario.has_path for scenario in vector.unwrapped.scenarios] == [True, True, *[False] * 7, True]
    seen += [vector.step(step)[0] for step in actions(10)]
    assert vector.unwrapped.episodes.simulation.paths is None  # the next episodes are drawn
    for device in (0, 1, 5, 9):
        env = gym.make("Amulett/Scaling-v0", **keywords)
        alone = [env.reset(seed=3 + device, options={"scenario": scenarios[device]})[0]]
        for step in actions(10)[:, device]:
            observation, _, _, truncated, _ = env.step(step)
            alone.append(observation)
            if truncated:
                break
        assert len(alone) == 41
        np.testing.assert_array_equal(alone, [observation[device] for observation in seen[:41]])


@pytest.mark.parametrize("scenario", [LOG, MANY], ids=["samples", "moves"])
def test_an_episode_on_a_path_replays_copies_and_goes_back(scenario):
    env = gym.make("Amulett/Tension-v0").unwrapped
    env.reset(seed=0, options={"scenario": scenario})
    told = json.loads(env.scenario.model_dump_json())
    head = [env.step(action)[0].tolist() for action in actions(1)[:20, 0]]
    state, twin = pickle.loads(pickle.dumps(env.get_state())), copy.deepcopy(env)
    tail = [env.step(action)[0].tolist() for action in actions(1)[20:, 0]]
    assert [twin.step(action)[0].tolist() for action in actions(1)[20:, 0]] == tail
    other = gym.make("Amulett/Tension-v0").unwrapped
    other.reset(seed=7)
    other.set_state(state)
    assert [other.step(action)[0].tolist() for action in actions(1)[20:, 0]] == tail
    assert other.scenario == env.scenario
    other.reset(seed=9, options={"scenario": told})
    assert [other.step(action)[0].tolist() for action in actions(1)[:20, 0]] == head
    other.reset()
    assert not other.scenario.has_path


def test_a_privileged_environment_refuses_a_path():
    env = gym.make("Amulett/Scaling-v0", privileged=True)
    with pytest.raises(AmulettError, match="at most 10 moves and no sampled setpoint"):
        env.reset(seed=0, options={"scenario": LOG})


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_the_tick_in_c_refuses_a_path(tmp_path):
    simulation = start(TESTBED, LOG)
    with pytest.raises(AmulettError, match="no sampled setpoint and at most 10 moves"):
        build("scalar", tmp_path)(
            simulation.parameters,
            simulation.which,
            simulation.scenarios,
            simulation.states,
            simulation.paths,
            None,
            None,
            1,
            1,
        )


def write_log(folder: Path, unit: str = "deg", separator: str = ",", count: int = 200) -> np.ndarray:
    times = np.arange(count) / 100.0
    angles = 30.0 + 20.0 * np.sin(times)
    lines = [separator.join(["stamp", "angle", "note"])]
    for time, angle in zip(times, np.radians(angles) if unit == "rad" else angles, strict=True):
        lines.append(separator.join([f"{1000 * (time + 5):.1f}", repr(float(angle)), "ok"]))
    (folder / "log.csv").write_text("\ufeff" + "\r\n".join(lines) + "\r\n")
    return angles


@pytest.mark.parametrize(("unit", "separator"), [("deg", ","), ("rad", ";")])
def test_a_logged_setpoint_is_read_from_a_column(unit, separator, tmp_path, monkeypatch):
    angles = write_log(tmp_path, unit, separator, 10_000)
    source = {"file": "log.csv", "column": "angle", "unit": unit, "time_column": "stamp", "time_unit": "ms"}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"setpoint": {**source, "begin": 0.5}}))
    monkeypatch.chdir("/")  # it is found beside the scenario's file
    scenario = load_scenario(tmp_path / "mine.yaml")
    np.testing.assert_allclose(scenario.setpoint.angle_deg, angles, atol=1e-9)
    np.testing.assert_allclose(scenario.setpoint.time, 0.5 + np.arange(10_000) / 100.0, atol=1e-9)
    assert scenario.initial_angle_deg == pytest.approx(30.0)
    monkeypatch.chdir(tmp_path)  # a mapping's is found from where one is
    assert load_scenario({"setpoint": source}).setpoint.time[0] == 5.0


def test_commands_play_a_logged_setpoint(tmp_path, capsys):
    angles = write_log(tmp_path)
    source = {"file": "log.csv", "column": "angle", "time_column": "stamp", "time_unit": "ms", "begin": 0.0}
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"setpoint": source}))
    assert main(["config", "validate", str(path)]) == 0
    capsys.readouterr()
    out = tmp_path / "motion.csv"
    assert main(["simulate", "--scenario", str(path), "--duration", "2", "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    table = np.genfromtxt(out, delimiter=",", names=True)
    np.testing.assert_allclose(table["setpoint_deg"][:796:4], angles[:199], atol=1e-6)
    assert told["scenario"]["setpoint"]["angle_deg"] == pytest.approx(angles.tolist())


def test_a_command_with_a_long_log_can_be_run_again(tmp_path):
    write_log(tmp_path, count=40_000)
    source = {"file": "log.csv", "column": "angle", "time_column": "stamp", "time_unit": "ms"}
    (tmp_path / "mine.json").write_text(json.dumps({"setpoint": source}))
    words = ["evaluate", "--policies", "eq6", "--scenario", str(tmp_path / "mine.json"), "--out", "comparison"]
    arguments = Parser()
    add_arguments(arguments)
    config = resolve(arguments.parse_args(words[1:]))
    (tmp_path / "comparison").mkdir()
    write_provenance(tmp_path / "comparison", "evaluate", config, [0], words)
    again = read_provenance(tmp_path / "comparison")
    assert load_scenario(again.config["scenarios"][0]) == load_scenario(tmp_path / "mine.json")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["time,angle", "0,1", "0.1,x"], r"row 3, column 'angle': 'x' is no finite number"),
        (["time,angle", "0,1", "0.1,nan"], r"row 3, column 'angle': 'nan' is no finite number"),
        (["time,angle", "0,1", "0.1,1,2"], r"row 3 has 3 cells, the header has 2"),
        (["time,angel", "0,1"], r"row 1 has no column 'angle'; did you mean 'angel'"),
        (["time,angle,angle", "0,1,2"], r"row 1 names the column 'angle' 2 times"),
        (["time,angle"], "has no samples"),
        (["time,angle", "", "1,1", "0.5,1"], "time falls from 1.0 to 0.5 s after row 3"),
        (["time,angle", "0,1", "1,190"], "angle_deg of row 3 is 190.0; it has to be -180 to 180"),
        (["time,angle", "-1,1", "1,90"], "time of row 2 is -1.0; it has to be 0 to 1e.06"),
    ],
)
def test_wrong_logs_are_refused(lines, message, tmp_path):
    (tmp_path / "log.csv").write_text("\n".join(lines))
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"setpoint": {"file": "log.csv", "column": "angle"}}))
    with pytest.raises(AmulettError, match=message):
        load_scenario(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"setpoint": {"file": "none.csv", "column": "a"}}, "cannot read setpoint 'none.csv'"),
        ({"setpoint": {"file": "none.csv", "colum": "a"}}, "setpoint: .*unknown key 'colum'; did you mean 'column'"),
        ({"setpoint": {"file": "none.csv", "column": "a", "unit": "grad"}}, "'unit' is 'grad'"),
        ({"setpoint": {"time": [0.0, 1.0], "angle_deg": [0.0]}}, "time has 2 samples and angle_deg 1"),
        ({"setpoint": {"time": [1.0, 0.5], "angle_deg": [0.0, 0.0]}}, "time falls from 1.0 to 0.5 s after sample 0"),
        ({"setpoint": {"time": [], "angle_deg": []}}, "'setpoint.time'.*at least 1"),
        ({"setpoint": {"time": [0.0], "angle_deg": [0.0]}, "moves": [{"time": 0.0, "angle_deg": 1.0}]}, "give one of"),
        ({"setpoint": {"time": [0.0], "angle_deg": [float("nan")]}}, "finite"),
    ],
)
def test_wrong_setpoints_are_refused(content, message):
    with pytest.raises(AmulettError, match=message):
        load_scenario(content)
