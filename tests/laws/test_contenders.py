"""Contenders by name: laws in other control loops."""

from __future__ import annotations

import pytest

from amulett_gym.errors import AmulettError
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
        ("co-rotatoin/eq6", "did you mean 'co-rotation'"),
        ("position-only/eq6", "'eq6' needs a loop that controls a tension"),
        ("co-rotation/position-only", "'position-only' needs position-only, not the loop 'co-rotation'"),
        ("co-rotation/nothing", "unknown policy 'nothing'"),
        ("constant:-1", "at least 0"),
    ],
)
def test_wrong_names_are_refused(name, words):
    with pytest.raises(AmulettError, match=words):
        parse_contender(name)


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
    results = evaluate(["co-rotation/pretrained", "co-rotation/parametric"], "mixed", episodes=1, duration=0.1)
    assert "co-rotation/pretrained was trained in the loop decentralized, not co-rotation" in results.remarks
    assert "co-rotation/parametric acts with the parameters tuned in the paper's loop" in results.remarks


def test_a_law_in_the_papers_loop_is_the_law_itself():
    assert parse_contender("decentralized/eq6") == parse_contender("eq6")
    assert list(evaluate(["decentralized/eq6"], "paper-step", episodes=1, duration=0.1).values) == ["eq6"]
