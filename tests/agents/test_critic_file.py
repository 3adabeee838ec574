"""The file of a critic: what is written is read, the same bytes each time, and nothing else is accepted."""

import io
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from amulett_agents.critic_file import Critic, critic_of_bundle, pack_critic
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import bundle_folder


def a_critic(hidden=(4, 3)):
    random, sizes = np.random.default_rng(0), (2 * len(OBSERVATIONS), *hidden, 1)
    layers = [
        (random.normal(size=(outputs, inputs)).astype(np.float32), random.normal(size=outputs).astype(np.float32))
        for inputs, outputs in pairwise(sizes)
    ]
    means = random.normal(size=sizes[0]).astype(np.float32)
    return Critic(OBSERVATIONS, 2, "relu", 0.99, 10.0, means, np.exp(means), layers)


def read(content):
    shipped = read_bundle(bundle_folder("pretrained"))
    return critic_of_bundle(replace(shipped, folder=Path("mine"), critic=content))


def test_what_is_written_is_read():
    critic = a_critic()
    found = read(pack_critic(critic))
    assert pack_critic(found) == pack_critic(critic)
    assert (found.inputs, found.hidden, found.is_privileged) == (OBSERVATIONS, [4, 3], False)
    assert (found.history, found.activation, found.gamma, found.reward_scale) == (2, "relu", 0.99, 10.0)
    assert np.array_equal(found.means, critic.means) and np.array_equal(found.layers[1][0], critic.layers[1][0])
    assert read(None) is None


def test_what_no_recipe_can_have_is_not_written():
    assert pack_critic(a_critic(hidden=())) is None
    assert pack_critic(a_critic(hidden=(1025,))) is None
    assert pack_critic(a_critic(hidden=[1024] * 6)) is None  # too large


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": np.array(2)}, "its version is 2; this amulett-gym reads version 1"),
        ({"inputs": np.array(["a", "a"])}, "inputs have to be different names"),
        ({"inputs": np.array([b"a"])}, "inputs have to be different names"),
        ({"scales": np.ones(13)}, "the scales of its inputs are not those of this amulett-gym"),
        ({"activation": np.array("sine")}, "activation has to be tanh or relu"),
        ({"history": np.array(0)}, "history has to be from 1 to 100"),
        ({"history": np.array(2.0)}, "history has to be one finite number"),
        ({"gamma": np.array(np.nan)}, "gamma has to be one finite number"),
        ({"gamma": np.array([0.9])}, "gamma has to be one finite number"),
        ({"gains": np.zeros(26, np.float32)}, "gains have to be positive"),
        ({"means": np.zeros(26)}, r"means is float64 of shape \(26,\); it has to be float32 of shape \(26,\)"),
        ({"layer_1.weight": np.zeros((3, 5), np.float32)}, r"layer_1.weight is float32 of shape \(3, 5\)"),
        ({"layer_2.bias": np.array([np.inf], np.float32)}, "layer_2.bias .* finite"),
        ({"layer_1.bias": np.zeros(2000, np.float32)}, "1 to 8 hidden layers, of 1 to 1024 units"),
        ({"more": np.zeros(1)}, "it holds arrays that a critic does not have"),
        ({"gamma": None}, "'gamma' is missing"),
        ({"layer_1.bias": None, "layer_1.weight": None}, "'layer_1.bias' is missing"),
    ],
)
def test_what_is_no_critic_is_refused(changes, message):
    with np.load(io.BytesIO(pack_critic(a_critic()))) as file:
        arrays = {name: value for name, value in {**file, **changes}.items() if value is not None}
    content = io.BytesIO()
    np.savez(content, **arrays)
    with pytest.raises(AmulettError, match=f"critic 'mine.critic.npz' cannot be used: .*{message}"):
        read(content.getvalue())


def test_objects_and_large_or_damaged_files_are_refused():
    content = io.BytesIO()
    np.savez(content, version=np.array([{}], dtype=object))
    large = io.BytesIO()
    np.savez_compressed(large, version=np.zeros(3_000_000))
    for wrong, message in (
        (content, "allow_pickle=False"),
        (large, "bytes unpacked"),
        (io.BytesIO(b"PK"), "not a zip"),
    ):
        with pytest.raises(AmulettError, match=f"critic 'mine.critic.npz' is damaged: .*{message}"):
            read(wrong.getvalue())
