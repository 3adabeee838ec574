"""The privileged observation: what no device can know, for the causal reference."""

import gymnasium as gym
import numpy as np
import pytest
from helpers import device as changed
from privileged_reference import observe_privileged

import amulett_gym
from amulett_gym.envs.privileged import FLEET_PRIVILEGED, FLEET_SCALES, PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import inertia
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation.reference import string_force
from amulett_gym.tasks.suites import suite_names

SCALING, TENSION = amulett_gym.ENV_IDS[:2]
SENSED = len(OBSERVATIONS)
MID = np.zeros(1, dtype=np.float32)

SCENARIO = {
    "initial_angle_deg": 30.0,
    "moves": [{"time": 0.5, "angle_deg": 60.0, "duration": 1.0}, {"time": 2.0, "angle_deg": 45.0}],
    "pushes": [
        {"time": 0.2, "duration": 0.6, "torque": 0.1},
        {"time": 1.2, "duration": 0.5, "torque": -0.2, "rise": 0.25},
    ],
    "obstacle": {"angle_deg": 50.0, "blocks": "flexion", "stiffness": 10.0, "damping": 0.02},
    "payload": {"mass": 0.1, "arm": 0.2},
    "orientation": "vertical",
    "device": {
        "spring_biceps": 0.9,
        "inertia": 1.2,
        "damping": 1.25,
        "encoder_bias_deg": 0.3,
        "late_probability": 0.05,
    },
    "family": "pick-place",
    "noise_seed": 1,
}


def seen(scenario: dict, seconds: float) -> dict[str, float]:
    """Return what is seen after a time in a scenario, in the units of its scales."""
    env = gym.make(SCALING, privileged=True)
    observation, _ = env.reset(seed=0, options={"scenario": scenario})
    for _ in range(round(seconds / 0.02)):
        observation, *_ = env.step(MID)
    entries = observation[SENSED:].astype(float) * list(PRIVILEGED_SCALES.values())
    return dict(zip(PRIVILEGED, entries, strict=True))


def test_it_follows_an_observation_that_stays_as_it_is():
    plain, told = (gym.make(SCALING, suite="mixed", privileged=flag) for flag in (False, True))
    assert plain.observation_space.shape == (SENSED,) == (13,)
    assert told.observation_space.shape == (SENSED + len(PRIVILEGED),)
    expected, observation = plain.reset(seed=3)[0], told.reset(seed=3)[0]
    for _ in range(200):
        assert told.observation_space.contains(observation)
        assert np.array_equal(observation[:SENSED], expected)
        (expected, *rest), (observation, *told_rest) = plain.step(MID), told.step(MID)
        assert rest[0] == told_rest[0]


@pytest.mark.parametrize("suite", suite_names())
def test_the_vector_environment_tells_what_the_single_one_does(suite):
    keywords = {"suite": suite, "privileged": True, "max_episode_steps": 60, "split": "shifted"}
    vector = gym.make_vec(TENSION, num_envs=11, threads=2, **keywords)
    singles = [gym.make(TENSION, **keywords) for _ in range(11)]
    observations, _ = vector.reset(seed=5)
    for device, env in enumerate(singles):
        assert np.array_equal(observations[device], env.reset(seed=5 + device)[0])
    actions = np.random.default_rng(0).uniform(-1, 1, (75, 11, 1)).astype(np.float32)
    for k in range(75):
        observations, *_ = vector.step(actions[k])
        for device, env in enumerate(singles):
            expected = env.reset()[0] if k == 60 else env.step(actions[k, device])[0]
            assert np.array_equal(observations[device], expected)


@pytest.mark.parametrize("split", ["train", "shifted"])
@pytest.mark.parametrize("suite", suite_names())
def test_it_tells_what_the_reference_in_numpy_does(suite, split):
    keywords = {"suite": suite, "split": split, "agent_period": 0.1, "max_episode_steps": 90}
    env = gym.make_vec(SCALING, num_envs=67, privileged=True, **keywords)
    observations, _ = env.reset(seed=2)
    for _ in range(100):
        expected = observe_privileged(env.unwrapped.episodes.simulation, np.arange(67))
        # Where numpy rounds a sine otherwise, the last digit may differ.
        np.testing.assert_allclose(observations[:, SENSED:], expected, rtol=0, atol=6e-8)
        observations, *_ = env.step(env.action_space.sample())


def test_it_tells_how_the_device_was_built_and_what_it_carries():
    entry = seen(SCENARIO, 0.0)
    assert entry["spring_biceps_factor"] == pytest.approx(-0.1)
    assert entry["spring_triceps_factor"] == 0.0
    assert entry["damping_factor"] == pytest.approx(0.25)
    assert entry["late_probability"] == pytest.approx(0.05)
    assert np.degrees(entry["encoder_bias"]) == pytest.approx(0.3)
    without = seen({**SCENARIO, "payload": None}, 0.0)
    assert without["loaded_inertia"] == pytest.approx(0.2)
    assert entry["static_torque"] - without["static_torque"] == pytest.approx(0.1 * 0.2 * 9.81, rel=1e-3)
    assert entry["weight_torque"] == pytest.approx(entry["static_torque"] * np.sin(np.radians(30.0)))
    families = {name: value for name, value in entry.items() if name.startswith("family_")}
    assert families == {name: float(name == "family_pick_place") for name in families}


def test_it_tells_where_the_obstacle_is_and_how_it_yields():
    entry = seen(SCENARIO, 0.0)
    assert entry["obstacle"] == entry["obstacle_side"] == 1.0
    assert np.degrees(entry["obstacle_distance"]) == pytest.approx(20.0)
    assert entry["obstacle_yield"] == pytest.approx(0.1)
    assert entry["obstacle_damping"] == pytest.approx(0.02)
    extension = {**SCENARIO["obstacle"], "angle_deg": 20.0, "blocks": "extension"}
    entry = seen({**SCENARIO, "obstacle": extension}, 0.0)
    assert entry["obstacle_side"] == -1.0
    assert np.degrees(entry["obstacle_distance"]) == pytest.approx(10.0)
    none = seen({**SCENARIO, "obstacle": None}, 0.0)
    assert [value for name, value in none.items() if name.startswith("obstacle")] == [0.0] * 5


@pytest.mark.parametrize(
    ("seconds", "remaining", "wait", "torque"), [(0.0, 0.0, 0.2, 0.1), (0.4, 0.4, 0.8, -0.2), (1.3, 0.4, 2.0, 0.0)]
)
def test_it_tells_of_the_present_and_the_coming_push(seconds, remaining, wait, torque):
    entry = seen(SCENARIO, seconds)
    assert entry["push_remaining"] == pytest.approx(remaining)
    assert entry["next_push_in"] == pytest.approx(wait)
    assert entry["next_push_torque"] == pytest.approx(torque)
    assert entry["next_push_rise"] == pytest.approx(0.25 if torque < 0.0 else 0.0)
    if seconds == 0.4:
        assert entry["push_torque"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("seconds", "left", "ends", "wait", "change"),
    [(0.0, 0.0, 0.0, 0.5, 30.0), (1.0, 15.0, 0.5, 1.0, -15.0), (1.8, 0.0, 0.0, 0.2, -15.0), (2.2, 0.0, 0.0, 2.0, 0.0)],
)
def test_it_tells_of_the_present_and_the_coming_move(seconds, left, ends, wait, change):
    entry = seen(SCENARIO, seconds)
    assert np.degrees(entry["move_remaining"]) == pytest.approx(left, abs=1e-4)
    assert entry["move_ends_in"] == pytest.approx(ends, abs=1e-6)
    assert entry["next_move_in"] == pytest.approx(wait)
    assert np.degrees(entry["next_move_change"]) == pytest.approx(change, abs=1e-4)


def test_it_tells_the_phase_of_a_wave():
    wave = {"amplitude_deg": 20.0, "frequency": 0.5, "chirp": 0.1, "time": 0.5, "duration": 5.0}
    scenario = {"initial_angle_deg": 40.0, "wave": wave, "noise_seed": 1}
    entry = seen(scenario, 1.5)
    phase = 2 * np.pi * 0.55
    assert (entry["wave_sine"], entry["wave_cosine"]) == pytest.approx((np.sin(phase), np.cos(phase)))
    assert entry["wave_frequency"] == pytest.approx(0.6)
    before = seen(scenario, 0.4)
    assert (before["wave_sine"], before["wave_cosine"]) == (0.0, 0.0)


def test_it_tells_the_truth_behind_the_sensors():
    env = gym.make(SCALING, privileged=True)
    observation, info = env.reset(seed=0, options={"scenario": SCENARIO})
    for _ in range(80):
        observation, *_, info = env.step(MID)
    entry = dict(zip(PRIVILEGED, observation[SENSED:] * list(PRIVILEGED_SCALES.values()), strict=True))
    assert entry["force_biceps"] == pytest.approx(min(info["force_biceps"], 20.0))
    assert entry["contact_torque"] == pytest.approx(np.clip(info["contact_torque"], -1.0, 1.0))
    assert np.degrees(entry["true_velocity"]) == pytest.approx(info["joint_velocity"], abs=1e-3)
    setpoint = env.unwrapped.episodes.simulation.read("setpoint")[0]
    assert entry["true_error"] == pytest.approx(setpoint - np.radians(info["joint_angle"]), abs=1e-6)


def test_a_mask_resets_some_and_states_can_be_put_back():
    env = gym.make_vec(SCALING, num_envs=4, suite="mixed", privileged=True)
    first = env.reset(seed=0, options={"reset_mask": np.array([True, False, True, False])})[0]
    assert np.isfinite(first).all()
    env.reset(seed=0)
    state = env.unwrapped.get_state()
    following = [env.step(np.zeros((4, 1), np.float32))[0] for _ in range(5)]
    env.unwrapped.set_state(state)
    assert all(np.array_equal(env.step(np.zeros((4, 1), np.float32))[0], expected) for expected in following)


def test_the_keyword_is_true_or_false():
    with pytest.raises(AmulettError, match="'privileged' is 1: Input should be a valid boolean"):
        gym.make(SCALING, privileged=1)


def test_with_a_fleet_the_device_itself_is_observed_last():
    fleet = [
        load_profile("testbed"),
        changed(
            "simulation",
            plant={"drive_pulley_radius": 0.01, "joint_pulley_radius": 0.04, "masses": [{"mass": 0.3, "arm": 0.1}]},
            spring={"measured_curve": "deflection_m,force_N\n0,0\n0.002,3\n0.004,10\n0.006,20\n"},
            sensors={"encoder_noise_deg": 0.25, "potentiometer_noise": 2e-5},
        ),
        changed("testbed", structure={"stiffness": 2e4}, spring={"beyond": "continued"}),
    ]
    env = gym.make_vec(TENSION, num_envs=24, fleet=fleet, privileged=True, suite="reach")
    observations, _ = env.reset(seed=0)
    assert observations.shape == (24, SENSED + len(PRIVILEGED) + len(FLEET_PRIVILEGED))
    observations, *_ = env.step(np.zeros((24, 1)))
    for profile, rows in zip(fleet, (observations[:8], observations[8:16], observations[16:]), strict=True):
        expected = describe(profile)
        entries = rows[:, SENSED + len(PRIVILEGED) :]
        np.testing.assert_allclose(entries, np.tile([expected[name] for name in FLEET_PRIVILEGED], (8, 1)), rtol=1e-5)
    alone = gym.make_vec(TENSION, num_envs=8, profile=fleet[1], privileged=True, suite="reach")
    alone.reset(seed=list(range(8, 16)))
    found = alone.step(np.zeros((8, 1)))[0]
    assert observations[8:16, : found.shape[1]].tobytes() == found.tobytes()


def describe(profile):
    """Return the entries of a fleet's device from its profile."""
    springs, plant, damping = build_tables(profile.spring), profile.plant, profile.damping
    give = 0.0 if profile.structure is None else springs.max_force / profile.structure.stiffness
    most, force = springs.max_deflection + give, string_force(profile)
    values = {
        "device_radius_ratio": plant.drive_pulley_radius / plant.joint_pulley_radius,
        "device_inertia": inertia([m.mass for m in plant.masses], [m.arm for m in plant.masses]),
        "device_lag": profile.drives.lag,
        "device_rate_limit": np.radians(profile.drives.rate_limit_deg or np.inf),
        "device_max_deflection": most,
        "device_encoder_noise": np.radians(profile.sensors.encoder_noise_deg),
        "device_slider_noise": profile.sensors.potentiometer_noise,
        "device_control_period": profile.loop.control_period,
        "device_force_end": springs.max_force,
    }
    for name, share in (("third", 1 / 3), ("two_thirds", 2 / 3)):
        values[f"device_force_{name}"] = force(share * most)
    for name, preload in (("low", 2.0), ("high", 15.0)):  # both profiles have the shifted fit
        rate = damping.a * np.exp(damping.b * (preload + damping.c)) + damping.d
        values[f"device_damping_{name}"] = max(rate, 0.0)
    return {name: min(values[name] / scale, 1.0) for name, scale in FLEET_SCALES.items()}
