"""An agent step's observation and report, against the state of the simulation that they are read from."""

from __future__ import annotations

import inspect
import math
import re

import gymnasium as gym
import numpy as np
import pytest
from helpers import BUSY

import amulett_gym  # noqa: F401  (registers the ids)
from amulett_gym.envs.action import tension_to_action
from amulett_gym.envs.prices import divisors
from amulett_gym.envs.single import ScalingEnv
from amulett_gym.envs.transition import METRICS, OBSERVATIONS
from amulett_gym.evaluation.metrics import UNITS
from amulett_gym.model.spring import build_tables
from amulett_gym.simulation.layout import BY_STIFFNESS
from amulett_gym.simulation.random import normal

ID = "amulett_gym:Amulett/Tension-v0"

# Biceps and triceps differ in every reading; the noise and the bias tell what is measured from what is true.
UNLIKE = {"spring_biceps": 0.8, "spring_triceps": 1.2, "encoder_bias_deg": 0.5, "noise": 2.0}
SCENARIO = {
    **BUSY,
    "moves": [{"time": 0.05, "angle_deg": 18.0}, {"time": 1.0, "angle_deg": 45.0}],
    "pushes": [{"time": 1.2, "duration": 0.2, "torque": 0.1}],
    "device": UNLIKE,
    "obstacle": {"angle_deg": 25.0, "stiffness": 2.0, "damping": 0.02},
    "orientation": "vertical",
}


@pytest.fixture
def played():
    """Return an environment after 65 steps of `SCENARIO`, in the middle of a push, and the last step's answer."""
    env = gym.make(ID, profile="testbed", suite="contact").unwrapped
    env.reset(seed=0, options={"scenario": SCENARIO})
    for step in range(65):
        answer = env.step(np.array([math.sin(step)], dtype=np.float32))
    return env, answer


def test_an_observation_is_what_the_microcontroller_knows(played):
    env, (observation, *_) = played
    simulation = env.episodes.simulation
    state = {name: float(simulation.read(name)[0]) for name in simulation.states.dtype.names}
    low, high = env.tension_range
    travel = float(simulation.parameters["max_spring_deflection"][0])
    deg = math.radians(1.0)
    expected = {
        "position_error": (state["setpoint"] - state["measured_angle"]) / (90 * deg),
        "joint_angle": state["measured_angle"] / (150 * deg),
        "joint_velocity": state["measured_velocity"] / (500 * deg),
        "setpoint": state["setpoint"] / (150 * deg),
        "time_since_move": (65 * 0.02 - 1.0) / 2.0,
        "estimated_tension_biceps": state["estimate_biceps"] / 20.0,
        "estimated_tension_triceps": state["estimate_triceps"] / 20.0,
        "spring_deflection_biceps": state["measured_biceps"] / travel,
        "spring_deflection_triceps": state["measured_triceps"] / travel,
        "agonist": state["agonist"],
        "command_biceps": state["command_biceps"] / (720 * deg),
        "command_triceps": state["command_triceps"] / (720 * deg),
        "tension_setpoint": 2 * (state["tension_setpoint"] - low) / (high - low) - 1,
    }
    assert list(expected) == list(OBSERVATIONS)
    assert all(-1 < value < 1 for name, value in expected.items() if name != "agonist")
    assert len({round(value, 6) for value in expected.values()}) == len(expected)
    np.testing.assert_allclose(observation, list(expected.values()), rtol=1e-5, atol=1e-6)


def test_the_readings_are_the_truth_behind_the_observation(played):
    env, (*_, info) = played
    read = {name: float(env.episodes.simulation.read(name)[0]) for name in env.episodes.simulation.states.dtype.names}
    assert info["time"] == pytest.approx(65 * 0.02)
    assert info["joint_angle"] == pytest.approx(math.degrees(read["angle"]))
    assert info["joint_velocity"] == pytest.approx(math.degrees(read["velocity"]))
    for name in ("tension_setpoint", "force_biceps", "force_triceps", "push_torque", "contact_torque"):
        assert info[name] == read[name] != 0.0
    assert info["push_torque"] == pytest.approx(0.1)
    assert len({info[name] for name in ("tension_setpoint", "force_biceps", "force_triceps")}) == 3


def test_metrics_are_the_simulations_in_degrees(played):
    env, (*_, info) = played
    read = {name: float(env.episodes.simulation.read(name)[0]) for name in env.episodes.simulation.states.dtype.names}
    squared = math.degrees(1.0) ** 2
    open_step = not math.isnan(read["inside_since"])
    settled = read["settling_count"] + open_step
    settling = read["settling_sum"] + (read["inside_since"] - read["step_start"] if open_step else 0.0)
    same = ("tension_ise", "tension_ise_estimated", "contact_ise", "contact_peak", "drive_work")
    expected = {
        "position_ise": read["position_ise"] * squared,
        **{name: read[name] * squared for name in METRICS if name.startswith(("isav", "effort", "drive_effort"))},
        **{name: math.degrees(read[name]) for name in ("iav_biceps", "iav_triceps", "overshoot", "push_deflection")},
        **{name: read[name] for name in same},
        "rise_time": read["rise_sum"] / read["rise_count"],
        "settling_time": settling / settled,
        "resting_stiffness": read["resting_stiffness_sum"] / read["resting_time"],
        "setpoint_steps": read["step_count"],
        "steps_risen": read["rise_count"],
        "steps_settled": settled,
        "agonist_switches": read["switch_count"],
        "resting_time": read["resting_time"],
    }
    assert set(expected) == set(METRICS)
    for name, value in expected.items():
        assert info[name] == pytest.approx(value), name
    assert info["setpoint_steps"] == 2.0


def test_the_docstring_gives_each_metric_with_its_unit_formula_and_source():
    table = re.search(r"\| Metric .*?\n\n", inspect.getdoc(ScalingEnv), re.DOTALL)[0].splitlines()[:-1]
    heading, _, *lines = ([cell.strip() for cell in line.strip("|").split("|")] for line in table)
    assert heading == ["Metric", "Unit", "Formula", "Source"]
    units = {}
    for names, unit, formula, source in lines:
        if names:
            assert formula and source, names
            units |= dict.fromkeys(re.findall(r"`(\w+)`", names), unit)
        else:  # the row above, continued
            assert formula and not unit
    assert units == {name: UNITS[name] for name in METRICS}


@pytest.mark.parametrize("suite", ["steps", "contact"])
def test_each_step_is_charged_for_what_it_added_to_the_metrics(suite):
    """The reward of each single step by the formula in the docstring, from the metrics before and after it."""
    weights = {"position": 0.5, "effort": 0.3, "tension": 0.2, "contact": 0.7}
    env = gym.make(ID, suite=suite, reward_weights=weights).unwrapped
    _, info = env.reset(seed=0, options={"scenario": BUSY})
    paid = divisors(env.profile, "contact")  # what eq. 6 costs; there is an obstacle
    before = info
    for _ in range(80):
        _, reward, _, _, info = env.step(np.zeros(1, dtype=np.float32))
        after = info
        added = {name: after[name] - before[name] for name in after}
        terms = {
            "position": -0.5 * added["position_ise"] / paid["position"],
            "effort": -0.3 * (added["effort_biceps"] + added["effort_triceps"]) / paid["effort"],
            "tension": -0.2 * added["tension_ise"] / paid["tension"],
            "contact": -0.7 * added["contact_ise"] / paid["contact"],
            "failure": 0.0,
        }
        cost = -sum(terms.values())
        share = min(1.0 / cost, 1.0)  # of a cost of at most 1, a whole episode of eq. 6
        for name, term in terms.items():
            assert info[f"reward_{name}"] == pytest.approx(share * term, rel=1e-6, abs=1e-9), name
        assert reward == pytest.approx(-min(cost, 1.0), rel=1e-6)
        before = after
    assert before["contact_ise"] > 0


@pytest.mark.parametrize("horizon", [40, 3])
def test_a_failure_costs_the_cap_for_each_step_that_was_left(horizon):
    push = {"initial_angle_deg": 80.0, "pushes": [{"time": 0.1, "duration": 5.0, "torque": 20.0}]}
    env = gym.make(ID, failure_horizon=horizon).unwrapped
    env.reset(seed=0, options={"scenario": push})
    before, terminated = 0, False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.zeros(1, dtype=np.float32))
        before += not terminated
    assert 5 <= before < 20
    assert info["reward_failure"] == -max(horizon - before, 1)
    assert -max(horizon - before, 1) - 1 <= reward <= -max(horizon - before, 1)


def test_observation_noise_is_drawn_anew_for_each_entry_and_step_and_apart_from_the_sensors():
    scenario = {"initial_angle_deg": 40.0, "noise_seed": 9}  # no entry but the agonist near -1 or 1
    seen = []
    for noise in (0.0, 0.02):
        env = gym.make(ID, observation_noise=noise).unwrapped
        env.reset(seed=0, options={"scenario": scenario})
        seen.append([env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(300)])
    drawn = np.delete(np.diff(seen, axis=0)[0], OBSERVATIONS.index("agonist"), axis=1) / 0.02
    assert drawn.std() == pytest.approx(1.0, abs=0.05) and abs(drawn.mean()) < 0.05
    assert len(np.unique(np.round(drawn, 4))) > 0.9 * drawn.size  # of 3600 numbers few are alike by chance
    # The sensors draw from the scenario's own key, one number for each counter: none of those is drawn here again.
    counters = np.arange(1, 301)[:, None] * round(0.02 / env.profile.loop.control_period) * 13 + np.arange(13)
    sensors = normal(np.array([9], dtype=np.uint64), np.zeros(1, dtype=np.uint64), counters.max() + 1)[0][counters]
    sensors = np.delete(sensors, OBSERVATIONS.index("agonist"), axis=1)
    assert abs(np.corrcoef(sensors.ravel(), drawn.ravel())[0, 1]) < 0.1


@pytest.mark.parametrize("control", BY_STIFFNESS)
def test_the_info_holds_the_stiffness_that_the_tension_asks_for(control):
    single = gym.make(ID, control=control).unwrapped
    many = gym.make_vec(ID, 2, control=control)
    single.reset(seed=1)
    many.reset(seed=1)
    action = float(tension_to_action(8.0, single.tension_range))
    for _ in range(20):
        info = single.step(np.array([action]))[4]
        infos = many.step(np.full((2, 1), action))[4]
    radius, springs = single.profile.plant.joint_pulley_radius, build_tables(single.profile.spring)
    asked = 2.0 * radius**2 * springs.stiffness_at(springs.deflection_at(8.0))
    assert info["stiffness_setpoint"] == pytest.approx(asked)
    assert infos["stiffness_setpoint"] == pytest.approx([asked, asked])
    assert info["joint_stiffness"] == pytest.approx(asked, rel=0.1)


def test_loops_that_take_no_stiffness_ask_for_none(played):
    _, (*_, info) = played
    assert "stiffness_setpoint" not in info
