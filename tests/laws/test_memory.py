"""What a policy remembers of an episode."""

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import ENV_IDS
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.memory import MEMORY, NAMES, SPANS, ClockedMemory, Memory, _quantities

COUNT = len(NAMES)


def rows_of(steps, devices, seed=0):
    rows = np.random.default_rng(seed).uniform(-0.5, 0.5, (steps, devices, len(OBSERVATIONS)))
    rows[..., OBSERVATIONS.index("agonist")] = np.where(rows[..., OBSERVATIONS.index("agonist")] > 0, 1.0, -1.0)
    return rows


def test_it_is_the_mean_of_all_steps_then_an_exponential_one():
    rows, memory = rows_of(80, 1), Memory(1)
    befores = np.concatenate([rows[:1], rows[:-1]])
    values = np.array([list(_quantities(*pair).values()) for pair in zip(rows, befores, strict=True)])[..., 0]
    short, long = values[0], values[0]
    for step, row in enumerate(rows):
        share = 1.0 / min(step + 1, SPANS[0])
        short = short + share * (values[step] - short)
        found = memory.add(row)[0]
        np.testing.assert_allclose(found[:COUNT], short, rtol=0, atol=1e-12)
        long = values[: step + 1].mean(axis=0)
        np.testing.assert_allclose(found[COUNT:], long, rtol=0, atol=1e-12)
    assert len(found) == len(MEMORY)
    assert np.abs(short - long).max() > 0.01


def test_the_first_observation_holds_no_change_whatever_was_before():
    rows, memory = rows_of(4, 3), Memory(3)
    for row in rows[:3]:
        memory.add(row)
    memory.forget(np.array([1]))
    again = memory.add(rows[3][[1, 2]], np.array([1, 2]))
    assert np.array_equal(again[0], Memory(1).add(rows[3][1:2])[0])
    assert not again[0][[NAMES.index(name) for name in ("jolt", "agonist_effort", "antagonist_answer")]].any()
    assert again[1][NAMES.index("antagonist_effort")] > 0.0


def test_both_sides_are_alike():
    """Mirrored: setpoint, arm and strings the other way round."""
    rows = rows_of(30, 2)
    mirrored = rows.copy()
    for name in ("position_error", "joint_angle", "joint_velocity", "setpoint", "agonist"):
        mirrored[..., OBSERVATIONS.index(name)] *= -1.0
    for name in ("estimated_tension", "spring_deflection", "command"):
        pair = [OBSERVATIONS.index(f"{name}_{side}") for side in ("biceps", "triceps")]
        mirrored[..., pair] = rows[..., pair[::-1]]
    memories = Memory(2), Memory(2)
    for pair in zip(rows, mirrored, strict=True):
        one, other = (memory.add(row) for memory, row in zip(memories, pair, strict=True))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_it_follows_the_environments_clock():
    env = gym.make_vec(ENV_IDS[0], num_envs=3, max_episode_steps=5)
    clocked, fresh = ClockedMemory(env), Memory(3)
    observations, _ = env.reset(seed=0)
    for step in range(13):
        if step in (0, 6, 12):  # episodes begin
            fresh.forget(slice(None))
        expected = fresh.add(observations)
        for _ in range(2):  # asking twice changes nothing
            assert np.array_equal(clocked.add(observations), expected)
        observations, *_ = env.step(np.full((3, 1), -0.3))
    assert np.abs(expected).max() <= 1.0


def test_it_needs_the_observations_of_all_devices():
    with pytest.raises(AmulettError, match=r"shape \(2, 13\).*memory.*\(3, 13\)"):
        ClockedMemory(gym.make_vec(ENV_IDS[0], num_envs=3)).add(np.zeros((2, 13)))
