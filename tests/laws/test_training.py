"""What a policy was trained for, and how the device on which it acts differs."""

import warnings

import gymnasium as gym
import pytest
from helpers import device, make_bundle

from amulett_gym import ENV_IDS, load_policy
from amulett_gym.cli import main
from amulett_gym.errors import OtherLoopWarning
from amulett_gym.evaluation.remarks import start_remarks
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.fleet import names_or_contents
from amulett_gym.laws.bundle import TrainingEnv
from amulett_gym.laws.training import control_of, devices_in_words, other_device, other_loop, trained_on
from amulett_gym.profile import load_profile

TESTBED = load_profile("testbed")
FLEET = [device("testbed", drives={"lag": lag}).model_copy(update={"name": f"lag-{lag}"}) for lag in (0.02, 0.05)]


def training(env_id: str = ENV_IDS[0], **keywords) -> TrainingEnv:
    return TrainingEnv(id=env_id, keywords=keywords, max_episode_steps=500)


OVER_FLEET = training(fleet=names_or_contents(FLEET))


def test_what_it_was_trained_on():
    assert trained_on(training()) == (TESTBED,) and devices_in_words(training()) == "the testbed"
    assert trained_on(OVER_FLEET) == tuple(FLEET) and devices_in_words(OVER_FLEET) == "a fleet of 2 devices"
    assert control_of(training()) == "decentralized" and control_of(training(ENV_IDS[2])) == "drives"
    assert control_of(training(control="cascade")) == "cascade"


def test_a_shipped_fleet_has_its_name(monkeypatch):
    monkeypatch.setattr("amulett_gym.laws.training.name_or_contents", lambda fleet: "plausible")
    assert devices_in_words(OVER_FLEET) == "the fleet plausible of 2 devices"


def test_a_device_is_the_trained_one_or_another():
    assert other_device(training(), TESTBED) == ""
    assert other_device(training(), FLEET[0]) == "on the testbed, not the lag-0.02"
    changed = TESTBED.model_copy(update={"drives": FLEET[0].drives})
    assert other_device(training(), changed) == "on another version of the testbed, not the testbed"
    assert "cannot read" in other_device(training(profile={"name": "old", "gone": 1}), TESTBED)


def test_a_device_is_in_a_fleet_or_within_its_ranges_or_outside():
    assert other_device(OVER_FLEET, FLEET[1]) == "on a fleet of 2 devices with the lag-0.05"
    within, beyond = (device("testbed", drives={"lag": lag}) for lag in (0.03, 0.1))
    there = "on a fleet of 2 devices without the testbed-test, which is"
    assert other_device(OVER_FLEET, within) == f"{there} within their ranges"
    assert other_device(OVER_FLEET, beyond) == f"{there} outside their ranges in drives.lag 0.1 (0.02 to 0.05)"


def test_what_differs_in_the_loop_is_named():
    assert other_loop(training(), [FLEET[0]], "decentralized") == []
    held = device("testbed", sensors={"below_floor": "hold"})
    assert other_loop(training(), [held], "decentralized") == ["for sensors.below_floor clamp (here hold)"]
    assert other_loop(OVER_FLEET, [FLEET[0], held], "decentralized") == [
        "for sensors.below_floor clamp (here clamp or hold)"
    ]
    assert other_loop(training(), [device("testbed", loop={"offset_deg": 25.0})], "decentralized") == []
    (many,) = other_loop(training(), [load_profile("simulation")], "decentralized")
    assert many.count("(here ") == 3 and many.endswith("more")
    assert other_loop(training(), [TESTBED], "cascade") == ["in the loop decentralized, not cascade"]
    gains = device("testbed", loops={"cascade": {"lead": 0.5}})
    assert other_loop(training(control="cascade"), [gains], "cascade") == [
        f"for loops.cascade.lead {TESTBED.loops.cascade.lead:.4g} (here 0.5)"
    ]


def test_loading_a_policy_for_another_loop_warns_once(tmp_path):
    folder, held = make_bundle(tmp_path / "mine"), {"base": "testbed", "sensors": {"below_floor": "hold"}}
    with pytest.warns(OtherLoopWarning, match=r"mine' was trained for sensors\.below_floor clamp") as found:
        load_policy(folder, gym.make(ENV_IDS[0], profile=held))
    assert len(found) == 1 and found[0].filename == __file__
    with pytest.warns(OtherLoopWarning, match="in the loop decentralized, not co-rotation"):
        load_policy(folder, gym.make(ENV_IDS[0], control="co-rotation"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(folder, gym.make(ENV_IDS[0]))
        load_policy("constant:10", gym.make(ENV_IDS[0], profile=held))
        found = evaluate([str(folder)], profile=held, episodes=1, duration=0.1)  # says so in its remarks
    assert [each for each in found.remarks if "for sensors.below_floor clamp (here hold)" in each]


def test_simulate_says_for_which_loop_a_policy_was_trained(tmp_path, capsys):
    folder = make_bundle(tmp_path / "mine")
    (tmp_path / "held.yaml").write_text("{name: held, base: testbed, sensors: {below_floor: hold}}")
    words = ["simulate", "--law", str(folder), "--profile", str(tmp_path / "held.yaml"), "--suite", "reach"]
    assert main([*words, "--duration", "0.1"]) == 0
    note = "Note: mine was trained on the testbed, not the held; for sensors.below_floor clamp (here hold).\n"
    assert note in capsys.readouterr().err


def test_a_training_that_starts_from_a_policy_says_for_which_loop_that_was_trained(tmp_path):
    folder, held = str(make_bundle(tmp_path / "mine")), device("testbed", sensors={"below_floor": "hold"})
    (remark,) = start_remarks(folder, [held], "decentralized")
    assert remark.endswith("mine, which was trained for sensors.below_floor clamp (here hold)")
    assert start_remarks(folder, [TESTBED], "decentralized") == start_remarks("none", [held], "decentralized") == []
