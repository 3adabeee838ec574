"""What a network sees of a wearer."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.envs.worn_transition import OBSERVATIONS
from amulett_gym.laws.actor import follow
from amulett_gym.laws.features import FEATURES, WORN_FEATURES, features, with_features
from amulett_gym.laws.memory import MEMORY, SPANS, WORN_MEMORY, WORN_NAMES, Memory
from amulett_gym.laws.worn_inputs import TRACES, cuff_features, next_traces

RANGE = (0.0, 15.0)


def observation(angle_deg=0.0, speed=0.0, cuff=0.0, rate=0.0, assistance=0.0, devices=1):
    """Return observations in deg, deg/s, N m and N m/s."""
    rows = np.zeros((devices, len(OBSERVATIONS)))
    for name, value in {
        "joint_angle": angle_deg / 150.0,
        "joint_velocity": speed / 500.0,
        "measured_cuff": cuff / 2.0,
        "cuff_rate": rate / 20.0,
        "assistance": assistance,
        "agonist": 1.0,
    }.items():
        rows[:, OBSERVATIONS.index(name)] = value
    return rows


def traces_of(*steps):
    """Return the traces after observations in turn, by name."""
    found = np.zeros((1, len(TRACES)))
    for k, rows in enumerate(steps):
        found = next_traces(rows, found, np.array([k == 0]))
    assert np.abs(found).max() <= 1.0
    return dict(zip(TRACES, found[0].tolist(), strict=True))


def test_features_of_the_cuff_are_in_physical_units():
    found = {
        name: float(values[0]) for name, values in cuff_features(observation(speed=30.0, cuff=0.4, rate=5.0)).items()
    }
    assert found["cuff_0.4Nm"] == pytest.approx(np.tanh(1.0))
    assert found["cuff_rate_5Nm_s"] == pytest.approx(np.tanh(1.0))
    assert found["cuff_power_fast"] == pytest.approx(np.tanh(1.0) ** 2)
    against = cuff_features(observation(speed=-30.0, cuff=0.4))
    assert float(against["cuff_power_fast"][0]) == pytest.approx(-(np.tanh(1.0) ** 2))


def test_inputs_begin_with_the_whole_observation():
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (4, len(OBSERVATIONS)))
    shown = with_features(rows, RANGE, None, worn=True)
    assert shown.shape == (4, len(OBSERVATIONS) + len(WORN_FEATURES))
    assert np.array_equal(shown[:, : len(OBSERVATIONS)], rows)
    assert np.array_equal(shown[:, len(OBSERVATIONS) :], features(rows, RANGE, worn=True))
    assert np.array_equal(features(rows, RANGE, worn=True)[:, : len(FEATURES)], features(rows, RANGE))


def test_the_memory_of_a_worn_device_adds_means_and_traces():
    generator = np.random.default_rng(1)
    rows = generator.uniform(-0.5, 0.5, (40, 3, len(OBSERVATIONS)))
    worn, bare = Memory(3, worn=True), Memory(3)
    for step in rows:
        found, known = worn.add(step), bare.add(step)
    assert found.shape == (3, len(WORN_MEMORY)) and len(WORN_MEMORY) == len(SPANS) * len(WORN_NAMES) + len(TRACES)
    assert np.array_equal(found[:, [WORN_MEMORY.index(name) for name in MEMORY]], known)
    cuff = np.tanh(2.0 * rows[:, :, OBSERVATIONS.index("measured_cuff")] / 0.4).mean(axis=0)
    np.testing.assert_allclose(found[:, WORN_MEMORY.index("cuff_250")], cuff)
    worn.forget(np.array([1]))
    again = worn.add(rows[0][1:2], np.array([1]))
    assert np.array_equal(again[0], Memory(1, worn=True).add(rows[0][1:2])[0])


def test_traces_show_where_the_arm_is_and_since_when_it_rests():
    way = [observation(30.0), *(observation(30.0 + k, speed=50.0) for k in range(1, 21))]
    arrived = traces_of(*way)
    assert arrived["first_angle"] == pytest.approx(30.0 / 150.0) and arrived["highest_angle"] == pytest.approx(
        50.0 / 150.0
    )
    assert arrived["place"] == pytest.approx(1.0) and arrived["displacement"] == pytest.approx(np.tanh(2.0))
    assert arrived["motion_1s"] == pytest.approx(1.0) and arrived["rest"] < 1e-6 and arrived["direction_1s"] > 0.3
    rested = traces_of(*way, *([observation(50.0)] * 50))
    assert rested["motion_1s"] == pytest.approx(np.exp(-1.0), rel=1e-3)
    assert rested["rest"] == pytest.approx(0.2, rel=0.15)  # the step at its edge is smooth
    back = traces_of(*way, *(observation(50.0 - k, speed=-50.0) for k in range(21)))
    assert back["place"] == pytest.approx(-1.0) and back["away"] == pytest.approx(0.0, abs=1e-9)
    assert back["direction_1s"] < arrived["direction_1s"] and back["rest"] < 1e-6


def test_a_push_is_remembered_where_the_arm_was_away_and_at_rest():
    away = [observation(30.0), *([observation(50.0, cuff=-1.0)] * 200)]
    assert traces_of(*away)["push_away"] < -0.8
    moving = [observation(30.0), *([observation(50.0, speed=60.0, cuff=-1.0)] * 200)]
    assert traces_of(*moving)["push_away"] == pytest.approx(0.0, abs=1e-6)
    assert traces_of(*([observation(30.0, cuff=-1.0)] * 200))["push_away"] == 0.0


def test_assistance_follows_as_the_tension_does():
    rows = observation(assistance=0.75, devices=2)
    rows[:, OBSERVATIONS.index("tension_setpoint")] = -0.2
    wanted = np.array([[0.8, -1.0], [-0.2, 0.5]], dtype=np.float32)
    found = follow(wanted, rows, 0.5, worn=True)
    np.testing.assert_allclose(found, [[0.3, -0.25], [-0.2, 0.5]], atol=1e-7)
