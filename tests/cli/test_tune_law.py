"""`amulett tune-law`: its result is a law for other commands; it goes on after an interrupt, and can be repeated."""

from __future__ import annotations

import csv
import json
import re
from functools import partial

import gymnasium as gym
import pytest

import amulett_gym
from amulett_gym.cli import build_parser, main, tune_law
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.evaluation.search import law_recipe, law_search
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.simulation.layout import LOOPS

DEVICE = "{name: mine, base: testbed, sensors: {encoder_bits: 12}}"
SEARCH = ["tune-law", "eq6-tuned", "--suite", "steps", "--seeds", "3", "--validation", "4"]


SHORT = ((1, 2), (2, 1))


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Let searches be of a tenth of a second."""
    monkeypatch.setattr(law_recipe, "STAGES", SHORT)
    monkeypatch.setattr(law_recipe, "Recipe", partial(law_recipe.Recipe, generations=SHORT))


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dev.yaml").write_text(DEVICE)
    return tmp_path


def test_a_law_tuned_on_a_device_of_ones_own_is_taken_by_all_commands(place, capsys):
    assert main([*SEARCH, "--profile", "dev.yaml", "--out", "tuned"]) == 0
    out, err = capsys.readouterr()
    assert (
        "in decentralized on steps of the mine, by the cost, starts 3: 90 simulated episodes, 84 on train"
        in " ".join(out.split())
    )
    assert "90 episodes were simulated." in out
    compare = "amulett evaluate --policies eq6 tuned/eq6-tuned-steps.json \\\n      --suite steps --profile dev.yaml"
    assert f"Compare:\n  {compare}\n" in out
    assert max(map(len, out.splitlines())) <= 80
    assert "Note:" not in err  # costs are divided by those of eq. 6 on this very device
    law = "tuned/eq6-tuned-steps.json"
    for command in (
        ["evaluate", "--policies", law, "--episodes", "1"],
        ["simulate", "--law", law, "--duration", "0.1"],
        ["play", law, "--steps", "1", "--video", "a.png"],
    ):
        for profile, remark in (("dev.yaml", False), ("testbed", True)):
            assert main([*command, "--profile", profile, "--json"]) == 0
            remarks = json.loads(capsys.readouterr().out)["remarks"]
            assert (f"{law} was tuned on the mine, not on the testbed" in remarks) is remark
    env = gym.make("amulett_gym:Amulett/Scaling-v0", profile="dev.yaml")
    assert amulett_gym.load_policy(law, env)(env.reset(seed=0)[0]).shape == (1,)


def test_a_law_tuned_in_another_loop_acts_in_it(place, capsys):
    assert main(["tune-law", "constant", "--control", "co-rotation", *SEARCH[2:], "--out", "tuned"]) == 0
    law = "tuned/co-rotation-constant-steps.json"
    assert f"  amulett evaluate --policies co-rotation/{law} \\\n" in capsys.readouterr().out
    for command in (
        ["evaluate", "--episodes", "1", "--policies"],
        ["simulate", "--duration", "0.1", "--law"],
        ["play", "--steps", "1", "--video", "a.png"],
    ):
        assert main([*command, f"co-rotation/{law}", "--json"]) == 0
        assert not any("tuned" in remark for remark in json.loads(capsys.readouterr().out)["remarks"])
        assert main([*command, f"equilibrium-point/{law}", "--json"]) == 0
        remark = f"equilibrium-point/{law} was tuned in co-rotation, not in equilibrium-point"
        assert remark in json.loads(capsys.readouterr().out)["remarks"]


def test_json_is_the_file(place, capsys):
    assert main([*SEARCH, "--out", "tuned", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((place / "tuned" / "eq6-tuned-steps.json").read_text())
    assert printed["recipe"]["profile"] == "testbed"


def test_an_interrupt_keeps_what_is_done_and_names_the_command_that_continues(place, capsys, monkeypatch):
    costs, calls = law_search.mean_costs, []

    def interrupted(*given):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return costs(*given)

    monkeypatch.setattr(law_search, "mean_costs", interrupted)
    assert main([*SEARCH, "--out", "tuned"]) == 130
    err = capsys.readouterr().err
    words = "amulett tune-law eq6-tuned --control decentralized --suite steps --profile testbed --seeds 3"
    words += " --validation 4 --out tuned"
    assert f"interrupted; finished generations are kept. Continue with:\n       {words}\n" in err
    assert main(["rerun", "tuned", "--out", "again"]) == 2
    assert "'tuned' is not finished" in capsys.readouterr().err.replace(str(place) + "/", "")
    assert main(words.split()[1:]) == 0
    assert "24 are done" in " ".join(capsys.readouterr().out.split())


def test_a_folder_can_be_repeated_without_its_profile_file(place, capsys):
    assert main([*SEARCH, "--profile", "dev.yaml", "--budget", "150", "--out", "tuned"]) == 0
    (place / "dev.yaml").unlink()
    assert main(["rerun", "tuned", "--out", "again", "--json"]) == 0
    assert '"same": true' in capsys.readouterr().out
    first, again = (json.loads((place / name / "eq6-tuned-steps.json").read_text()) for name in ("tuned", "again"))
    assert first == again
    first["parameters"]["exponent"]["value"] += 1e-9
    (place / "tuned" / "eq6-tuned-steps.json").write_text(json.dumps(first))
    assert main(["rerun", "tuned", "--out", "third"]) == 1
    assert "parameters.exponent.value was" in capsys.readouterr().out


def test_the_package_is_written_only_when_asked_for_and_before_nothing_is_searched(place, capsys, monkeypatch):
    shipped = []
    monkeypatch.setattr(tuning, "ship", lambda recipe, content: shipped.append(recipe.law) or "there.json")
    assert main([*SEARCH, "--out", "tuned"]) == 0
    assert shipped == []
    assert main([*SEARCH, "--out", "tuned", "--write"]) == 0
    assert shipped == ["eq6-tuned"]
    assert "tuned/eq6-tuned-steps.json, there.json" in capsys.readouterr().out
    assert main([*SEARCH, "--profile", "dev.yaml", "--out", "other", "--write"]) == 2
    assert not (place / "other").exists()


def test_the_track_decides_which_cost_is_minimised(place, capsys):
    words = ["tune-law", "constant", *SEARCH[2:]]
    assert main([*words, "--track", "full-control", "--out", "full"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "by the full-control cost" in out
    full = json.loads((place / "full" / "constant-steps.json").read_text())
    assert full["cost"] == "control_cost" and full["recipe"]["track"] == "full-control"
    assert main([*words, "--track", "schedule", "--out", "full"]) == 2
    assert "choose another folder" in capsys.readouterr().err
    assert main([*words, "--track", "schedule", "--out", "usual"]) == 0
    usual = json.loads((place / "usual" / "constant-steps.json").read_text())
    assert "track" not in usual["recipe"]
    tension, values = f"constant:{full['parameters']['tension']['value']!r}", full["starts"]["3"]["validation"]
    found = evaluate([tension], suite="steps", split="validation", episodes=4).values[tension]
    assert found["control_cost"].mean() == pytest.approx(values, rel=1e-12)
    assert main(["rerun", "full", "--out", "again"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["parametrc", "--out", "x"], "did you mean 'parametric'"),
        (["constant", "--suite", "stepz", "--out", "x"], "did you mean 'steps'"),
        (["constant", "--profile", "none.yaml", "--out", "x"], "cannot read profile 'none.yaml'"),
        (["constant", "--budget", "0", "--out", "x"], "a budget of 0 simulated episodes is too small"),
        (["constant", "--seeds", "1", "1", "--out", "x"], "seeds are .1, 1.; they have to differ"),
        (["constant", "--validation", "0", "--out", "x"], "at least 1"),
        (["gains", "--write", "--out", "x"], "gains of the paper's loop stay"),
        (["gains", "--control", "position-only", "--out", "x"], "loop that takes a tension 'position-only'"),
        (["gains", "--control", "co-rotaton", "--out", "x"], "did you mean 'co-rotation'"),
        (["eq6-tuned", "--control", "co-rotation", "--write", "--out", "x"], "of the paper's loop only"),
        (["constant", "--write", "--out", "x"], "no tuned constant"),
        (["eq6-tuned", "--track", "full", "--out", "x"], "unknown track 'full'"),
        (["eq6-tuned", "--track", "full-control", "--write", "--out", "x"], "tuned for the track 'full-control'"),
        (["constant", "--out", "dev.yaml"], "is a file"),
        (["gains", "--control", "cascade", "cascade", "--out", "x"], "--control names a loop twice: cascade cascade"),
        (["gains", "--control", "all", "--write", "--out", "x"], "gains of the paper's loop stay"),
        (["gains", "--control", "all", "cascade", "--out", "x"], "all stands alone; .* the loops without it: cascade"),
        (["constant", "--fleet", "fleet.yaml", "--out", "x"], "cannot read fleet 'fleet.yaml'"),
        (["constant", "--choose-fleet", "fleet.yaml", "--out", "x"], "choose_fleet is for laws .* give fleet, too"),
        (["constant", "--workers", "0", "--out", "x"], "--workers is 0; it has to be at least 1"),
        (["constant", "--ray", "there", "--out", "x"], "--ray "),
    ],
)
def test_wrong_input_is_refused_before_anything_is_made(words, message, place, capsys):
    assert main(["tune-law", *words]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert [path.name for path in place.iterdir()] == ["dev.yaml"]


def test_tuned_gains_are_a_profile_for_other_commands(place, capsys, monkeypatch):
    monkeypatch.setattr(law_recipe, "GAIN_POPULATION", 5)
    words = ["tune-law", "gains", "--control", "equilibrium-point", *SEARCH[2:], "--out", "tuned"]
    assert main([*words, "--profile", "dev.yaml"]) == 0
    out = capsys.readouterr().out
    assert "Written: tuned/equilibrium-point-gains-steps.json, tuned/profile.yaml" in out
    tension = json.loads((place / "tuned" / "equilibrium-point-gains-steps.json").read_text())["parameters"]
    law = f"equilibrium-point/constant:{tension['co_contraction']['value']:.4g}"
    assert f"  amulett evaluate --policies {law} \\\n      --suite steps --profile tuned/profile.yaml" in out
    assert main(["config", "validate", "tuned/profile.yaml"]) == 0
    assert main(["evaluate", "--policies", law, "--profile", "tuned/profile.yaml", "--episodes", "1"]) == 0
    assert main(["simulate", "--law", "tuned/equilibrium-point-gains-steps.json"]) == 2
    assert "holds gains of a control loop, not a law; use the profile.yaml in its folder" in capsys.readouterr().err
    assert main(["rerun", "tuned", "--out", "again"]) == 0
    assert (place / "again" / "profile.yaml").read_text() == (place / "tuned" / "profile.yaml").read_text()
    assert main([*words, "--profile", "testbed"]) == 2
    assert "holds a tuning of gains on steps in equilibrium-point, for another device" in capsys.readouterr().err


def test_gains_of_several_loops_are_one_profile(place, capsys, monkeypatch):
    monkeypatch.setattr(law_recipe, "GAIN_POPULATION", 5)
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # other processes would not have the short recipes
    loops = ["decentralized", "equilibrium-point"]
    words = ["tune-law", "gains", "--control", *loops, *SEARCH[2:], "--out", "tuned"]
    assert main(words) == 0
    out = capsys.readouterr().out
    shown = " ".join(out.split())
    assert "gains in decentralized, equilibrium-point on steps of the testbed" in shown
    assert "82 simulated episodes, 41 in each of 2 loops: 35 on train" in shown
    assert "82 episodes were simulated." in out
    with (place / "tuned" / "costs.csv").open() as file:
        rows = {row["loop"]: row for row in csv.DictReader(file)}
    assert [*rows] == loops and {row["training episodes"] for row in rows.values()} == {"35"}
    policies = []
    for loop in loops:
        content = json.loads((place / "tuned" / f"{loop}-gains-steps.json").read_text())
        start, found = content["starts"]["3"], content["parameters"]
        assert rows[loop]["cost on validation"] == f"{start['validation']:.4f}"
        assert rows[loop]["reference"] == (found["reference"]["value"] if loop != "decentralized" else "")
        own = f"{loop}/" if loop != "decentralized" else ""
        policies.append(f"{own}constant:{found['co_contraction']['value']:.4g}")
    again = f"amulett evaluate --policies eq6 {' '.join(policies)} \\\n      --suite steps --profile tuned/profile.yaml"
    assert f"Compare:\n  {again}\n" in out
    assert re.search(r"equilibrium-point, start 3: cost .*\n  reference motion: .*; costs when it was chosen: min", out)
    assert main([*again.replace("\\\n", "").split()[1:], "--episodes", "1"]) == 0
    assert main(["rerun", "tuned", "--out", "again"]) == 0
    assert (place / "again" / "profile.yaml").read_text() == (place / "tuned" / "profile.yaml").read_text()
    (place / "again" / "equilibrium-point-gains-steps.json").unlink()
    assert main(["rerun", "again", "--out", "third"]) == 2
    assert "is not finished" in capsys.readouterr().err
    assert main(["tune-law", "gains", *SEARCH[2:], "--out", "tuned"]) == 2
    assert "of gains on steps in decentralized, equilibrium-point; choose" in " ".join(capsys.readouterr().err.split())


def test_all_are_the_loops_that_take_a_tension():
    words = ["tune-law", "gains", "--control", "all", "--budget", "20000", "--out", "x"]
    recipes, skipped = tune_law._recipes(build_parser().parse_args(words))
    assert skipped == {}
    assert [recipe.control for recipe in recipes] == ["decentralized", *LOOPS]
    assert len({recipe.episodes for recipe in recipes}) == 1 and recipes[0].episodes <= 20_000


def test_all_skips_loops_that_do_not_fit_the_device_and_says_why(place, capsys, monkeypatch):
    (place / "dev.yaml").write_text("{name: linear, base: testbed, spring: {free_length: 0}}")
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # other processes would not have the short recipes
    words = ["tune-law", "constant", "--control", "all", "--profile", "dev.yaml", *SEARCH[2:]]
    assert main([*words, "--out", "tuned"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "Without torque-stiffness, which does not fit this device: control 'torque-stiffness' sets the joint" in out
    assert "co-rotation, start 3: cost" in out
    assert main([*words, "--out", "tuned", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed.pop("skipped")) == {"torque-stiffness", "feedforward-feedback"}
    assert set(printed) == {"decentralized", *LOOPS} - {"torque-stiffness", "feedforward-feedback"}


def test_a_folder_holds_one_law(place, capsys):
    assert main([*SEARCH, "--out", "tuned"]) == 0
    assert main([*SEARCH, "--out", "tuned", "--seeds", "3", "4"]) == 0  # another start is added
    assert main(["tune-law", "constant", "--suite", "steps", "--out", "tuned"]) == 2
    assert (
        "'tuned' holds a tuning of eq6-tuned on steps in decentralized; choose another folder"
        in capsys.readouterr().err
    )
    assert main([*SEARCH, "--out", "tuned", "--profile", "dev.yaml"]) == 2
    assert "eq6-tuned on steps in decentralized, for another device; choose another folder" in capsys.readouterr().err
    assert main([*SEARCH, "--out", "."]) == 2
    assert "holds no tuned law" in capsys.readouterr().err


def test_a_loop_is_an_option_and_no_part_of_the_name(place, capsys):
    assert main(["tune-law", "cascade/eq6-tuned", "--out", "tuned"]) == 2
    assert "'cascade/eq6-tuned' names a loop; write eq6-tuned --control cascade" in capsys.readouterr().err


def test_a_law_tuned_over_a_fleet_is_one_law_for_all_devices(place, capsys):
    (place / "fleet.yaml").write_text(f"[testbed, simulation, {DEVICE}]")
    words = [*SEARCH, "--fleet", "fleet.yaml", "--choose-fleet", "fleet.yaml"]
    assert main([*words, "--out", "tuned"]) == 0
    out, err = capsys.readouterr()
    assert "eq6-tuned in decentralized on steps over a fleet of 3 devices, by the cost" in " ".join(out.split())
    law = "tuned/eq6-tuned-steps.json"
    again = f"amulett evaluate --policies eq6 {law} \\\n      --suite steps --fleet fleet.yaml"
    assert f"Compare:\n  {again}\n" in out and "Note:" not in err
    for profile, remark in (("dev.yaml", False), ("simulation", False), ("other.yaml", True)):
        (place / "other.yaml").write_text("{name: other, base: testbed, sensors: {encoder_bits: 13}}")
        assert main(["simulate", "--law", law, "--duration", "0.1", "--profile", profile, "--json"]) == 0
        remarks = json.loads(capsys.readouterr().out)["remarks"]
        assert (f"{law} was tuned over a fleet of 3 devices, not on the other" in remarks) is remark
    (place / "fleet.yaml").unlink()
    assert main(["rerun", "tuned", "--out", "again", "--json"]) == 0
    assert '"same": true' in capsys.readouterr().out
    (place / "fleet.yaml").write_text(f"[testbed, {DEVICE}]")
    assert main([*words, "--out", "tuned"]) == 2
    assert "for another fleet; choose another folder" in " ".join(capsys.readouterr().err.split())
    assert main([*SEARCH, "--fleet", "fleet.yaml", "--out", "short", "--write"]) == 2
    assert "not over a fleet of 2 devices of your own" in " ".join(capsys.readouterr().err.split())


def test_all_skips_loops_that_do_not_fit_a_device_of_the_fleet(place, capsys):
    linear = "{name: linear, base: testbed, spring: {free_length: 0}}"
    (place / "fleet.yaml").write_text(f"[testbed, {linear}]")
    words = ["tune-law", "constant", "--control", "all", "--fleet", "fleet.yaml", "--out", "x"]
    recipes, skipped = tune_law._recipes(build_parser().parse_args(words))
    assert set(skipped) == {"torque-stiffness", "feedforward-feedback"}
    assert skipped["torque-stiffness"].startswith("'linear': control 'torque-stiffness' sets the joint")
    assert {recipe.control for recipe in recipes} == {"decentralized", *LOOPS} - skipped.keys()
