"""Training in `Amulett/Worn-v0`."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from helpers import SMALL_RECIPE
from stable_baselines3 import PPO

import amulett_gym
from amulett_agents import make_sb3_env, save_policy
from amulett_agents.bundles import describe_policy, start_from
from amulett_agents.checkpoint import capture, newest_checkpoint, restore, write_checkpoint
from amulett_agents.config import load_train_config
from amulett_agents.critic_file import critic_of_bundle
from amulett_agents.model import make_model
from amulett_agents.run import RunState
from amulett_agents.sb3_zip import load_sb3_zip
from amulett_agents.training import train
from amulett_gym import load_policy
from amulett_gym.cli import main
from amulett_gym.envs.worn_reward import WORN_TERMS, WORN_WEIGHTS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.card import model_card
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.laws.features import WORN_FEATURES
from amulett_gym.laws.memory import WORN_MEMORY
from amulett_gym.profile import load_profile

WORN = amulett_gym.WORN_ID
SMALL = [*SMALL_RECIPE, f"env.id={WORN}", "network.hidden=[8, 6]", "network.memory=true"]


def test_a_recipe_has_the_defaults_of_its_environment():
    env = load_train_config(None, [f"env.id={WORN}"]).env
    given = env.profile, env.suite, env.control, env.tension_range
    assert given == ("worn", "assembly", "equilibrium-point", [0.0, 15.0])
    env = load_train_config(None, [f"env.id={WORN}", "env.suite=carry", "env.control=co-rotation"]).env
    assert (env.suite, env.control, env.keywords()["control"]) == ("carry", "co-rotation", "co-rotation")
    assert load_train_config(None, [f"env.id={WORN}", "env.fleet=[worn, testbed]"]).env.suite == "assembly"


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ([f"env.id={WORN}", "env.suite=mixed"], "unknown suite 'mixed'"),
        (["env.suite=assembly"], "'assembly' is a suite of Amulett/Worn-v0"),
        ([f"env.id={WORN}", "env.reward_weights={position: 1}"], "unknown reward weight 'position'"),
        (["env.reward_weights={muscle: 1}"], "unknown reward weight 'muscle'"),
        (["network.initial_assistance=0.5"], "only Amulett/Worn-v0 has it"),
        ([f"env.id={WORN}", "network.initial_assistance=2"], "less than or equal to 1"),
    ],
)
def test_wrong_recipes_are_refused(changes, problem):
    with pytest.raises(AmulettError, match=problem):
        load_train_config(None, changes)


def test_the_papers_loop_is_refused_and_not_replaced(tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", "--set", *SMALL, "env.control=decentralized", "--out", str(run)]) == 2
    assert "feeds the co-contraction forward" in capsys.readouterr().err
    assert not run.exists()


def test_older_recipes_keep_their_records():
    assert "initial_assistance" not in load_train_config().model_dump()["network"]
    given = load_train_config(None, [*SMALL, "network.initial_assistance=0.5"]).model_dump()
    assert given["network"]["initial_assistance"] == 0.5


def test_the_cost_without_the_device_is_known():
    own = [f"env.id={WORN}"]
    assert load_train_config().env.doffed_cost is None
    assert load_train_config(None, own).env.doffed_cost == pytest.approx(0.8)
    heavy = [*own, "env.reward_weights={muscle: 1.0, drives: 3.0}", "env.max_episode_steps=250"]
    assert load_train_config(None, heavy).env.doffed_cost == pytest.approx(0.65)


@pytest.mark.parametrize(
    "changes", [[], ["env.history=3", "network.features=false"], ["network.memory=false", "network.features=false"]]
)
def test_the_first_policy_has_a_constant_co_contraction_and_assistance(changes):
    config = load_train_config(None, [*SMALL, *changes, "network.initial_assistance=0.25"])
    layers, description = describe_policy(make_model(config))
    env = gym.make_vec(WORN, num_envs=5, agent_period=0.05)
    observations, _ = env.reset(seed=0)
    actions = Actor(layers, description.model_copy(update={"follow": 1.0}), env)(observations)
    np.testing.assert_allclose(actions, np.tile([7.0 / 7.5 - 1.0, -0.5], (5, 1)), atol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        [],
        ["env.history=2", "env.follow_time=0.2"],
        ["algorithm=sac", "sac.learning_starts=64", "total_steps=192", "network.memory=false"],
    ],
)
def test_a_training_makes_a_bundle_that_acts_alike(tmp_path, changes):
    config = load_train_config(None, [*SMALL, *changes])
    result = train(config, tmp_path / "run", progress=False)
    assert result.diverged is None and np.isfinite(result.last_cost)
    bundle = read_bundle(result.last)
    policy = bundle.policy
    assert (bundle.env.id, policy.actions, len(policy.observations)) == (WORN, ["tension", "assistance"], 16)
    assert (policy.tension_range, bundle.env.keywords["suite"]) == ([0.0, 15.0], "assembly")
    assert policy.features == list(WORN_FEATURES)
    assert policy.memory == (list(WORN_MEMORY) if config.network.memory else None)
    assert policy.is_worn and not policy.is_privileged
    header, *rows = (result.out / "evaluations.csv").read_text().splitlines()
    assert header == f"steps,seconds,cost,{','.join(WORN_TERMS)},failures,exploration_std"
    last = dict(zip(header.split(","), map(float, rows[-1].split(",")), strict=True))
    assert last["cost"] == pytest.approx(sum(last[term] for term in WORN_TERMS))

    env = gym.make_vec(WORN, num_envs=4, **{**bundle.env.keywords, "split": "validation"}, max_episode_steps=25)
    acts = load_policy(result.last, env)
    observations, _ = env.reset(seed=0)
    total = 0.0
    for _ in range(25):
        observations, rewards, *_ = env.step(acts(observations))
        total += rewards.sum()
    assert -total / 4 == pytest.approx(result.last_cost, rel=1e-9)


def test_a_checkpoint_restores_the_worn_devices_and_the_memory(tmp_path):
    config = load_train_config(None, [*SMALL, "env.history=2"])
    model = make_model(config)
    model.learn(256)
    (tmp_path / "config.yaml").write_text("")
    state = RunState(seconds=0, rows=[], best=0, validated_steps=-1, next_validation=0, episodes=[])
    write_checkpoint(tmp_path, model, state, config.model_dump())
    expected = capture(model)[1]
    other = make_model(config)
    other.learn(0)
    checkpoint = newest_checkpoint(tmp_path)
    assert checkpoint is not None
    restore(other, checkpoint)
    found = capture(other)[1]
    assert found.keys() == expected.keys() and "memory.means" in found
    for name, array in expected.items():
        assert np.array_equal(found[name], array, equal_nan=True), name


def test_a_bundle_holds_its_critic_and_can_be_started_from(tmp_path):
    model = make_model(load_train_config(None, SMALL))
    folder = save_policy(model, tmp_path / "bundle")
    bundle = read_bundle(folder)
    critic = critic_of_bundle(bundle)
    assert critic is not None and critic.inputs[13:16] == ("measured_cuff", "cuff_rate", "assistance")
    assert critic.inputs[16:] == (*WORN_FEATURES, *WORN_MEMORY)
    config = load_train_config(None, [], start=str(folder))
    assert (config.env.id, config.network.memory, config.env.control) == (WORN, True, "equilibrium-point")
    again = make_model(load_train_config(None, [*SMALL, f"network.start={folder}"]))
    for mine, theirs in zip(describe_policy(again)[0], bundle.layers, strict=True):
        for values, expected in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-5)
    bare = make_model(load_train_config(None, [*SMALL_RECIPE, "network.hidden=[8, 6]", "network.memory=true"]))
    with pytest.raises(AmulettError, match=r"actions \['tension', 'assistance'\]; this recipe's has None"):
        start_from(bare, bundle)


def test_a_bundle_acts_in_its_environment_alone(tmp_path, capsys):
    folder = save_policy(make_model(load_train_config(None, SMALL)), tmp_path / "bundle")
    bare = save_policy(make_model(load_train_config(None, [*SMALL_RECIPE])), tmp_path / "bare")
    with pytest.raises(AmulettError, match="needs Amulett/Worn-v0, whose cuff it observes; this is Amulett/Scaling-v0"):
        load_policy(folder, gym.make("Amulett/Scaling-v0", agent_period=0.05))
    with pytest.raises(AmulettError, match="needs an environment without a wearer"):
        load_policy(bare, gym.make(WORN, agent_period=0.05))
    assert parse_contender(str(folder)).env_id == WORN
    assert main(["evaluate", "--policies", str(folder), "--suite", "steps", "--out", str(tmp_path / "e")]) == 2
    assert "which acts there alone" in capsys.readouterr().err
    assert main(["export", str(folder), "--out", str(tmp_path / "x")]) == 2
    assert "needs the cuff of a worn device" in capsys.readouterr().err


def test_other_tension_ranges_change_the_co_contraction_alone(tmp_path):
    folder = save_policy(
        make_model(load_train_config(None, [*SMALL, "network.initial_assistance=0.75"])), tmp_path / "b"
    )
    wide = gym.make_vec(WORN, num_envs=3, agent_period=0.05, tension_range=(0.0, 30.0))
    observations, _ = wide.reset(seed=0)
    actions = load_policy(folder, wide)(observations)
    np.testing.assert_allclose(actions, np.tile([7.0 / 15.0 - 1.0, 0.5], (3, 1)), atol=1e-5)


def test_models_of_sb3_become_bundles_and_zips(tmp_path):
    model = PPO("MlpPolicy", make_sb3_env(WORN, 2), n_steps=8, batch_size=8, seed=0, device="cpu")
    model.learn(16)
    env = gym.make_vec(WORN, num_envs=3)
    observations, _ = env.reset(seed=0)
    expected = np.clip(model.predict(observations, deterministic=True)[0], -1.0, 1.0)
    policy = load_policy(save_policy(model, tmp_path / "bundle"), env)
    np.testing.assert_allclose(policy(observations), expected, atol=1e-5)
    model.save(tmp_path / "model.zip")
    about = {"env_id": WORN, "agent_period": 0.02, "tension_range": [0.0, 15.0], "control": "equilibrium-point"}
    (tmp_path / "model.json").write_text(json.dumps(about))
    contender = load_sb3_zip(tmp_path / "model.zip", load_profile("worn"), trust_pickle=True)
    assert (contender.env_id, contender.env_keywords["control"]) == (WORN, "equilibrium-point")
    np.testing.assert_allclose(contender.act(observations), expected, atol=1e-6)
    (tmp_path / "model.json").write_text(json.dumps({**about, "env_id": "Amulett/Tension-v0"}))
    with pytest.raises(AmulettError, match=r"it has to be \(13,\)"):
        load_sb3_zip(tmp_path / "model.zip", load_profile("testbed"), trust_pickle=True)


def test_the_card_and_the_command_say_what_a_cost_is_compared_with(tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", "--set", *SMALL, "total_steps=256", "--out", str(run)]) == 0
    assert "for comparison: without the device, the same wearers cost 0.1\n" in capsys.readouterr().out
    assert main(["config", "validate", str(run / "best"), "--show"]) == 0
    shown = capsys.readouterr().out
    assert "an assistance from 0 to 1" in shown and "16 observations of the environment" in shown
    assert "0.8 is that of the same wearers in 10 s without the device" in shown
    assert main(["config", "validate", str(run / "config.yaml")]) == 0
    bundle = read_bundle(run / "best")
    bundle.env.keywords["reward_weights"] = {**WORN_WEIGHTS, "muscle": 1.0}
    assert "1.3 is that of the same wearers" in model_card(bundle.policy, bundle.env, bundle.provenance)
