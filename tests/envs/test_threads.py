"""Several threads step the devices faster where cores are free, and never otherwise."""

import copy
import os
import pickle
import signal
import threading
import time

import gymnasium as gym
import numba
import numpy as np
import pytest
from helpers import wait_until

import amulett_gym  # noqa: F401
from amulett_gym.envs import shared_step, transition
from amulett_gym.envs.shares import AWAKE
from amulett_gym.errors import AmulettError
from amulett_gym.simulation.layout import LANES

SCALING = "Amulett/Scaling-v0"


def play(vector, steps, seed):
    vector.reset(seed=seed)
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, vector.num_envs, 1))
    return [go(vector, action) for action in actions]


def go(vector, action):
    observations, rewards, terminated, truncated, info = vector.step(action)
    return [observations, rewards, terminated, truncated, *info.values()]


def assert_same(ours, theirs):
    for one, other in zip(ours, theirs, strict=True):
        for values, others in zip(one, other, strict=True):
            np.testing.assert_array_equal(values, others)


@pytest.mark.parametrize("devices", [1, LANES - 1, LANES + 1, 5 * LANES + 3, 67 * LANES + 1])
@pytest.mark.parametrize("threads", [2, 3, 8])
def test_any_number_of_threads_gives_the_same_bits(devices, threads):
    keywords = {"num_envs": devices, "max_episode_steps": 30}
    alone, together = gym.make_vec(SCALING, **keywords), gym.make_vec(SCALING, threads=threads, **keywords)
    assert_same(play(alone, 40, seed=3), play(together, 40, seed=3))  # an episode's end is among these steps


def test_a_wrong_action_stops_all_threads_before_anything_is_done():
    vector = gym.make_vec(SCALING, num_envs=4 * LANES, threads=2)
    vector.reset(seed=0)
    before = vector.unwrapped.get_state()["episodes"]["simulation"]["states"]
    actions = np.zeros((4 * LANES, 1))
    actions[3 * LANES] = np.nan
    with pytest.raises(AmulettError, match=f"the action of device {3 * LANES} is NaN"):
        vector.step(actions)
    assert vector.unwrapped.get_state()["episodes"]["simulation"]["states"].tobytes() == before.tobytes()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda vector: pickle.loads(pickle.dumps(vector))])
def test_a_copy_in_mid_episode_goes_on_alike(duplicate):
    vector = gym.make_vec(SCALING, num_envs=3 * LANES, threads=2)
    play(vector, 5, seed=1)
    other = duplicate(vector)
    action = np.full((3 * LANES, 1), 0.3)
    assert_same([go(vector, action)], [go(other, action)])


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="one thread does all")
def test_close_ends_the_threads():
    def ours():
        return {thread for thread in threading.enumerate() if thread.name.startswith("amulett-gym")}

    before = ours()
    vector = gym.make_vec(SCALING, num_envs=4 * LANES, threads=3)
    play(vector, 1, seed=0)
    assert ours() - before  # environments of other tests may be collected meanwhile, and their threads end
    vector.close()
    assert not ours() - before
    play(vector, 1, seed=0)
    assert ours() - before
    vector.close()


def test_after_an_error_in_a_step_an_environment_plays_as_before():
    vector = gym.make_vec(SCALING, num_envs=3 * LANES, threads=2)
    play(vector, 2, seed=0)
    episodes = vector.unwrapped.episodes

    def fail(*given):
        raise ValueError("no")

    step, episodes._step = episodes._step, fail
    with pytest.raises(ValueError, match="no"):
        vector.step(np.zeros((3 * LANES, 1)))
    assert episodes._step is fail  # kept, with its threads
    episodes._step = step
    alone = gym.make_vec(SCALING, num_envs=3 * LANES)
    assert_same(play(alone, 3, seed=1), play(vector, 3, seed=1))


def test_a_step_amid_another_has_threads_of_its_own():
    vector = gym.make_vec(SCALING, num_envs=3 * LANES, threads=2)
    play(vector, 1, seed=0)
    episodes, actions = vector.unwrapped.episodes, np.zeros(3 * LANES)
    outer, inner = episodes._step, []

    def step(*given):
        episodes.step(actions)  # as a signal's handler or another thread may do
        inner.append(episodes._step)
        return outer(*given)

    episodes._step = step
    episodes.step(actions)
    assert inner[0] not in (None, outer, step)
    assert episodes._step is step


def test_a_reset_amid_a_step_is_not_forgotten():
    vectors = [gym.make_vec(SCALING, num_envs=3 * LANES, threads=threads) for threads in (1, 2)]
    path = {"setpoint": {"time": [0.0, 1.0], "angle_deg": [10.0, 20.0]}, "initial_angle_deg": 10.0}
    for vector in vectors:
        play(vector, 1, seed=0)
        episodes, actions = vector.unwrapped.episodes, np.zeros(3 * LANES)
        outer = episodes._step

        def step(*given, episodes=episodes, actions=actions, outer=outer):
            wrong = outer(*given)
            episodes.start(np.arange(3 * LANES), [path] * 3 * LANES)
            episodes.step(actions)
            return wrong

        episodes._step = step
        episodes.step(actions)
    alone, together = ([go(vector, np.zeros((3 * LANES, 1))) for _ in range(20)] for vector in vectors)
    assert_same(alone, together)


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2"])
def test_a_wrong_number_of_threads_is_refused(threads):
    with pytest.raises(AmulettError, match="'threads' is"):
        gym.make_vec(SCALING, num_envs=4, threads=threads)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_starts_threads_of_its_own():
    vector = gym.make_vec(SCALING, num_envs=2 * LANES, threads=2)
    play(vector, 2, seed=0)
    action = np.zeros((2 * LANES, 1))
    child = os.fork()
    if child == 0:
        vector.step(action)
        started = sum(thread.name.startswith("amulett-gym") for thread in threading.enumerate())
        os._exit(7 if started or numba.config.DISABLE_JIT else 8)
    for _ in range(600):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.05)
    else:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        pytest.fail("the forked process hangs")
    assert os.waitstatus_to_exitcode(status) == 7


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="one thread does all")
def test_a_reset_without_a_path_keeps_the_threads_though_another_device_has_one():
    vector = gym.make_vec(SCALING, num_envs=4 * LANES, threads=2)
    play(vector, 1, seed=0)
    episodes, device = vector.unwrapped.episodes, np.arange(1)
    episodes.start(device, [{"setpoint": {"time": [0.0, 1.0], "angle_deg": [10.0, 20.0]}, "initial_angle_deg": 10.0}])
    steps = []
    for reset in (device + 1, device + 20, device):
        episodes.step(np.zeros(4 * LANES))
        steps.append(episodes._step)
        episodes.start(reset)
    episodes.step(np.zeros(4 * LANES))
    assert steps[0] is steps[1] is steps[2] is not episodes._step
    assert episodes.simulation.paths is None


def test_actions_of_any_memory_layout_do_the_same_by_the_same_code():
    wide = np.linspace(-0.9, 0.9, 12).reshape(4, 3)
    read_only = np.full((4, 1), 0.5)
    read_only.flags.writeable = False
    known = 0
    for actions in (
        wide[:, :1].copy(),
        wide[:, 1:2],
        wide[::-1, :1],
        read_only,
        wide[:, :1].astype(">f8"),
        wide[:, :1] > 0,
    ):
        found = []
        for given in (actions, np.array(actions, dtype=np.float64, order="C")):
            vector = gym.make_vec(SCALING, num_envs=4)
            vector.reset(seed=0)
            first = vector.step(given)[0]
            found.append((first, *vector.unwrapped.episodes.step(given[:, 0])))
        for one, other in zip(*found, strict=True):
            np.testing.assert_array_equal(one, other)
        known = known or len(transition.step.signatures)
    assert len(transition.step.signatures) == known


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs the compiler")
@pytest.mark.parametrize("env_id", [SCALING, "Amulett/Drives-v0", "Amulett/Worn-v0"])
def test_threads_that_stay_awake_take_shares_of_the_next_step(env_id, monkeypatch):
    monkeypatch.setattr(shared_step, "LOOKS", 10**9)
    alone, together = (gym.make_vec(env_id, num_envs=40 * LANES, threads=threads) for threads in (1, 3))
    actions = np.random.default_rng(0).uniform(-1, 1, (20, *alone.action_space.shape))
    for vector in (alone, together):
        vector.reset(seed=0)
    assert_same([go(alone, actions[0])], [go(together, actions[0])])
    turns = together.unwrapped.episodes._step._turns
    wait_until(lambda: turns[AWAKE, 0] == 2)
    for action in actions:
        assert_same([go(alone, action)], [go(together, action)])
    assert turns[AWAKE, 0] == 2
    together.close()
    assert turns[AWAKE, 0] == 0
