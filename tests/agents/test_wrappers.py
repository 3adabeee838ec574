"""What a learner sees and does in training is what its bundle sees and does; and episodes begin one after the other."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from gymnasium.envs.classic_control import PendulumEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, unwrap_vec_wrapper

from amulett_agents import load_train_config, make_sb3_env, recipe_view, save_policy, train
from amulett_agents.adapter import SB3VecEnv
from amulett_agents.bundles import describe_policy
from amulett_agents.model import make_model
from amulett_agents.validation import torch_threads
from amulett_agents.wrappers import ActorView, Staggered, native_view
from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.studies.benchmark.frozen import seed_overlap

SMALL = ["num_envs=12", "env.max_episode_steps=40", "ppo.n_steps=16", "ppo.batch_size=64", "network.hidden=[16]"]


@pytest.fixture(autouse=True)
def one_thread():
    with torch_threads(1):
        yield


def adapter_of(env):
    while not isinstance(env, SB3VecEnv):
        env = env.venv
    return env


def spy(monkeypatch, owner, method):
    """Return a list of the first arguments that a method is called with from now on."""
    calls, original = [], getattr(owner, method)

    def record(first, *others):
        calls.append(first)
        return original(first, *others)

    monkeypatch.setattr(owner, method, record)
    return calls


@pytest.mark.parametrize(
    "recipe",
    [
        [],  # its critic sees more
        ["env.history=3"],
        ["env.history=3", "env.privileged=true"],
        ["ppo.privileged_critic=false", "network.standard_inputs=false"],
        ["network.memory=true", "env.max_episode_steps=25"],
        ["network.memory=true", "network.features=false", "env.history=2", "ppo.privileged_critic=false"],
        ["env.follow_time=0", "network.features=false"],
        ["algorithm=sac", "env.history=2", "env.tension_range=[5.0, 9.0]"],
    ],
)
def test_a_policy_acts_from_its_bundle_as_it_did_in_training(recipe, monkeypatch):
    model = make_model(load_train_config(None, [*SMALL, *recipe]))
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for weights in model.policy.parameters():
            weights.copy_(0.2 * torch.randn(weights.shape, generator=generator))
    env = model.get_env()
    adapter, view = adapter_of(env), unwrap_vec_wrapper(env, ActorView)
    actor = Actor(*describe_policy(model), adapter.venv)
    shown, done = spy(monkeypatch, view, "_show"), spy(monkeypatch, adapter, "step_async")
    observations, expected = env.reset(), []
    done.clear()  # of what staggers the episodes
    for _ in range(60):
        expected.append(actor(shown[-1]))
        actions, _ = model.predict(observations, deterministic=True)
        observations, *_ = env.step(actions)
    assert np.ptp(done) > 0.1
    np.testing.assert_allclose(np.array(expected), np.array(done), rtol=0, atol=5e-6)


def test_staggered_episodes_end_one_after_the_other_and_none_lasts_longer():
    env = Staggered(make_sb3_env(num_envs=12, suite="mixed", max_episode_steps=40), 0.0, 40)
    env.seed(0)
    first = env.reset()
    ended, lengths = [], []
    for step in range(120):
        _, _, dones, infos = env.step(np.zeros((12, 1), np.float32))
        ended += [(step, device) for device in np.flatnonzero(dones)]
        lengths += [infos[device]["episode"]["l"] for device in np.flatnonzero(dones)]
    assert lengths == [40] * 36
    assert max(sum(step == at for at, _ in ended) for step in range(120)) == 1
    again = Staggered(make_sb3_env(num_envs=12, suite="mixed", max_episode_steps=40), 0.0, 40)
    again.seed(0)
    assert np.array_equal(again.reset(), first)
    again.seed(12)
    assert not np.isclose(again.reset(), first).all(axis=1).any()


def test_training_seeds_share_no_scenario():
    config = load_train_config(None, [*SMALL, "total_steps=480"])
    alone = seed_overlap([config], seed=0, episodes=1)["train"]
    both = seed_overlap([config, config.model_copy(update={"seed": 1})], seed=0, episodes=1)["train"]
    assert both == 2 * alone


def test_both_kinds_of_action_are_learned_alike(tmp_path):
    """So one training gives the weights of both policies that come with the package."""
    kept = []
    for env_id in ENV_IDS[:2]:
        short = ["total_steps=768", "ppo.n_epochs=2", "validation.episodes=4", f"env.id={env_id}"]
        result = train(load_train_config(None, [*SMALL, *short]), tmp_path / env_id, progress=False)
        kept.append([array for layer in read_bundle(result.last).layers for array in layer])
    assert all(np.array_equal(a, b) for a, b in zip(*kept, strict=True))


@pytest.mark.parametrize("vector", [True, False])
def test_what_is_learned_in_a_recipes_view_acts_alike_from_its_bundle(vector, tmp_path):
    native = make_sb3_env(ENV_IDS[1], num_envs=2, tension_range=(4.0, 8.0))
    single = DummyVecEnv([lambda: gym.make(ENV_IDS[1], tension_range=(4.0, 8.0)) for _ in range(2)])
    view = recipe_view(native if vector else single, follow_time=0.04)
    model = PPO("MlpPolicy", view, n_steps=32, batch_size=64, learning_rate=0.01, seed=0, device="cpu").learn(64)
    bundle = read_bundle(save_policy(model, tmp_path / "bundle"))
    assert (bundle.policy.follow, bundle.policy.tension_range) == (0.5, [4.0, 8.0])
    assert bundle.policy.features
    env = gym.make_vec(ENV_IDS[1], num_envs=2, tension_range=(4.0, 8.0))
    view.seed(3)
    seen, (observations, _) = view.reset(), env.reset(seed=3)
    actor = Actor(bundle.layers, bundle.policy, env)
    for _ in range(20):
        np.testing.assert_allclose(actor.inputs(observations), seen, rtol=0, atol=1e-6)
        seen, rewards, *_ = view.step(model.predict(seen, deterministic=True)[0])
        observations, expected, *_ = env.step(actor(observations))
        np.testing.assert_allclose(rewards, expected, rtol=1e-4, atol=1e-6)


def test_a_recipes_view_refuses_what_it_is_not_for():
    with pytest.raises(AmulettError, match="configs/drives.yaml"):
        recipe_view(make_sb3_env(DRIVES_ID))
    with pytest.raises(AmulettError, match="follow_time is -1"):
        recipe_view(make_sb3_env(), follow_time=-1.0)
    with pytest.raises(AmulettError, match="for AMULETT environments"):
        recipe_view(make_vec_env("Pendulum-v1"))


@pytest.mark.parametrize("steps", [15, None])
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_native_devices_are_those_of_single_environments(env_id, steps):
    def singles():
        keywords = {"suite": "mixed"} if env_id != WORN_ID else {}
        return make_vec_env(env_id, 3, seed=7, env_kwargs=keywords | {"max_episode_steps": steps})

    alone, together = singles(), native_view(singles())
    assert isinstance(together, SB3VecEnv)
    np.testing.assert_array_equal(together.reset(), alone.reset())
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 3, *alone.action_space.shape)).astype(np.float32)
    for action in actions:
        for found, expected in zip(together.step(action)[:3], alone.step(action)[:3], strict=True):
            np.testing.assert_array_equal(found, expected)
    assert together.get_attr("settings")[0].given.items() >= alone.get_attr("settings")[0].given.items()


def test_native_leaves_windows_and_refuses_other_environments():
    window = make_vec_env(ENV_IDS[0], 1, env_kwargs={"render_mode": "human"})
    assert native_view(window) is window
    window.close()
    for view in (native_view, recipe_view):
        with pytest.raises(AmulettError, match=f"^{view.__name__} is for .*Tension-v0, not for 'Pendulum-v1'$"):
            view(make_vec_env("Pendulum-v1", 2))
        with pytest.raises(AmulettError, match="not for an environment without an id$"):
            view(DummyVecEnv([PendulumEnv]))
        with pytest.raises(AmulettError, match=f"^{view.__name__} takes a VecEnv .*, not a PendulumEnv: make one with"):
            view(PendulumEnv())
