"""Training on a fleet of devices."""

import contextlib
import json

import numpy as np
import pytest
import torch
from helpers import SMALL_RECIPE

from amulett_agents.adapter import make_sb3_env
from amulett_agents.bundles import describe_env
from amulett_agents.config import load_train_config
from amulett_agents.model import make_model
from amulett_agents.run import Run
from amulett_agents.training import resume, train
from amulett_agents.validation import make_validation_env
from amulett_gym.cli import main
from amulett_gym.envs.privileged import FLEET_PRIVILEGED, PRIVILEGED
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol, training_differs
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.laws.features import FEATURES
from amulett_gym.laws.memory import MEMORY
from amulett_gym.profile import load_profile
from amulett_gym.storage.safe_yaml import MAX_NODES

HEAVY = {"name": "heavy", "base": "testbed", "plant": {"masses": [{"mass": 0.4, "arm": 0.13}]}}
SMALL = [*SMALL_RECIPE, "num_envs=24", "ppo.batch_size=384", "env.suite=reach"]
SMALL += ["validation.episodes=16", "validation.every_steps=700", "checkpoint_seconds=0"]


class Died(Exception):
    pass


def test_a_run_on_a_fleet_is_resumed_and_run_again(tmp_path, monkeypatch, capsys):
    path = tmp_path / "fleet.json"
    path.write_text(json.dumps(["testbed", HEAVY, "simulation"]))
    config = load_train_config(None, [*SMALL, "network.memory=true", f"env.fleet={path}", "validation.fleet=[testbed]"])
    train(config, tmp_path / "whole", progress=False)

    calls, validate = [], Run._validate

    def die_at_the_second(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise Died
        return validate(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(Run, "_validate", die_at_the_second)
        with pytest.raises(Died):
            train(config, tmp_path / "run", progress=False)
    path.unlink()
    resume(tmp_path / "run", progress=False)
    weights = [(tmp_path / run / "last" / "weights.safetensors").read_bytes() for run in ("run", "whole")]
    assert weights[0] == weights[1]
    assert main(["rerun", str(tmp_path / "whole"), "--out", str(tmp_path / "again")]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    keywords = read_bundle(tmp_path / "run" / "last").env.keywords
    assert [load_profile(each).name for each in keywords["fleet"]] == ["testbed", "heavy", "simulation"]
    assert "profile" not in keywords
    assert tuple(read_bundle(tmp_path / "run" / "last").policy.memory) == MEMORY
    bundle = parse_contender(str(tmp_path / "run" / "last"))
    assert "with the simulation" in training_differs(bundle, Protocol(load_profile("simulation"), "reach"))
    other = load_profile({"name": "other", "base": "testbed", "drives": {"lag": 0.3}})
    without = "on a fleet of 3 devices without the other, which is outside their ranges in drives.lag 0.3"
    assert without in training_differs(bundle, Protocol(other, "reach"))


def test_a_recipe_has_a_profile_or_a_fleet():
    config = load_train_config(None, [*SMALL, f"env.fleet=[testbed, {json.dumps(HEAVY)}]"])
    assert [each.name for each in config.env.devices] == ["testbed", "heavy"]
    assert load_train_config(None).env.devices == (load_profile("testbed"),)
    with pytest.raises(AmulettError, match="profile and fleet are both given"):
        load_train_config(None, ["env.profile=simulation", "env.fleet=[testbed]"])
    with pytest.raises(AmulettError, match="unknown profile 'testbad'"):
        load_train_config(None, ["env.fleet=[testbad]"])


def test_infos_of_the_adapter_have_the_device_of_their_own_block():
    env = make_sb3_env(num_envs=16, fleet=["testbed", "simulation"], max_episode_steps=3)
    env.seed(0)
    env.reset()
    assert [info["device"] for info in env.reset_infos] == [0] * 8 + [1] * 8
    for _ in range(3):
        *_, infos = env.step(np.zeros((16, 1), dtype=np.float32))
    assert [info["device"] for info in infos] == [0] * 8 + [1] * 8
    assert [info["device"] for info in env.reset_infos] == [0] * 8 + [1] * 8


def test_policies_are_compared_on_other_devices_each_as_often():
    fleets = ["env.fleet=[testbed, simulation]", f"validation.fleet=[testbed, {json.dumps(HEAVY)}, simulation]"]
    config = load_train_config(None, [*SMALL, *fleets, "validation.episodes=25"])
    with contextlib.closing(make_validation_env(config)) as env:
        _, info = env.reset(seed=0)
    assert [profile.name for profile in env.devices] == ["testbed", "heavy", "simulation"]
    assert np.bincount(info["device"]).tolist() == [16, 16, 16]
    config = load_train_config(None, [*SMALL, fleets[1], "validation.episodes=24"])
    assert config.env.keywords()["profile"] == "testbed"
    assert config.validation_keywords["num_envs"] == 24
    with pytest.raises(AmulettError, match=r"validation.fleet.*unknown profile 'testbad'"):
        load_train_config(None, ["validation.fleet=[testbad]"])


def test_the_critic_is_given_the_device_and_the_policy_is_not():
    model = make_model(load_train_config(None, [*SMALL, f"env.fleet=[testbed, {json.dumps(HEAVY)}]"]))
    env = model.get_env()
    first = env.reset()
    end = len(OBSERVATIONS) + len(FEATURES) + len(PRIVILEGED)
    assert first.shape[1] == end + len(FLEET_PRIVILEGED)
    inertia = first[:, end + FLEET_PRIVILEGED.index("device_inertia")]
    assert len(np.unique(inertia)) == 2
    assert model.policy.mlp_extractor.visible.tolist() == list(range(len(OBSERVATIONS) + len(FEATURES)))
    changed = torch.as_tensor(first)
    values, actions = model.policy.predict_values(changed), model.policy.get_distribution(changed).mode()
    changed[:, end:] += 0.5
    assert not torch.equal(model.policy.predict_values(changed), values)
    assert torch.equal(model.policy.get_distribution(changed).mode(), actions)


def test_a_bundle_names_a_shipped_fleet():
    env = make_sb3_env("Amulett/Scaling-v0", 8, fleet="plausible-choose", suite="reach")
    assert describe_env(env).keywords["fleet"] == "plausible-choose"
    own = make_sb3_env("Amulett/Scaling-v0", 8, fleet=["testbed", HEAVY], suite="reach")
    assert [load_profile(each).name for each in describe_env(own).keywords["fleet"]] == ["testbed", "heavy"]


def test_the_recipe_of_a_run_on_many_own_devices_can_be_read():
    config = load_train_config(None, ["env.fleet=full_control/plausible.yaml"])
    assert len(config.env.fleet) == 64
    assert 1e4 < _nodes(config.model_dump(mode="json")) < MAX_NODES / 4  # written and read, it takes seconds


def _nodes(content):
    """Return the number of keys and values."""
    if isinstance(content, dict):
        return 1 + sum(1 + _nodes(value) for value in content.values())
    return 1 + sum(map(_nodes, content)) if isinstance(content, list) else 1
