"""PPO's throughput is measured beside that of the same PPO on a null environment."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
from stable_baselines3 import PPO

from amulett_agents import make_sb3_env
from amulett_agents.speed.throughput import ConstantVecEnv, ppo_throughput


def test_ppo_is_measured_beside_the_same_ppo_on_a_null_environment(recipe):
    turns = []
    found = ppo_throughput(recipe, turns=3, watch=lambda: turns.append(1))
    assert len(turns) == 3
    assert found["ratio_spread"][0] <= found["ratio"] <= found["ratio_spread"][1]
    assert min(found["env"], found["null"]) > 0


def test_a_steps_rollout_and_its_share_of_the_update_are_told_apart(recipe, clock):
    found = ppo_throughput(recipe, turns=2)
    # The clock is looked at before, at the rollout's beginning and end, and after: a second each time, 32 steps.
    expected = {"rollout": pytest.approx(1000 / 32), "update": pytest.approx(2000 / 32)}
    assert found["step_ms"] == {"env": expected, "null": expected}
    assert found["env"] == pytest.approx(8 * 32 / 3) and found["ratio"] == pytest.approx(1.0)


def test_the_null_environment_returns_constants(recipe):
    ours = make_sb3_env(num_envs=3)
    env = ConstantVecEnv(3, ours.observation_space, ours.action_space)
    first = env.reset().copy()
    for action in (-1.0, 1.0):
        observations, rewards, dones, infos = env.step(np.full((3, 1), action, dtype=np.float32))
        assert np.array_equal(observations, first) and not dones.any() and not any(infos)
        assert rewards.dtype == np.float32 and np.unique(rewards).size == 1
    assert env.observation_space.contains(first[0])
    PPO("MlpPolicy", env, n_steps=8, batch_size=24, n_epochs=1, device="cpu").learn(24)
