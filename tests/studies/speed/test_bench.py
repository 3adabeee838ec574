"""`amulett bench`: what it measures, and that nothing measured is lost."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from helpers import SMALL_RECIPE

from amulett_gym.c.build import find_compiler
from amulett_gym.cli import bench, build_parser, main
from amulett_gym.errors import AmulettError, install_extra
from amulett_gym.profile import load_profile
from amulett_gym.reporting.document import update_document
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import CONTROLS, LOOPS, RUNNING
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.studies.speed import document as performance
from amulett_gym.studies.speed import peers, scale, sections
from amulett_gym.studies.speed.document import SECTIONS, section_marks, tables
from amulett_gym.studies.speed.rates import Contestant, Speed, kernel, race, ratios, worn_kernels

DOCUMENT = Path(__file__).parents[3] / "docs" / "performance.md"
MEMORY = {"devices": 100, "simulation": 800.0, "arrays": 900.0, "resident": 1000.0}
QUICK = ["bench", "--turns", "1", "--devices", "4"]


@pytest.fixture
def brief(monkeypatch):
    """Let turns take no time."""
    quick: Any = lambda entrants, turns, **keywords: race(entrants, turns, 0.0, **keywords)  # noqa: E731
    monkeypatch.setattr("amulett_gym.studies.speed.rates.race", quick)


# --- the command


def test_kernel_and_environments_are_written_as_json(brief, tmp_path, capsys):
    assert main([*QUICK, "--out", str(tmp_path)]) == 0
    data = json.loads((tmp_path / "bench.json").read_text())
    assert set(data["kernel_ticks_per_s"]) == {"simulation", "testbed"}
    assert data["vector_steps_per_s"] == data["environments"]["vector of 4, testbed"]["steps_per_s"] > 0
    assert data["single_step_us"] == pytest.approx(1e6 / data["environments"]["single, testbed"]["steps_per_s"])
    assert not {"ppo", "peers", "scale", "time_to_beat_s", "ratio_to_c"} & set(data)
    printed = capsys.readouterr().out
    assert "CartPole-v1, vector of 4" in printed
    assert f"On {data['machine']}" in " ".join(printed.split())
    assert f"compiled for {data['target']}, registers of {data['vector_bits']} bits" in data["machine"]
    assert main(["rerun", str(tmp_path), "--out", str(tmp_path.parent / "again")]) == 0
    assert "speeds are not compared" in " ".join(capsys.readouterr().out.split())


def test_json_is_printed_and_nothing_else(brief, capsys):
    assert main([*QUICK, "--peers", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["peers"]["Gymnasium Pendulum"]["steps_per_s"] > 0


def test_a_file_after_json_is_deprecated_and_still_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sections.MEASURE, "speed", lambda settings, data, recipe: data.update(devices=3))
    path = tmp_path / "bench.json"
    for words in (str(path), "-"):
        assert main(["bench", "--json", words]) == 0
        output, note = capsys.readouterr()
        assert ("Written" in output) == (words != "-") and "--json FILE is deprecated" in note
    assert json.loads(path.read_text()) == json.loads(output)
    assert json.loads(output)["devices"] == 3


def test_every_loop_is_compared_with_the_papers_in_the_same_turns(brief, tmp_path):
    assert main([*QUICK, "--loops", "--turns", "3", "--json", str(tmp_path / "bench.json")]) == 0
    data = json.loads((tmp_path / "bench.json").read_text())
    assert tuple(data["loops"]) == CONTROLS
    assert data["loops"]["decentralized"]["ratio"] == {"median": 1.0, "least": 1.0, "most": 1.0}
    fastest = data["loops"]["decentralized"]["fastest"], data["loops"]["decentralized"]["slowest"]
    for row in data["loops"].values():
        assert row["slowest"] / fastest[0] <= row["ratio"]["median"] <= row["fastest"] / fastest[1]
    assert len({row["ticks_per_s"] for row in data["loops"].values()}) == len(CONTROLS)  # each has its own turns
    (table,) = tables("loops", data)
    assert table.title == "Control loops, kernel of 4, testbed"
    assert [row[0] for row in table.rows] == [f"`{control}`" for control in CONTROLS]


def test_the_worn_tick_is_compared_with_the_bare_one(brief, tmp_path):
    assert main([*QUICK, "--worn", "--turns", "3", "--json", str(tmp_path / "bench.json")]) == 0
    data = json.loads((tmp_path / "bench.json").read_text())
    assert tuple(data["worn"]) == LOOPS
    for row in data["worn"].values():
        ratio = row["worn_tick_over_bare"]
        assert 0.0 < ratio["least"] <= ratio["median"] <= ratio["most"]
    (table,) = tables("worn", data)
    assert [row[0] for row in table.rows] == [f"`{control}`" for control in LOOPS]
    spread = {"median": 1.5, "least": 1.0, "most": 2.0}
    row = {"bare_ticks_per_s": 3e6, "worn_ticks_per_s": 2e6, "worn_tick_over_bare": spread}
    (table,) = tables("worn", {"worn_devices": 4, "worn": {"torque": row}})
    assert table.rows == [["`torque`", "3.00", "2.00", "1.50 (1.00-2.00)"]]


def test_worn_and_bare_contestants_have_the_same_devices_and_scenarios(monkeypatch):
    made = []
    monkeypatch.setattr(
        "amulett_gym.studies.speed.rates._kernel", lambda name, simulation: made.append((name, simulation))
    )
    worn_kernels("torque", 5, seed=3)
    (first, worn), (second, bare) = made
    for simulation in (worn, bare):
        start = simulation.get_state()
        simulation.advance(4000)  # an episode, in which a device that failed would take no time
        assert (simulation.read("failure") == RUNNING).all()
        simulation.set_state(start)
    assert (first, second) == ("worn, torque", "bare, torque")
    assert isinstance(worn, WornSimulation) and not isinstance(bare, WornSimulation)
    np.testing.assert_array_equal(worn.scenarios, bare.scenarios)
    assert worn.profile == bare.profile and worn.control == bare.control and worn.num_devices == bare.num_devices == 5
    assert (worn.read_wearers(np.arange(5))["worn"] == 1.0).all() and (worn.read_worn("assistance") == 1.0).all()


def test_a_kernel_runs_the_loop_that_it_is_asked_for(monkeypatch):
    made = []

    def simulation(*words: Any, **keywords: Any) -> Simulation:
        made.append(Simulation(*words, **keywords))
        return made[-1]

    monkeypatch.setattr("amulett_gym.studies.speed.rates.Simulation", simulation)
    kernel("testbed", 4, control="co-rotation").step()
    assert made[0].control == "co-rotation" and made[0].states["tick"].max() == 8


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_c_ticks_beside_the_kernels(brief, tmp_path):
    assert main([*QUICK, "--c", "--json", str(tmp_path / "bench.json")]) == 0
    data = json.loads((tmp_path / "bench.json").read_text())
    for profile, ratio in data["ratio_to_c"].items():
        assert ratio == pytest.approx(data["kernel_ticks_per_s"][profile] / data["c_ticks_per_s"][profile])


def test_without_a_compiler_c_is_refused_before_anything_is_measured(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(AmulettError, match="--c: no C compiler found"):
        sections.prepare("c", sections.Settings())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--turns", "0"], "--turns is 0; it has to be at least 1"),
        (["--time-to-beat", "--seeds", "0"], "--seeds is 0"),
        (["--time-to-beat", "--limit", "nan"], "--limit is nan; it has to be a positive number of seconds"),
        (["--scale", "--simulated", "-1"], "--simulated is -1.0"),
        (["--ppo", "--set", "ppo.n_epoch=1"], "did you mean 'n_epochs'"),
        (["--doc", "none.md"], "cannot read document 'none.md'"),
        (["--json", ""], "--json is empty"),
        (["--set", "num_envs=64"], "--set changes nothing here: it is read by --ppo or --time-to-beat, which was not"),
        (["--scale", "--config", "configs/ppo.yaml"], "--config changes nothing here"),
        (["--ppo", "--seeds", "3"], "--seeds changes nothing here: it is read by --time-to-beat"),
        (["--ppo", "--limit", "3"], "--limit changes nothing here"),
        (["--ppo", "--simulated", "60"], "--simulated changes nothing here: it is read by --scale"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_measured(words, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sections, "MEASURE", {})
    assert main(["bench", *words]) == 2
    assert message in capsys.readouterr().err


def test_the_command_that_is_written_down_has_the_options_of_its_section():
    words = ["bench", "--ppo", "--scale", "--turns", "2", "--simulated", "60", "--set", "num_envs=64"]
    arguments = build_parser().parse_args(words)
    assert " ".join(bench._words(arguments, "ppo")) == "amulett bench --ppo --turns 2 --set num_envs=64"
    assert " ".join(bench._words(arguments, "scale")) == "amulett bench --scale --turns 2 --simulated 60.0"
    assert " ".join(bench._words(arguments, "speed")) == "amulett bench --turns 2"
    assert " ".join(bench._words(arguments, "time-to-beat")) == "amulett bench --time-to-beat --set num_envs=64"


def test_ctrl_c_keeps_what_was_measured(brief, monkeypatch, tmp_path, capsys):
    def interrupted(arguments: Any, data: dict[str, Any], config: Any) -> None:
        data["scale"] = {"memory_per_device": MEMORY | {"resident": None}}
        raise KeyboardInterrupt

    monkeypatch.setitem(sections.MEASURE, "scale", interrupted)
    document = shutil.copy(DOCUMENT, tmp_path / "performance.md")
    words = ["--scale", "--peers", "--json", str(tmp_path / "bench.json"), "--doc", str(document)]
    assert main([*QUICK, *words]) == 130
    data = json.loads((tmp_path / "bench.json").read_text())
    assert "environments" in data
    assert data["scale"]["memory_per_device"]["arrays"] == MEMORY["arrays"]
    assert "peers" not in data
    assert "`amulett bench --devices 4 --turns 1` on " in document.read_text()
    assert "amulett bench --scale --devices 4" not in document.read_text()  # a section that is not done is not renewed
    assert str(tmp_path) not in document.read_text()
    assert "interrupted" in capsys.readouterr().err


# --- races


def test_a_kernel_alone_starts_its_scenarios_again():
    entrant = kernel("testbed", 4)
    for _ in range(1200):
        entrant.step()
    assert entrant.devices == 4
    assert entrant.ticks * load_profile("testbed").loop.control_period == pytest.approx(0.02)


def test_contestants_of_one_name_have_turns_of_their_own():
    speeds = race([Contestant("twin", int), Contestant("twin", int)], 2, 0.0)
    assert [len(speed.rates) for speed in speeds] == [2, 2] and speeds[0].rates != speeds[1].rates


def test_ratios_are_taken_turn_by_turn():
    ours, theirs = Speed("ours", (10.0, 30.0, 20.0), 5), Speed("theirs", (5.0, 10.0, 40.0))
    assert ratios(ours, theirs) == [2.0, 3.0, 0.5]
    found = peers.compare([ours], [theirs], {"absent": "x is not installed"})
    assert found["theirs"]["ratio_steps"]["ours"] == {"median": 2.0, "least": 0.5, "most": 3.0}
    assert found["theirs"]["ratio_ticks"]["ours"]["median"] == 10.0
    assert found["absent"] == {"skipped": "x is not installed"}


def test_a_peer_that_is_absent_or_broken_is_one_line():
    absent = peers.Peer("absent", "Nothing-v0", ("no_such_module_here",))
    broken = peers.Peer("broken", "Nothing-v0", ())
    there = peers.Peer("there", "CartPole-v1", ())
    entrants, why = peers.enter([absent, broken, there])
    assert [entrant.name for entrant in entrants] == ["there"]
    assert why["absent"] == f"no_such_module_here is not installed ({install_extra('peers')})"
    assert why["broken"].startswith("does not run here: NameNotFound") and "\n" not in why["broken"]


def test_inner_ticks_are_mujocos_frame_skip():
    env = gym.make("CartPole-v1")
    assert peers.inner_ticks(env) == 1
    env.unwrapped.frame_skip = 10
    assert peers.inner_ticks(env) == 10


# --- scale


def test_held_bytes_counts_every_array_once():
    array = np.zeros(1000)
    held = scale.held_bytes({"whole": array, "view": array[10:20], "again": [array, (array.reshape(10, 100),)]})
    assert held == array.nbytes
    env = gym.make_vec("Amulett/Scaling-v0", num_envs=64).unwrapped
    assert scale.held_bytes(env) > env.episodes.simulation.states.nbytes + env.episodes.simulation.scenarios.nbytes


def test_a_device_has_a_cost_at_each_size():
    costs = scale.cost_by_size(sizes=(1, 512), turns=2)
    assert list(costs) == [1, 512]
    assert all(0.0 < cost["least"] <= cost["median"] <= cost["most"] for cost in costs.values())


def test_two_threads_are_compared_with_one_turn_by_turn():
    found = scale.two_threads(sizes=(32, 64), turns=3)
    assert list(found) == [32, 64]
    for size in found.values():
        assert list(size) == ["threads", "cores"]
        assert all(0.0 < ratio["least"] <= ratio["median"] <= ratio["most"] for ratio in size.values())
    rows = [table for table in tables("scale", {"scale": {"two_threads": found}}) if "threads" in table.title]
    assert [row[0] for row in rows[0].rows] == ["32", "64"]


SLICES = 12


@pytest.fixture(scope="module")
def long_run():
    """Run for long, but not for very long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scale, "SLICES", SLICES)
        return scale.long_run(devices=2, seconds=1.0)


def test_nothing_drifts_in_a_long_run(long_run):
    assert long_run["simulated_s"] == pytest.approx(SLICES * 501 * 0.02)
    assert long_run["last_episode_is_exact"] is True
    assert long_run["failures"] == 0
    assert long_run["lone_clock_error_s"] < 1e-6
    assert long_run["lone_angle_change_deg"] < 0.1
    assert len(long_run["steps_per_s"]) == len(long_run["resident_bytes"]) == SLICES


def test_another_episode_is_not_taken_for_the_last_one():
    env = gym.make_vec("Amulett/Scaling-v0", num_envs=2, max_episode_steps=scale.EPISODE_STEPS, suite="steps").unwrapped
    env.reset(seed=0)
    actions = np.zeros((2, 1), dtype=np.float32)
    for _ in range(scale.EPISODE_STEPS + 1):
        observations = env.step(actions)[0]
    state = env.get_state()
    assert scale._replays(env, "testbed", 0, 1, observations, actions)
    env.set_state(state)
    assert not scale._replays(env, "testbed", 0, 2, observations, actions)


def test_scale_measures_memory_sizes_and_the_long_run(brief, monkeypatch, long_run, tmp_path):
    monkeypatch.setattr(scale, "memory_per_device", lambda seed: MEMORY)
    monkeypatch.setattr(scale, "long_run", lambda **keywords: long_run)
    monkeypatch.setattr(scale, "SIZES", (1, 8))
    assert main([*QUICK, "--scale", "--out", str(tmp_path / "figures")]) == 0
    assert set(json.loads((tmp_path / "figures" / "bench.json").read_text())["scale"]["device_step_ns"]) == {"1", "8"}
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        "bench.json",
        "command.json",
        "scale.png",
        "hour.png",
    }


# --- tables


def test_a_section_that_was_not_measured_has_no_table():
    assert [tables(section, {}) for section in SECTIONS] == [[]] * len(SECTIONS)


def test_the_document_has_a_place_for_every_section(tmp_path):
    document = shutil.copy(DOCUMENT, tmp_path / "performance.md")
    update_document(document, {section_marks(section): "measured" for section in SECTIONS})
    assert document.read_text().count("measured\n\n<!-- End") == len(SECTIONS)


def test_times_that_were_not_reached_are_the_longest():
    runs = [{"lower_s": value} for value in (3.0, None, 5.0)]
    assert performance._median(runs, "lower_s") == "5.0"
    assert performance._median([*runs, {"lower_s": 8.0}], "lower_s") == "6.5"
    assert performance._median([*runs, {"lower_s": None}], "lower_s") == "not reached"


# --- learning


@pytest.fixture
def recipe():
    """Return a small recipe; without torch there is nothing to test here."""
    pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    from amulett_agents import load_train_config

    return load_train_config(None, SMALL_RECIPE)


def test_ppo_has_the_recipe_of_training_and_time_to_beat_its_own():
    from amulett_agents.config import SPRINT, TrainConfig, load_train_config

    given = sections.Settings(overrides=["seed=3"])
    assert sections.prepare("ppo", given) == TrainConfig(seed=3)
    sprint = load_train_config(None, [*SPRINT, "seed=3"])
    assert sections.prepare("time-to-beat", given) == sprint != TrainConfig(seed=3)
    named = replace(given, config=str(DOCUMENT.parent.parent / "configs" / "ppo.yaml"))
    assert sections.prepare("time-to-beat", named) == TrainConfig(seed=3)


def test_the_command_beats_from_the_middle_of_the_environments_tensions(brief, recipe, tmp_path, monkeypatch):
    monkeypatch.setattr(sections, "prepare", lambda section, settings: recipe)
    words = ["--ppo", "--time-to-beat", "--seeds", "2", "--limit", "2"]
    assert main([*QUICK, *words, "--out", str(tmp_path / "figures")]) == 0
    data = json.loads((tmp_path / "figures" / "bench.json").read_text())
    assert len(data["time_to_beat_s"]) == len(data["time_to_beat_lower_s"]) == 2
    assert data["time_to_beat"]["initial_tension"] == 9.5
    assert data["time_to_beat"]["recipe"]["env"]["tension_range"] == [4.0, 15.0]
    assert {"env", "null", "ratio"} < set(data["ppo"])
    assert (tmp_path / "figures" / "time-to-beat.png").is_file()


def test_targets_that_cannot_be_written_are_refused_before_anything_is_measured(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sections.MEASURE, "speed", lambda *_: pytest.fail("measured"))
    unmarked = tmp_path / "unmarked.md"
    unmarked.write_text("# Mine\n")
    for words, message in (
        (["--json", str(tmp_path)], "is a folder"),
        (["--json", str(unmarked / "x.json")], "cannot write"),
        (["--doc", str(unmarked)], "has to hold the line"),
    ):
        assert main(["bench", *words]) == 2
        assert message in capsys.readouterr().err
    assert unmarked.read_text() == "# Mine\n"


def test_an_error_in_a_late_section_keeps_the_early_ones(tmp_path, monkeypatch):
    def fails(*_):
        raise AmulettError("no")

    monkeypatch.setitem(sections.MEASURE, "speed", lambda arguments, data, config: data.update(devices=3))
    monkeypatch.setitem(sections.MEASURE, "scale", fails)
    monkeypatch.setattr(performance, "tables", lambda section, data: [])
    out = tmp_path / "bench.json"
    assert main(["bench", "--scale", "--json", str(out)]) == 2
    assert json.loads(out.read_text())["devices"] == 3
