"""Environments with several devices."""

import json
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
from helpers import device

import amulett_gym
from amulett_gym.errors import AmulettError
from amulett_gym.laws.policies import load_policy
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import LANES

SCALING, TENSION, DRIVES = amulett_gym.ENV_IDS[:3]
QUICK = device(
    "simulation",
    plant={"joint_pulley_radius": 0.03, "masses": [{"mass": 0.4, "arm": 0.1}]},
    spring={"stiffness": 15000.0},
    loop={"control_period": 0.0005},
).model_copy(update={"name": "quick"})
LAZY = device(
    "testbed",
    drives={"lag": 0.05, "rate_limit_deg": 400.0},
    sensors={"below_floor": "ignore"},
    loop={"control_period": 0.005, "substeps": 4, "wiring": "tension_only"},
).model_copy(update={"name": "lazy"})
FLEET = (load_profile("testbed"), QUICK, LAZY)
"""Devices with other physics, other control periods (8, 40 and 4 ticks in an agent step) and another loop."""

NAMES = [profile.name for profile in FLEET]
COUNT = 4 * LANES + 3
STEPS = 12


def vector(count=COUNT, env_id=TENSION, **keywords):
    return gym.make_vec(env_id, num_envs=count, **{"fleet": FLEET, "suite": "mixed", **keywords})


def single(env_id=TENSION, **keywords):
    return gym.make(env_id, **{"fleet": FLEET, "suite": "mixed", **keywords}).unwrapped


def entry(info, lane):
    """Return one device's info of a vector environment's."""
    return {key: value[lane] for key, value in info.items() if not key.startswith("_")}


def names(info, fleet=FLEET):
    """Return the devices' names in an info."""
    return np.array([profile.name for profile in fleet])[info["device"]]


@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        (TENSION, {}),
        (SCALING, {"control": "torque", "threads": 2}),
        (TENSION, {"control": "position-only", "privileged": True, "agent_period": 0.04}),
        (DRIVES, {"track": "full-control"}),
    ],
)
def test_single_and_vector_environment_give_the_same_bits(env_id, keywords):
    many = vector(env_id=env_id, max_episode_steps=5, **keywords)
    seed = 7
    observations, infos = many.reset(seed=seed)
    assert names(infos).tolist() == [NAMES[(lane // LANES * 3 // 5 + seed) % 3] for lane in range(COUNT)]
    size = many.single_action_space.shape[0]
    actions = np.random.default_rng(0).uniform(-1, 1, size=(STEPS, COUNT, size))
    history = [(observations, np.zeros(COUNT), infos)]
    for chosen in actions:
        found, rewards, _, _, infos = many.step(chosen)
        history.append((found, rewards, infos))
    keywords.pop("threads", None)
    for lane in (0, LANES + 1, 2 * LANES, COUNT - 1):
        name = str(names(history[0][2])[lane])
        one = single(env_id, **keywords)
        observation, info = one.reset(seed=seed + lane, options={"device": name})
        reward, passed = 0.0, 0
        for step in range(STEPS + 1):
            if step and passed == 5:
                observation, info = one.reset(options={"device": name})
                reward, passed = 0.0, 0
            elif step:
                observation, reward, terminated, _, info = one.step(actions[step - 1, lane])
                assert not terminated
                passed += 1
            found, rewards, infos = history[step]
            assert observation.tobytes() == found[lane].tobytes(), (lane, step)
            assert reward == rewards[lane] and info == entry(infos, lane), (lane, step)
            assert one.devices[info["device"]].name == name == one.profile.name


def test_a_single_environment_draws_the_device_of_each_episode():
    env = single()
    drawn = []
    for _ in range(2):
        _, info = env.reset(seed=3)
        drawn.append([names(info)])
        for _ in range(11):
            drawn[-1].append(names(env.reset()[1]))
    assert drawn[0] == drawn[1] and set(drawn[0]) == set(NAMES)
    of_seeds = [names(env.reset(seed=seed)[1]) for seed in range(300)]
    assert all(70 < of_seeds.count(name) < 130 for name in NAMES)


def test_each_device_of_a_vector_environment_has_as_many_blocks():
    env = vector(6 * LANES, max_episode_steps=2)
    first, second, third = NAMES
    turned = [second, second, third, third, first, first]
    assert names(env.reset()[1])[::LANES].tolist() == [first, first, second, second, third, third]
    assert names(env.reset(seed=1)[1])[::LANES].tolist() == turned
    for _ in range(4):  # the next episodes, and a reset without a seed
        *_, info = env.step(np.zeros((6 * LANES, 1)))
        assert names(info)[::LANES].tolist() == turned
    assert names(env.reset()[1])[::LANES].tolist() == turned
    _, info = env.next_episodes(np.array([0, 2 * LANES + 1]))
    assert names(info).tolist() == [second, third]
    assert names(env.reset(seed=[5] + [None] * (6 * LANES - 1))[1])[0] == NAMES[5 % 3]


def test_options_choose_the_device_of_a_block():
    env = vector(2 * LANES)
    env.reset(seed=0)
    assert set(names(env.reset(options={"device": "lazy"})[1])) == {"lazy"}
    wanted = ["quick"] * LANES + [None] * (LANES - 1) + ["testbed"]
    assert names(env.reset(options={"device": wanted})[1])[[0, -1]].tolist() == ["quick", "testbed"]
    second = np.arange(2 * LANES) >= LANES
    state = env.get_state()
    for options, message in (
        ({"device": ["lazy", *["quick"] * (2 * LANES - 1)]}, "device 0 is to be 'lazy' and device 1 'quick'"),
        ({"device": "lasy"}, "unknown device 'lasy'; choose from lazy, quick, testbed; did you mean 'lazy'"),
        ({"device": ["lazy"]}, f"1 devices were given for the {2 * LANES} devices to reset"),
        (
            {"device": ["lazy"], "reset_mask": np.arange(2 * LANES) == 9},
            "device 8 of the same block of 8, which is not",
        ),
    ):
        with pytest.raises(AmulettError, match=message):
            env.reset(options=options)
    np.testing.assert_array_equal(
        env.get_state()["episodes"]["simulation"]["which"], state["episodes"]["simulation"]["which"]
    )
    _, info = env.reset(options={"device": "lazy", "reset_mask": second})
    assert names(info)[second].tolist() == ["lazy"] * LANES
    assert info["_device"].tolist() == second.tolist()
    assert names(env.step(np.zeros((2 * LANES, 1)))[4])[[0, -1]].tolist() == ["quick", "lazy"]


def test_a_scenario_replays_with_its_device():
    env = single()
    for seed in range(6):
        first, info = env.reset(seed=seed)
        scenario = json.loads(env.scenario.model_dump_json())
        assert scenario["device"]["name"] == names(info)
        rewards = [env.step(np.zeros(1))[1] for _ in range(5)]
        again, other = env.reset(seed=99, options={"scenario": scenario})
        assert other["device"] == info["device"] and again.tobytes() == first.tobytes()
        assert [env.step(np.zeros(1))[1] for _ in range(5)] == rewards
    many = vector(LANES)
    many.reset(seed=0, options={"scenario": scenario})
    assert {one.device.name for one in many.scenarios} == {scenario["device"]["name"]}
    assert [many.step(np.zeros((LANES, 1)))[1][3] for _ in range(5)] == rewards


def test_a_scenario_of_another_device_is_refused():
    scenario = {"device": {"name": "lazy"}}
    plain = gym.make(TENSION)
    with pytest.raises(AmulettError, match="'device.name' is 'lazy'; this device is 'testbed'"):
        plain.reset(options={"scenario": scenario})
    plain.reset(options={"scenario": {"device": {"name": "testbed"}}})
    with pytest.raises(AmulettError, match="option 'device' chooses a device of a fleet"):
        plain.reset(options={"device": "testbed"})
    with pytest.raises(AmulettError, match="device 0 is to be 'quick'; its scenario is of the device 'lazy'"):
        single().reset(options={"scenario": scenario, "device": "quick"})
    with pytest.raises(AmulettError, match="unknown device 'lasy'"):
        single().reset(options={"scenario": {"device": {"name": "lasy"}}})


@pytest.mark.parametrize("make", [single, vector])
def test_a_snapshot_continues_with_the_same_devices(make):
    env, other = make(), make()
    shape = env.action_space.shape
    env.reset(seed=4)
    env.step(np.zeros(shape))
    state = pickle.loads(pickle.dumps(env.get_state()))
    other.set_state(state)
    for _ in range(3):
        expected, found = env.step(np.ones(shape)), other.step(np.ones(shape))
        assert found[0].tobytes() == expected[0].tobytes() and np.array_equal(found[4]["device"], expected[4]["device"])
    expected, found = env.reset(), other.reset()
    assert found[0].tobytes() == expected[0].tobytes() and np.array_equal(found[1]["device"], expected[1]["device"])
    with pytest.raises(AmulettError, match="the snapshot's devices are testbed, quick, lazy"):
        make(fleet=FLEET[::-1]).set_state(state)


def test_a_fleet_of_one_plays_as_its_profile():
    for make in (single, vector):
        fleet, plain = make(fleet=[LAZY]), make(fleet=None, profile=LAZY)
        observation, info = fleet.reset(seed=2)
        expected, _ = plain.reset(seed=2)
        assert observation.tobytes() == expected.tobytes() and np.all(names(info, [LAZY]) == "lazy")
        actions = np.full(fleet.action_space.shape, 0.3)
        found, wanted = fleet.step(actions), plain.step(actions)
        assert found[0].tobytes() == wanted[0].tobytes() and np.all(found[1] == wanted[1])


def test_a_fleet_is_a_keyword_of_the_environment():
    env = gym.make(TENSION, fleet=["testbed", QUICK.model_dump(mode="json")])
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.reset(seed=1)[0].tobytes() == env.reset(seed=1)[0].tobytes()
    keywords = json.loads(json.dumps(env.unwrapped.settings.keywords()))
    assert keywords["fleet"][0] == "testbed" and "profile" not in keywords
    assert gym.make(TENSION, **keywords).unwrapped.settings.devices == env.unwrapped.settings.devices


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"profile": "testbed"}, "profile and fleet are both given"),
        ({"agent_period": 0.0125}, "'lazy' of the fleet: agent_period is 0.0125 s"),
        ({"fleet": "plausibel"}, "unknown fleet 'plausibel'"),
        (
            {"fleet": ["testbed", device("testbed", spring={"free_length": 0.0})], "control": "torque-stiffness"},
            "'testbed-test' of the fleet: control 'torque-stiffness' sets the joint stiffness",
        ),
        (
            {"fleet": ["testbed", device("testbed", damping={"d": 1e5})]},
            "'testbed-test' of the fleet: the device 'testbed-test' is damped",
        ),
    ],
)
@pytest.mark.parametrize("make", [single, vector])
def test_a_device_that_the_settings_do_not_fit_is_named(make, keywords, message):
    with pytest.raises(AmulettError, match=message):
        make(**keywords)


def test_rewards_are_by_the_device_s_own_prices():
    env = vector(3 * LANES)
    env.reset(seed=0)
    found = env.episodes._constants["prices"]
    for row, profile in zip(found, FLEET, strict=True):
        plain = vector(1, fleet=None, profile=profile)
        np.testing.assert_array_equal(row, plain.episodes._constants["prices"][0])
        assert not np.isnan(row[env.episodes._families]).any()
    assert not np.array_equal(found[0], found[1])


def test_pictures_are_of_the_device_s_own_arm():
    from amulett_gym.envs.rendering.frame import frame_of

    env = vector(3 * LANES)
    env.reset(seed=0)
    for block, profile in enumerate(FLEET):
        assert frame_of(env.episodes, block * LANES).joint_radius == profile.plant.joint_pulley_radius
    env = vector(1)
    env.reset(seed=1)
    env.step(np.zeros((1, 1)))
    assert frame_of(env.episodes, 0).time == pytest.approx(0.02)


def test_laws_with_parameters_of_one_device_are_refused():
    env = single()
    env.reset(seed=0)
    assert load_policy("constant:7", env)(env.reset(seed=0)[0]).shape == (1,)
    load_policy("eq6-held", env)  # eq. 6 has the same parameters on all of them
    with pytest.raises(AmulettError, match="'eq6-tuned' acts by the parameters of one device; the 3 devices"):
        load_policy("eq6-tuned", env)
    other = device("testbed", variable_stiffness={"nominal_tension": 9.0})
    with pytest.raises(AmulettError, match="'eq6-held' acts by the parameters of one device"):
        load_policy("eq6-held", single(fleet=["testbed", other]))
    with pytest.raises(AmulettError, match="the devices have 3 profiles"):
        _ = vector().profile


@pytest.mark.parametrize("fleet", [FLEET, FLEET[:1]])
def test_steps_are_counted_with_each_devices_own_ticks(fleet):
    episodes = vector(fleet=fleet).unwrapped.episodes
    per_step = np.array([episodes.settings.ticks(profile) for profile in episodes.profiles])
    own = np.repeat(per_step[episodes.simulation.which], LANES)[: episodes.started.size]
    for passed in (0, 1, *per_step.tolist(), *(3 * per_step + 1).tolist(), *(3 * per_step - 1).tolist()):
        episodes.simulation.states["tick"][...] = passed  # within a step where a device has failed
        expected = np.array([math.ceil(passed / ticks) for ticks in own])
        np.testing.assert_array_equal(episodes.steps(), expected)
        for count in (1, 2, 3, 4, math.inf):
            np.testing.assert_array_equal(episodes.have_steps(count), expected >= count)
