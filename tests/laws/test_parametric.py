"""Laws with parameters to tune: what they are without tuning, and what they can never do."""

import json
from importlib.resources import files

import gymnasium as gym
import numpy as np
import pytest
from helpers import EXACT_SENSORS, device, start
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import amulett_gym
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.laws import parametric
from amulett_gym.laws.contenders import contender_names, parse_contender
from amulett_gym.laws.parametric import (
    EQ6_TUNED,
    LAWS,
    PARAMETRIC,
    RANGE,
    Device,
    _external_torque,
    _squash,
    tuned_content,
    tuned_names,
    tuned_over,
    tuned_vector,
)
from amulett_gym.profile import load_profile

TENSION = amulett_gym.ENV_IDS[1]
TESTBED = Device.of(load_profile("testbed"), 0.02)
WIDTHS = {"error_width": 15.0, "speed_width": 60.0, "early_time": 0.3, "torque_width": 0.1}

observations = arrays(np.float32, (5, len(OBSERVATIONS)), elements=st.floats(-1.0, 1.0, width=32))
laws = pytest.mark.parametrize("law", LAWS.values(), ids=list(LAWS))


def parameters(**values):
    """Return the parameters of a law without gains that follows at once, but for what is given."""
    none = {parameter.name: 0.0 for parameter in PARAMETRIC.parameters if parameter.name.endswith("_gain")}
    return PARAMETRIC.vector({**none, **WIDTHS, "base": 8.0, "rise_time": 0.002, "fall_time": 0.002, **values})[None]


def observed(**entries):
    observation = np.zeros((1, len(OBSERVATIONS)))
    for name, value in entries.items():
        observation[0, OBSERVATIONS.index(name)] = value
    return observation


@settings(deadline=None)  # the first one compiles
@given(st.floats(-90.0, 90.0))
def test_eq6_with_the_papers_parameters_is_the_papers_law(error_deg):
    paper = EQ6_TUNED.vector({"nominal_tension": 10, "minimum_tension": 4, "error_offset": 30, "exponent": 4})
    row = observed(position_error=np.float32(error_deg / 90.0)).astype(np.float32)
    action = amulett_gym.load_policy("eq6-held", gym.make(TENSION))(row)[0, 0]
    tension = EQ6_TUNED.tensions(row, paper[None], TESTBED, RANGE)[0]
    assert tension == pytest.approx(4.0 + 5.5 * (action + 1.0), abs=1e-5)


@laws
@settings(deadline=None)
@given(rows=observations, points=arrays(float, (5, len(PARAMETRIC.parameters)), elements=st.floats(0.0, 1.0)))
def test_tensions_stay_in_their_range_whatever_is_seen_and_tuned(law, rows, points):
    tensions = law.tensions(rows, law.from_unit(points[:, : len(law.parameters)]), TESTBED, (2.0, 20.0))
    assert ((tensions >= RANGE[0]) & (tensions <= RANGE[1])).all()


@laws
@settings(deadline=None)
@given(rows=observations, seed=st.integers(0, 99))
def test_each_row_may_have_its_own_parameters(law, rows, seed):
    vectors = law.from_unit(np.random.default_rng(seed).uniform(size=(5, len(law.parameters))))
    together = law.tensions(rows, vectors, TESTBED, RANGE)
    alone = [law.tensions(rows[k : k + 1], vectors[k : k + 1], TESTBED, RANGE)[0] for k in range(5)]
    assert together.tolist() == alone


@laws
def test_the_unit_cube_covers_every_parameters_range(law):
    points = np.random.default_rng(1).uniform(size=(20, len(law.parameters)))
    np.testing.assert_allclose(law.to_unit(law.from_unit(points)), points, atol=1e-9)
    for corner, bound in ((0.0, "low"), (1.0, "high")):
        expected = [getattr(parameter, bound) for parameter in law.parameters]
        np.testing.assert_allclose(law.from_unit(np.full(len(law.parameters), corner)), expected)
    named = dict(zip((parameter.name for parameter in law.parameters), law.start(), strict=True))
    assert law.vector(named).tolist() == law.start().tolist()


def test_without_gains_the_law_is_a_constant():
    rows = np.random.default_rng(2).uniform(-1, 1, (50, len(OBSERVATIONS)))
    rows[:, OBSERVATIONS.index("tension_setpoint")] = 2.0 * (8.0 - 4.0) / 11.0 - 1.0
    np.testing.assert_allclose(PARAMETRIC.tensions(rows, parameters(), TESTBED, RANGE), 8.0, atol=1e-4)


def test_the_tension_follows_at_one_rate_up_and_at_another_down():
    for last, expected in ((6.0, 6.0 + 2.0 * 0.02 / 0.12), (10.0, 10.0 - 2.0 * 0.02 / 0.42)):
        row = observed(tension_setpoint=2.0 * (last - 4.0) / 11.0 - 1.0)
        tension = PARAMETRIC.tensions(row, parameters(rise_time=0.1, fall_time=0.4), TESTBED, RANGE)[0]
        assert tension == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("gain", "seen", "other"),
    [
        ("error_gain", {"position_error": 1.0}, {}),
        ("direction_gain", {"position_error": 1.0}, {"position_error": -1.0}),
        ("switch_gain", {"position_error": 1.0, "agonist": -1.0}, {"position_error": 1.0, "agonist": 1.0}),
        ("speed_gain", {"joint_velocity": 1.0}, {}),
        (
            "approach_gain",
            {"position_error": 1.0, "joint_velocity": 0.5},
            {"position_error": 1.0, "joint_velocity": -0.5},
        ),
        ("early_gain", {}, {"time_since_move": 1.0}),
        ("early_error_gain", {"position_error": 1.0}, {"position_error": 1.0, "time_since_move": 1.0}),
        ("early_direction_gain", {"position_error": 1.0}, {"position_error": -1.0}),
        ("torque_gain", {"estimated_tension_triceps": 0.5}, {}),
        (
            "help_gain",
            {"position_error": 1.0, "estimated_tension_triceps": 0.5},
            {"position_error": 1.0, "estimated_tension_biceps": 0.5},
        ),
        ("angle_gain", {"joint_angle": 0.6}, {}),
    ],
)
def test_each_gain_raises_the_tension_where_it_says(gain, seen, other):
    vector = parameters(**{gain: 3.0})
    here, there = (PARAMETRIC.tensions(observed(**row), vector, TESTBED, RANGE)[0] for row in (seen, other))
    assert here - there > 1.0


def test_the_external_torque_is_the_push_on_an_arm_at_rest():
    profile = device("testbed", sensors={**EXACT_SENSORS, "force_floor": 0.0})
    arm = start(profile, {"pushes": [{"time": 0.0, "duration": 30.0, "torque": 0.1}]})
    arm.command_tension(10.0)
    arm.advance(round(20.0 / arm.control_period))
    estimates = [np.float64(arm.read(f"estimate_{side}")[0]) for side in ("biceps", "triceps")]
    assert arm.read("velocity")[0] == pytest.approx(0.0, abs=1e-3)
    torque = _external_torque(Device.of(profile, 0.02).constants, *estimates, 0.0)
    assert torque == pytest.approx(0.1, abs=0.005)


def test_the_squash_is_a_smooth_clip():
    wanted = np.linspace(-20.0, 40.0, 601)
    tensions = np.array([_squash(value, *RANGE) for value in wanted])
    assert (np.diff(tensions) >= 0.0).all()
    assert np.abs(tensions - np.clip(wanted, *RANGE)).max() < 0.5
    inner = (wanted > 5.1) & (wanted < 13.9)
    assert np.abs(tensions - wanted)[inner].max() < 0.1


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"error_offset": 300.0}, "'error_offset' is 300.0 deg; it has to be from 2 to 90"),
        ({"offset": 30.0}, "did you mean 'error_offset'"),
        ({"exponent": float("nan")}, "'exponent' is nan"),
    ],
)
def test_wrong_parameters_are_refused(changed, message):
    right = dict(zip((parameter.name for parameter in EQ6_TUNED.parameters), EQ6_TUNED.start(), strict=True))
    with pytest.raises(AmulettError, match=message):
        EQ6_TUNED.vector({**right, **changed})


SHIPPED = [name.split(":") for name in tuned_names() if ":" in name and not tuned_over(name)]


def test_both_laws_are_shipped_as_tuned_on_the_mix_and_on_the_default_suite():
    assert {(law, suite) for law in ("eq6-tuned", "parametric") for suite in ("mixed", "steps")} == {
        tuple(pair) for pair in SHIPPED
    }
    assert "constant" not in tuned_names()  # a constant has its own name, with its tension


@pytest.mark.parametrize("name", tuned_names())
def test_a_tuned_law_is_a_contender_like_any_other(name):
    assert name in contender_names()
    assert parse_contender(name).policy_name == name
    env = gym.make(TENSION, suite="steps")
    policy = amulett_gym.load_policy(name, env)
    assert env.action_space.contains(policy(env.reset(seed=0)[0]))


def test_a_bare_name_means_the_law_tuned_on_the_mix_wherever_it_acts():
    rows = np.random.default_rng(3).uniform(-1, 1, (50, len(OBSERVATIONS))).astype(np.float32)
    for suite in ("steps", "hold-push"):
        env = gym.make(TENSION, suite=suite)
        bare, mixed, steps = (
            amulett_gym.load_policy(f"parametric{tuned}", env)(rows) for tuned in ("", ":mixed", ":steps")
        )
        assert (bare == mixed).all()
        assert (bare != steps).any()


def test_tuned_laws_are_compared_with_the_others():
    results = evaluate(["eq6-tuned", "parametric:steps", "constant:6"], episodes=10)
    cost = {name: values["cost"].mean() for name, values in results.values.items()}
    assert cost["parametric:steps"] < cost["constant:6"] < cost["eq6"]
    assert set(results.schedules) == {"eq6-tuned", "parametric:steps", "constant:6"}


def test_what_was_not_tuned_is_refused_with_what_was():
    with pytest.raises(AmulettError, match="not tuned on the suite 'paper-step'.*parametric:mixed"):
        tuned_content("parametric", load_profile("testbed"), "paper-step")
    with pytest.raises(AmulettError, match="on this device it was not tuned at all"):
        amulett_gym.load_policy("parametric:steps", gym.make(TENSION, profile="simulation"))
    with pytest.raises(AmulettError, match="did you mean 'parametric:steps'"):
        parse_contender("parametric:step")
    with pytest.raises(AmulettError, match="needs 4 to 15 N"):
        amulett_gym.load_policy("parametric:steps", gym.make(TENSION, tension_range=(5, 9)))


def test_a_tuned_file_is_a_contender(tmp_path):
    content = tuned_content("parametric", load_profile("testbed"), "steps")
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(content))
    shipped, own = evaluate(["parametric:steps"], episodes=3), evaluate([str(path)], episodes=3)
    for metric, values in shipped.values["parametric:steps"].items():
        np.testing.assert_array_equal(own.values[str(path)][metric], values)
    assert own.remarks == []
    strange = {"name": "mine", "base": "simulation", "drives": {"lag": 0.01}}
    assert evaluate([str(path)], profile=strange, episodes=1).values[str(path)]["cost"][0] > 0
    for wrong, message in (
        ({**content, "format": "x"}, "is not a tuned law: its 'format' is not 'amulett-tuned-law'"),
        ({**content, "recipe": {"law": "x"}}, "is damaged: KeyError 'x'"),
        ({**content, "parameters": {}}, "'base' is nan N; it has to be from 2 to 17"),
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(AmulettError, match=message):
            parse_contender(str(path))
    with pytest.raises(AmulettError, match="cannot read tuned law"):
        parse_contender(str(tmp_path / "none.json"))


@pytest.mark.parametrize(("law", "place"), [name.split(":") for name in tuned_names() if ":" in name])
def test_a_shipped_law_tells_how_it_was_tuned(law, place):
    content, fleet = tuned_content(law, load_profile("testbed"), place), tuned_over(f"{law}:{place}")
    assert (content["recipe"]["law"], content["recipe"]["suite"]) == (law, "mixed" if fleet else place)
    assert content["recipe"].get("fleet", "") == fleet
    chosen = content["starts"][str(content["chosen_seed"])]
    assert chosen["validation"] == min(start["validation"] for start in content["starts"].values())
    assert content["training_episodes"] >= 10_000
    assert set(content["sha256"]) == {"train", "validation"}


def test_a_law_tuned_over_a_fleet_has_a_name_and_acts_on_any_device(monkeypatch):
    here = {("testbed", "parametric", "mixed"): (*parametric.TUNED, "testbed", "parametric-mixed.json")}
    over = {("ours", "parametric", "mixed"): (*parametric.TUNED, "testbed", "parametric-steps.json")}
    monkeypatch.setattr(parametric, "_shipped", lambda: here | over)
    monkeypatch.setattr(parametric, "fleet_names", lambda: ("ours",))
    names = tuned_names()
    assert set(names) == {"parametric", "parametric:mixed", "parametric:ours"}
    assert names["parametric:ours"] == "parametric, tuned on mixed over the fleet ours"
    assert [tuned_over(name) for name in (*names, "constant:6", "eq6")] == ["", "", "ours", "", ""]
    own = load_profile({**load_profile("simulation").model_dump(), "name": "mine", "base": None})
    _, vector = tuned_vector("parametric:ours", own)
    assert vector.tolist() == tuned_vector(str(files("amulett_gym").joinpath(*over.popitem()[1])), own)[1].tolist()
    with pytest.raises(AmulettError, match="was not tuned on the suite 'mixed' of the device 'mine'"):
        tuned_vector("parametric", own)
