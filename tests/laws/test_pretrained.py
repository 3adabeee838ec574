"""The policies that come with the package."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import amulett_gym
from amulett_gym import ENV_IDS, load_policy
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.card import model_card
from amulett_gym.laws.contenders import PRETRAINED, bundle_folder, contender_names

NAMES = ("pretrained", "pretrained:testbed", "pretrained:device")
POLICIES = Path(amulett_gym.__file__).parent / "policies"


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_contender_without_privileges(name):
    bundle = read_bundle(bundle_folder(name))
    assert name in contender_names()
    assert bundle.env.id in ENV_IDS[:2]
    assert not bundle.policy.is_privileged


def test_each_name_has_a_folder_and_each_folder_a_name():
    assert set(PRETRAINED.values()) == {path.name for path in POLICIES.iterdir() if path.is_dir()}
    assert set(PRETRAINED) <= set(contender_names())
    assert bundle_folder("pretrained:tension") == bundle_folder("pretrained")


@pytest.mark.parametrize("name", NAMES)
def test_it_acts_alike_in_both_environments(name):
    actions = []
    for env_id in ENV_IDS[:2]:
        env = gym.make_vec(env_id, num_envs=5)
        observations, _ = env.reset(seed=1)
        policy = load_policy(name, env)
        for _ in range(20):
            chosen = policy(observations)
            observations, *_ = env.step(chosen)
        actions.append(chosen)
    np.testing.assert_allclose(actions[1], actions[0], rtol=0, atol=1e-5)


def test_numpy_computes_what_torch_would():
    torch = pytest.importorskip("torch")
    for name in NAMES:
        bundle = read_bundle(bundle_folder(name))
        assert bundle.policy.network.activation == "relu"
        layers = []
        for weight, bias in bundle.layers:
            linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
            with torch.no_grad():
                linear.weight.copy_(torch.tensor(weight))
                linear.bias.copy_(torch.tensor(bias))
            layers += [linear, torch.nn.ReLU()]
        observations = np.random.default_rng(0).uniform(-0.5, 0.5, (200, layers[0].in_features)).astype(np.float32)
        with torch.no_grad():
            expected = torch.nn.Sequential(*layers[:-1])(torch.tensor(observations)).clamp(-1, 1).numpy()
        np.testing.assert_allclose(bundle.act(observations), expected, rtol=0, atol=1e-6)


def test_they_are_compared_without_torch():
    code = (
        "import sys; from amulett_gym.cli import main; "
        "main(['evaluate', '--policies', 'eq6', 'pretrained', '--suite', 'mixed', '--episodes', '3', '--json']); "
        "assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["policies"]["pretrained"]["cost"]["mean"] > 0


def test_it_costs_less_than_what_was_tuned_by_hand():
    costs = evaluate(
        ["pretrained:testbed", "pretrained:device", "eq6-tuned", "constant:5.5"],
        suite="mixed",
        episodes=100,
        seed=5_000,
    ).values
    mean = {name: values["cost"].mean() for name, values in costs.items()}
    assert (
        max(mean["pretrained:testbed"], mean["pretrained:device"])
        < min(mean["eq6-tuned"], mean["constant:5.5"])
        < mean["eq6"]
    )


def test_an_environment_of_another_rate_is_refused_with_the_right_one():
    with pytest.raises(AmulettError, match=r"make it with agent_period=0\.02"):
        load_policy("pretrained", gym.make(ENV_IDS[0], agent_period=0.05))


@pytest.mark.parametrize("name", NAMES)
def test_its_card_says_what_its_bundle_says_and_more_limits(name):
    bundle = read_bundle(bundle_folder(name))
    generated = model_card(bundle.policy, bundle.env, bundle.provenance)
    assert bundle.card.startswith(generated.rstrip()) and len(bundle.card) > len(generated)
    assert f"{bundle.provenance['steps']:,} agent steps, seed {bundle.provenance['seed']}" in bundle.card
