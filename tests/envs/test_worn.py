"""`Amulett/Worn-v0` keeps what its docstring promises."""

from __future__ import annotations

import inspect
import pickle
import re

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import ENV_IDS, FAILURES, WORN_ID
from amulett_gym.envs.rendering.frame import frame_of
from amulett_gym.envs.reward import COST_CAP
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.worn import WornEnv
from amulett_gym.envs.worn_reward import WORN_WEIGHTS, doffed_costs, worn_divisors
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.envs.worn_transition import METRICS, OBSERVATIONS, READINGS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.laws.contenders import Own
from amulett_gym.laws.policies import load_policy
from amulett_gym.profile import load_profile
from amulett_gym.tasks.worn_suites import WORN_SUITES

HELD = np.array([0.2, 0.5], dtype=np.float32)
REACH = {
    "initial_angle_deg": 30.0,
    "moves": [{"time": 0.1, "angle_deg": 50.0, "duration": 0.5}],
    "pushes": [{"time": 0.8, "duration": 0.3, "torque": -1.0, "rise": 0.1}],
    "noise_seed": 3,
}


def played(env, steps, action=HELD):
    return [env.step(action) for _ in range(steps)]


def test_docstring_names_all_terms_readings_and_metrics():
    text = WornEnv.__doc__ or ""
    documented = set(re.findall(r"`(\w+)`", text))
    assert documented >= {*METRICS, *READINGS, *WORN_WEIGHTS}
    for term, weight in WORN_WEIGHTS.items():
        assert f"`{term}` ({weight:g})" in text


def test_observation_is_what_the_table_says():
    env = gym.make(WORN_ID).unwrapped
    observation, info = env.reset(seed=0)
    assert dict(zip(OBSERVATIONS, observation.tolist(), strict=True))["assistance"] == info["assistance"] == 0.0
    observation, *_, info = played(env, 60)[-1]
    entry = dict(zip(OBSERVATIONS, observation.tolist(), strict=True))
    assert entry["time_since_move"] == 1.0  # it would tell when the wearer began to move
    assert entry["tension_setpoint"] == pytest.approx(0.2, abs=1e-6)
    assert info["tension_setpoint"] == pytest.approx(9.0)
    assert entry["assistance"] == info["assistance"] == 0.75
    assert entry["joint_angle"] * 150 == pytest.approx(info["joint_angle"], abs=1.0)
    assert -2.0 * entry["measured_cuff"] == pytest.approx(info["cuff_torque"], abs=0.1)
    assert entry["cuff_rate"] != 0.0


def test_the_device_knows_moves_that_it_makes_itself():
    env = gym.make(WORN_ID).unwrapped
    since = OBSERVATIONS.index("time_since_move")
    for guided, expected in ((True, 0.2), (False, 1.0)):
        env.reset(seed=0, options={"scenario": {**REACH, "wearer": {"guided": guided}}})
        assert played(env, 25)[-1][0][since] == pytest.approx(expected, abs=1e-6)


def test_assistance_moves_on_a_ramp_as_the_tension_does():
    env = gym.make(WORN_ID, agent_period=0.1, action_delay=10).unwrapped
    env.reset(seed=0)
    first, second = (info for *_, info in played(env, 2, np.array([1.0, 1.0], dtype=np.float32)))
    assert first["assistance"] == pytest.approx(1.0 - 10 / 40)
    assert first["tension_setpoint"] == pytest.approx(15.0 - 5.0 * 10 / 40)
    assert second["assistance"] == pytest.approx(1.0) and second["tension_setpoint"] == pytest.approx(15.0)


def test_returns_are_the_weighted_metrics_over_the_divisors():
    env = gym.make(WORN_ID, suite="reaches").unwrapped
    env.reset(seed=1)
    steps = played(env, 200)
    metrics, divisors = steps[-1][-1], worn_divisors(env.profile, "reaches")
    costs = {
        "muscle": metrics["muscle_effort"],
        "tracking": metrics["tracking_ise"],
        "cuff": metrics["moving_cuff_ise"],
        "drives": metrics["effort_biceps"] + metrics["effort_triceps"],
    }
    for term, cost in costs.items():
        total = sum(info[f"reward_{term}"] for *_, info in steps)
        assert total == pytest.approx(-WORN_WEIGHTS[term] * cost / divisors[term], rel=1e-9) and total < 0.0


def test_drives_are_charged_by_the_devices_own_pulleys():
    worn = load_profile("worn")
    larger = load_profile({"base": "worn", "name": "mine", "plant": {"joint_pulley_radius": 0.1}})
    for suite in WORN_SUITES:
        own, other = (worn_divisors(profile, suite) for profile in (worn, larger))
        assert other == {**own, "drives": pytest.approx(4.0 * own["drives"])}
        assert all(cost > 0.0 for cost in doffed_costs(suite).values())


def test_weights_and_a_reward_of_ones_own():
    plain, heavy = (gym.make(WORN_ID, reward_weights=weights).unwrapped for weights in (None, {"muscle": 1.0}))
    for env in (plain, heavy):
        env.reset(seed=0)
    mine, theirs = (played(env, 60)[-1][-1] for env in (plain, heavy))
    assert theirs == {**mine, "reward_muscle": pytest.approx(2 * mine["reward_muscle"])}
    own = gym.make(WORN_ID, reward_fn=lambda costs, terms: terms["muscle"] - costs["failure"] - costs["drives"])
    own.reset(seed=0)
    *_, (_, reward, _, _, info) = played(own, 60)
    plain.reset(seed=0)
    before, after = (info for *_, info in played(plain, 60)[-2:])
    drives = sum(after[name] - before[name] for name in ("effort_biceps", "effort_triceps"))
    assert reward == pytest.approx(info["reward_muscle"] - drives)


def test_failure_costs_as_in_the_other_environments():
    env = gym.make(WORN_ID)
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 60.0}]}
    env.reset(seed=0, options={"scenario": push})
    terminated, steps = False, 0
    while not terminated:
        steps += 1
        _, reward, terminated, _, info = env.step(HELD)
    assert FAILURES[info["failure"]] == "joint angle limit"
    assert reward <= -COST_CAP * (500 - steps)


def test_a_saved_episode_replays_with_its_wearer():
    env = gym.make(WORN_ID, suite="carry").unwrapped
    env.reset(seed=4)
    scenario = env.scenario
    assert scenario.wearer is not None and scenario.payload is not None
    first = [(o.tolist(), r) for o, r, *_ in played(env, 40)]
    env.reset(seed=9, options={"scenario": scenario.model_dump(mode="json")})
    assert [(o.tolist(), r) for o, r, *_ in played(env, 40)] == first
    env.reset(seed=9, options={"scenario": {**scenario.model_dump(mode="json"), "wearer": {"mass": 100.0}}})
    assert [(o.tolist(), r) for o, r, *_ in played(env, 40)] != first


def test_a_scenario_without_a_wearer_has_the_default_one():
    env = gym.make(WORN_ID).unwrapped
    env.reset(seed=0, options={"scenario": REACH})
    first = played(env, 60)[-1][-1]
    env.reset(seed=0, options={"scenario": {**REACH, "wearer": {}}})
    assert repr(played(env, 60)[-1][-1]) == repr(first)


def test_snapshots_continue_alike_and_are_refused_elsewhere():
    env = gym.make(WORN_ID).unwrapped
    env.reset(seed=2)
    played(env, 30)
    state = pickle.loads(pickle.dumps(env.get_state()))
    expected = [o.tolist() for o, *_ in played(env, 30)]
    other = gym.make(WORN_ID).unwrapped
    other.reset(seed=5)
    other.set_state(state)
    assert [o.tolist() for o, *_ in played(other, 30)] == expected
    bare = gym.make(ENV_IDS[1], control="equilibrium-point").unwrapped
    bare.reset(seed=0)
    with pytest.raises(AmulettError, match="not worn"):
        other.set_state(bare.get_state())


def test_a_snapshot_of_another_fitting_is_refused():
    softer = {"base": "worn", "name": "worn", "wearer": {"cuff": {"stiffness": 60.0}}}
    env, other = (gym.make(WORN_ID, profile=profile).unwrapped for profile in ("worn", softer))
    for each in (env, other):
        each.reset(seed=0)
    before = other.get_state()["episodes"]["simulation"]["worn"]
    with pytest.raises(AmulettError, match="group 'wearer' differs in stiffness$"):
        other.set_state(env.get_state())
    assert np.array_equal(other.get_state()["episodes"]["simulation"]["worn"], before)


@pytest.mark.parametrize(("split", "least"), [("train", "0.00055"), ("shifted", "0.00087")])
def test_periods_that_are_too_short_for_a_reflex_are_refused(split, least):
    def device(period):
        return {"base": "worn", "name": "fast", "loop": {"control_period": period}}

    with pytest.raises(AmulettError, match=rf"'fast' has a loop.control_period of 0.0005 s.*at least {least} s"):
        gym.make(WORN_ID, profile=device(5e-4), split=split)
    allowed = {"train": 0.000625, "shifted": 0.001}[split]
    env = gym.make_vec(WORN_ID, num_envs=64, profile=device(allowed), split=split)
    env.reset(seed=0)
    with pytest.raises(AmulettError, match=r"'fast' of the fleet|'fast' has a loop.control_period"):
        gym.make(WORN_ID, fleet=["worn", device(5e-4)], split=split)


def test_errors_of_a_fleet_name_device_and_wearer():
    stiff = {"base": "worn", "name": "stiff", "loop": {"substeps": 1}, "wearer": {"cuff": {"stiffness": 10_000.0}}}
    env = gym.make_vec(WORN_ID, num_envs=16, fleet=["worn", stiff])
    with pytest.raises(AmulettError, match=r"^the device 'stiff', wearer (8|9|1\d): with 'wearer.cuff.stiffness' 1"):
        env.reset(seed=0, options={"device": ["worn"] * 8 + ["stiff"] * 8})


def test_threads_and_batches_change_no_bit():
    actions = np.random.default_rng(1).uniform(-1, 1, (30, 40, 2)).astype(np.float32)
    found = []
    for threads in (1, 3):
        env = gym.make_vec(WORN_ID, num_envs=40, threads=threads, max_episode_steps=20)
        env.reset(seed=3)
        steps = [env.step(each) for each in actions]
        found.append([(o.tolist(), r.tolist(), repr(info)) for o, r, *_, info in steps])
        env.close()
    assert found[0] == found[1]
    single = gym.make(WORN_ID).unwrapped
    single.reset(seed=3 + 37)
    assert [single.step(each[37])[1] for each in actions[:20]] == [rewards[37] for _, rewards, _ in found[0][:20]]


def test_infos_of_single_and_vector_have_the_same_keys():
    single, vector = gym.make(WORN_ID), gym.make_vec(WORN_ID, num_envs=2)
    one, many = single.reset(seed=0)[1], vector.reset(seed=0)[1]
    assert list(one) == [key for key in many if not key.startswith("_")]
    assert one["elbow_angle"] == many["elbow_angle"][0]


def test_a_fleet_plays_on_each_of_its_devices():
    strong = {"base": "worn", "name": "strong", "wearer": {"cuff": {"stiffness": 40.0}}}
    env = gym.make_vec(WORN_ID, num_envs=16, fleet=["worn", strong])
    _, info = env.reset(seed=0)
    assert {env.devices[kind].name for kind in info["device"]} == {"worn", "strong"}
    rewards = env.step(np.zeros((16, 2), dtype=np.float32))[1]
    assert np.isfinite(rewards).all()


def test_a_frame_shows_the_device():
    env = gym.make(WORN_ID, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    _, *_, info = played(env, 5)[-1]
    assert np.degrees(frame_of(env.episodes, 0).joint_angle) == pytest.approx(info["joint_angle"])
    assert env.render().ndim == 3
    env.close()


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"suite": "steps"}, "unknown suite 'steps'.*assembly"),
        ({"control": "decentralized"}, "feeds the co-contraction forward.*equilibrium-point"),
        ({"control": "drives"}, "unknown control 'drives'"),
        ({"track": "full-control"}, "leave track out"),
        ({"privileged": True}, "leave privileged out"),
        ({"reward_weights": {"position": 1.0}}, "unknown reward weight 'position'.*muscle"),
        ({"profil": "worn"}, "profil"),
    ],
)
def test_wrong_keywords_are_refused(keywords, message):
    with pytest.raises(AmulettError, match=message):
        gym.make(WORN_ID, **keywords)


def test_docstring_and_settings_name_the_same_keywords():
    table = inspect.getdoc(WornEnv).partition("## Arguments")[2].partition("## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` +\| (\S.*?) +\|", table, re.M))
    defaults = {name: field.default for name, field in WornSettings.model_fields.items()}
    own = {
        name
        for name, field in WornSettings.model_fields.items()
        if field.default != Settings.model_fields[name].default
    }
    assert own | {"tension_law", "reward_weights", "track", "privileged"} == rows.keys()
    assert {name: default.strip('`"') for name, default in rows.items()} == {
        name: str(defaults[name]) for name in rows
    } | {"tension_range": "(0, 15)"}


def test_laws_and_bundles_of_other_environments_are_refused_and_functions_act():
    env = gym.make(WORN_ID)
    observation, _ = env.reset(seed=0)
    for name, message in (
        ("constant:10", "chooses a tension and cannot act in Amulett/Worn-v0"),
        ("equilibrium-point/constant:10", "cannot act in Amulett/Worn-v0"),
        ("pretrained", "needs an environment without a wearer; this is Amulett/Worn-v0"),
    ):
        with pytest.raises(AmulettError, match=message):
            load_policy(name, env)
    policy = load_policy(lambda observations: np.zeros((len(observations), 2)), env)
    assert env.step(policy(observation))[0].shape == (16,)
    with pytest.raises(AmulettError, match="has to be .1, 2."):
        load_policy(lambda observations: np.zeros(len(observations)), env)(observation)


def test_comparisons_refuse_the_environment():
    mine = Own("mine", act=lambda observations: np.zeros((len(observations), 2)), env_id=WORN_ID)
    with pytest.raises(AmulettError, match="'mine', which acts there alone, cannot be done in Amulett/Worn-v0"):
        evaluate([mine], episodes=2)
    with pytest.raises(AmulettError, match="cannot be done in Amulett/Worn-v0"):
        evaluate(["eq6"], episodes=2, env_id=WORN_ID)


def test_a_reset_that_fails_leaves_the_old_episode_with_its_wearer():
    env = gym.make(WORN_ID).unwrapped
    env.reset(seed=0)
    before = env.scenario
    high = {"initial_angle_deg": 80.0, "orientation": "vertical", "initial_tension": 21.6, "wearer": {"mass": 40.0}}
    with pytest.raises(AmulettError, match="starts with a string force"):
        env.reset(options={"scenario": high})
    assert env.scenario == before


def test_bare_environments_refuse_worn_suites_and_wearers():
    with pytest.raises(AmulettError, match=r"'assembly' is a suite of Amulett/Worn-v0.*'amulett wearer'"):
        gym.make(ENV_IDS[0], suite="assembly")
    env = gym.make(ENV_IDS[0]).unwrapped
    with pytest.raises(AmulettError, match="wearer"):
        env.reset(options={"scenario": {**REACH, "wearer": {}}})
