"""The environments' keywords: what is accepted, what is refused and how, and what is kept of them."""

from __future__ import annotations

import inspect
import json
import math
import re
import warnings

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym import ENV_IDS
from amulett_gym.envs.reward import COST_TERMS
from amulett_gym.envs.settings import NO_LIMIT, Settings, VectorSettings
from amulett_gym.envs.single import ScalingEnv, TensionEnv
from amulett_gym.envs.vector import ScalingVectorEnv, TensionVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import TrainingEnv

SCALING, TENSION = ENV_IDS[:2]
EVERY = (ScalingEnv, TensionEnv, ScalingVectorEnv, TensionVectorEnv)
VECTOR_ONLY = ("num_envs", "max_episode_steps", "threads")

NUMBERS = st.one_of(
    st.integers(-2, 600), st.floats(), st.none(), st.booleans(), st.just("7"), st.sampled_from([10**400, -(10**400)])
)
KINDS = (lambda number: number, np.float32, np.float64, np.int64, np.array, lambda number: (number,))


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"suite": "stepz"}, "unknown suite 'stepz'.*did you mean 'steps'"),
        ({"profile": "testbet"}, "did you mean 'testbed'"),
        ({"profile": 3}, "profile is 3"),
        ({"split": "test"}, "unknown split 'test'"),
        ({"control": "centralized"}, "did you mean 'decentralized'"),
        ({"control": 3}, "'control' is 3"),
        ({"tension_law": "eq7"}, "did you mean 'eq6'"),
        ({"reward_weights": {"efort": 1.0}}, "did you mean 'effort'"),
        ({"reward_weights": {"effort": -1.0}}, "'effort' is -1.0; it has to be from 0 to"),
        ({"reward_weights": {"effort": math.nan}}, "'reward_weights.effort' is nan"),
        ({"reward_weights": [1.0]}, "'reward_weights'.*dictionary"),
        ({"reward_fn": "mine"}, "'reward_fn' is 'mine'.*callable"),
        ({"tension_range": (2.0, 1.0)}, "0 <= low < high"),
        ({"tension_range": 3.0}, "'tension_range' is 3.0"),
        ({"tension_range": (1.0, 1e7)}, "at most 1,000,000 N"),
        ({"agent_period": 0.0111}, r"multiple of the profile's control period, 0\.0\d+ s; the nearest is 0\.01\d* s"),
        ({"agent_period": -1.0}, "'agent_period' is -1.0"),
        ({"agent_period": math.nan}, "'agent_period' is nan"),
        ({"agent_period": math.inf}, "'agent_period' is inf"),
        ({"agent_period": "fast"}, "'agent_period' is 'fast'"),
        ({"action_delay": -1}, "'action_delay' is -1"),
        ({"action_delay": 0.5}, "'action_delay' is 0.5"),
        ({"action_delay": 8}, "action_delay is 8 control ticks; an agent period of 0.02 s has 8: .* from 0 to 7"),
        ({"action_delay": 1, "tension_law": "eq6"}, "action_delay is 1; with tension_law='eq6' .*it has to be 0"),
        ({"observation_noise": -0.1}, "'observation_noise' is -0.1"),
        ({"observation_noise": None}, "'observation_noise' is None"),
        ({"failure_horizon": 0}, "'failure_horizon' is 0"),
        ({"failure_horizon": 1.5}, "'failure_horizon' is 1.5.*integer"),
        ({"privileged": 1}, "'privileged' is 1"),
        ({"render_mode": "ansi"}, "unknown render_mode 'ansi'"),
        ({"suiet": "steps"}, "unexpected keyword argument 'suiet'; did you mean 'suite'"),
    ],
)
def test_wrong_keywords_are_refused_alike(keywords, message):
    for make in EVERY:
        with pytest.raises(AmulettError, match=message) as refused:
            make(**keywords)
        assert str(refused.value).startswith(make.env_id)
        assert isinstance(refused.value, TypeError) == ("unexpected keyword argument" in message)  # as Python's own


@pytest.mark.parametrize("keyword", [{"autoreset_mode": "SameStep"}, {"threads": 2}])
def test_single_environments_say_which_take_a_keyword_of_the_vector_ones(keyword):
    with pytest.raises(AmulettError, match="only the native vector environments take it.*vector_kwargs"):
        gym.make_vec("Amulett/Scaling-v0", 2, vectorization_mode="sync", **keyword)


@pytest.mark.parametrize("steps", [0, -2, 100.5, math.nan, math.inf, True, "100"])
def test_wrong_time_limits_are_refused(steps):
    with pytest.raises(AmulettError, match=f"'max_episode_steps' is {re.escape(repr(steps))}"):
        gym.make_vec(SCALING, max_episode_steps=steps)


def test_time_limits_mean_what_they_mean_in_gymnasium():
    none, default = (gym.make_vec(SCALING, max_episode_steps=steps) for steps in (NO_LIMIT, None))
    assert (none.max_episode_steps, default.max_episode_steps) == (-1, 500)
    singles = [gym.make(SCALING, max_episode_steps=steps) for steps in (NO_LIMIT, None)]
    for env in (none, default, *singles):
        env.reset(seed=0)
    limits = []
    for env in (none, default, *singles):
        shape = (1, 1) if env in (none, default) else (1,)
        limits.append([bool(env.step(np.zeros(shape))[3]) for _ in range(501)].count(True))
    assert limits == [0, 1, 0, 2]  # the vector environment begins anew instead of truncating once more
    assert gym.make_vec(SCALING, max_episode_steps=np.int64(7)).max_episode_steps == 7
    assert gym.make_vec(SCALING, max_episode_steps=7.0).max_episode_steps == 7


def test_numbers_are_numbers_and_sequences_are_sequences():
    given_ = {
        "reward_weights": {"position": np.float32(0.5), "effort": np.int64(1)},
        "failure_horizon": np.int64(60),
        "agent_period": np.float64(0.04),
        "action_delay": np.int64(3),
        "observation_noise": 0,
        "privileged": np.bool_(True),
    }
    for tension_range in ([5, 9], (5, 9), np.array([5, 9]), (np.float32(5), np.int8(9))):
        for make in EVERY:
            settings = make(**given_, tension_range=tension_range).settings
            assert settings.tension_range == (5.0, 9.0) and settings.failure_horizon == 60
            assert settings.reward_weights == {"position": 0.5, "effort": 1.0}
            kept = settings.keywords()
            assert json.loads(json.dumps(kept)) == kept
            assert make(**kept).settings == settings


def test_a_profile_can_be_a_path(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nbase: testbed\nloop: {offset_deg: 25.0}\n")
    for profile in (path, str(path)):
        env = ScalingEnv(profile=profile)
        assert env.profile.loop.offset_deg == 25.0
        assert TensionEnv(**env.settings.keywords()).profile == env.profile  # whole, not by its path
    assert ScalingEnv(profile="simulation").settings.keywords() == {"profile": "simulation"}


@given(st.sampled_from(sorted(VectorSettings.model_fields.keys() - {"profile", "render_mode", "reward_fn"})), st.data())
def test_whatever_is_accepted_can_be_kept_and_makes_the_same_environment(name, data):
    number, kind = data.draw(NUMBERS), data.draw(st.sampled_from(KINDS))
    try:
        with np.errstate(over="ignore"):
            value = kind(number)
    except (TypeError, ValueError, OverflowError):  # no such number in NumPy
        return
    value = {"effort": value} if name == "reward_weights" else (value, 9.0) if name == "tension_range" else value
    try:
        settings = VectorSettings.read({name: value})
    except AmulettError as error:
        assert name in str(error)
        return
    kept = TrainingEnv(id=SCALING, keywords=settings.keywords(), max_episode_steps=settings.max_episode_steps)
    again = TrainingEnv.model_validate_json(kept.model_dump_json())
    assert Settings.read(again.keywords).keywords() == settings.keywords()
    assert getattr(VectorSettings.read(again.keywords), name) == getattr(settings, name) or name in VECTOR_ONLY


def test_the_action_range_is_deprecated_and_means_what_it_did():
    wanted = {"profile": {"name": "mine", "base": "testbed", "variable_stiffness": {"nominal_tension": 8.0}}}
    for env_id, action_range in ((SCALING, [0.5, 1.25]), (TENSION, (4.0, 10.0))):
        for make in (gym.make, gym.make_vec):
            with pytest.warns(DeprecationWarning, match="use tension_range") as warned:
                env = make(env_id, action_range=action_range, **wanted)
            assert env.unwrapped.tension_range == (4.0, 10.0)
            assert {warning.filename for warning in warned} == {__file__}  # where it was written
    with pytest.warns(DeprecationWarning), pytest.raises(AmulettError, match="give tension_range only"):
        ScalingEnv(action_range=(0.4, 1.5), tension_range=(4.0, 15.0))
    with pytest.warns(DeprecationWarning), pytest.raises(AmulettError, match="action_range is 3.0; .* a pair"):
        ScalingEnv(action_range=3.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for env_id in ENV_IDS:
            assert gym.make(env_id, tension_range=(5.0, 12.0)).unwrapped.tension_range == (5.0, 12.0)


def test_signature_docstring_and_settings_name_the_same_keywords():
    shown = inspect.signature(ScalingEnv).parameters
    assert {name: parameter.default for name, parameter in shown.items()}["agent_period"] == 0.02
    assert all(parameter.kind is inspect.Parameter.KEYWORD_ONLY for parameter in shown.values())
    table = inspect.getdoc(ScalingEnv).partition("## Arguments")[2].partition("## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` +\| (\S.*?) +\|", table, re.M))
    assert rows.keys() == shown.keys() == Settings.model_fields.keys()
    for name, default in rows.items():
        assert str(list(shown[name].default) if name == "tension_range" else shown[name].default) in (
            default.strip('`"'),
            "[4.0, 15.0]" if default == "(4, 15)" else "",
        )
    assert inspect.signature(ScalingVectorEnv).parameters.keys() == VectorSettings.model_fields.keys()
    assert all(field.description for field in VectorSettings.model_fields.values())


# --- a reward of the user's own


def rooted(costs, terms):
    return -((costs["position"] / 50.0) ** 0.7) + np.tanh(terms["effort"]) - np.exp(costs["tension"] / 1e4) * 1e-3


def default(costs, terms):
    return sum(terms.values())


def test_a_reward_function_gives_the_single_and_the_vector_environment_the_same_bits():
    count, steps = 11, 60
    keywords = {"suite": "mixed", "reward_fn": rooted}
    vector = gym.make_vec(SCALING, num_envs=count, threads=2, max_episode_steps=steps, **keywords)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, count, 1))
    vector.reset(seed=5)
    rewards = np.array([vector.step(action)[1] for action in actions])
    assert (rewards < 0).all() and len(np.unique(rewards[40:])) > 100
    for i in range(count):
        single = gym.make(SCALING, **keywords)
        single.reset(seed=5 + i)
        assert [single.step(action[i])[1] for action in actions] == rewards[:, i].tolist()
    assert (vector.step(np.zeros((count, 1)))[1] == 0).all()  # the next episodes begin


def test_a_reward_function_gets_the_raw_costs_and_the_terms_of_the_default_reward():
    seen = []

    def watch(costs, terms):
        seen.append((costs, terms))
        return default(costs, terms)

    plain, own = gym.make(SCALING, suite="contact"), gym.make(SCALING, suite="contact", reward_fn=watch)
    for env in (plain, own):
        env.reset(seed=3)
    for _ in range(120):
        expected, (_, reward, _, _, info) = plain.step([0.3]), own.step([0.3])
        assert reward == expected[1] and info == expected[4]
        assert all(float(term[0]) == info[f"reward_{name}"] for name, term in seen[-1][1].items())
    totals = {name: sum(float(costs[name][0]) for costs, _ in seen) for name in (*COST_TERMS, "failure")}
    assert totals == pytest.approx(
        {
            "position": info["position_ise"],
            "effort": info["effort_biceps"] + info["effort_triceps"],
            "tension": info["tension_ise"],
            "contact": info["contact_ise"],
            "failure": 0.0,
        }
    )
    assert totals["position"] > 0 and totals["effort"] > 0


@pytest.mark.parametrize("count", [None, 1])
def test_a_reward_function_may_keep_the_terms(count):
    kept, then = [], []

    def keep(costs, terms):
        kept.append(terms)
        then.append({name: term.copy() for name, term in terms.items()})
        return default(costs, terms)

    env = gym.make(SCALING, reward_fn=keep) if count is None else gym.make_vec(SCALING, count, reward_fn=keep)
    env.reset(seed=0)
    for _ in range(60):
        env.step(np.zeros(env.action_space.shape))
    assert kept == then and len({float(terms["position"][0]) for terms in kept}) > 20


def test_a_reward_function_sees_a_failure_and_an_episode_that_begins_in_the_middle():
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
    env = gym.make(SCALING, reward_fn=lambda costs, terms: -costs["failure"])
    env.reset(seed=0, options={"scenario": push})
    rewards, terminated = [], False
    while not terminated:
        _, reward, terminated, _, _ = env.step([0.0])
        rewards.append(reward)
    assert rewards[-1] == -1.0 and not any(rewards[:-1])
    env = ScalingEnv(reward_fn=rooted)
    env.reset(seed=0)
    for _ in range(40):
        env.step([0.2])
    state = env.get_state()
    first = [env.step([-0.2])[1] for _ in range(5)]
    env.set_state(state)
    assert [env.step([-0.2])[1] for _ in range(5)] == first


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda costs, terms: 0.0, r"the shape \(\); .* in the shape \(2,\)"),
        (lambda costs, terms: costs["position"] * math.nan, "returned nan; .* finite"),
        (lambda costs, terms: None, "returned None|the shape"),
        (lambda costs, terms: terms, "returned {"),
        (lambda costs, terms: ["a", "b"], "an array of numbers"),
    ],
)
def test_what_a_reward_function_may_not_return_is_refused(wrong, message):
    env = gym.make_vec(SCALING, num_envs=2, reward_fn=wrong)
    env.reset(seed=0)
    with pytest.raises(AmulettError, match=message):
        env.step(np.zeros((2, 1)))


def test_with_a_reward_function_the_spec_is_no_json_and_without_it_is():
    with pytest.raises(TypeError, match="not JSON serializable"):
        gym.make(SCALING, reward_fn=rooted).spec.to_json()
    assert "reward_fn" not in gym.make(SCALING, reward_fn=rooted).unwrapped.settings.keywords()
    spec = gym.make(SCALING, tension_range=[5.0, 9.0], reward_weights={"contact": 0.1}).spec
    again = gym.envs.registration.EnvSpec.from_json(spec.to_json())
    assert again == spec and gym.make(again).unwrapped.tension_range == (5.0, 9.0)


# --- resets of none of the devices


@pytest.mark.parametrize("scenario", [None, {}, []])
@pytest.mark.parametrize("started", [True, False])
def test_a_mask_of_no_device_resets_nothing_and_gives_the_same_keys(started, scenario):
    vector = gym.make_vec(SCALING, num_envs=3).unwrapped
    options = {"reset_mask": np.zeros(3, dtype=bool)} | ({} if scenario is None else {"scenario": scenario})
    expected = gym.make_vec(SCALING, num_envs=3).reset(seed=1)[1]
    if started:
        vector.reset(seed=1)
        seen = vector.step(np.full((3, 1), 0.3))[0]
    before = vector.get_state()
    observations, info = vector.reset(seed=7, options=options)
    assert observations.shape == (3, 13) and list(info) == list(expected)
    after = vector.get_state()
    for key in ("states", "scenarios"):
        assert after["episodes"]["simulation"][key].tobytes() == before["episodes"]["simulation"][key].tobytes()
    if started:
        assert np.array_equal(observations, seen)
        vector.step(np.zeros((3, 1)))
    else:
        with pytest.raises(gym.error.ResetNeeded):
            vector.step(np.zeros((3, 1)))


def test_a_float32_agent_period_is_the_multiple_it_stands_for():
    env = ScalingEnv(agent_period=np.float32(0.02))
    assert env.episodes.agent_period == pytest.approx(0.02, rel=1e-12)


def test_slack_strings_need_a_loop_that_feeds_the_co_contraction_forward():
    assert Settings.read({"control": "co-rotation"}).tension_range == (0.0, 15.0)
    assert Settings.read({"control": "co-rotation", "tension_range": (5.0, 9.0)}).tension_range == (5.0, 9.0)
    assert Settings.read({}).tension_range == (4.0, 15.0)
    with pytest.raises(AmulettError, match="the loop 'decentralized' needs a range above 0 N"):
        Settings.read({"tension_range": (0.0, 15.0)})
    with pytest.raises(AmulettError, match="did you mean 'co-rotation'"):
        Settings.read({"control": "co-rotatoin"})


def test_the_track_full_control_has_no_weight_of_the_tension():
    with pytest.raises(AmulettError, match="gives the tension 1; the track full-control has no such term"):
        Settings.read({"track": "full-control", "reward_weights": {"tension": 1.0}})
    assert Settings.read({"track": "full-control", "reward_weights": {"tension": 0.0}}).track == "full-control"
