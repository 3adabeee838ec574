"""The hyper-parameter files for rl_zoo3: every key and name in them exists, and what they train becomes a bundle."""

from __future__ import annotations

import argparse
import inspect
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")

import stable_baselines3
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from amulett_agents import load_train_config, make_sb3_env, recipe_view, save_policy
from amulett_agents.model import make_model
from amulett_agents.networks import AsymmetricPolicy, StandardInputs, visible_entries
from amulett_agents.zoo import MeasuredInputs
from amulett_gym import DRIVES_ID, ENV_IDS
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.features import FEATURES

FILES = sorted((Path(__file__).parents[2] / "configs" / "zoo").glob("*.yml"))
ENTRIES = [(path, name) for path in FILES for name in yaml.safe_load(path.read_text())]
OF_THE_ZOO = {*("n_timesteps", "n_envs", "env_kwargs", "vec_env_wrapper", "callback", "noise_type", "noise_std")}
"""Keys that rl_zoo3 takes out before it makes the model."""
KNOWN = len(OBSERVATIONS) + len(FEATURES)


def entry_of(path, name):
    return yaml.safe_load(path.read_text())[name]


def named(name):
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


@pytest.mark.parametrize(("path", "name"), ENTRIES, ids=lambda value: getattr(value, "stem", value))
def test_keys_are_arguments_of_the_algorithm_and_names_exist(path, name):
    entry = entry_of(path, name)
    algorithm = getattr(stable_baselines3, path.stem.upper())
    assert set(entry) - OF_THE_ZOO <= set(inspect.signature(algorithm).parameters)
    for key, first in (("vec_env_wrapper", ["venv"]), ("callback", [])):
        for item in entry.get(key, []):
            thing, keywords = next(iter(item.items())) if isinstance(item, dict) else (item, {})
            inspect.signature(named(thing)).bind(*first, **keywords)
            assert key != "callback" or issubclass(named(thing), BaseCallback)
    words = {"nn": import_module("torch.nn"), "get_class_by_name": named, "range": range, "dict": dict, "list": list}
    chosen = eval(entry["policy_kwargs"], {"__builtins__": {}}, words)  # as rl_zoo3 does
    policy = named(entry["policy"]) if "." in entry["policy"] else algorithm.policy_aliases[entry["policy"]]
    known = set(inspect.signature(policy).parameters) | set(inspect.signature(policy.__mro__[1]).parameters)
    assert set(chosen) <= known
    assert chosen.get("visible", list(range(KNOWN))) == list(range(KNOWN))


@pytest.mark.parametrize(("path", "name"), ENTRIES, ids=lambda value: getattr(value, "stem", value))
def test_rl_zoo3_trains_with_it(path, name, tmp_path):
    manager = pytest.importorskip("rl_zoo3.exp_manager").ExperimentManager
    short = {"n_envs": 4, "net_arch": [8], "batch_size": 16}
    short |= {"n_steps": 16} if path.stem == "ppo" else {"learning_starts": 8, "buffer_size": 64}
    short = {key: value for key, value in short.items() if key in entry_of(path, name)}
    about = {
        "n_timesteps": 64,
        "eval_freq": -1,
        "log_interval": -1,
        "config": str(path),
        "hyperparams": short,
        "device": "cpu",
    }
    experiment = manager(argparse.Namespace(), path.stem, name, str(tmp_path), **about)
    model, _ = experiment.setup_experiment()
    before = [values.clone() for values in model.policy.parameters()]
    experiment.learn(model)
    assert any((values != was).any() for values, was in zip(model.policy.parameters(), before, strict=True))
    bundle = read_bundle(save_policy(model, tmp_path / "bundle"))
    assert bundle.env.keywords["suite"] == entry_of(path, name)["env_kwargs"]["suite"]


def learner(env_id=ENV_IDS[0], **policy_kwargs):
    envs = make_sb3_env(env_id, num_envs=4, suite="mixed", privileged=True, max_episode_steps=40)
    envs = envs if env_id == DRIVES_ID else recipe_view(envs)
    chosen = {"net_arch": {"pi": [8], "vf": [8]}} | policy_kwargs
    visible = visible_entries(0, KNOWN if env_id != DRIVES_ID else len(OBSERVATIONS), 1)
    policy_kwargs = chosen | {"visible": visible}
    return PPO(AsymmetricPolicy, envs, n_steps=4, batch_size=16, n_epochs=1, policy_kwargs=policy_kwargs, device="cpu")


def test_measured_inputs_are_those_of_the_recipe():
    settings = ["network.initial_tension=null", "env.max_episode_steps=40", "num_envs=12", "ppo.n_steps=16"]
    recipe = make_model(load_train_config(None, [*settings, "ppo.batch_size=64"])).policy.features_extractor
    model = learner(features_extractor_class=StandardInputs)
    model.learn(16, callback=MeasuredInputs())
    own = model.policy.features_extractor
    np.testing.assert_array_equal(own.means, recipe.means)
    np.testing.assert_array_equal(own.gains, recipe.gains)
    kept = own.means.clone()
    own.means += 1.0  # as of a training with other inputs
    model.learn(16, callback=MeasuredInputs())
    np.testing.assert_array_equal(own.means, kept + 1.0)


def test_measured_inputs_need_a_place():
    with pytest.raises(AmulettError, match="needs policy_kwargs with features_extractor_class: StandardInputs"):
        learner().learn(16, callback=MeasuredInputs())
    with pytest.raises(AmulettError, match=r"not for Amulett/Drives-v0: train with configs/drives\.yaml"):
        learner(DRIVES_ID, features_extractor_class=StandardInputs).learn(16, callback=MeasuredInputs())
