"""The environments keep what their docstring promises."""

from __future__ import annotations

import itertools
import json
import math
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import amulett_gym
from amulett_gym import FAILURES
from amulett_gym.control.variable_stiffness import scaling_factor
from amulett_gym.envs.prices import divisors, prices
from amulett_gym.envs.reward import COST_CAP, COST_TERMS, DEFAULT_WEIGHTS, default_weights
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation import conformance
from amulett_gym.evaluation.conformance import CHECKS, Subject, run_checks
from amulett_gym.evaluation.metrics import control_cost, control_prices
from amulett_gym.profile import device_names, load_profile
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.tasks.suites import families_of, suite_names
from amulett_gym.tasks.worn_suites import WORN_SUITES

SCALING, TENSION = amulett_gym.ENV_IDS[:2]
MID = np.zeros(1, dtype=np.float32)


SUBJECTS = [
    Subject(env_id, {"profile": profile, "suite": suite})
    for env_id, profile, suite in itertools.product(amulett_gym.ENV_IDS[:3], device_names(), suite_names())
    if env_id == SCALING or suite == "mixed"  # but for their actions, the others are the same
]
SUBJECTS += [Subject(amulett_gym.WORN_ID, {"suite": suite}) for suite in WORN_SUITES]


@pytest.mark.parametrize(
    "subject", SUBJECTS, ids=lambda subject: "-".join([subject.env_id, *subject.keywords.values()])
)
def test_conformance(subject):
    outcomes = list(run_checks(subject))
    assert len(outcomes) == len(CHECKS)
    assert [outcome for outcome in outcomes if outcome.problem] == []


class Late(Subject):
    """Gymnasium's vector environment reports a time too late."""

    def make_vec(self, num_envs, **more):
        env = super().make_vec(num_envs, **more)
        observations, info = env.reset(seed=6)
        if more["vectorization_mode"] == "sync":
            env.reset = lambda **_: (observations, {**info, "time": info["time"] + 0.5})
        return env


def test_a_wrong_info_is_shown():
    (check,) = (check for requirement, check in CHECKS.items() if "infos are those of Gymnasium" in requirement)
    with pytest.raises(AssertionError, match=r"^'time' is array\(\[0., 0.\]\) and array\(\[0.5, 0.5\]\)$"):
        check(Late(SCALING, {"suite": "steps"}))


def test_another_process_that_fails_is_started_anew():
    with pytest.raises(AssertionError, match="another process cannot play it"):
        conformance.elsewhere(Subject(SCALING, {"suite": "unheard-of"}), 4)
    subject = Subject(SCALING, {"suite": "steps"})
    assert conformance.elsewhere(subject, 4) == conformance.fingerprint(subject, 4)


def test_ids_resolve_without_an_import_of_ours():
    script = "import gymnasium; print(gymnasium.make('amulett_gym:Amulett/Scaling-v0').spec.id)"
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == SCALING


def test_package_imports_neither_torch_nor_the_kernel():
    script = "import amulett_gym, sys; print([m for m in ('torch', 'stable_baselines3', 'numba') if m in sys.modules])"
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"


def test_both_actions_span_the_same_tensions():
    scaling, tension = (gym.make(env_id).unwrapped for env_id in (SCALING, TENSION))
    assert scaling.tension_range == tension.tension_range == (4.0, 15.0)
    for env in (scaling, tension):
        env.reset(seed=0)
        assert env.step(np.array([0.2], dtype=np.float32))[4]["tension_setpoint"] == pytest.approx(4 + 0.6 * 11)


def test_actions_beyond_the_space_are_clipped():
    env = gym.make(TENSION).unwrapped
    env.reset(seed=0)
    assert env.step(np.array([7.0]))[4]["tension_setpoint"] == 15.0
    assert env.step(np.array([-np.inf]))[4]["tension_setpoint"] == 4.0


def test_observation_is_what_the_table_says():
    env = gym.make(SCALING, profile="simulation", suite="steps").unwrapped
    env.reset(seed=0)
    for _ in range(60):
        observation, *_, info = env.step(MID)
    entry = dict(zip(OBSERVATIONS, observation.tolist(), strict=True))
    assert entry["joint_angle"] * 150 == pytest.approx(info["joint_angle"], abs=1e-4)
    assert entry["estimated_tension_biceps"] * 20 == pytest.approx(info["force_biceps"], abs=2.0)
    assert entry["tension_setpoint"] == pytest.approx(0.0, abs=1e-6)
    assert entry["position_error"] * 90 == pytest.approx(
        (entry["setpoint"] - entry["joint_angle"]) * math.degrees(OBSERVATION_SCALES["joint_angle"]), abs=1e-3
    )
    assert entry["time_since_move"] * 2 == pytest.approx(info["time"] - 0.5, abs=1e-6)


def test_time_limit_truncates():
    env = gym.make(SCALING)
    env.reset(seed=0)
    ends = [env.step(MID)[2:4] for _ in range(500)]
    assert ends == [(False, False)] * 499 + [(False, True)]


def test_eq6_returns_about_minus_one():
    for suite in suite_names():
        env = gym.make_vec(SCALING, num_envs=160, suite=suite, tension_law="eq6")
        env.reset(seed=0)
        returns = sum(env.step(np.zeros((160, 1), dtype=np.float32))[1] for _ in range(500))
        assert np.mean(returns) == pytest.approx(-1.0, abs=0.15)


@pytest.mark.parametrize("profile", device_names())
def test_eq6_returns_about_minus_one_in_each_family_of_a_mix(profile):
    env = gym.make_vec(SCALING, num_envs=480, profile=profile, suite="mixed", tension_law="eq6")
    env.reset(seed=0)
    families = np.array([scenario.family for scenario in env.scenarios])
    returns = sum(env.step(np.zeros((480, 1), dtype=np.float32))[1] for _ in range(500))
    for family in families_of("mixed"):
        assert np.mean(returns[families == family]) == pytest.approx(-1.0, abs=0.2), family


def test_a_saved_scenario_of_a_mix_replays_with_its_rewards():
    env = gym.make(SCALING, suite="mixed").unwrapped
    met = set()
    for seed in range(30):
        env.reset(seed=seed)
        scenario = json.loads(env.scenario.model_dump_json())
        first = [env.step(MID)[1] for _ in range(60)]
        bumps = scenario["family"] == "contact" and scenario["obstacle"] is not None  # contact without being named
        for family, same in ((scenario["family"], True), (None, bumps)):
            env.reset(seed=99, options={"scenario": {**scenario, "family": family}})
            assert ([env.step(MID)[1] for _ in range(60)] == first) is same
        met.add(scenario["family"])
    assert met == set(families_of("mixed"))


def test_a_family_is_charged_at_its_own_prices_wherever_it_is_met():
    own, given = gym.make(SCALING, suite="hold-push").unwrapped, gym.make(SCALING, suite="steps").unwrapped
    own.reset(seed=0)
    given.reset(seed=1, options={"scenario": own.scenario})
    assert [own.step(MID)[1] for _ in range(60)] == [given.step(MID)[1] for _ in range(60)]


def test_weights_of_ones_own_hold_in_every_family():
    testbed = load_profile("testbed")
    default, own = prices(testbed, "mixed"), prices(testbed, "mixed", {"contact": 0.6})
    contact = COST_TERMS.index("contact")
    assert np.delete(own, contact, axis=1).tolist() == np.delete(default, contact, axis=1).tolist()
    for family in families_of("mixed"):
        paid = divisors(testbed, "mixed", family)["contact"]
        assert own[FAMILIES.index(family), contact] == 0.6 / paid


def test_returns_are_the_weighted_metrics_over_the_divisors():
    env = gym.make(TENSION, suite="reach").unwrapped
    env.reset(seed=1)
    total = sum(env.step(MID)[1] for _ in range(300))
    metrics = env.step(MID)[4]
    before = env.get_state()
    paid = divisors(env.profile, "reach")
    expected = -(
        DEFAULT_WEIGHTS["position"] * metrics["position_ise"] / paid["position"]
        + DEFAULT_WEIGHTS["effort"] * (metrics["effort_biceps"] + metrics["effort_triceps"]) / paid["effort"]
        + DEFAULT_WEIGHTS["tension"] * metrics["tension_ise"] / paid["tension"]
    )
    env.set_state(before)
    assert total == pytest.approx(expected, rel=0.02)


def test_weights_change_their_term_alone():
    plain, heavy = gym.make(SCALING).unwrapped, gym.make(SCALING, reward_weights={"position": 1.0}).unwrapped
    for env in (plain, heavy):
        env.reset(seed=0)
    for _ in range(60):
        infos = [env.step(MID)[4] for env in (plain, heavy)]
    assert infos[1]["reward_position"] == pytest.approx(2 * infos[0]["reward_position"])
    assert infos[1]["reward_effort"] == infos[0]["reward_effort"]


def test_failure_terminates_and_costs_no_less_than_the_rest_could():
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
    env = gym.make(SCALING)
    env.reset(seed=0, options={"scenario": push})
    steps = 0
    terminated = False
    while not terminated:
        steps += 1
        _, reward, terminated, _, info = env.step(MID)
    assert FAILURES[info["failure"]] == "joint angle limit"
    assert reward <= -COST_CAP * (500 - steps)
    assert sum(value for key, value in info.items() if key.startswith("reward_")) == pytest.approx(reward)


def test_failure_costs_the_same_in_the_vector_environment():
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
    keywords = {"max_episode_steps": 60, "failure_horizon": 60}
    single, vector = gym.make(SCALING, **keywords), gym.make_vec(SCALING, num_envs=1, **keywords)
    for env in (single, vector):
        env.reset(seed=0, options={"scenario": push})
    terminated = False
    while not terminated:
        _, reward, terminated, _, _ = single.step(MID)
        expected = vector.step(np.zeros((1, 1)))
        assert reward == expected[1][0]
        assert terminated == expected[2][0]


def test_failure_leaves_neighbours_alone_and_starts_anew():
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
    rest = {"initial_angle_deg": 10.0}
    pair, alone = (gym.make_vec(SCALING, num_envs=n, suite="steps") for n in (2, 1))
    pair.reset(seed=0, options={"scenario": [rest, push]})
    alone.reset(seed=0, options={"scenario": rest})
    failed = False
    for _ in range(60):
        observations, rewards, terminated, _, info = pair.step(np.zeros((2, 1)))
        expected = alone.step(np.zeros((1, 1)))
        assert np.array_equal(observations[:1], expected[0])
        assert rewards[0] == expected[1][0]
        if failed:
            assert (rewards[1], terminated[1], info["time"][1], info["failure"][1]) == (0.0, False, 0.0, 0)
            break
        failed = bool(terminated[1])
    assert failed


def test_scenario_option_replays_an_episode():
    env = gym.make(SCALING, suite="hold-push")
    env.reset(seed=3)
    scenario = json.loads(env.unwrapped.scenario.model_dump_json())
    first = [env.step(MID)[0].tolist() for _ in range(100)]
    env.reset(seed=99, options={"scenario": scenario})
    assert [env.step(MID)[0].tolist() for _ in range(100)] == first


def test_obstacle_is_felt():
    wall = {"moves": [{"time": 0.1, "angle_deg": 60.0}], "obstacle": {"angle_deg": 30.0, "stiffness": 20.0}}
    env = gym.make(SCALING)
    env.reset(seed=0, options={"scenario": wall})
    for _ in range(300):
        info = env.step(MID)[4]
    assert 30.0 < info["joint_angle"] < 35.0
    assert info["contact_peak"] > 0.1
    assert info["contact_torque"] < 0
    assert info["reward_contact"] < -1e-4  # it is charged, although neither suite nor scenario is of contact


def test_vertical_arm_holds_its_payload():
    profile = {"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}}
    env = gym.make(SCALING, profile=profile)
    # 0.1 N m is what the strings can hold beside 10 N of co-contraction.
    env.reset(seed=0, options={"scenario": {"initial_angle_deg": 20.0, "payload": {"mass": 0.02, "arm": 0.1}}})
    info = env.step(MID)[4]
    for _ in range(200):
        info = env.step(MID)[4]
    assert info["joint_angle"] == pytest.approx(20.0, abs=0.5)
    assert info["force_biceps"] > info["force_triceps"] + 1.0


def test_impossible_posture_is_refused():
    profile = {"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}}
    env = gym.make(SCALING, profile=profile)
    with pytest.raises(AmulettError, match=r"springs give 0 to \d+\.\d\d N"):
        env.reset(options={"scenario": {"initial_angle_deg": 90.0, "payload": {"mass": 1.0, "arm": 0.2}}})


def test_eq6_from_outside_at_control_rate_equals_the_built_in_law():
    keywords = {"profile": "simulation", "suite": "steps"}
    inside = gym.make(SCALING, tension_law="eq6", **keywords).unwrapped
    outside = gym.make(SCALING, agent_period=0.001, **keywords).unwrapped
    observation, _ = outside.reset(seed=2)
    inside.reset(seed=2)
    low, high = outside.tension_range
    for _ in range(100):
        for _ in range(20):
            error = float(observation[0]) * OBSERVATION_SCALES["position_error"]
            tension = 10.0 * scaling_factor(error, 10.0, 4.0, math.radians(30.0))
            action = np.array([2 * (tension - low) / (high - low) - 1])
            observation, *_, theirs = outside.step(action)
        ours = inside.step(MID)[4]
        # The observation is float32, the loop float64.
        assert theirs["joint_angle"] == pytest.approx(ours["joint_angle"], abs=2e-3)
        assert theirs["tension_setpoint"] == pytest.approx(ours["tension_setpoint"], abs=2e-4)


def test_scenarios_of_a_batch_are_those_of_the_single_environments():
    vector, single = gym.make_vec(SCALING, num_envs=9, suite="hold-push"), gym.make(SCALING, suite="hold-push")
    for scenarios in (lambda: vector.unwrapped.scenarios, lambda: single.unwrapped.scenario):
        with pytest.raises(gym.error.ResetNeeded):
            scenarios()
    vector.reset(seed=3)
    for i, scenario in enumerate(vector.unwrapped.scenarios):
        single.reset(seed=3 + i)
        assert single.unwrapped.scenario == scenario


def test_position_only_ignores_actions():
    first, second = (gym.make(SCALING, control="position-only").unwrapped for _ in range(2))
    for env in (first, second):
        env.reset(seed=0)
    for _ in range(50):
        assert np.array_equal(first.step(np.ones(1))[0], second.step(-np.ones(1))[0])


def test_with_a_delay_ramps_begin_late():
    single = gym.make("Amulett/Tension-v0", action_delay=3).unwrapped
    vector = gym.make_vec("Amulett/Tension-v0", num_envs=9, action_delay=3, threads=2)
    start = single.reset(seed=0)[1]["tension_setpoint"]
    vector.reset(seed=0)
    first, third = start + 5 / 8 * (15.0 - start), 15.0 - 5 / 8 * 11.0
    for action, tension in ((1.0, first), (1.0, 15.0), (-1.0, third), (0.0, third - 3 / 8 * 11.0 + 5 / 8 * 5.5)):
        observation, reward, _, _, info = single.step([action])
        assert info["tension_setpoint"] == pytest.approx(tension, abs=1e-12)
        assert observation[12] == pytest.approx(action, abs=1e-6)  # where the ramp ends
        observations, rewards, *_, infos = vector.step(np.full((9, 1), action))
        assert (observations[0] == observation).all() and rewards[0] == reward
        assert infos["tension_setpoint"][0] == info["tension_setpoint"]


def test_observation_noise_is_seeded():
    noisy = gym.make(SCALING, observation_noise=0.1)
    first, again = noisy.reset(seed=0)[0], noisy.reset(seed=0)[0]
    assert np.array_equal(first, again)
    assert not np.array_equal(first, gym.make(SCALING).reset(seed=0)[0])


def test_scenarios_of_the_splits_differ():
    angles = [gym.make(SCALING, split=split).reset(seed=0)[0][1] for split in ("train", "validation", "held-out")]
    assert len(set(angles)) == 3


def test_what_a_refused_constructor_leaves_can_be_closed():
    from amulett_gym.envs.vector import ScalingVectorEnv

    ScalingVectorEnv.__new__(ScalingVectorEnv).close()  # as Gymnasium 1.2 does when it is forgotten


def test_wrong_reset_options_are_refused():
    env = gym.make(SCALING).unwrapped
    with pytest.raises(AmulettError, match="unknown reset option 'scenarios'.*did you mean 'scenario'"):
        env.reset(options={"scenarios": {}})
    vector = gym.make_vec(SCALING, num_envs=2)
    for options, message in [
        ({"scenaro": {}}, "did you mean 'scenario'"),
        ({"reset_mask": [True, False]}, "ndarray of bool"),
        ({"reset_mask": np.ones(3, dtype=bool)}, "ndarray of bool"),
        ({"scenario": [{}]}, "1 scenarios were given for the 2 devices"),
    ]:
        with pytest.raises(AmulettError, match=message):
            vector.reset(options=options)
    with pytest.raises(AmulettError, match="3 seeds were given for 2"):
        vector.reset(seed=[1, 2, 3])


def test_a_refused_first_scenario_starts_no_episode():
    env = gym.make(SCALING).unwrapped
    with pytest.raises(AmulettError, match="limit"):
        env.reset(options={"scenario": {"initial_angle_deg": 170.0}})
    with pytest.raises(gym.error.ResetNeeded):
        env.step(MID)


@pytest.mark.parametrize("seed", [0, 2**32 - 1, 2**64 - 2, 2**200])
def test_device_i_plays_what_the_single_environment_plays_with_the_seed_plus_i(seed):
    single, vector = gym.make(SCALING), gym.make_vec(SCALING, num_envs=5, max_episode_steps=20)
    played, _ = vector.reset(seed=seed)
    ended = [vector.step(np.zeros((5, 1)))[0] for _ in range(21)][-1]  # the last step started the next episodes
    for i in range(5):
        assert np.array_equal(single.reset(seed=seed + i)[0], played[i])
        assert np.array_equal(single.reset()[0], ended[i])
    assert len(np.unique(played, axis=0)) == len(np.unique(ended, axis=0)) == 5


def test_numpy_seeds_are_seeds():
    vector = gym.make_vec(SCALING, num_envs=2)
    assert np.array_equal(vector.reset(seed=np.array([4, 9]))[0], vector.reset(seed=[4, 9])[0])
    assert np.array_equal(vector.reset(seed=np.int64(4))[0], vector.reset(seed=4)[0])


def test_devices_without_a_seed_go_on_or_are_seeded_by_np_random():
    vector = gym.make_vec(SCALING, num_envs=3)
    vector.np_random = np.random.default_rng(1)
    first, _ = vector.reset(seed=[None, 7, None])
    assert np.array_equal(gym.make(SCALING).reset(seed=7)[0], first[1])
    assert len(np.unique(first, axis=0)) == 3
    second, _ = vector.reset(seed=[7, None, None])
    single = gym.make(SCALING)
    assert np.array_equal(single.reset(seed=7)[0], second[0])
    assert np.array_equal(single.reset()[0], second[1])
    other = gym.make_vec(SCALING, num_envs=3)
    other.np_random = np.random.default_rng(1)
    assert np.array_equal(other.reset()[0][0], first[0])


@pytest.mark.parametrize("seed", [-1, 1.0, True, "7"])
def test_seeds_that_gymnasium_refuses_are_refused(seed):
    single, vector = gym.make(SCALING).unwrapped, gym.make_vec(SCALING, num_envs=2)
    with pytest.raises(gym.error.Error, match="Seed must be"):
        single.reset(seed=seed)
    for seeds in (seed, [0, seed], np.array([seed, seed])):
        with pytest.raises(gym.error.Error, match="Seed must be"):
            vector.reset(seed=seeds)
    with pytest.raises(gym.error.ResetNeeded):
        vector.step(np.zeros((2, 1)))


def test_law_inside_the_loop_is_no_policy():
    with pytest.raises(AmulettError, match="acts inside the loop.*tension_law='eq6'"):
        amulett_gym.load_policy("eq6", gym.make(SCALING))


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
def test_steps_and_pictures_before_reset_are_refused(env_id):
    env = gym.make(env_id, render_mode="rgb_array")
    for refused in (env, env.unwrapped):
        with pytest.raises(gym.error.ResetNeeded):
            refused.step(env.action_space.sample())
        with pytest.raises(gym.error.ResetNeeded):
            refused.render()
    other = gym.make(env_id)
    other.reset(seed=0)
    env.unwrapped.set_state(other.unwrapped.get_state())
    with pytest.raises(gym.error.ResetNeeded):  # the time limit's wrapper does not know the episode
        env.step(env.action_space.sample())
    env.unwrapped.step(env.action_space.sample())


def test_steps_before_reset_and_wrong_shapes_are_refused():
    vector = gym.make_vec(SCALING, num_envs=2)
    with pytest.raises(gym.error.ResetNeeded):
        vector.step(np.zeros((2, 1)))
    vector.reset(seed=0)
    with pytest.raises(AmulettError, match=r"has to be \(2, 1\)"):
        vector.step(np.zeros(2))
    with pytest.raises(AmulettError, match=r"an action is no number: \['left', 'right'\]"):
        vector.step([["left"], ["right"]])
    before = vector.get_state()["episodes"]["simulation"]["states"].tobytes()
    with pytest.raises(AmulettError, match="action of device 1 is NaN"):
        vector.step(np.array([[0.5], [np.nan]]))
    assert vector.get_state()["episodes"]["simulation"]["states"].tobytes() == before


def test_next_episodes_are_those_of_a_reset_by_a_mask():
    one, other = (gym.make_vec("Amulett/Scaling-v0", num_envs=5, suite="mixed").unwrapped for _ in range(2))
    with pytest.raises(gym.error.ResetNeeded):
        one.next_episodes(np.array([1]))
    devices = np.array([0, 3])
    for env in (one, other):
        env.reset(seed=7)
        env.step(np.zeros((5, 1)))
    observations, info = one.next_episodes(devices)
    expected, expected_info = other.reset(options={"reset_mask": np.isin(np.arange(5), devices)})
    assert np.array_equal(observations, expected[devices])
    readings = [name for name, value in info.items() if isinstance(value, np.ndarray)]
    assert readings
    for name in readings:
        np.testing.assert_array_equal(info[name], expected_info[name][devices], name)
    actions = np.full((5, 1), 0.3)
    assert np.array_equal(one.step(actions)[0], other.step(actions)[0])


@pytest.mark.parametrize("devices", [np.array([True, False]), [0], np.array([0, 0]), np.array([2]), np.array([-1])])
def test_devices_that_are_no_indices_are_refused_and_nothing_changes(devices):
    env = gym.make_vec("Amulett/Scaling-v0", num_envs=2).unwrapped
    env.reset(seed=7)
    before = pickle.dumps(env.get_state())
    for wrong in (devices, np.zeros(0, dtype=np.int64)):
        with pytest.raises(AmulettError, match=r"indices from 0 to 1, at least one, all different"):
            env.next_episodes(wrong)
    assert pickle.dumps(env.get_state()) == before


def test_vector_seeds_and_autoreset():
    vector = gym.make_vec(SCALING, num_envs=3, max_episode_steps=5)
    assert vector.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    first, _ = vector.reset(seed=10)
    listed, _ = vector.reset(seed=[10, 11, 12])
    assert np.array_equal(first, listed)
    assert len(np.unique(first[:, 1])) == 3
    for _ in range(5):
        *_, truncated, _ = vector.step(np.zeros((3, 1)))
    assert truncated.all()
    observations, rewards, _, truncated, info = vector.step(np.ones((3, 1)))
    assert not truncated.any()
    assert (rewards == 0).all()
    assert (info["time"] == 0).all()
    assert not np.array_equal(observations, first)


def test_states_can_be_taken_and_put_back():
    for env in (gym.make(SCALING).unwrapped, gym.make_vec(SCALING, num_envs=3, max_episode_steps=30)):
        shape = (1,) if isinstance(env, gym.Env) else (3, 1)
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.zeros(shape))
        state = pickle.loads(pickle.dumps(env.get_state()))

        def follow(env=env, shape=shape):
            steps = [env.step(np.full(shape, 0.5))[0].tolist() for _ in range(40)]
            return steps, env.reset()[0].tolist()

        expected = follow()
        env.set_state(state)
        assert follow() == expected


def test_vector_copies_go_on_alike():
    vector = gym.make_vec(SCALING, num_envs=3)
    vector.reset(seed=0)
    vector.step(np.zeros((3, 1)))
    copy = pickle.loads(pickle.dumps(vector))
    assert np.array_equal(vector.step(np.ones((3, 1)))[0], copy.step(np.ones((3, 1)))[0])


def test_gymnasium_wrappers_take_the_vector_environment():
    from gymnasium.wrappers import vector as wrappers

    env = gym.make_vec(SCALING, num_envs=4, max_episode_steps=20)
    env = wrappers.RecordEpisodeStatistics(wrappers.NormalizeObservation(env))
    env.reset(seed=0)
    for _ in range(20):
        *_, info = env.step(np.zeros((4, 1), dtype=np.float32))
    assert (info["episode"]["l"] == 20).all()
    listed = wrappers.DictInfoToList(gym.make_vec(SCALING, num_envs=2))
    _, infos = listed.reset(seed=0)
    assert infos[1]["position_ise"] == 0.0


def test_an_action_is_reached_on_a_ramp_and_then_kept():
    env = gym.make("Amulett/Tension-v0", agent_period=0.1).unwrapped
    env.reset(seed=0)
    ticks = round(0.1 / env.profile.loop.control_period)
    setpoints = []
    for action in (-1.0, 1.0, 1.0):  # 4 N, then twice 15 N
        _, _, _, _, info = env.step(np.array([action], dtype=np.float32))
        setpoints.append(info["tension_setpoint"])
    assert setpoints == pytest.approx([4.0, 15.0, 15.0])
    assert env.episodes.simulation.read("tension_rate") == 0.0
    env.step(np.array([0.0], dtype=np.float32))
    assert env.episodes.simulation.read("tension_rate") == pytest.approx((9.5 - 15.0) / ticks)


@pytest.mark.parametrize("control", ["decentralized", "co-rotation"])
@pytest.mark.parametrize("suite", ["mixed", "contact"])
def test_the_reward_of_full_control_is_minus_its_cost(control, suite):
    env = gym.make("Amulett/Tension-v0", suite=suite, control=control, track="full-control", max_episode_steps=100)
    env.reset(seed=4)
    total, info = 0.0, {}
    for step in range(100):
        _, reward, _, _, info = env.step(np.float32([0.8 if step % 20 < 10 else -0.5]))
        assert info["reward_tension"] == 0.0
        total += reward
    raw = {name: np.array([value]) for name, value in info.items()}
    family = env.unwrapped.episodes.scenario(0)["family"]
    prices = control_prices(env.unwrapped.profile, suite)[[family]]
    assert control_cost(raw, np.zeros(1), prices)[0] == pytest.approx(-total, rel=1e-9)
    assert total < -0.001


def test_a_reward_function_gets_the_drives_effort_on_full_control():
    seen = []

    def own(costs, terms):
        seen.append(float(costs["effort"][0]))
        return -costs["position"]

    env = gym.make("Amulett/Tension-v0", track="full-control", reward_fn=own)
    env.reset(seed=1)
    for _ in range(30):
        *_, info = env.step(np.float32([0.3]))
    assert sum(seen) == pytest.approx(info["drive_effort"], rel=1e-9)


def test_weights_of_full_control_sum_to_one():
    for suite in ("steps", "contact"):
        weights = default_weights(suite, "full-control")
        assert weights["tension"] == 0.0
        assert sum(weights.values()) == pytest.approx(1.0)
