"""Behaviour cloning: a bundle that acts as the recorded policies did."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from amulett_agents import cloning  # noqa: E402
from amulett_agents.cloning import CloneSettings, clone  # noqa: E402
from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID, load_policy  # noqa: E402
from amulett_gym.cli import main  # noqa: E402
from amulett_gym.datasets.playing import Random, make_stage, play_episodes  # noqa: E402
from amulett_gym.datasets.reading import Demonstrations  # noqa: E402
from amulett_gym.errors import AmulettError  # noqa: E402
from amulett_gym.evaluation.runner import evaluate  # noqa: E402
from amulett_gym.laws.bundle import TrainingEnv, read_bundle  # noqa: E402
from amulett_gym.laws.contenders import Own, parse_contender  # noqa: E402

SCALING = ENV_IDS[0]


def demonstrations(contender, env_id=SCALING, episodes=20, duration=2.0, **given) -> Demonstrations:
    """Return what `read_demonstrations` does, without a data set."""
    stage = make_stage([contender], env_id, duration, given)
    played = [each for batch in play_episodes(stage, contender, 0, episodes) for each in batch]
    env = TrainingEnv(id=env_id, keywords=stage.spec.kwargs, max_episode_steps=stage.steps)
    observations, actions = [each.observations[:-1] for each in played], [each.actions for each in played]
    mean = float(np.mean([each.rewards.sum() for each in played]))
    return Demonstrations(
        "amulett/x-v0", env, stage.settings, {contender.name: len(played)}, observations, actions, mean
    )


@pytest.fixture
def data(monkeypatch):
    """Let `clone` read the demonstrations that a test makes."""

    def use(*arguments, **options) -> Demonstrations:
        found = demonstrations(*arguments, **options)
        monkeypatch.setattr(cloning, "read_demonstrations", lambda *given: found)
        return found

    return use


@pytest.mark.slow
def test_a_clone_costs_what_its_model_costs(data, tmp_path):
    data(parse_contender("eq6-held"), episodes=100, duration=10.0, suite="mixed")
    found = clone("x", tmp_path / "clone", CloneSettings(gradient_steps=1500))
    assert found.errors["tension"] < 0.15 and (found.episodes, found.steps) == (90, 45_000)
    results = evaluate(["eq6-held", str(found.folder)], "mixed", episodes=60)
    model, own = (results.values[name]["cost"].mean() for name in ("eq6-held", str(found.folder)))
    assert own == pytest.approx(model, rel=0.02)
    constant = evaluate(["constant:10"], "mixed", episodes=60).values["constant:10"]["cost"].mean()
    assert abs(constant - model) > 0.05 * model  # so that the agreement means something


def test_the_same_seed_gives_the_same_weights_and_another_one_others(data, tmp_path):
    data(parse_contender("eq6-held"))
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        clone("x", tmp_path / name, CloneSettings(gradient_steps=20, hidden=[8], seed=seed))
    first, again, other = (read_bundle(tmp_path / name).layers for name in "abc")
    np.testing.assert_array_equal(first[0][0], again[0][0])
    assert (first[0][0] != other[0][0]).any()


def both(observations):
    return np.stack([observations[:, 3], -observations[:, 1]], axis=1)


CASES = {
    "drives": (Own("both", act=both), DRIVES_ID, {}),
    "worn": (Random("random"), WORN_ID, {}),
    "memory on a fleet": (parse_contender("pretrained"), SCALING, {"fleet": ["testbed", "simulation"]}),
    "another loop": (parse_contender("co-rotation/constant:3"), SCALING, {}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_clone_acts_in_the_environment_of_its_data(case, data, tmp_path):
    contender, env_id, given = CASES[case]
    found = data(contender, env_id, **given)
    clone("x", tmp_path / "clone", CloneSettings(gradient_steps=20, hidden=[8], memory=case.startswith("memory")))
    bundle = read_bundle(tmp_path / "clone")
    assert bundle.env.id == env_id and bundle.policy.tension_range == list(found.settings.tension_range)
    assert bool(bundle.policy.memory) == case.startswith("memory") and bundle.critic is None
    env = gym.make_vec(env_id, num_envs=3, **bundle.env.keywords)
    actions = load_policy(tmp_path / "clone", env)(env.reset(seed=0)[0])
    assert env.action_space.contains(actions)


def test_the_network_sees_what_the_policy_will_see(data, tmp_path):
    """The clone's inputs in an episode that it plays are those that it would learn from, memory among them."""
    data(parse_contender("eq6-held"))
    clone("x", tmp_path / "clone", CloneSettings(gradient_steps=5, hidden=[8], memory=True))
    seen = []

    def spy(layers, network, inputs):
        seen.append(np.asarray(inputs))
        return forward(layers, network, inputs)

    from amulett_gym.laws import actor

    forward = actor.forward
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(actor, "forward", spy)
        played = demonstrations(parse_contender(str(tmp_path / "clone")), episodes=3)
    expected = cloning._inputs(played, memory=True)
    np.testing.assert_allclose(np.stack(seen, axis=1), np.stack(expected), atol=1e-6)


def test_a_policy_in_the_folder_is_kept_unless_it_is_to_be_replaced(data, tmp_path):
    data(parse_contender("eq6-held"))
    few = CloneSettings(gradient_steps=1, hidden=[4])
    clone("x", tmp_path / "clone", few)
    with pytest.raises(AmulettError, match="holds a policy already.*--overwrite"):
        clone("x", tmp_path / "clone", few)
    clone("x", tmp_path / "clone", few, overwrite=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    with pytest.raises(AmulettError, match="not a policy bundle and not empty"):
        clone("x", tmp_path / "other", few, overwrite=True)


@pytest.mark.parametrize(
    ("contender", "env_id", "names"),
    [
        (Own("both", act=both), DRIVES_ID, ["mean_drive_angle", "tension"]),
        (Random("random"), WORN_ID, ["tension", "assistance"]),
    ],
)
def test_errors_are_those_of_the_actions_in_the_episodes_kept_apart(contender, env_id, names, data, tmp_path):
    found = data(contender, env_id)
    cloned = clone("x", tmp_path / "clone", CloneSettings(gradient_steps=20, hidden=[8]))
    assert list(cloned.errors) == names
    bundle = read_bundle(cloned.folder)
    inputs = cloning._inputs(found, memory=False)
    differences = np.concatenate([bundle.act(inputs[k]).astype(float) - found.actions[k] for k in (9, 19)])
    low, high = found.settings.tension_range
    scales = {"tension": (high - low) / 2, "assistance": 0.5, "mean_drive_angle": found.settings.mean_angle_deg}
    for name, column in zip(names, differences.T, strict=True):
        assert cloned.errors[name] == pytest.approx(scales[name] * np.sqrt(np.mean(column**2)))


def test_one_episode_is_too_few(data, tmp_path):
    data(parse_contender("eq6-held"), episodes=1)
    with pytest.raises(AmulettError, match="has 1 episode; cloning needs 2"):
        clone("x", tmp_path / "clone")
    assert not (tmp_path / "clone").exists()


def test_the_card_says_what_was_imitated(data, tmp_path):
    data(parse_contender("eq6-held"))
    clone("x", tmp_path / "clone", CloneSettings(gradient_steps=1, hidden=[4]), command=["amulett", "clone"])
    bundle = read_bundle(tmp_path / "clone")
    assert "behaviour cloning" in bundle.card and "It imitates eq6-held" in bundle.card
    assert bundle.provenance["dataset"] == {"name": "amulett/x-v0", "policies": {"eq6-held": 20}}


def test_the_commands_record_and_clone(tmp_path, monkeypatch, capsys):
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "all"))
    words = "record --policies eq6-held random --suite mixed --episodes 3 --duration 0.5 --author Me You --json"
    assert main(words.split()) == 0
    recorded = json.loads(capsys.readouterr().out)
    assert recorded["name"] == "amulett/scaling/mixed-eq6-held-random-v0" and recorded["steps"] == 150
    assert recorded["policies"]["random"]["episodes"] == 3
    words = f"clone {recorded['name']} --policy eq6-held --steps 10 --out clone"
    assert main([*words.split(), "--json"]) == 0
    cloned = json.loads(capsys.readouterr().out)
    assert cloned["policies"] == {"eq6-held": 3} and cloned["episodes"] == 2
    assert main([*words.split(), "--overwrite"]) == 0
    assert "Written: clone" in capsys.readouterr().out
    words = "record --policies eq6-held --episodes 2 --duration 0.5 --split held-out --name amulett/held-v0"
    assert main(words.split()) == 0
    assert main(["clone", "amulett/held-v0", "--steps", "10", "--out", "held"]) == 0
    assert "are of the split held-out; evaluate the clone in another split" in capsys.readouterr().err
    words = f"clone {recorded['name']} --policy eq6-held --steps 10 --out clone"
    assert main([*words.split()]) == 2 and "--overwrite" in capsys.readouterr().err
