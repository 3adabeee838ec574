"""The same seed gives the same bits: in any process, batch and number of threads, and from a copy or a snapshot on.

Everything that an environment returns is compared, over the ends of episodes. Beside: `test_env` (the devices of a
vector environment are single ones), `test_threads` (copies of a threaded one), `test_kernel` (places in a block),
`conformance` (every suite, in another process, from copies).
"""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import ENV_IDS, WORN_ID
from amulett_gym.errors import AmulettError

SCALING, TENSION = ENV_IDS[:2]
LIMIT = 20
KEYWORDS: dict[str, Any] = {"suite": "mixed", "observation_noise": 0.05, "max_episode_steps": LIMIT}


def actions(devices: int, first: int, last: int) -> np.ndarray:
    """Return what devices do in steps `first` to `last`, shape (steps, devices, 1): the same in any batch."""
    drawn = [np.random.default_rng(device).uniform(-1, 1, last)[first:] for device in range(devices)]
    return np.array(drawn).T[:, :, None]


def make(devices: int, **keywords: Any) -> Any:
    return gym.make_vec(SCALING, num_envs=devices, **KEYWORDS, **keywords)


def flat(info: dict[str, Any]) -> list[np.ndarray]:
    nested = [flat(value) if isinstance(value, dict) else [value] for value in info.values()]
    return [value for values in nested for value in values]


def go(env: Any, first: int, last: int) -> list[bytes]:
    """Return all that each device gives from one step to another, to the last bit."""
    given: list[list[bytes]] = [[] for _ in range(env.num_envs)]
    for step in actions(env.num_envs, first, last):
        *arrays, info = env.step(step)
        for values in [*arrays, *flat(info)]:
            for device, row in enumerate(values):
                given[device].append(np.asarray(row).tobytes())
    return [b"".join(rows) for rows in given]


def play(devices: int, seed: int = 3, steps: int = 3 * LIMIT, **keywords: Any) -> list[bytes]:
    env = make(devices, **keywords)
    env.reset(seed=seed)
    return go(env, 0, steps)


def go_on(state: dict[str, Any], devices: int, first: int, last: int) -> list[bytes]:
    env = make(devices)
    env.set_state(state)
    return go(env, first, last)


@pytest.fixture(scope="module")
def elsewhere():
    """Another process, which has inherited nothing."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield lambda function, *arguments, **keywords: pool.submit(function, *arguments, **keywords).result()


@pytest.mark.parametrize("devices", [1, 7, 8, 9, 33])
def test_a_device_is_the_same_in_any_batch(devices):
    assert play(devices) == play(40)[:devices]


@pytest.mark.parametrize(("devices", "threads"), [(1, 1), (19, 3)])
def test_a_spawned_process_gives_the_same_bits(elsewhere, devices, threads):
    assert elsewhere(play, devices, threads=threads) == play(devices)


def test_gymnasiums_processes_give_the_same_bits_as_the_native_vector_environment():
    options = {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}}
    native, processes = make(2), gym.make_vec(SCALING, num_envs=2, **options, **KEYWORDS)
    try:
        np.testing.assert_array_equal(processes.reset(seed=3)[0], native.reset(seed=3)[0])
        for step in actions(2, 0, 2 * LIMIT):
            for theirs, ours in zip(processes.step(step)[:4], native.step(step)[:4], strict=True):
                np.testing.assert_array_equal(theirs, ours)
    finally:
        processes.close()


@pytest.mark.parametrize("moment", [0, 7, LIMIT, LIMIT + 1])
def test_copies_and_snapshots_go_on_alike_here_and_in_another_process(elsewhere, moment):
    env = make(9)
    env.reset(seed=3)
    go(env, 0, moment)
    state = env.get_state()
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = go(env, moment, 3 * LIMIT)
    for twin in twins:
        assert go(twin, moment, 3 * LIMIT) == expected
    for _ in range(2):  # a snapshot is not used up
        assert go_on(state, 9, moment, 3 * LIMIT) == expected
    assert elsewhere(go_on, state, 9, moment, 3 * LIMIT) == expected


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_a_single_environment_goes_on_from_a_snapshot_over_later_episodes(env_id):
    def follow(env: Any) -> list[Any]:
        played = []
        for _ in range(3):
            played += [env.step(np.full(env.action_space.shape, 0.3)) for _ in range(10)]
            played.append(env.reset())
        return played

    suite = "carry" if env_id == WORN_ID else "mixed"
    env, fresh = (gym.make(env_id, suite=suite, observation_noise=0.05).unwrapped for _ in range(2))
    env.reset(seed=5)
    env.step(np.zeros(env.action_space.shape))
    state, twins = env.get_state(), [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = repr(follow(env))
    fresh.set_state(pickle.loads(pickle.dumps(state)))
    assert [repr(follow(one)) for one in (fresh, *twins)] == [expected] * 3


def test_devices_without_a_seed_are_drawn_alike_after_a_snapshot():
    env, fresh = make(3), make(3)
    env.reset(seed=5)
    state = env.get_state()
    fresh.set_state(state)
    assert env.np_random.integers(2**63) == fresh.np_random.integers(2**63)


@pytest.mark.parametrize("devices", [1, 3, 9])
def test_a_snapshot_of_another_number_of_devices_is_refused(devices):
    env, other = make(5), make(devices)
    for one in (env, other):
        one.reset(seed=0)
    before = pickle.dumps(env.get_state())
    with pytest.raises(AmulettError, match=f"snapshot of {devices} devices?.* has 5"):
        env.set_state(other.get_state())
    assert pickle.dumps(env.get_state()) == before


def test_another_seed_another_device_and_another_reset_give_something_else():
    ours, theirs = play(8, seed=3), play(8, seed=30)
    assert len({*ours, *theirs}) == 16
    env = make(1)
    env.reset(seed=3)
    started = [env.reset()[0].tobytes() for _ in range(20)]
    assert len(set(started)) == 20


def test_another_action_gives_something_else():
    env = make(2)
    env.reset(seed=[3, 3])
    same = go(env, 0, 1)
    assert same[0] != same[1]
    first, second = (env.reset(seed=[3, 3])[0] for _ in range(2))
    assert np.array_equal(first, second) and np.array_equal(first[0], first[1])
