"""Contenders by name: laws in other control loops."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers import keep_network, make_bundle

from amulett_gym import DRIVES_ID
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import evaluate, labels
from amulett_gym.laws.contenders import Own, in_loop, parse_contender, split_loop
from amulett_gym.laws.copies import policy_file
from amulett_gym.simulation.layout import LOOPS


@pytest.mark.parametrize("loop", LOOPS)
def test_a_law_acts_in_each_loop(loop):
    contender = parse_contender(f"{loop}/constant:10")
    assert contender.name == f"{loop}/constant:10"
    assert contender.env_keywords == {"control": loop}
    assert contender.policy_name == "constant:10"
    assert parse_contender(f"{loop}/eq6").env_keywords == {"tension_law": "eq6", "control": loop}


def test_a_bundle_keeps_its_period_in_another_loop():
    contender = parse_contender("co-rotation/pretrained")
    assert contender.env_keywords == {**parse_contender("pretrained").env_keywords, "control": "co-rotation"}
    assert contender.policy_name == parse_contender("pretrained").policy_name


def test_a_folder_is_no_loop():
    assert split_loop("runs/x") == ("", "runs/x")
    assert split_loop("./co-rotation/x") == ("", "./co-rotation/x")
    assert split_loop("co-rotation/runs/x") == ("co-rotation", "runs/x")


def test_labels_keep_the_loop():
    names = ["co-rotation/runs/a/best", "runs/a/best", "co-rotation/constant:5", "constant:5"]
    assert list(labels(names).values()) == ["co-rotation/a", "a", "co-rotation/constant:5", "constant:5"]


def test_files_of_a_law_in_a_loop_are_found(tmp_path):
    law = tmp_path / "mine.json"
    law.write_text("{}")
    assert policy_file(f"co-rotation/{law}") == law
    assert policy_file("co-rotation/eq6") is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("co-rotatoin/eq6", "unknown control loop 'co-rotatoin'; choose from cascade, .*; did you mean 'co-rotation'"),
        ("x/eq6", "unknown control loop 'x'; choose from cascade, co-rotation, computed-torque, "),
        ("Cascade/eq6", "unknown control loop 'Cascade'; choose from .*; did you mean 'cascade'"),
        ("x/constant:10", "unknown control loop 'x'"),
        ("cascde/runs/mine", "no policy bundle 'cascde/runs/mine': the folder does not exist$"),
        ("cascde/mine", "the folder does not exist; did you mean 'cascade'"),
        ("cascade/", "'cascade/' names a loop and no law; write cascade/<law>, for example cascade/constant:10"),
        ("cascade//", "names a loop and no law"),
        ("cascade", "'cascade' is a control loop, not a law; write cascade/<law>"),
        ("cascade/cascade", "'cascade' is a control loop, not a law"),
        ("drives/eq6", "no law of a tension acts in 'drives', the loop of Amulett/Drives-v0, .* loops are cascade,"),
        ("cascade/cascade/eq6", "names two loops; write cascade/eq6, or for a law in a folder cascade/./cascade/eq6"),
        ("co-rotation/cascade/eq6", "names two loops; write cascade/eq6"),
        ("co-rotation/decentralized/eq6", "names two loops; write decentralized/eq6"),
        ("position-only/eq6", "a fixed co-contraction, which no law sets; write position-only$"),
        ("position-only/position-only", "a fixed co-contraction, which no law sets; write position-only$"),
        ("co-rotation/position-only", "write position-only, or a law in the loop 'co-rotation', for example co-"),
        ("decentralized/position-only", "write position-only, or a law in the loop 'decentralized'"),
        ("co-rotation/nothing", "unknown policy 'nothing'; choose from"),
        ("co-rotation/eq7", "unknown policy 'eq7'; choose from .*; did you mean 'eq6'"),
        ("constant:-1", "at least 0"),
    ],
)
def test_wrong_names_are_refused(name, words):
    with pytest.raises(AmulettError, match=words):
        parse_contender(name)


@pytest.fixture
def in_cascade(tmp_path):
    """Return a policy trained in the loop cascade."""
    return make_bundle(tmp_path / "mine", keywords={"control": "cascade"}, tension_range=[0.0, 15.0])


def test_a_bundle_acts_in_the_loop_that_it_was_trained_in(in_cascade):
    name = str(in_cascade)
    contender = parse_contender(name)
    assert (contender.name, contender.env_keywords["control"]) == (name, "cascade")
    named = parse_contender(f"cascade/{name}")
    assert (named.name, named.env_keywords) == (f"cascade/{name}", contender.env_keywords)
    results = evaluate([name, f"cascade/{name}"], "paper-step", episodes=1, duration=0.1)
    assert results.track == "full-control"
    assert [*results.values] == ["eq6", name]
    assert f"cascade/{name} is the same as {name}, and ran once" in results.remarks
    assert "mine acts in its own loop, cascade, as cascade/mine would" in results.remarks
    assert not any("in the loop" in remark for remark in results.remarks)
    assert record_episode(name, results.protocol).metrics["cost"] == results.values[name]["cost"][0]


def test_a_bundle_acts_with_the_delay_that_it_was_trained_with(tmp_path):
    name = str(make_bundle(tmp_path / "mine", keywords={"action_delay": 3}))
    assert parse_contender(name).env_keywords["action_delay"] == 3
    results = evaluate([name], "paper-step", episodes=1, duration=0.2)
    assert "mine acts late, with an action_delay of 3 control ticks" in results.remarks
    episode = record_episode(name, results.protocol)
    assert episode.metrics["cost"] == results.values[name]["cost"][0]
    tension = episode.trajectory["tension_setpoint"]
    assert np.ptp(tension[:4]) < 1e-12 < abs(tension[4] - tension[3])  # the first row is before the first tick
    np.testing.assert_allclose(np.diff(tension[3:12]), tension[4] - tension[3], atol=1e-12)


def test_a_bundle_of_a_loop_can_act_in_another(in_cascade):
    other = f"co-rotation/{in_cascade}"
    results = evaluate([other], "paper-step", episodes=1, duration=0.1)
    assert any("was trained in the loop cascade, not co-rotation" in remark for remark in results.remarks)
    papers = parse_contender(f"decentralized/{in_cascade}")
    assert (papers.name, papers.env_keywords["control"]) == (f"decentralized/{in_cascade}", "decentralized")
    with pytest.raises(
        AmulettError, match=f"'{papers.name}' chooses tensions from 0 N on.* it can act in cascade, co-"
    ):
        evaluate([papers], "paper-step", episodes=1, duration=0.1)


def test_a_bundle_of_the_drives_acts_there_alone(tmp_path):
    about = {"env_id": DRIVES_ID, "mean_angle_range": 258.66, "tension_range": [0.0, 15.0]}
    folder = keep_network(tmp_path / "mine", [(np.zeros((2, 13), "f4"), np.zeros(2, "f4"))], **about)
    results = evaluate([str(folder)], "paper-step", episodes=1, duration=0.1)
    assert (results.track, [*results.values]) == ("full-control", ["eq6", str(folder)])
    for loop in ("cascade", "decentralized"):
        with pytest.raises(AmulettError, match="acts in Amulett/Drives-v0 alone, .*; write it without a loop"):
            parse_contender(f"{loop}/{folder}")
    with pytest.raises(AmulettError, match=f"write '{folder}'; a policy trained in Amulett/Drives-v0 acts there"):
        parse_contender(f"drives/{folder}")


def test_a_tuned_law_acts_in_the_loop_that_it_was_tuned_in(tmp_path):
    def keep(name, tension, **recipe):
        content = {"format": "amulett-tuned-law", "recipe": {"law": "constant", "profile": "testbed", **recipe}}
        (tmp_path / name).write_text(json.dumps({**content, "parameters": {"tension": {"value": tension}}}))
        return str(tmp_path / name)

    name = keep("cascade.json", 2.0, control="cascade")
    assert parse_contender(name).env_keywords == {"control": "cascade"}
    assert parse_contender(keep("papers.json", 5.0)).env_keywords == {}
    results = evaluate([name, f"co-rotation/{name}"], "paper-step", episodes=1, duration=0.1)
    assert not any("cascade.json was tuned" in remark for remark in results.remarks if "co-rotation" not in remark)
    assert any("was tuned in cascade, not in co-rotation" in remark for remark in results.remarks)


def test_own_laws_act_in_a_loop():
    mine = in_loop(Own("mine", {"agent_period": 0.1}, act=lambda observations: observations[:, 0]), "co-rotation")
    assert isinstance(mine, Own)
    assert mine.env_keywords == {"agent_period": 0.1, "control": "co-rotation"}


def test_slack_strings_are_for_loops_that_feed_the_co_contraction_forward():
    with pytest.raises(AmulettError, match="needs 0 N; the actions of this environment reach from 4 to 15 N"):
        evaluate(["constant:0"], "paper-step", episodes=1, duration=0.1)
    results = evaluate(["equilibrium-point/constant:0"], "paper-step", episodes=1, duration=0.1)
    assert set(results.values) == {"eq6", "equilibrium-point/constant:0"}


def test_results_say_in_which_loop_a_policy_was_trained():
    results = evaluate(["co-rotation/pretrained:testbed", "co-rotation/parametric"], "mixed", episodes=1, duration=0.1)
    assert "co-rotation/pretrained:testbed was trained in the loop decentralized, not co-rotation" in results.remarks
    assert "co-rotation/parametric acts with the parameters tuned in the paper's loop" in results.remarks


def test_a_law_in_the_papers_loop_is_the_law_itself():
    assert parse_contender("decentralized/eq6") == parse_contender("eq6")
    assert list(evaluate(["decentralized/eq6"], "paper-step", episodes=1, duration=0.1).values) == ["eq6"]
