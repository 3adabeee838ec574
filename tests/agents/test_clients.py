"""Programs that nobody here wrote take the environments as they are: they wrap, record or train a few thousand steps.

Those of Gymnasium, Stable-Baselines3 and sb3-contrib, and a single-file PPO, are in CI. TorchRL, skrl, Tianshou, Minari
(with jax and h5py), IPython and the moviepy of RecordVideo are tested where they are installed; `docs/reliability.md`
names the versions.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers

import amulett_gym

pytestmark = pytest.mark.clients
SCALING, TENSION = amulett_gym.ENV_IDS[:2]
STEPS = 2_000


@pytest.fixture(autouse=True)
def one_thread():
    """Networks this small gain nothing from torch's threads."""
    try:
        import torch
    except ImportError:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def play(env: gym.Env, steps: int) -> list[dict]:
    """Act at random, over the ends of episodes; return the infos of their last steps."""
    env.reset(seed=0)
    env.action_space.seed(0)
    ends = []
    for _ in range(steps):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            ends.append(info)
            env.reset()
    return ends


def test_gymnasiums_wrappers_of_single_environments():
    env = gym.make(SCALING, max_episode_steps=None, disable_env_checker=True).unwrapped
    env = wrappers.TimeLimit(env, 100)
    env = wrappers.RecordEpisodeStatistics(env)
    env = wrappers.NormalizeReward(wrappers.NormalizeObservation(env))
    env = wrappers.FlattenObservation(wrappers.FrameStackObservation(env, 4))
    env = wrappers.ClipAction(wrappers.RescaleAction(env, np.float32(0.0), np.float32(1.0)))
    ends = play(env, STEPS)
    assert [info["episode"]["l"] for info in ends] == [100] * (STEPS // 100)
    observation, _ = env.reset()
    assert observation.shape == (4 * 13,) and env.observation_space.contains(observation)


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
def test_gymnasiums_wrappers_of_vector_environments(env_id):
    envs = gym.make_vec(env_id, num_envs=4, max_episode_steps=50)
    envs = vector_wrappers.RecordEpisodeStatistics(envs)
    envs = vector_wrappers.NormalizeReward(vector_wrappers.NormalizeObservation(envs))
    envs = vector_wrappers.ClipReward(vector_wrappers.RescaleAction(envs, np.float32(0.0), np.float32(1.0)), -5, 5)
    envs.reset(seed=0)
    lengths = []
    for _ in range(STEPS // 4):
        observations, rewards, *_, info = envs.step(envs.action_space.sample())
        assert np.isfinite(observations).all() and np.isfinite(rewards).all()
        lengths += info["episode"]["l"][info["_episode"]].tolist() if "episode" in info else []
    assert len(lengths) > 30 and set(lengths) == {50}


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_makes_vector_environments_of_single_ones(mode):
    envs = gym.make_vec(SCALING, num_envs=2, vectorization_mode=mode, max_episode_steps=30)
    envs.reset(seed=0)
    ended = [envs.step(envs.action_space.sample())[3] for _ in range(62)]
    envs.close()
    assert np.sum(ended, axis=0).tolist() == [2, 2]


def test_gymnasium_records_videos(tmp_path):
    pytest.importorskip("moviepy")
    env = wrappers.RecordVideo(gym.make(SCALING, render_mode="rgb_array", max_episode_steps=10), str(tmp_path))
    play(env, 20)
    env.close()
    assert all(video.stat().st_size > 1000 for video in tmp_path.glob("*.mp4")) and list(tmp_path.glob("*.mp4"))


@pytest.mark.parametrize("algorithm", ["PPO", "A2C", "SAC", "TD3"])
def test_stable_baselines3_trains(algorithm, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    chosen = {"PPO": {"n_steps": 256, "n_epochs": 2}, "A2C": {}, "SAC": {}, "TD3": {}}[algorithm]
    if algorithm in ("SAC", "TD3"):
        chosen = {"learning_starts": 100, "train_freq": 8, "batch_size": 64, "buffer_size": STEPS}
    learner = getattr(sb3, algorithm)
    env = gym.make(SCALING, max_episode_steps=100)
    model = learner("MlpPolicy", env, policy_kwargs={"net_arch": [16]}, seed=0, device="cpu", **chosen)
    before = [values.clone() for values in model.policy.parameters()]
    model.learn(STEPS)
    assert any((values != was).any() for values, was in zip(model.policy.parameters(), before, strict=True))
    assert len(model.ep_info_buffer) == model.num_timesteps // 100 >= STEPS // 100
    observation, _ = env.reset(seed=1)
    model.save(tmp_path / "model")
    again = learner.load(tmp_path / "model", device="cpu")
    assert again.predict(observation, deterministic=True)[0] == model.predict(observation, deterministic=True)[0]


def test_sb3_contribs_recurrent_ppo_trains_on_the_native_vector_environment():
    contrib = pytest.importorskip("sb3_contrib")
    agents = pytest.importorskip("amulett_agents")
    envs = agents.make_sb3_env(SCALING, num_envs=4, max_episode_steps=100)
    sizes = {"lstm_hidden_size": 8, "net_arch": [8]}
    model = contrib.RecurrentPPO(
        "MlpLstmPolicy", envs, n_steps=128, n_epochs=2, policy_kwargs=sizes, seed=0, device="cpu"
    )
    model.learn(STEPS)
    assert model.num_timesteps >= STEPS and len(model.ep_info_buffer) >= STEPS // 100 - 4


def test_a_single_file_ppo_trains():
    torch = pytest.importorskip("torch")
    from clients.single_file_ppo import train

    envs = gym.make_vec(f"amulett_gym:{TENSION}", num_envs=32, max_episode_steps=100)
    agent, learned = train(envs, 40_000)
    assert all(torch.isfinite(values).all() for values in agent.parameters())
    assert np.mean(learned[-8:]) > 0.5 * np.mean(learned[:8])  # what it pays has halved at least


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
def test_gymnasium_converts_all_of_a_step_to_torch(env_id):
    torch = pytest.importorskip("torch")
    pytest.importorskip("array_api_compat")
    envs = vector_wrappers.NumpyToTorch(gym.make_vec(env_id, num_envs=2))
    _, info = envs.reset(seed=0)
    *_, stepped = envs.step(torch.zeros(envs.action_space.shape))
    assert {type(value) for value in [*info.values(), *stepped.values()]} == {torch.Tensor}


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
def test_skrl_wraps_the_native_vector_environment(env_id):
    pytest.importorskip("skrl")
    import torch
    from skrl.envs.wrappers.torch import wrap_env

    env = wrap_env(gym.make_vec(env_id, num_envs=3, max_episode_steps=5))
    env.reset()
    for _ in range(7):
        observations, rewards, *_ = env.step(torch.zeros(3, *env.action_space.shape))
    assert observations.shape == (3, *env.observation_space.shape) and rewards.shape == (3, 1)


def test_tianshou_collects():
    pytest.importorskip("tianshou")
    from tianshou.algorithm.algorithm_base import RandomActionPolicy
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv

    envs = DummyVectorEnv([lambda: gym.make(SCALING, max_episode_steps=50)] * 2)
    buffer = VectorReplayBuffer(STEPS, 2)
    collector = Collector(RandomActionPolicy(gym.make(SCALING).action_space), envs, buffer)
    collector.reset()
    collected = collector.collect(n_step=400)
    assert collected.n_collected_episodes == 8 and (collected.lens == 50).all()
    assert np.isfinite(buffer.info.settling_time[: len(buffer)]).all()


def test_torchrls_gym_env_collects():
    pytest.importorskip("torchrl")
    from torchrl.envs import GymEnv, RewardSum, StepCounter, TransformedEnv
    from torchrl.envs.utils import check_env_specs

    env = TransformedEnv(GymEnv(SCALING, max_episode_steps=100))
    env.append_transform(RewardSum())
    env.append_transform(StepCounter())
    check_env_specs(env)
    data = env.rollout(STEPS, break_when_any_done=False)
    assert data.batch_size == (STEPS,) and data["next", "truncated"].sum() == STEPS // 100
    assert bool(data["observation"].isfinite().all())


@pytest.mark.parametrize("mode", ["Disabled", "SameStep"])
def test_torchrls_gym_wrapper_collects_from_the_native_vector_environment(mode):
    pytest.importorskip("torchrl")
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    env = GymWrapper(gym.make_vec(SCALING, num_envs=4, autoreset_mode=mode, max_episode_steps=50))
    check_env_specs(env)
    data = env.rollout(STEPS // 4, break_when_any_done=False)
    assert data.batch_size == (4, STEPS // 4) and data["next", "truncated"].sum() == STEPS // 50
    assert bool(data["next", "observation"].isfinite().all())


def test_torchrls_gym_env_collects_from_several():
    pytest.importorskip("torchrl")
    from torchrl.envs import GymEnv

    data = GymEnv(f"amulett_gym:{SCALING}", num_envs=2).rollout(20)
    assert data.batch_size == (2, 20) and bool(data["next", "reward"].isfinite().all())


def test_a_notebook_shows_a_picture():
    shell = pytest.importorskip("IPython.core.interactiveshell").InteractiveShell.instance()
    try:
        shell.run_cell("import importlib, amulett_gym; importlib.reload(amulett_gym)")
        display = shell.display_formatter
        display.active_types = ["text/plain", "image/png"]
        env = gym.make(SCALING)
        before, _ = display.format(env)
        assert before["image/png"][1:4] == b"PNG"
        with pytest.raises(gym.error.ResetNeeded):
            env.step([0.0])  # the picture is of another environment
        env.reset(seed=0)
        assert display.format(env)[0]["image/png"] == before["image/png"]
        assert "image/png" not in display.format(gym.make("CartPole-v1"))[0]
    finally:
        type(shell).clear_instance()


def test_minari_records_a_dataset_and_reads_it_back(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    for needed in ("h5py", "jax"):
        pytest.importorskip(needed)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    collector = minari.DataCollector(gym.make(f"amulett_gym:{SCALING}", max_episode_steps=100), record_infos=True)
    play(collector, STEPS)
    collector.create_dataset("amulett/random-v0", algorithm_name="random", author="nobody")
    dataset = minari.load_dataset("amulett/random-v0")
    assert dataset.total_episodes >= STEPS // 100 and dataset.total_steps == STEPS
    episode = next(dataset.iterate_episodes())
    assert episode.observations.shape == (101, 13)
    env = dataset.recover_environment()
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation, episode.observations[0])
    for action, expected in zip(episode.actions, episode.rewards, strict=True):
        assert env.step(action)[1] == expected


SCRIPTS = Path(__file__).parents[1] / "clients"


def test_a_search_with_gymnasium_alone_learns():
    found = subprocess.run([sys.executable, SCRIPTS / "gymnasium_search.py", "160000"], capture_output=True, text=True)
    result = json.loads(found.stdout)
    assert result["steps"] == 160_000 and result["after"] > result["before"] + 0.03


def test_every_script_has_a_row_in_the_table():
    listed = set(re.findall(r"tests/clients/(\w+)\.py\)", (SCRIPTS.parents[1] / "docs" / "clients.md").read_text()))
    assert listed == {path.stem for path in SCRIPTS.glob("*.py")} - {"judging", "single_file_ppo"}
