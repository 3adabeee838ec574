"""Contenders by name, and the policies that act from outside the loop."""

import gymnasium as gym
import numpy as np
import pytest
from helpers import make_bundle
from hypothesis import given, settings
from hypothesis import strategies as st

import amulett_gym
from amulett_gym import load_policy
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import contender_names, parse_contender
from amulett_gym.profile import load_profile

SCALING, TENSION = amulett_gym.ENV_IDS[:2]


def observation_at(error_deg: float) -> np.ndarray:
    observation = np.zeros(len(OBSERVATIONS), dtype=np.float32)
    observation[OBSERVATIONS.index("position_error")] = error_deg / 90.0
    return observation


def play(env: gym.Env, policy, steps: int, seed: int = 0) -> list[dict]:
    observation, _ = env.reset(seed=seed)
    infos = []
    for _ in range(steps):
        observation, *_, info = env.step(policy(observation))
        infos.append(info)
    return infos


@pytest.mark.parametrize(
    ("name", "keywords", "policy"),
    [
        ("eq6", {"tension_law": "eq6"}, None),
        ("eq6-printed", {"tension_law": "eq6-printed"}, None),
        ("position-only", {"control": "position-only"}, None),
        ("eq6-held", {}, "eq6-held"),
        ("constant:8.5", {}, "constant:8.5"),
    ],
)
def test_a_contender_is_environment_keywords_and_a_policy(name, keywords, policy):
    contender = parse_contender(name)
    assert (contender.name, contender.env_keywords, contender.policy_name) == (name, keywords, policy)
    env = gym.make(SCALING, **contender.env_keywords)
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])


def test_every_listed_name_can_be_parsed():
    for name in contender_names():
        if "<" not in name:
            assert parse_contender(name).name == name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("eq7", "did you mean 'eq6'"),
        ("constant", "did you mean 'constant:<N>'"),
        ("constant:", "has to name a tension in N of at least 0"),
        ("constant:ten", "has to name a tension in N of at least 0"),
        ("constant:-3", "has to name a tension in N of at least 0"),
        ("constant:inf", "has to name a tension in N of at least 0"),
        ("./nowhere", "does not exist"),
        ("", "choose from"),
    ],
)
def test_a_wrong_name_is_refused_with_what_would_be_right(name, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AmulettError, match=message) as refused:
        parse_contender(name)
    if name != "":
        assert name in str(refused.value)


def test_a_folder_or_file_without_a_bundle_is_refused(tmp_path):
    with pytest.raises(AmulettError, match="holds no policy bundle"):
        parse_contender(str(tmp_path))
    (tmp_path / "policy.zip").write_bytes(b"")
    with pytest.raises(AmulettError, match="is a file"):
        parse_contender(str(tmp_path / "policy.zip"))


@pytest.mark.parametrize("env_id", [SCALING, TENSION])
@pytest.mark.parametrize("tension", [4.0, 10.0, 15.0])
def test_a_constant_commands_its_tension_in_both_environments(env_id, tension):
    env = gym.make(env_id)
    for info in play(env, amulett_gym.load_policy(f"constant:{tension}", env), 3):
        assert info["tension_setpoint"] == pytest.approx(tension, abs=1e-5)


def test_a_constant_out_of_the_actions_reach_is_refused():
    with pytest.raises(AmulettError, match=r"3 N.*from 4 to 15 N"):
        amulett_gym.load_policy("constant:3", gym.make(SCALING))
    with pytest.raises(AmulettError, match=r"12 N.*from 6 to 9 N"):
        amulett_gym.load_policy("constant:12", gym.make(TENSION, tension_range=(6, 9)))


@settings(deadline=None)  # the first example may compile
@given(error_deg=st.floats(-90, 90))
def test_eq6_held_is_the_equation(error_deg):
    env = gym.make(TENSION)
    law = load_profile("testbed").variable_stiffness
    lowest = law.minimum_tension / law.nominal_tension
    distance = abs(error_deg) - law.error_offset_deg
    text = (1 - lowest) / law.error_offset_deg**4 * min(distance, 0) ** 4 + lowest
    printed = min((1 - lowest) / law.error_offset_deg**4 * error_deg**4 + lowest, 1)
    for name, factor in (("eq6-held", text), ("eq6-held-printed", printed)):
        action = amulett_gym.load_policy(name, env)(observation_at(error_deg))
        tension = 4 + (action[0] + 1) / 2 * 11
        assert tension == pytest.approx(factor * law.nominal_tension, abs=1e-4)


@pytest.mark.parametrize("law", ["eq6", "eq6-printed"])
def test_eq6_from_outside_at_control_rate_is_eq6_inside_the_loop(law):
    period = load_profile("testbed").loop.control_period
    outside = gym.make(SCALING, agent_period=period)
    inside = gym.make(SCALING, agent_period=period, tension_law=law)
    policy = amulett_gym.load_policy(law.replace("eq6", "eq6-held"), outside)
    pairs = list(zip(play(outside, policy, 400), play(inside, lambda _: np.zeros(1), 400), strict=True))
    assert max(abs(a["tension_setpoint"] - b["tension_setpoint"]) for a, b in pairs) < 1e-3
    assert max(abs(a["joint_angle"] - b["joint_angle"]) for a, b in pairs) < 1e-3
    assert np.ptp([a["tension_setpoint"] for a, _ in pairs]) > 3


@pytest.mark.parametrize("name", ["constant:9", "eq6-held", "eq6-held-printed"])
def test_a_batch_gives_what_its_rows_give(name):
    env = gym.make_vec(SCALING, num_envs=7)
    policy = amulett_gym.load_policy(name, env)
    observations, _ = env.reset(seed=3)
    batch = policy(observations)
    assert batch.shape == (7, 1)
    assert batch.dtype == np.float32
    for observation, action in zip(observations, batch, strict=True):
        single = policy(observation)
        assert single.shape == (1,)
        assert single == action
    assert env.action_space.contains(batch)


def test_policies_work_on_wrapped_environments():
    env = gym.wrappers.TimeLimit(gym.make(SCALING), 10)
    assert env.action_space.contains(amulett_gym.load_policy("eq6-held", env)(env.reset(seed=0)[0]))


def test_eq6_that_the_action_cannot_reach_is_refused():
    with pytest.raises(AmulettError, match=r"eq\. 6 needs 4 to 10 N.*from 5 to 9 N"):
        amulett_gym.load_policy("eq6-held", gym.make(TENSION, tension_range=(5, 9)))


def test_eq6_of_errors_that_cannot_be_observed_is_refused():
    profile = {"base": "testbed", "variable_stiffness": {"error_offset_deg": 120.0}}
    with pytest.raises(AmulettError, match="90 deg"):
        amulett_gym.load_policy("eq6-held", gym.make(SCALING, profile=profile))


def test_other_environments_and_shapes_are_refused():
    with pytest.raises(AmulettError, match="AMULETT environment"):
        amulett_gym.load_policy("eq6-held", gym.make("Pendulum-v1"))
    policy = amulett_gym.load_policy("constant:10", gym.make(SCALING))
    for wrong in (np.zeros(12), np.zeros((2, 3, 13)), 1.0):
        with pytest.raises(AmulettError, match="shape"):
            policy(wrong)


def test_a_policy_of_a_loop_is_for_an_environment_with_it(tmp_path):
    env, papers = gym.make(SCALING, control="cascade"), gym.make(SCALING)
    observation, _ = env.reset(seed=0)
    assert load_policy("cascade/constant:10", env)(observation) == load_policy("constant:10", env)(observation)
    with pytest.raises(AmulettError, match="acts in the loop 'cascade', and this environment's is 'decentralized'"):
        load_policy("cascade/constant:10", papers)
    with pytest.raises(AmulettError, match="acts in the loop 'decentralized', and this environment's is 'cascade'"):
        load_policy("decentralized/constant:10", env)
    folder = make_bundle(tmp_path / "mine", keywords={"control": "cascade"}, tension_range=[0.0, 15.0])
    assert load_policy(folder, env)(observation).shape == (1,)
    with pytest.raises(AmulettError, match="made for the loop 'cascade': make one with control='cascade'"):
        load_policy(folder, papers)
