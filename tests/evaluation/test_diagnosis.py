"""The diagnosis of an own device: short movements find each fault, and none on a sound device."""

import json
import re
from pathlib import Path

import pytest
from helpers import PROFILES, device

from amulett_gym import DRIVES_ID
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.diagnosis import diagnose
from amulett_gym.evaluation.remarks import device_remarks
from amulett_gym.laws.contenders import Contender, loops_of, parse_contender
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import CONTROLS, DRIVES

MY_DEVICE = Path(__file__).parents[2] / "configs" / "my_device.yaml"
STIFF = {"name": "stiff", "base": "testbed", "spring": {"stiffness": 250_000.0}}


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("profile", [*PROFILES, MY_DEVICE], ids=str)
def test_a_sound_device_gives_no_finding_in_any_loop(profile, control):
    assert diagnose(load_profile(profile), control=control) == []


@pytest.mark.parametrize(
    ("groups", "kind", "least", "most", "words"),
    [
        ({"spring": {"stiffness": 250_000.0}}, "chatters", 2, 100, "the agonist of the resting arm switches"),
        ({"loop": {"tension": {"kp": 20.0, "ki": 400.0}}}, "oscillates", 2, 10, "the resting joint swings by"),
        ({"plant": {"orientation": "vertical"}}, "cannot hold", 5, 30, "a hold at 90 deg, at 15 N, the joint rests"),
        ({"plant": {"orientation": "vertical"}}, "spring end", 0.9, 1, "a spring is at the end of its table for 100%"),
        ({"drives": {"command_limit_deg": 200.0}}, "drive limit", 0.9, 1, "a drive is at command_limit_deg"),
        ({"drives": {"command_limit_deg": 200.0}}, "cannot start", 60, 70, "67.5 deg cannot begin: it may start with"),
        ({"spring": {"stiffness": 5000.0}}, "tension", 11, 12, "at 15 N, the antagonist's tension is 11.2 N"),
        ({"sensors": {"force_floor": 9.0}}, "force floor", 9, 9, "below sensors.force_floor, 9 N, are not estimated"),
        ({"plant": {"velocity_limit_deg": 20.0}}, "fails", 0, 6, "the device fails after .* s: joint velocity limit"),
    ],
)
def test_each_fault_is_found_with_its_number(groups, kind, least, most, words):
    (finding,) = [finding for finding in diagnose(device("testbed", **groups)) if finding.kind == kind]
    assert least <= finding.number <= most
    assert re.search(words, finding.text)


@pytest.mark.parametrize(
    ("control", "groups", "kind", "least", "most"),
    [
        ("co-rotation", {"loops": {"co_rotation": {"lead": 3.0}}}, "overshoots", 30, 60),
        ("cascade", {"loops": {"cascade": {"kf": 5.0}}}, "oscillates", 2, 20),
        ("co-rotation", {"plant": {"velocity_limit_deg": 20.0}}, "fails", 0, 6),
        ("torque-stiffness", {"loops": {"torque_stiffness": {"angle_weight": 5000.0}}}, "oscillates", 2, 50),
        ("equilibrium-point", {"drives": {"command_limit_deg": 200.0}}, "drive limit", 0.9, 1),
        ("equilibrium-point", {"plant": {"orientation": "vertical"}}, "tension", 13, 14),
        ("feedback-linearisation", {"spring": {"stiffness": 250_000.0}}, "oscillates", 10, 40),
        ("co-rotation", {"drives": {"rate_limit_deg": 100.0}}, "cannot hold", 2, 10),
    ],
)
def test_each_fault_of_another_loop_is_found_in_that_loop(control, groups, kind, least, most):
    profile = device("testbed", **groups)
    (finding,) = [finding for finding in diagnose(profile, control=control) if finding.kind == kind]
    assert least <= finding.number <= most
    if "loops" in groups:
        assert diagnose(profile) == []


def test_a_device_that_cannot_have_a_loop_is_an_error():
    with pytest.raises(AmulettError, match="the slope of the springs has to rise"):
        diagnose(device("testbed", spring={"free_length": 0.0}), control="torque-stiffness")
    with pytest.raises(AmulettError, match="did you mean 'co-rotation'"):
        diagnose(load_profile("testbed"), control="co-rotatoin")


def test_the_end_of_the_tension_range_is_played():
    profile = device("testbed", plant={"orientation": "vertical"})
    assert diagnose(profile, (4.0, 10.0)) == []
    assert "cannot hold" in [finding.kind for finding in diagnose(profile, (4.0, 15.0))]


def test_remarks_name_borrowed_parameters_and_what_was_found():
    assert device_remarks(load_profile("testbed"), ["parametric"], suite="steps") == []
    (on_worn,) = device_remarks(load_profile("worn"), ["parametric:steps"], suite="steps")
    assert on_worn == "parametric:steps acts with the parameters tuned on the testbed, not on the worn"
    tuned, *found = device_remarks(load_profile(STIFF), ["eq6", "eq6-tuned", "parametric:steps", "constant:5"])
    assert tuned == "eq6-tuned, parametric:steps act with the parameters tuned on the testbed, not on the stiff"
    assert any("the agonist of the resting arm switches" in remark for remark in found)
    assert not any("tuned" in remark for remark in device_remarks(load_profile(STIFF), ["eq6"]))


def test_remarks_say_where_eq6_fails_or_cannot_be_measured():
    fast = device("testbed", plant={"velocity_limit_deg": 200.0})
    weak = device("testbed", spring={"stiffness": 1.0})
    said = [
        "eq6 fails in 0.75 % of the training scenarios of steps on the testbed-test: costs are divided by its mean "
        "costs until then, as rates",
        "eq6 could not be measured in training scenarios of steps on the testbed-test: it cannot begin them, or they "
        "have too many integration steps; costs are divided by those on the testbed",
    ]
    for profile, remark in zip((fast, weak), said, strict=True):
        assert [each for each in device_remarks(profile, suite="steps") if "eq6" in each] == [remark]
        assert not any("eq6" in each for each in device_remarks(profile))
        of_testbed = profile.model_copy(update={"divisors_of": "testbed"})  # which eq. 6 plays well
        assert not any("eq6" in each for each in device_remarks(of_testbed, suite="steps"))


def test_an_environment_without_a_loop_is_not_diagnosed():
    drives = Contender("mine", {"control": DRIVES}, env_id=DRIVES_ID)
    assert loops_of([drives, parse_contender("cascade/eq6"), parse_contender("eq6")]) == ("cascade", "decentralized")
    assert device_remarks(load_profile(STIFF), loops=loops_of([drives])) == []


@pytest.mark.parametrize(
    "command",
    [
        ["config", "validate", "{file}", "--json"],
        ["simulate", "--law", "eq6-tuned", "--profile", "{file}", "--duration", "0.1", "--json"],
        ["play", "eq6-tuned", "--profile", "{file}", "--steps", "1", "--video", "{folder}/a.png", "--json"],
    ],
    ids=lambda command: command[0],
)
def test_commands_warn_of_a_device_of_ones_own_once(command, tmp_path, capsys):
    path = tmp_path / "stiff.yaml"
    path.write_text(json.dumps(STIFF))
    assert main([word.format(file=path, folder=tmp_path) for word in command]) == 0
    out, err = capsys.readouterr()
    names = [] if command[0] == "config" else ["eq6-tuned"]
    assert json.loads(out)["remarks"] == device_remarks(load_profile(path), names, suite="steps")
    assert err.count("the agonist of the resting arm switches") == 1


LEADING = {"name": "leading", "base": "testbed", "loops": {"co_rotation": {"lead": 3.0}}}


@pytest.mark.parametrize(
    "command",
    [
        ["config", "validate", "{file}"],
        ["simulate", "--law", "{law}", "--profile", "{file}", "--duration", "0.1"],
        ["play", "{law}", "--profile", "{file}", "--steps", "1", "--video", "{folder}/a.png"],
        ["evaluate", "--policies", "{law}", "--suite", "reach", "--profile", "{file}", "--episodes", "2"],
    ],
    ids=lambda command: command[0],
)
def test_commands_warn_of_the_loop_in_use(command, tmp_path, capsys):
    path = tmp_path / "leading.yaml"
    path.write_text(json.dumps(LEADING))
    for loop in ("co-rotation", "cascade"):
        options = ["--control", loop] if command[0] == "config" else []
        words = [word.format(file=path, folder=tmp_path, law=f"{loop}/constant:10") for word in command]
        assert main([*words, *options]) == 0
        printed = " ".join("".join(capsys.readouterr()).split())
        assert ("on the leading in the loop co-rotation, in a step" in printed) == (loop == "co-rotation")


@pytest.mark.parametrize(
    "command", [["tune-law", "gains", "--control"], ["train", "--set"]], ids=lambda words: words[0]
)
def test_a_search_warns_of_its_loop(command, tmp_path, capsys):
    path = tmp_path / "leading.yaml"
    path.write_text(json.dumps(LEADING))
    (tmp_path / "full" / "file").mkdir(parents=True)  # so that none begins
    for loop in ("co-rotation", "cascade"):
        if command[0] == "train":
            words = [*command, f"env.profile={path}", f"env.control={loop}"]
        else:
            words = [*command, loop, "--profile", str(path)]
        assert main([*words, "--out", str(tmp_path / "full")]) == 2
        found = capsys.readouterr().err.count("on the leading in the loop co-rotation, in a step")
        assert found == (loop == "co-rotation")


def test_train_warns_by_the_recipes_own_device_and_tension_range(tmp_path, capsys):
    upright = tmp_path / "upright.yaml"
    upright.write_text(json.dumps({"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}}))
    (tmp_path / "full" / "file").mkdir(parents=True)  # so that no training begins
    command = ["train", "--out", str(tmp_path / "full"), "--set", f"env.profile={upright}"]
    assert main(command) == 2
    assert capsys.readouterr().err.count("the joint rests 15.3 deg from its setpoint") == 1
    assert main([*command, "env.tension_range=[4.0, 10.0]"]) == 2
    assert "from its setpoint" not in capsys.readouterr().err
