"""Gymnasium's three ways to begin the next episode, against its own vector environment of single ones."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode

import amulett_gym
from amulett_gym.errors import AmulettError

SCALING = amulett_gym.ENV_IDS[0]
COUNT = 3
PUSHED = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
"""A scenario that fails in about 15 steps."""


def pair(mode, env_id=SCALING, **keywords):
    """Return the native environment and Gymnasium's."""
    native = gym.make_vec(env_id, COUNT, autoreset_mode=mode, **keywords)
    return native, gym.make_vec(
        env_id, COUNT, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **keywords
    )


def same(native, other):
    """Return whether all that two resets or steps return is equal; the native arrays may be read-only or strided."""
    infos = native[-1], other[-1]
    assert infos[0].keys() == infos[1].keys()
    parts = zip(native[:-1], other[:-1], strict=True)
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in parts) and data_equivalence(
        {key: infos[0][key] for key in infos[1]}, infos[1], exact=True
    )


def fail_one(*envs):
    """Let the device 1 of each environment begin an episode that fails; return what they return."""
    chosen = np.array([False, True, False])
    return [env.reset(seed=[None, 3, None], options={"scenario": PUSHED, "reset_mask": chosen.copy()}) for env in envs]


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_each_mode_gives_what_gymnasiums_own_vector_environment_gives(mode, env_id):
    envs = pair(mode, env_id, max_episode_steps=20)
    assert [env.metadata["autoreset_mode"] for env in envs] == [env.autoreset_mode for env in envs] == [mode] * 2
    assert same(*(env.reset(seed=8) for env in envs))
    assert same(*fail_one(*envs))
    actions = np.random.default_rng(0).uniform(-1, 1, (60, *envs[0].action_space.shape)).astype(np.float32)
    ends = np.zeros(2, dtype=int)
    for action in actions:
        native, other = (env.step(action) for env in envs)
        assert same(native, other)
        ended = native[2] | native[3]
        ends += native[2].sum(), native[3].sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            assert same(*(env.reset(options={"reset_mask": ended.copy()}) for env in envs))
    assert (ends >= (1, 4)).all()  # failures, and truncations


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_failure_in_the_last_step_is_terminated_and_truncated(mode):
    single = gym.make(SCALING)
    single.reset(seed=0, options={"scenario": PUSHED})
    steps = 1
    while not single.step([0.0])[2]:
        steps += 1
    envs = pair(mode, max_episode_steps=steps)
    for env in envs:
        env.reset(seed=0, options={"scenario": PUSHED})
    for _ in range(steps):
        native, other = (env.step(np.zeros((COUNT, 1), dtype=np.float32)) for env in envs)
    assert same(native, other)
    assert native[2].all() and native[3].all()


def test_the_last_observation_and_info_of_an_episode_are_those_before_its_reset():
    envs = [gym.make_vec(SCALING, 2, autoreset_mode=mode, max_episode_steps=3) for mode in ("SameStep", "NextStep")]
    for env in envs:
        env.reset(seed=0)
    for _ in range(3):
        same_step, next_step = (env.step(np.zeros((2, 1))) for env in envs)
    assert np.array_equal(np.stack(same_step[4]["final_obs"]), next_step[0])
    assert same_step[4]["time"].tolist() == [0.0, 0.0]
    assert same_step[4]["final_info"]["time"] == pytest.approx([0.06, 0.06])
    begun = envs[1].step(np.zeros((2, 1)))
    assert np.array_equal(same_step[0], begun[0])
    assert "final_obs" not in envs[0].step(np.zeros((2, 1)))[4]


def test_without_autoreset_an_ended_device_is_not_stepped():
    env = gym.make_vec(SCALING, 2, autoreset_mode="Disabled", max_episode_steps=2)
    env.reset(seed=0)
    env.step(np.zeros((2, 1)))
    *_, truncated, _ = env.step(np.zeros((2, 1)))
    assert truncated.all()
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gym.error.ResetNeeded, match=r"the episode of device 1 has ended \(1 in all\): call reset"):
        env.step(np.zeros((2, 1)))
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(np.zeros((2, 1)))


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, "SameStep", "SAME_STEP"])
def test_a_mode_is_gymnasiums_or_its_name(mode):
    env = gym.make_vec(SCALING, autoreset_mode=mode)
    assert env.autoreset_mode is env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_an_unknown_mode_is_refused():
    with pytest.raises(AmulettError, match="unknown autoreset_mode 'SamStep'; .* did you mean 'SameStep'"):
        gym.make_vec(SCALING, autoreset_mode="SamStep")


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_frames_are_collected_as_in_gymnasium(mode):
    envs = pair(mode, max_episode_steps=4, render_mode="rgb_array_list")
    for env in envs:
        env.reset(seed=0)
    for step in range(7):
        for env in envs:
            env.step(np.zeros((COUNT, 1), dtype=np.float32))
        if step in (1, 2, 6):
            native, other = (env.render() for env in envs)
            assert [len(frames) for frames in native] == [len(frames) for frames in other]
            assert np.array_equal(native, other)
    assert envs[0].render() == ([],) * COUNT


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, "SameStep"])
def test_how_an_environment_was_made_can_be_written_as_json(mode):
    env = gym.make_vec("Amulett/Scaling-v0", 3, autoreset_mode=mode)
    again = gym.make_vec(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.autoreset_mode is env.autoreset_mode is AutoresetMode.SAME_STEP
    assert again.num_envs == 3
