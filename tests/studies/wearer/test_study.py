"""The study of worn devices: its parts against the environment, its stages, and the files of the command."""

from __future__ import annotations

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import WORN_ID, load_policy
from amulett_gym.cli import main
from amulett_gym.envs.worn_transition import OBSERVATIONS
from amulett_gym.jit.code_cache import PACKAGE, fingerprint
from amulett_gym.laws.bundle import PolicyDescription, TrainingEnv, write_bundle
from amulett_gym.laws.worn import Constant, WornLaw, as_actions
from amulett_gym.laws.worn_inputs import WORN_ACTIONS, WORN_SCALES
from amulett_gym.profile import load_profile
from amulett_gym.reporting.document import marks
from amulett_gym.storage.kept import read_kept
from amulett_gym.studies.wearer import study
from amulett_gym.studies.wearer.baselines import (
    BASELINES,
    BY_INTENTION,
    TWO_ASSISTANCES,
    TWO_LEVEL,
    Tuned,
    device_of,
    space_of,
    tune,
)
from amulett_gym.studies.wearer.comparison import DOFFED, GUARDS, load_learned
from amulett_gym.studies.wearer.description import Description, load_description, quick
from amulett_gym.studies.wearer.episodes import STEPS, Schedule, draw, play
from amulett_gym.studies.wearer.headroom import foresee
from amulett_gym.studies.wearer.results import content
from amulett_gym.studies.wearer.search import Budget, cross_entropy
from amulett_gym.studies.wearer.tables import answer, tables

LOOP = "co-rotation"


@pytest.fixture(scope="module")
def device():
    return load_profile("worn")


@pytest.fixture(scope="module")
def scenarios(device):
    return draw(device, "assembly", "held-out", 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a quick study, which the command wrote."""
    folder = tmp_path_factory.mktemp("wearer") / "out"
    assert main(["wearer", "--quick", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def found(folder):
    return json.loads((folder / "results.json").read_text())


def test_the_cost_is_minus_the_environments_return(device, scenarios):
    law = WornLaw(Constant(co_contraction=6.0))
    env = gym.make_vec(WORN_ID, num_envs=3, profile=device, suite="assembly", control=LOOP, split="held-out")
    observations, _ = env.reset(seed=0)
    returns, law_of_env = np.zeros(3), WornLaw(Constant(co_contraction=6.0))
    for _ in range(STEPS):
        observations, rewards, _, _, info = env.step(law_of_env(observations))
        returns += rewards
    played = play(device, LOOP, scenarios, law)
    assert played["cost"] == pytest.approx(-returns, rel=1e-12)
    assert np.array_equal(played["muscle_effort"], info["muscle_effort"])
    assert np.array_equal(played["cuff_peak"], info["cuff_peak"])


def test_a_doffed_wearer_has_neither_cuff_nor_drives(scenarios):
    doffed = scenarios.doffed
    assert (doffed["cuff_peak"] == 0.0).all() and (doffed["failed"] == 0.0).all()
    assert doffed["cost"] == pytest.approx(doffed["muscle"] + doffed["tracking"])
    assert (doffed["cost"] > 0.3).all()
    assert scenarios.moving.mean() == pytest.approx(doffed["moving_time"].mean() / 10.0, abs=0.02)


def test_two_levels_follow_the_true_intention(scenarios):
    values = {"moving_tension": 2.0, "holding_tension": 12.0, "holding_assistance": 0.0}
    act = Tuned(TWO_LEVEL, LOOP, values, 0.0).act(scenarios)
    for step in range(100):
        actions = act(np.zeros((3, 16), dtype=np.float32))
        moving = scenarios.moving[:, step]
        assert actions[:, 1] == pytest.approx(np.where(moving, 1.0, -1.0))
        assert 7.5 * (actions[:, 0] + 1.0) == pytest.approx(np.where(moving, 2.0, 12.0), abs=1e-5)
    single = Tuned(TWO_ASSISTANCES, LOOP, {"co_contraction": 3.0, "holding_assistance": 0.5}, 0.0).act(scenarios)
    for step in range(100):
        actions = single(np.zeros((3, 16), dtype=np.float32))
        assert 7.5 * (actions[:, 0] + 1.0) == pytest.approx([3.0] * 3, abs=1e-5)
        assert actions[:, 1] == pytest.approx(np.where(scenarios.moving[:, step], 1.0, 0.0), abs=1e-6)


def test_a_clairvoyant_begins_with_the_two_levels(device, scenarios):
    space = space_of(TWO_LEVEL, LOOP)
    tuned = Tuned(TWO_LEVEL, LOOP, {p.name: p.start for p in space.parameters}, 0.0)
    cost = tuned.play(device, scenarios)["cost"]
    alone = foresee(device, tuned, scenarios, Budget(1, 1))
    assert alone == pytest.approx(cost, rel=1e-6)
    assert (foresee(device, tuned, scenarios, Budget(6, 2)) <= alone).all()


def test_a_search_finds_the_least_cost_of_each_problem():
    targets = np.array([[0.2, 0.9], [0.7, 0.1], [0.0, 0.5]])

    def costs_of(points):
        return ((points - targets[:, None]) ** 2).sum(axis=2)

    points, costs = cross_entropy(costs_of, np.full((3, 2), 0.5), Budget(24, 20), seed=0)
    assert points == pytest.approx(targets, abs=0.03)
    assert costs == pytest.approx(costs_of(points[:, None])[:, 0])
    start, _ = cross_entropy(lambda points: points.sum(axis=2) * 0.0, targets, Budget(4, 1), seed=0)
    assert np.array_equal(start, targets)  # the start is the first candidate


def test_tuning_lowers_the_cost_and_names_its_parameters(device):
    train = draw(device, "assembly", "train", 2)
    bad = {"co_contraction": 15.0, "gain": 0.2, "carry": 0.0}
    before = Tuned("constant", LOOP, {p.name: p.start for p in space_of("constant", LOOP).parameters} | bad, 0.0)
    after = tune("constant", device, LOOP, train, Budget(6, 3), start=bad)
    assert after.train < before.play(device, train)["cost"].mean()
    assert after.train == pytest.approx(after.play(device, train)["cost"].mean())
    changed = device_of(device, after.values)
    assert changed.wearer.admittance.gain == after.values["gain"]
    assert changed.wearer.cuff == device.wearer.cuff


def test_a_transparent_device_has_no_virtual_spring(device):
    changed = device_of(device, {"co_contraction": 5.0, "torque_time": 0.05})
    gains = changed.loops.torque
    assert (gains.virtual_stiffness, gains.virtual_damping, gains.torque_time) == (0.0, 0.0, 0.05)


def test_the_papers_loop_is_played_in_its_own_range(device, scenarios):
    space = space_of("constant", "decentralized")
    assert (space.parameters[0].low, space.parameters[0].high) == (4.0, 15.0)
    seen = []

    def look(step, episodes):
        seen.append(episodes.simulation.read("tension_setpoint"))

    play(device, "decentralized", scenarios, Schedule(np.full((3, 1), 5.5), np.ones((3, 1)), (4.0, 15.0)), look)
    assert seen[10] == pytest.approx([5.5] * 3, abs=1e-5)


def test_the_recipe_is_the_default():
    assert load_description("configs/wearer.yaml") == load_description(None) == Description()


def test_the_testbeds_own_pulley_is_compared_in_the_same_way():
    other = load_description("configs/wearer_testbed.yaml")
    headroom = Description().headroom.model_copy(update={"loops": {"assembly": ["co-rotation"]}})
    assert other == Description(profile=other.profile, headroom=headroom)
    worn, device = load_profile("worn"), other.device()
    assert device.plant.joint_pulley_radius == load_profile("testbed").plant.joint_pulley_radius
    same = {"name": worn.name, "base": worn.base, "plant": worn.plant}
    assert device.model_copy(update=same) == worn


def test_the_command_writes_numbers_tables_and_figures(folder, found, capsys, tmp_path):
    written = {path.name for path in folder.iterdir()}
    pictures = {"wearer_headroom.png", "wearer_ratios.png"}
    assert written == {"results.json", "tables.md", "command.json", "stages", *pictures}
    assert [*found["comparison"]] == [DOFFED, *BASELINES, *BY_INTENTION]
    assert [*found["guards"]] == [*GUARDS]
    document = tmp_path / "wearer.md"
    document.write_text("before\n" + "\n".join(marks("amulett wearer")) + "\nafter\n")
    capsys.readouterr()
    words = ["wearer", "--quick", "--out", str(folder), "--doc", str(document), "--json"]
    assert main(words) == 0  # finished stages are not repeated
    again = json.loads(capsys.readouterr().out)
    assert {key: again[key] for key in again if key != "machine"} == {k: found[k] for k in found if k != "machine"}
    text = document.read_text()
    assert "wearer_headroom.png" in text and text.startswith("before") and text.endswith("after\n")
    assert (tmp_path / "images" / "wearer_headroom.png").is_file()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    assert main(["wearer", "--quick", "--out", str(tmp_path / "other")]) == 2


def test_finished_stages_are_read_back(folder, found):
    before = {path: path.stat().st_mtime_ns for path in (folder / "stages").rglob("*.json")}
    description, done = quick(load_description(None)), []
    again = study.run(description, folder=folder, report=done.append)
    assert {path: path.stat().st_mtime_ns for path in (folder / "stages").rglob("*.json")} == before
    assert len(done) == study.parts(description, [])
    numbers = json.loads(json.dumps(content(again), allow_nan=False))
    assert numbers == {key: value for key, value in found.items() if key not in ("command", "machine")}


@pytest.mark.parametrize("changed", ["WORN_VERSION", "code"])
def test_stages_of_other_code_or_suites_are_not_read(changed, folder, monkeypatch):
    def read(path, inputs, make, pack, unpack):
        content = read_kept(path, inputs)
        if content is None:
            raise LookupError(path.name)
        return unpack(content)

    monkeypatch.setattr(study, "kept", read)
    description = quick(load_description(None))
    study.run(description, folder=folder)
    monkeypatch.setattr(study, changed, 99 if changed == "WORN_VERSION" else lambda: "other")
    with pytest.raises(LookupError, match="constant"):
        study.run(description, folder=folder)


def test_the_code_of_stages_is_that_of_their_files():
    assert all((PACKAGE / name).is_file() for name in study.OWN_SOURCES)
    assert study.code() != fingerprint()


def test_ratios_are_those_of_the_costs(folder, found):
    description = quick(load_description(None))
    again = study.run(description, folder=folder)
    plain = again.played[study.NO_CABLE]
    for name in BASELINES:
        row = found["comparison"][name]
        doffed = plain[DOFFED]
        assert row["cost_over_doffed"]["mean"] == pytest.approx(plain[name]["cost"].sum() / doffed["cost"].sum())
        assert row["worse_off"]["count"] == (plain[name]["cost"] > doffed["cost"]).sum()
        assert row["cuff_peak"] == pytest.approx(plain[name]["cuff_peak"].mean())
    assert found["comparison"][again.best]["cost_over_best"]["mean"] == pytest.approx(1.0)
    cell = found["headroom"][0]
    assert cell["costs"]["clairvoyant"] <= cell["costs"]["constant"] * 2.0
    assert cell["over_constant"]["clairvoyant"]["mean"] <= 1.0 + 1e-12
    two_levels, two_assistances = (cell["costs"][name] for name in (TWO_LEVEL, TWO_ASSISTANCES))
    assert cell["two_levels_over_two_assistances"]["mean"] == pytest.approx(two_levels / two_assistances)


def test_a_suite_without_headroom_is_named_so(folder, found):
    assert not any("without headroom" in line for line in answer({**found, "suites": {}}))
    description = quick(load_description(None))
    again = study.run(description, folder=folder)
    cell = again.headroom[0]
    flat = replace(cell, costs={**cell.costs, "clairvoyant": 0.97 * cell.costs["constant"][:2]})
    numbers = content(replace(again, headroom=[flat]))
    assert numbers["suites"]["assembly"]["headroom"] is False
    assert any(line.startswith("assembly: **without headroom**") for line in answer(numbers))
    # A clairvoyant is compared with the best constant of all loops, each in its own best loop.
    worse = replace(flat, control="cascade", costs={name: 0.5 * costs for name, costs in flat.costs.items()})
    worse.costs["constant"] = 2.0 * cell.costs["constant"]
    gains = content(replace(again, headroom=[flat, worse]))["suites"]["assembly"]
    assert gains["control"] == flat.control
    assert gains["gains"]["clairvoyant"] == pytest.approx(1.0 - 0.5 * 0.97) and gains["headroom"]


def test_a_suites_best_loop_is_that_of_the_training_wearers(folder):
    again = study.run(quick(load_description(None)), folder=folder)
    cell = again.headroom[0]

    def changed(control, trained, held_out):
        tuned = {kind: replace(each, control=control, train=trained) for kind, each in cell.tuned.items()}
        return replace(cell, control=control, tuned=tuned, costs={k: held_out * v for k, v in cell.costs.items()})

    cells = [changed("cascade", 0.5, 1.1), changed("torque", 0.6, 0.9), changed("decentralized", 0.1, 0.1)]
    found = content(replace(again, headroom=cells))["suites"]["assembly"]
    assert found["control"] == "cascade"
    assert found["loops"] == {"constant": "cascade", **dict.fromkeys(BY_INTENTION, "cascade"), "clairvoyant": "torque"}
    mean = {name: costs.mean() for name, costs in cell.costs.items()}
    assert found["gains"][TWO_LEVEL] == pytest.approx(1.0 - mean[TWO_LEVEL] / mean["constant"])
    assert content(replace(again, headroom=cells[2:]))["suites"] == {}  # the environment has no such loop


def test_tables_name_every_contender(found):
    shown = tables(found)
    assert [row[0].split(" (")[0] for row in shown["comparison"].rows] == [DOFFED, *BASELINES, *BY_INTENTION]
    assert len(shown["guards"].rows) == len(GUARDS)
    assert all(len(row) == len(table.head) for table in shown.values() for row in table.rows)


def test_cables_change_the_costs(found):
    (cable,) = [f"mu {c['friction']:g}, {c['bend_deg']:g} deg" for c in found["description"]["cables"]]
    assert found["cables"][DOFFED]["costs"][cable] == pytest.approx(found["comparison"][DOFFED]["cost"])
    for name in BASELINES:
        assert found["cables"][name]["costs"][cable] != found["comparison"][name]["cost"]
    assert [*tables(found)][-2:] == ["cables", "drawn_cables"]
    without = {name: {**row, "drawn": None} for name, row in found["cables"].items()}
    assert [*tables({**found, "cables": without})][-1] == "cables"


def test_drawn_cables_are_each_wearers_own(device, folder, found):
    description = quick(load_description(None))
    cables = description.drawn_cables.draw(description.seed, description.held_out)
    assert len({cable.name for cable in cables}) == len(cables) == 4
    assert all(0.05 <= cable.friction <= 0.2 and 90.0 <= cable.bend_deg <= 360.0 for cable in cables)
    assert cables[1:] == description.drawn_cables.draw(description.seed + 1, 3)
    again = study.run(description, folder=folder)
    (latched, *_), wearers = again.baselines["latched"], draw(device, "assembly", "held-out", 4)
    for k, cable in enumerate(cables):
        alone = latched.play(description.with_cable(device, cable), wearers)
        assert again.played["drawn"]["latched"]["cost"][k] == alone["cost"][k]
    drawn = found["cables"]["latched"]["drawn"]
    best = again.played["drawn"][again.best]["cost"]
    assert drawn["lead"] == pytest.approx(1.0 - again.played["drawn"]["latched"]["cost"].sum() / best.sum())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"suite": "assembley"}, "unknown"),
        ({"control": "decentralized"}, "unknown"),
        ({"headroom": {"loops": {"assembly": ["cascad"]}}}, "unknown"),
        ({"drawn_cables": {"friction": [0.2, 0.1]}}, "the first has to be the least"),
        ({"drawn_cables": {"bend_deg": [0, 2000]}}, "drawn_cables.bend_deg.1"),
        ({"side": "drive"}, "drives.stall_torque"),
        (
            {"profile": {"base": "worn", "loop": {"control_period": 0.003}}},
            "a multiple of the profile's control period",
        ),
        ({"side": "drive", "cables": []}, "drives.stall_torque"),
    ],
)
def test_a_wrong_description_is_refused(wrong, message, tmp_path, capsys):
    file = tmp_path / "study.json"
    file.write_text(json.dumps(wrong))
    assert main(["wearer", "--config", str(file)]) == 2
    assert message in capsys.readouterr().err


def bundle(folder, keywords, weights, bias, **described):
    """Write a policy of one layer."""
    described = {
        "network": {"layers": [weights.shape[1], 2], "activation": "tanh", "output": "clip"},
        "observations": list(OBSERVATIONS),
        "observation_scales": WORN_SCALES,
        "actions": list(WORN_ACTIONS),
        "tension_range": [0.0, 15.0],
        "agent_period": 0.02,
        **described,
    }
    env = TrainingEnv(id=WORN_ID, keywords=keywords, max_episode_steps=STEPS)
    layers = [(weights.astype(np.float32), bias.astype(np.float32))]
    return write_bundle(folder, layers, PolicyDescription.model_validate(described), env, {})


def test_a_learned_policy_is_compared_in_its_own_loop_and_device(folder, tmp_path, capsys):
    # A network whose output is constant costs what the constant law does.
    softer = {"base": "worn", "name": "softer", "wearer": {"admittance": {"gain": 0.7}}}
    keywords = {"profile": load_profile(softer).model_dump(mode="json"), "control": "cascade", "suite": "assembly"}
    nothing = np.zeros((2, len(OBSERVATIONS)))
    policy = bundle(tmp_path / "policy", keywords, nothing, as_actions(6.0, 0.75, 1)[0])
    words = ["wearer", "--quick", "--out", str(folder), "--policy", str(policy), "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["policies"] == {str(policy): {"control": "cascade", "device": "softer"}}
    device = load_profile(softer)
    wearers = draw(device, "assembly", "held-out", found["description"]["held_out"])
    law = WornLaw(Constant(co_contraction=6.0, assistance=0.75))
    same = play(device, "cascade", wearers, law)
    row = found["comparison"][str(policy)]
    assert row["cost"] == pytest.approx(same["cost"].mean(), rel=1e-9)
    assert row["cost_ratios"] == pytest.approx(same["cost"] / wearers.doffed["cost"], rel=1e-9)
    cables = found["cables"][str(policy)]
    assert cables["lead"] == pytest.approx(1.0 - row["cost"] / found["comparison"][found["best_baseline"]]["cost"])
    assert any(line.startswith(f"The policy {policy} costs") for line in answer(found))


@pytest.mark.parametrize("period", [0.01, 0.04])
def test_a_learned_policy_acts_with_its_own_period_range_delay_and_history(period, device, scenarios, tmp_path):
    weights = np.random.default_rng(3).normal(scale=0.2, size=(2, 2 * len(OBSERVATIONS)))
    keywords = {"control": LOOP, "action_delay": 2, "observation_noise": 0.01, "suite": "reaches", "split": "train"}
    described = {"tension_range": [1.0, 9.0], "agent_period": period, "history": 2}
    folder = bundle(tmp_path / "policy", keywords, weights, np.array([0.1, 0.4]), **described)
    learned, steps = load_learned(str(folder), device), round(10.0 / period)
    played = learned.play(learned.device, scenarios)
    alike = {"tension_range": (1.0, 9.0), "agent_period": period, "failure_horizon": steps}
    own = {**keywords, **alike, "suite": "assembly", "split": "held-out"}
    env = gym.make_vec(WORN_ID, num_envs=3, profile=device, max_episode_steps=steps, **own)
    observations, _ = env.reset(seed=0)
    policy, returns = load_policy(str(folder), env), np.zeros(3)
    for _ in range(steps):
        observations, rewards, _, truncated, info = env.step(policy(observations))
        returns += rewards
    assert truncated.all()
    assert played["cost"] == pytest.approx(-returns, rel=1e-12)
    assert np.array_equal(played["muscle_effort"], info["muscle_effort"])


def test_a_policy_of_a_fleet_plays_on_the_studys_device(device, tmp_path):
    fleet = [{"base": "worn", "name": f"worn {k}"} for k in range(2)]
    fleet = [load_profile(each).model_dump(mode="json") for each in fleet]
    folder = bundle(tmp_path / "policy", {"fleet": fleet}, np.zeros((2, 16)), np.zeros(2))
    assert load_learned(str(folder), device).device == device


def test_a_period_that_does_not_fit_an_episode_is_refused(tmp_path, capsys):
    folder = bundle(tmp_path / "policy", {}, np.zeros((2, 16)), np.zeros(2), agent_period=0.03)
    assert main(["wearer", "--quick", "--policy", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "acts every 0.03 s" in error and "0.03003 s" in error


def test_a_folder_is_written_again(folder, tmp_path, capsys):
    assert main(["rerun", str(folder), "--out", str(tmp_path / "again"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["same"] is True


def test_a_policy_of_another_environment_is_refused(capsys):
    assert main(["wearer", "--quick", "--policy", "pretrained"]) == 2
    assert "Amulett/Worn-v0" in capsys.readouterr().err
    assert main(["wearer", "--quick", "--policy", "constant"]) == 2
    assert "./constant" in capsys.readouterr().err
