"""``info``: flat, finite, of constant keys and types, and the same in the single and in all vector environments."""

import json
import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

import amulett_gym
from amulett_gym import FAILURES
from amulett_gym.envs.transition import BRIEF_SIZE, FIRST_TERM
from amulett_gym.evaluation.metrics import or_nan

SCALING, TENSION, DRIVES, WORN = amulett_gym.ENV_IDS
PUSHED = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
STEP = {"moves": [{"time": 0.02, "angle_deg": 10.0}]}

anywhere = pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        (SCALING, {}),
        (TENSION, {"control": "torque-stiffness", "suite": "contact"}),
        (TENSION, {"fleet": ["testbed", "simulation"]}),
        (DRIVES, {"privileged": True}),
        (WORN, {"suite": "carry"}),
    ],
    ids=["scaling", "stiffness", "fleet", "drives", "worn"],
)


def types(info):
    return {key: type(value) for key, value in info.items()}


@anywhere
def test_each_step_and_reset_has_the_same_keys_with_finite_numbers_of_the_same_type(env_id, keywords):
    env = gym.make(env_id, max_episode_steps=40, **keywords)
    episodes = env.unwrapped.episodes
    assert len(episodes.entries) == episodes.report_size - FIRST_TERM  # a name for each
    _, first = env.reset(seed=0)
    wanted = dict.fromkeys(first, float) | {"failure": int} | ({"device": int} if "fleet" in keywords else {})
    infos = [first]
    for _ in range(90):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        infos.append(info)
        if terminated or truncated:
            infos.append(env.reset()[1])
    assert len(infos) > 91
    for info in infos:
        assert types(info) == wanted
        assert all(map(math.isfinite, info.values()))
    assert json.loads(json.dumps(info)) == info


@anywhere
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_brief_report_is_the_begin_of_the_whole_one_and_can_be_completed(env_id, keywords, mode):
    whole, brief = (
        gym.make_vec(env_id, num_envs=3, max_episode_steps=20, autoreset_mode=mode, threads=threads, **keywords)
        for threads in (1, 2)
    )
    for env in (whole, brief):
        scenarios = {} if env_id == WORN else {"scenario": [{}, PUSHED, {}]}  # the pushed one fails
        env.reset(seed=0, options=scenarios)
        env.action_space.seed(0)
    ends = failures = 0
    for _ in range(50):
        seen, report, terminated, truncated, final = whole.step_report(whole.action_space.sample())
        found, shown, *others = brief.step_report(brief.action_space.sample(), brief=True)
        assert report.shape == (3, whole.episodes.report_size) and shown.shape == (3, BRIEF_SIZE)
        assert np.array_equal(found, seen) and np.array_equal(shown, report[:, :BRIEF_SIZE])
        assert data_equivalence((terminated, truncated, final), tuple(others))
        completed = brief.episodes.whole(shown, np.arange(3))
        assert np.array_equal(completed, report, equal_nan=True)
        ends += np.count_nonzero(truncated)
        failures += np.count_nonzero(terminated)
    assert ends > 3 and (env_id == WORN or failures > 0)


@pytest.mark.parametrize("mode", ["sync", "async"])
@anywhere
def test_gymnasiums_vector_environments_of_single_ones_have_the_infos_of_the_native_one(env_id, keywords, mode):
    if "fleet" in keywords:  # a block of the native one has one device; that of the single ones is drawn
        keywords = {"fleet": keywords["fleet"][:1]}
    made = [
        gym.make_vec(env_id, num_envs=3, vectorization_mode=mode, max_episode_steps=7, **keywords)
        for mode in ("vector_entry_point", mode)
    ]
    native, others = ([env.reset(seed=5)[1]] for env in made)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, *made[0].action_space.shape))
    for action in actions.astype(np.float32):
        native.append(made[0].step(action)[4])
        others.append(made[1].step(action)[4])
    for env in made:
        env.close()
    for info, other in zip(native, others, strict=True):
        assert {key: values.dtype for key, values in info.items()} == {key: v.dtype for key, v in other.items()}
        assert data_equivalence({key: info[key] for key in other}, other, exact=True)


def test_a_failure_is_the_number_of_its_name():
    env, envs = gym.make(SCALING), gym.make_vec(SCALING, num_envs=2)
    env.reset(seed=0, options={"scenario": PUSHED})
    envs.reset(seed=0, options={"scenario": [{}, PUSHED]})
    terminated = False
    while not terminated:
        _, _, terminated, _, info = env.step([0.0])
        _, _, _, _, infos = envs.step(np.zeros((2, 1)))
    assert FAILURES[info["failure"]] == "joint angle limit"
    assert [FAILURES[code] for code in infos["failure"]] == ["", "joint angle limit"]


def test_a_mean_over_nothing_is_0_and_its_count_says_so():
    env = gym.make(TENSION)
    _, info = env.reset(seed=0, options={"scenario": STEP})
    means = ("rise_time", "settling_time", "resting_stiffness")
    assert [info[name] for name in means] == [0.0] * 3
    assert all(math.isnan(or_nan(info)[name]) for name in means)
    while not info["steps_settled"]:
        assert info["settling_time"] == 0.0
        info = env.step([0.0])[4]
    while info["steps_settled"] < 1 or info["resting_time"] < 0.5:
        info = env.step([0.0])[4]
    assert all(info[name] > 0.0 for name in means) and info["steps_risen"] == 1
    assert {name: float(value) for name, value in or_nan(info).items()} == info


def test_the_terms_sum_to_the_reward():
    env = gym.make_vec(WORN, num_envs=3)
    env.reset(seed=0)
    for _ in range(40):
        _, rewards, _, _, info = env.step(env.action_space.sample())
    assert rewards == pytest.approx(sum(values for key, values in info.items() if key.startswith("reward_")))
    assert (rewards < 0).all()


def test_after_a_reset_by_a_mask_the_info_is_that_of_the_devices_it_names():
    env = gym.make_vec(SCALING, num_envs=4)
    env.reset(seed=0)
    before = env.step(np.zeros((4, 1)))[4]
    chosen = np.array([False, True, True, False])
    _, info = env.reset(options={"reset_mask": chosen})
    assert info.keys() == before.keys()
    for key, values in info.items():
        if not key.startswith("_"):
            assert info[f"_{key}"].tolist() == chosen.tolist()
            assert (values[~chosen] == 0).all()
    assert (info["tension_setpoint"][chosen] > 0).all()
    assert env.step(np.zeros((4, 1)))[4]["time"] == pytest.approx([0.04, 0.02, 0.02, 0.04])
