"""Policies that see the last observations: the same stack in training, in validation and in numpy."""

import itertools
import json

import gymnasium as gym
import numpy as np
import pytest
from helpers import keep_network

import amulett_gym
from amulett_gym.envs.privileged import PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.runner import evaluate as compare
from amulett_gym.laws.bundle import PolicyDescription, read_bundle
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.laws.history import History

SCALING, TENSION = amulett_gym.ENV_IDS[:2]
SIZE = len(OBSERVATIONS)
FAILS = {"profile": {"base": "testbed", "plant": {"velocity_limit_deg": 80.0}}}


def keep(folder, history=3, privileged=False, seed=0):
    """Write a bundle of random weights."""
    names = OBSERVATIONS + PRIVILEGED if privileged else OBSERVATIONS
    scales = {**OBSERVATION_SCALES, **(PRIVILEGED_SCALES if privileged else {})}
    generator = np.random.default_rng(seed)
    sizes = [history * len(names), 8, 1]
    layers = [
        (generator.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32), np.zeros(outputs, np.float32))
        for inputs, outputs in itertools.pairwise(sizes)
    ]
    seen = {"observations": list(names), "observation_scales": scales, "history": history}
    return keep_network(folder, layers, output="tanh", **seen)


# --- the stack


@pytest.mark.parametrize("keywords", [{"max_episode_steps": 7}, FAILS])
def test_it_is_the_last_observations_of_the_present_episode(keywords):
    env = gym.make_vec(SCALING, num_envs=4, **keywords)
    history = History(env, 3, SIZE)
    observations, _ = env.reset(seed=0)
    lists = [[one] for one in observations]
    begun, actions = 0, np.random.default_rng(0).uniform(-1, 1, (150, 4, 1))
    for k in range(150):
        expected = [np.concatenate([np.zeros(SIZE)] * max(3 - len(seen), 0) + seen[-3:]) for seen in lists]
        ended = env.unwrapped._ended.copy()
        for _ in range(2):  # asking twice changes nothing; nobody acts on what is seen last
            assert np.array_equal(history.add(observations)[~ended], np.array(expected)[~ended])
        observations, *_ = env.step(actions[k])
        for device, one in enumerate(observations):
            lists[device] = [one] if ended[device] else [*lists[device], one]
            begun += ended[device]
    assert begun >= 4


def test_a_mask_makes_some_devices_forget():
    env = gym.make_vec(SCALING, num_envs=3)
    history = History(env, 2, SIZE)
    observations, _ = env.reset(seed=0)
    history.add(observations)
    observations, *_ = env.step(np.zeros((3, 1)))
    history.add(observations)
    observations, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    seen = history.add(observations)
    assert np.array_equal(np.abs(seen[:, :SIZE]).sum(axis=1) > 0, [True, False, True])


def test_it_needs_the_observations_of_all_devices():
    with pytest.raises(AmulettError, match=r"shape \(2, 13\).*\(3, 13\)"):
        History(gym.make_vec(SCALING, num_envs=3), 2, SIZE).add(np.zeros((2, SIZE)))


# --- policies


def test_a_batch_acts_like_single_devices(tmp_path):
    folder = keep(tmp_path / "bundle")
    vector, singles = gym.make_vec(SCALING, num_envs=3), [gym.make(SCALING) for _ in range(3)]
    policy, policies = (
        amulett_gym.load_policy(folder, vector),
        [amulett_gym.load_policy(folder, env) for env in singles],
    )
    observations, _ = vector.reset(seed=0)
    rows = [env.reset(seed=k)[0] for k, env in enumerate(singles)]
    for _ in range(20):
        actions = policy(observations)
        single = [act(row) for act, row in zip(policies, rows, strict=True)]
        assert np.array_equal(actions, single)
        observations, *_ = vector.step(actions)
        rows = [env.step(action)[0] for env, action in zip(singles, single, strict=True)]


def test_it_acts_alike_wherever_it_is_played(tmp_path):
    folder = keep(tmp_path / "bundle")
    results = compare([str(folder)], episodes=3, duration=3.0)
    episode = record_episode(str(folder), Protocol(results.protocol.profile, duration=3.0))
    for metric in ("position_ise", "isav_biceps", "effort_triceps"):
        assert episode.metrics[metric] == results.values[str(folder)][metric][0]


def test_it_means_the_same_tensions_in_another_range(tmp_path):
    folder = keep(tmp_path / "bundle")
    chosen = []
    for keywords in ({}, {"tension_range": (3.0, 20.0)}):
        env = gym.make(TENSION, **keywords)
        policy = amulett_gym.load_policy(folder, env)
        observation, _ = env.reset(seed=0)
        for _ in range(30):
            observation, *_, info = env.step(policy(observation))
        chosen.append(info["tension_setpoint"])
    assert chosen[0] == pytest.approx(chosen[1], abs=1e-3)


def test_bundles_from_before_there_was_a_history_are_read(tmp_path):
    policy = read_bundle(keep(tmp_path / "bundle", history=1)).policy
    content = json.loads(policy.model_dump_json())
    del content["history"]
    assert PolicyDescription.model_validate(content) == policy


def test_a_wrong_length_is_refused(tmp_path):
    content = read_bundle(keep(tmp_path / "bundle")).policy.model_dump()
    for history, message in ((2, "2 times the 13 observations"), (0, "greater than or equal to 1")):
        with pytest.raises(ValueError, match=message):
            PolicyDescription.model_validate({**content, "history": history})


def test_a_policy_that_has_to_be_told_brings_its_keyword_and_is_refused_elsewhere(tmp_path):
    folder = keep(tmp_path / "bundle", history=2, privileged=True)
    contender = parse_contender(str(folder))
    assert contender.env_keywords == {"agent_period": 0.02, "privileged": True}
    with pytest.raises(AmulettError, match="privileged observations.*privileged=True"):
        amulett_gym.load_policy(folder, gym.make(SCALING))
    results = compare([str(folder)], episodes=2, duration=1.0)
    assert np.isfinite(results.values[str(folder)]["cost"]).all()


def test_other_policies_act_in_a_privileged_environment_as_they_do_elsewhere(tmp_path):
    folder = str(keep(tmp_path / "bundle"))
    for name in ("constant:7", "eq6-held", "parametric", folder):
        plain, told = gym.make(SCALING), gym.make(SCALING, privileged=True)
        policies = [amulett_gym.load_policy(name, env) for env in (plain, told)]
        rows = [env.reset(seed=0)[0] for env in (plain, told)]
        for _ in range(5):
            actions = [policy(row) for policy, row in zip(policies, rows, strict=True)]
            assert np.array_equal(*actions)
            rows = [env.step(action)[0] for env, action in zip((plain, told), actions, strict=True)]


# --- training


@pytest.fixture
def one_thread():
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("keywords", [{"max_episode_steps": 7, "privileged": True}, FAILS])
def test_numpy_torch_and_the_training_see_and_do_the_same(keywords, tmp_path, one_thread):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecFrameStack

    from amulett_agents import make_sb3_env, save_policy

    adapter = make_sb3_env(num_envs=4, **keywords)
    env = VecFrameStack(adapter, 3)
    settings = {"n_steps": 8, "batch_size": 32, "n_epochs": 2, "learning_rate": 0.01, "seed": 0, "device": "cpu"}
    model = PPO("MlpPolicy", env, **settings).learn(400)
    folder = save_policy(model, tmp_path / "bundle")
    assert read_bundle(folder).policy.history == 3
    policy = amulett_gym.load_policy(folder, adapter.venv)
    history = History(adapter.venv, 3, adapter.observation_space.shape[0])
    size = adapter.observation_space.shape[0]
    env.seed(1)
    stacked, endings = env.reset(), 0
    for _ in range(150):
        newest = stacked[:, -size:]
        assert np.array_equal(history.add(newest), stacked)
        actions, _ = model.predict(stacked, deterministic=True)
        np.testing.assert_allclose(policy(newest), actions, rtol=0, atol=1e-6)
        before = stacked.copy()
        stacked, _, dones, infos = env.step(actions)
        for device in np.flatnonzero(dones):
            last = infos[device]["terminal_observation"]
            assert np.array_equal(last[:-size], before[device, size:])
            assert not stacked[device, :-size].any()
            endings += 1
    assert endings >= 4


def test_a_recipe_with_history_is_trained_validated_and_evaluated(tmp_path, one_thread):
    from amulett_agents import load_train_config, train

    config = load_train_config(
        None,
        [
            "env.history=3",
            "env.privileged=true",
            "env.suite=mixed",
            "env.agent_period=0.02",
            "env.max_episode_steps=75",
            "num_envs=16",
            "total_steps=1000",
            "network.hidden=[16]",
            "ppo.n_steps=32",
            "ppo.batch_size=128",
            "validation.episodes=10",
        ],
    )
    result = train(config, tmp_path / "run", progress=False)
    bundle = read_bundle(result.last)
    assert (bundle.policy.history, bundle.policy.is_privileged) == (3, True)
    keywords = {"suite": "mixed", "privileged": True, "split": "validation", "max_episode_steps": 75}
    keywords["tension_range"] = config.env.tension_range  # nothing has to be converted
    env = gym.make_vec(SCALING, num_envs=10, **keywords)
    policy, total = amulett_gym.load_policy(result.last, env), 0.0
    observations, _ = env.reset(seed=config.validation.seed)
    for _ in range(75):
        observations, rewards, *_ = env.step(policy(observations))
        total -= rewards.mean()
    assert total == pytest.approx(result.last_cost, rel=1e-9)
    results = compare([str(tmp_path / "run")], suite="mixed", episodes=2, duration=1.0)
    assert np.isfinite(results.values[str(tmp_path / "run")]["cost"]).all()


def test_wrappers_that_change_what_is_seen_cannot_be_kept(tmp_path, one_thread):
    from stable_baselines3 import PPO

    from amulett_agents import save_policy

    env = gym.wrappers.FlattenObservation(gym.wrappers.FrameStackObservation(gym.make(SCALING), 2))
    model = PPO("MlpPolicy", env, n_steps=4, batch_size=4, device="cpu")
    with pytest.raises(AmulettError, match="has 26 inputs, its environment 1 times 13"):
        save_policy(model, tmp_path / "bundle")
