"""Training in `Amulett/Drives-v0`."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from helpers import SMALL_RECIPE
from stable_baselines3 import PPO

import amulett_gym
from amulett_agents import make_sb3_env, save_policy
from amulett_agents.bundles import describe_policy
from amulett_agents.config import load_train_config
from amulett_agents.first_policy import first_policy
from amulett_agents.model import make_model
from amulett_agents.sb3_zip import load_sb3_zip
from amulett_agents.training import train
from amulett_gym import load_policy
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.profile import load_profile

DRIVES = amulett_gym.DRIVES_ID
SMALL = [*SMALL_RECIPE, f"env.id={DRIVES}", "env.tension_range=[0, 15]", "network.hidden=[8, 6]"]


@pytest.mark.parametrize(
    "changes",
    [
        [],
        ["network.activation=tanh"],
        ["env.history=3", "network.features=false"],
        ["ppo.privileged_critic=false", "network.standard_inputs=false"],
    ],
)
def test_the_first_policy_holds_the_arm_at_its_setpoint(changes):
    config = load_train_config(None, [*SMALL, *changes])
    layers, description = describe_policy(make_model(config))
    env = gym.make_vec(DRIVES, num_envs=5, suite="mixed", agent_period=0.05)
    observations, info = env.reset(seed=0)
    actions = Actor(layers, description.model_copy(update={"follow": 1.0}), env)(observations)
    np.testing.assert_allclose(actions, first_policy(config.env, 7.0)(observations), atol=1e-6)
    joints = actions[:, 0] * 259.0 * 0.34795  # at the setpoints
    np.testing.assert_allclose(joints, 150.0 * observations[:, 3], atol=0.5)
    np.testing.assert_allclose(actions[:, 1], 7.0 / 7.5 - 1.0, rtol=1e-6)
    assert np.ptp(info["joint_angle"]) > 10.0


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_training_makes_a_bundle_that_acts_alike(tmp_path, algorithm):
    small = ["algorithm=sac", "sac.learning_starts=64", "total_steps=192"] if algorithm == "sac" else []
    config = load_train_config(None, [*SMALL, *small, "env.mean_angle_range=300"])
    result = train(config, tmp_path / "run", progress=False)
    assert result.diverged is None and np.isfinite(result.last_cost)
    bundle = read_bundle(result.last)
    assert (bundle.env.id, bundle.policy.mean_angle_range) == (DRIVES, 300.0)
    assert bundle.env.keywords["mean_angle_range"] == 300.0
    env = gym.make_vec(DRIVES, num_envs=4, **{**bundle.env.keywords, "split": "validation"}, max_episode_steps=25)
    policy = load_policy(result.last, env)
    observations, _ = env.reset(seed=0)
    total = 0.0
    for _ in range(25):
        observations, rewards, *_ = env.step(policy(observations))
        total += rewards.sum()
    assert -total / 4 == pytest.approx(result.last_cost, rel=1e-9)


def test_the_mean_angle_is_explored_less():
    config = load_train_config(None, [*SMALL, "ppo.mean_exploration=0.25", "staggered=false"])
    model = make_model(config)
    assert model.action_space.high.tolist() == [4.0, 1.0]
    env = model.get_env()
    env.reset()
    venv = env.get_attr("unwrapped")[0]
    before = venv.episodes.simulation.loop[1]["mean_command"].reshape(-1)[:8].copy()
    setpoints = venv.episodes.simulation.read("setpoint")
    env.step(np.tile(np.array([1.2, 0.0], dtype=np.float32), (8, 1)))
    after = venv.episodes.simulation.loop[1]["mean_command"].reshape(-1)[:8]
    # A learner's action of 1 is a quarter of the environment's, and is added to the setpoint's drive angle.
    wanted = np.minimum(np.radians(0.25 * 1.2 * 259.0) + setpoints / 0.34795, np.radians(259.0))
    np.testing.assert_allclose(after, before + config.env.share * (wanted - before), atol=1e-4)


def test_a_training_can_start_from_a_bundle(tmp_path):
    one = load_train_config(None, SMALL)
    folder = save_policy(make_model(one), tmp_path / "bundle")
    other = load_train_config(None, [*SMALL, f"network.start={folder}", "ppo.mean_exploration=0.3"])
    layers, _ = describe_policy(make_model(other))
    for mine, theirs in zip(layers, read_bundle(folder).layers, strict=True):
        for values, expected in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-5)


def test_models_of_sb3_become_bundles_and_zips(tmp_path):
    model = PPO("MlpPolicy", make_sb3_env(DRIVES, 2), n_steps=8, batch_size=8, seed=0, device="cpu")
    model.learn(16)
    env = gym.make_vec(DRIVES, num_envs=3)
    observations, _ = env.reset(seed=0)
    expected = np.clip(model.predict(observations, deterministic=True)[0], -1.0, 1.0)
    policy = load_policy(save_policy(model, tmp_path / "bundle"), env)
    np.testing.assert_allclose(policy(observations), expected, atol=1e-5)
    model.save(tmp_path / "model.zip")
    about = {"env_id": DRIVES, "agent_period": 0.02, "tension_range": [0.0, 15.0], "mean_angle_range": 259.0}
    (tmp_path / "model.json").write_text(json.dumps(about))
    contender = load_sb3_zip(tmp_path / "model.zip", load_profile("testbed"), trust_pickle=True)
    assert (contender.env_id, contender.env_keywords["mean_angle_range"]) == (DRIVES, 259.0)
    np.testing.assert_allclose(contender.act(observations), expected, atol=1e-6)
    (tmp_path / "model.json").write_text(json.dumps({**about, "env_id": "Amulett/Tension-v0"}))
    with pytest.raises(AmulettError, match=r"mean_angle_range|it has to be \(1,\)"):
        load_sb3_zip(tmp_path / "model.zip", load_profile("testbed"), trust_pickle=True)


@pytest.mark.parametrize(
    ("change", "problem"), [("env.mean_angle_range=0", "greater than 0"), ("ppo.mean_exploration=0", "greater than 0")]
)
def test_wrong_recipes_are_refused(change, problem):
    with pytest.raises(AmulettError, match=problem):
        load_train_config(None, [*SMALL, change])
    with pytest.raises(AmulettError, match="only Amulett/Drives-v0 has it"):
        load_train_config(None, ["env.mean_angle_range=100"])
