"""Model cards of policies."""

import json

from helpers import device, make_bundle

from amulett_gym.cli import main
from amulett_gym.fleet import names_or_contents
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.card import card_of, model_card, rewrite_card
from amulett_gym.laws.copies import copy_policies

FLEET = [device("testbed", drives={"lag": lag}).model_copy(update={"name": f"lag-{lag}"}) for lag in (0.02, 0.05)]
PROVENANCE = {
    "algorithm": "PPO",
    "config": {"network": {"start": "pretrained"}},
    "command": ["amulett", "train"],
    "seed": 3,
    "steps": 12_000,
    "validation": {"split": "validation", "episodes": 20, "seconds": 90.0, "cost": 0.6543, "failures": 1},
    "versions": {"numpy": "2.0"},
}


def card(tmp_path, provenance=PROVENANCE, **keywords) -> str:
    bundle = read_bundle(make_bundle(tmp_path / "mine", keywords=keywords))
    return model_card(bundle.policy, bundle.env, provenance)


def test_it_says_on_what_and_for_what_a_policy_was_trained(tmp_path):
    found = card(tmp_path, suite="mixed", profile="testbed")
    for part in (
        "# Model card: PPO, trained on the testbed",
        "suite `mixed`, split `train`; episodes of 500 agent steps of 0.02 s",
        "Training: 12,000 agent steps, seed 3, 1.5 minutes until this policy was reached.",
        "Command: `amulett train`.",
        "Began as the policy `pretrained`.",
        "Software: numpy 2.0.",
        "Control loop: `decentralized`",
        "`sensors.below_floor` clamp",
        "Input: 13 observations of the environment.",
        "every 0.02 s, a tension setpoint from 4 to 15 N.",
        "Network: 13-4-1, tanh",
        "In 20 scenarios of the split `validation`, by which the policy was chosen: cost 0.6543, failures 1",
        "It knows one device, the testbed and what its suite draws around it",
        "Setpoints below 5 N",
    ):
        assert part in found, part


def test_of_a_fleet_it_gives_the_ranges(tmp_path):
    found = card(tmp_path, fleet=names_or_contents(FLEET))
    assert "trained on a fleet of 2 devices" in found
    assert "Nothing is known beyond the physics of its devices: `drives.lag` 0.02 to 0.05." in found
    assert "one device" not in found


def test_what_is_not_known_is_left_out(tmp_path):
    found = card(tmp_path, {}, profile={"name": "old", "gone": 1})
    assert "trained on a device that this version cannot read" in found and "None were recorded." in found
    assert "Training:" not in found and "configuration" not in found


def test_characters_that_cannot_be_printed_are_replaced(tmp_path):
    assert "`a?b`" in card(tmp_path, {"command": ["a\x1bb"]})


def test_limits_are_added_and_nothing_else_changes(tmp_path):
    folder = make_bundle(tmp_path / "mine")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    rewrite_card(folder, ["It fears pushes."])
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert after.pop("card.md").endswith(b"\n- It fears pushes.\n")
    assert before.keys() == after.keys()
    assert [name for name in before if before[name] != after[name]] == ["manifest.json"]
    (files,) = copy_policies([str(folder)]).files
    assert "card.md" in files


def test_the_card_of_an_early_bundle_is_made_from_its_description(tmp_path, capsys):
    folder = make_bundle(tmp_path / "mine")
    bundle = read_bundle(folder)
    assert bundle.card is None and card_of(bundle) == model_card(bundle.policy, bundle.env, {})
    assert main(["config", "validate", str(folder), "--show"]) == 0
    assert capsys.readouterr().out.startswith(card_of(bundle))


def test_the_card_of_a_shipped_policy_is_printed(capsys):
    assert main(["config", "validate", "pretrained:testbed", "--show"]) == 0
    assert capsys.readouterr().out.startswith("# Model card: PPO, trained on the testbed\n")
    assert main(["config", "validate", "pretrained:testbed", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "a policy bundle" and found["card"].startswith("# Model card")
