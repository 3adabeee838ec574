"""`Amulett/Drives-v0`: what its actions mean, how it starts, and what it takes."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import brentq

import amulett_gym
from amulett_gym.envs.settings import DrivesSettings, DrivesVectorSettings, Settings, VectorSettings
from amulett_gym.envs.single import DrivesEnv, ScalingEnv
from amulett_gym.envs.vector import DrivesVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import DRIVES, LOOPS
from amulett_gym.simulation.random import random_bits
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import Scenario, pack

ENV_ID = amulett_gym.ENV_IDS[2]
TESTBED = load_profile("testbed")
QUIET = {
    "name": "quiet",
    "base": "testbed",
    "sensors": {"encoder_noise_deg": 0.0, "potentiometer_noise": 0.0, "encoder_bits": 0, "potentiometer_bits": 0},
}
STILL = {"moves": [], "initial_angle_deg": 0.0, "noise_seed": 3}
LOADED = {"initial_angle_deg": 30.0, "orientation": "vertical", "payload": {"mass": 0.1, "arm": 0.1}, "noise_seed": 3}


def action(env, mean, tension) -> np.ndarray:
    """Return the action of a mean drive angle [deg] and a tension [N]."""
    low, high = env.unwrapped.tension_range
    values = [mean / env.unwrapped.mean_angle_range, 2.0 * (tension - low) / (high - low) - 1.0]
    return np.array(values, dtype=np.float64)


def hold(mean, tension, steps=300, **scenario):
    """Return the environment and the last info after the same action again and again."""
    env = gym.make(ENV_ID)
    env.reset(seed=0, options={"scenario": {**STILL, **scenario}})
    for _ in range(steps):
        info = env.step(action(env, mean, tension))[-1]
    return env, info


def commands(env) -> np.ndarray:
    """Return the commands of biceps and triceps [deg]."""
    simulation = env.unwrapped.episodes.simulation
    return np.degrees([simulation.read("command_biceps")[0], simulation.read("command_triceps")[0]])


def deflection(tension) -> float:
    """Return the string deflection [m] at a tension [N], by root finding."""
    tables = build_tables(TESTBED.spring)
    return brentq(lambda y: tables.force_at(y) - tension, 0.0, tables.max_deflection, xtol=1e-15)


@pytest.mark.parametrize("mean", [-120.0, 0.0, 57.5, 200.0])
@pytest.mark.parametrize("tension", [6.0, 12.0])
def test_an_action_is_the_mean_angle_and_the_tension_of_both_strings(mean, tension):
    env, info = hold(mean, tension)
    apart = np.degrees(deflection(tension) / TESTBED.plant.drive_pulley_radius)
    assert commands(env) == pytest.approx([mean + apart, mean - apart], abs=1e-5)
    ratio = TESTBED.plant.drive_pulley_radius / TESTBED.plant.joint_pulley_radius
    assert info["joint_angle"] == pytest.approx(ratio * mean, abs=1e-3)
    assert info["force_biceps"] == pytest.approx(tension, abs=1e-3)
    assert info["force_triceps"] == pytest.approx(tension, abs=1e-3)
    assert info["tension_setpoint"] == pytest.approx(tension)


def test_co_contraction_raises_the_stiffness_and_none_leaves_the_strings_slack():
    stiffness = [hold(0.0, tension)[1]["joint_stiffness"] for tension in (0.0, 5.0, 10.0, 15.0)]
    assert stiffness == sorted(stiffness)
    slope = build_tables(TESTBED.spring).stiffness_at(deflection(10.0))
    assert stiffness[2] == pytest.approx(2.0 * slope * TESTBED.plant.joint_pulley_radius**2, rel=1e-3)
    assert hold(0.0, 0.0)[1]["force_biceps"] < 1e-3


def test_with_a_delay_both_ramps_begin_late():
    env = gym.make("Amulett/Drives-v0", action_delay=2, mean_angle_range=200.0).unwrapped
    env.reset(seed=0)
    memory = env.episodes.simulation.loop[1]
    start = math.degrees(memory["mean_command"][0, 0])
    for share in (0.75, 1.0, 1.0):
        env.step([0.5, 0.0])
        assert math.degrees(memory["mean_command"][0, 0]) == pytest.approx(start + share * (100.0 - start))


def test_an_action_is_reached_on_a_ramp_that_takes_the_agent_period():
    env = gym.make(ENV_ID)
    env.reset(seed=0, options={"scenario": STILL})
    simulation = env.unwrapped.episodes.simulation
    memory = simulation.loop[1]
    env.step(action(env, 0.0, 8.0))
    env.step(action(env, 40.0, 8.0))
    assert np.degrees(memory["mean_rate"][0, 0]) * 8 == pytest.approx(40.0)  # 8 control ticks
    assert np.degrees(memory["mean_command"][0, 0]) == pytest.approx(40.0)
    for beyond, least in ((np.array([7.0, 3.0]), 1.0), (np.array([-7.0, -3.0]), -1.0)):
        env.step(beyond)
        assert np.degrees(memory["mean_command"][0, 0]) == pytest.approx(least * 259.0)
        assert simulation.read("tension_command")[0] == pytest.approx(7.5 + 7.5 * least)


@pytest.mark.parametrize(
    "scenario", [STILL, LOADED, {**STILL, "device": {"spring_biceps": 0.9, "pulley_biceps": 1.04}}]
)
def test_an_arm_at_rest_starts_without_a_jump(scenario):
    profile = load_profile(QUIET)
    simulation = Simulation(profile, 1, DRIVES)
    simulation.reset(pack(Scenario.model_validate(scenario), profile))
    start = simulation.read("command_biceps")[0], simulation.read("command_triceps")[0]
    assert simulation.loop[1]["mean_command"][0, 0] == pytest.approx(sum(start) / 2.0)
    trajectory = record(simulation, 400)  # without an action, the drives stay where they are
    changes = np.degrees([np.diff(trajectory["command_biceps"]), np.diff(trajectory["command_triceps"])])
    assert np.abs(changes).max() < 1e-9
    assert np.abs(np.degrees(trajectory["angle"] - trajectory["angle"][0])).max() < 1e-3
    env = gym.make(ENV_ID, profile=QUIET)
    env.reset(options={"scenario": scenario})
    before = commands(env)
    wanted = action(env, before.mean() + 8.0, env.unwrapped.episodes.simulation.read("tension_command")[0])
    env.step(wanted)
    assert commands(env) == pytest.approx(before + 8.0, abs=1e-3)  # the ramp began at the settled commands


def test_late_ticks_hold_the_commands():
    simulation = Simulation(TESTBED, 1, DRIVES)
    simulation.reset(pack(Scenario.model_validate({**STILL, "device": {"late_probability": 0.3}}), TESTBED))
    simulation.loop[1]["mean_rate"][0, 0] = 1e-3
    key = simulation.read_scenarios(np.array([0]))["noise_key"][0]
    late = np.array([float(random_bits(key, np.uint64(tick * 4 + 3))) * 2.0**-64 < 0.3 for tick in range(300)])
    changes = np.diff(record(simulation, 300)["command_biceps"])
    assert late.sum() > 50
    np.testing.assert_allclose(changes, np.where(late, 0.0, 1e-3), atol=1e-12)


def test_commands_stay_within_their_limit():
    near = {"name": "near", "base": "testbed", "drives": {"command_limit_deg": 150.0}}
    env = gym.make(ENV_ID, profile=near)
    assert env.unwrapped.mean_angle_range == 150.0
    env.reset(seed=0, options={"scenario": STILL})
    for _ in range(50):
        info = env.step(np.ones(2))[-1]
        assert np.abs(commands(env)).max() <= 150.0 + 1e-9
    assert info["failure"] == 0


def test_flexion_and_extension_are_mirrored():
    def play(sign):
        env = gym.make(ENV_ID, profile=QUIET)
        push = {"time": 0.9, "duration": 0.2, "torque": sign * 0.1}
        env.reset(options={"scenario": {**STILL, "pushes": [push]}})
        infos = [env.step(action(env, sign * 100.0 * np.sin(0.1 * k), 8.0))[-1] for k in range(100)]
        return np.array([info["joint_angle"] for info in infos])

    np.testing.assert_allclose(play(1.0), -play(-1.0), atol=1e-7)


def test_a_snapshot_continues_with_the_same_bits():
    random = np.random.default_rng(0).uniform(-1, 1, (60, 5, 2))
    env, other = (gym.make_vec(ENV_ID, num_envs=5, suite="mixed") for _ in range(2))
    env.reset(seed=4)
    for actions in random[:30]:
        env.step(actions)
    other.reset(seed=9)
    other.set_state(env.get_state())
    for actions in random[30:]:
        for mine, theirs in zip(env.step(actions)[:2], other.step(actions)[:2], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_threads_change_no_bit():
    random = np.random.default_rng(0).uniform(-1, 1, (20, 27, 2))
    envs = [gym.make_vec(ENV_ID, num_envs=27, suite="mixed", threads=threads) for threads in (1, 2)]
    for env in envs:
        env.reset(seed=4)
    for actions in random:
        for one, two in zip(*(env.step(actions)[:2] for env in envs), strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("law", ["eq6", "eq6-printed"])
def test_eq_6_can_choose_the_co_contraction(law):
    seen = set()
    for second in (-1.0, 1.0):
        env = gym.make(ENV_ID, tension_law=law)
        env.reset(seed=0)
        seen.add(tuple(env.step(np.array([0.1, second]))[0].tolist()))
    assert len(seen) == 1


def test_the_scenarios_and_observations_are_those_of_the_other_environments():
    drives, scaling = (gym.make(env_id, suite="mixed").unwrapped for env_id in (ENV_ID, amulett_gym.ENV_IDS[0]))
    seen = [env.reset(seed=5)[0] for env in (drives, scaling)]
    assert drives.scenario == scaling.scenario
    np.testing.assert_array_equal(seen[0][:12], seen[1][:12])
    assert drives.observation_space == scaling.observation_space
    assert drives.action_space.shape == (2,) and drives.action_space.dtype == np.float32


def test_the_loop_belongs_to_this_environment_alone():
    assert DRIVES not in LOOPS
    for env_id in amulett_gym.ENV_IDS[:2]:
        with pytest.raises(AmulettError, match="'drives' is the loop of Amulett/Drives-v0 alone"):
            gym.make(env_id, control="drives")
    for control in ("decentralized", "co-rotation", "drive", None):
        with pytest.raises(AmulettError, match="the only loop of Amulett/Drives-v0 is 'drives'"):
            gym.make(ENV_ID, control=control)
    assert gym.make(ENV_ID, control="drives").unwrapped.settings.control == "drives"
    with pytest.raises(AmulettError, match="unexpected keyword argument 'mean_angle_range'"):
        ScalingEnv(mean_angle_range=100.0)
    with pytest.raises(AmulettError, match="only the loop 'drives' takes a mean drive angle"):
        Simulation(TESTBED).command_mean(0.1)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (0.0, "greater than 0"),
        (-5.0, "greater than 0"),
        (721.0, "command_limit_deg is 720"),
        ("90", "valid number"),
        (1e9, "less than or equal"),
    ],
)
def test_a_wrong_range_of_the_mean_angle_is_refused(value, problem):
    for make in (DrivesEnv, DrivesVectorEnv):
        with pytest.raises(AmulettError, match=problem):
            make(mean_angle_range=value)


def test_the_range_of_the_mean_angle_reaches_a_right_angle_by_default():
    assert DrivesEnv().mean_angle_range == DrivesVectorEnv().mean_angle_range == 259.0
    thin = load_profile({"name": "thin", "base": "simulation", "plant": {"drive_pulley_radius": 0.02}})
    assert DrivesEnv(profile=thin).mean_angle_range == round(90.0 * thin.plant.joint_pulley_radius / 0.02)
    assert DrivesEnv(mean_angle_range=100).mean_angle_range == 100.0


def test_its_keywords_can_be_kept():
    given = {"mean_angle_range": 200.0, "tension_range": (2.0, 9.0), "suite": "reach"}
    for make in (DrivesEnv, DrivesVectorEnv):
        kept = make(**given).settings.keywords()
        assert kept == {**given, "tension_range": [2.0, 9.0]}
        assert make(**kept).settings == make(**given).settings
    assert "num_envs" not in DrivesVectorEnv(num_envs=3, threads=1).settings.keywords()
    assert DrivesVectorSettings.model_fields.keys() - DrivesSettings.model_fields.keys() == (
        VectorSettings.model_fields.keys() - Settings.model_fields.keys()
    )


@pytest.mark.parametrize(
    "wrong", [np.zeros(1), np.zeros(3), np.zeros((1, 2)), np.array([np.nan, 0.0]), "left", ["left", "right"]]
)
def test_wrong_actions_are_refused(wrong):
    env = DrivesEnv()
    env.reset(seed=0)
    with pytest.raises(
        AmulettError, match=r"it has to be \(2,\)|the action of device 0 is NaN|is no number: \['left', 'right'\]"
    ):
        env.step(wrong)


@pytest.mark.parametrize("entry", [0, 1])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_nan_names_its_device_and_moves_none(entry, threads):
    env = DrivesVectorEnv(num_envs=19, threads=threads)
    env.reset(seed=0)
    before = env.get_state()["episodes"]["simulation"]["states"].tobytes()
    actions = np.zeros((19, 2))
    actions[17, entry] = np.nan
    with pytest.raises(AmulettError, match="the action of device 17 is NaN"):
        env.step(actions)
    assert env.get_state()["episodes"]["simulation"]["states"].tobytes() == before


def test_actions_of_another_shape_are_refused():
    env = DrivesVectorEnv(num_envs=3)
    env.reset(seed=0)
    with pytest.raises(AmulettError, match=r"shape \(3, 1\); it has to be \(3, 2\)"):
        env.step(np.zeros((3, 1)))
