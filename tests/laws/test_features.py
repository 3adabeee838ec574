"""What a network with features sees and does: by hand, in a batch, in another action range."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from helpers import keep_network

import amulett_gym
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor, follow
from amulett_gym.laws.bundle import read_bundle, write_bundle
from amulett_gym.laws.features import FEATURES, features, with_features

RANGE = (4.0, 15.0)


def observation(**values: float) -> np.ndarray:
    row = np.zeros((1, len(OBSERVATIONS)))
    for name, value in values.items():
        row[0, OBSERVATIONS.index(name)] = value
    return row


def seen(**values: float) -> dict[str, float]:
    return dict(zip(FEATURES, features(observation(**values), RANGE)[0], strict=True))


def test_features_are_what_their_names_say():
    there = seen(position_error=3.0 / 90.0, joint_velocity=-30.0 / 500.0, time_since_move=0.1 / 2.0, agonist=-1.0)
    assert there["error_1.5deg"] == pytest.approx(math.tanh(2.0))
    assert there["error_15deg"] == pytest.approx(math.tanh(0.2))
    assert there["velocity_30deg_s"] == pytest.approx(-math.tanh(1.0))
    assert there["recent_0.1s"] == pytest.approx(math.exp(-1.0))
    assert there["agonist_error_1.5deg"] == pytest.approx(-math.tanh(2.0))
    assert there["approach_fast"] == pytest.approx(-math.tanh(0.6) * math.tanh(1.0))


@pytest.mark.parametrize(("agonist", "pulls", "other"), [(1.0, 9.0, 6.0), (-1.0, 6.0, 9.0)])
def test_the_antagonist_is_the_drive_that_does_not_pull(agonist, pulls, other):
    at_7 = 2.0 * (7.0 - 4.0) / 11.0 - 1.0
    there = seen(
        estimated_tension_biceps=9.0 / 20.0,
        estimated_tension_triceps=6.0 / 20.0,
        agonist=agonist,
        tension_setpoint=at_7,
    )
    assert (there["agonist_tension"], there["antagonist_tension"]) == pytest.approx((pulls / 20.0, other / 20.0))
    assert there["tension_error_2N"] == pytest.approx(math.tanh((other - 7.0) / 2.0))


def test_no_feature_changes_unnoticed_under_its_name():
    """Bundles name their features: another formula has to get another name."""
    there = seen(
        position_error=-0.05,
        joint_velocity=-19.0 / 600.0,
        time_since_move=0.04,
        estimated_tension_biceps=0.31,
        estimated_tension_triceps=0.28,
        agonist=1.0,
        tension_setpoint=-0.7,
    )
    assert there == pytest.approx(
        {
            "error_1.5deg": -0.995055,
            "error_5deg": -0.716298,
            "error_15deg": -0.291313,
            "velocity_8deg_s": -0.962526,
            "velocity_30deg_s": -0.483681,
            "velocity_100deg_s": -0.157023,
            "recent_0.1s": 0.449329,
            "recent_0.4s": 0.818731,
            "agonist_error_1.5deg": -0.995055,
            "agonist_error_5deg": -0.716298,
            "agonist_velocity_30deg_s": -0.483681,
            "approach_slow": 0.957766,
            "approach_fast": 0.346459,
            "agonist_tension": 0.31,
            "antagonist_tension": 0.28,
            "antagonist_floor": 0.53705,
            "antagonist_7N": -0.604368,
            "tension_error_0.5N": -0.099668,
            "tension_error_2N": -0.024995,
            "tension_error_6N": -0.008333,
            "setpoint_floor": 0.336376,
        },
        abs=1e-5,
    )


def test_features_keep_within_one_and_hang_on_each_row_alone():
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (37, 13)).astype(np.float32)
    together = features(rows, RANGE)
    assert together.dtype == np.float32
    assert np.abs(together).max() <= 1.0
    assert np.array_equal(together, np.concatenate([features(row[None], RANGE) for row in rows]))
    assert len(np.unique(together, axis=0)) == len(rows)


def test_they_stand_between_the_observation_and_what_only_some_are_told():
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 20))
    whole = with_features(rows, RANGE)
    assert np.array_equal(whole[:, :13], rows[:, :13])
    assert np.array_equal(whole[:, 13 : 13 + len(FEATURES)], features(rows, RANGE))
    assert np.array_equal(whole[:, 13 + len(FEATURES) :], rows[:, 13:])


def test_an_action_goes_its_share_of_the_way():
    rows = observation(tension_setpoint=-0.5)
    wanted = np.array([[0.5]], dtype=np.float32)
    assert follow(wanted, rows, 0.4) == pytest.approx(np.array([[-0.1]]))
    assert follow(wanted, rows, 1.0) is wanted


@pytest.fixture
def folder(tmp_path):
    size = 13 + len(FEATURES)
    weights = np.random.default_rng(1).normal(0.0, 0.3, (1, size)).astype(np.float32)
    layers = [(weights, np.zeros(1, np.float32))]
    return keep_network(tmp_path / "bundle", layers, "relu", features=list(FEATURES), follow=0.4)


def test_a_bundle_with_features_means_the_same_tensions_in_every_tension_range(folder):
    tensions = []
    for low, high in ((4.0, 15.0), (3.0, 20.0)):
        env = gym.make("amulett_gym:Amulett/Scaling-v0", suite="mixed", tension_range=(low, high))
        policy = amulett_gym.load_policy(folder, env)
        seen, _ = env.reset(seed=3)
        for _ in range(100):
            seen, _, _, _, info = env.step(policy(seen))
        tensions.append(info["tension_setpoint"])
    assert tensions[0] == pytest.approx(tensions[1], abs=1e-3)


def test_the_policy_is_the_network_on_features_then_a_part_of_the_way(folder):
    env = gym.make("amulett_gym:Amulett/Scaling-v0", suite="mixed", tension_range=RANGE)
    bundle = read_bundle(folder)
    seen, _ = env.reset(seed=3)
    rows = np.asarray(seen, dtype=np.float64)[None]
    wanted = np.clip(with_features(rows, RANGE) @ bundle.layers[0][0].T.astype(np.float64), -1.0, 1.0)
    setpoint = rows[:, OBSERVATIONS.index("tension_setpoint")]
    expected = setpoint + 0.4 * (wanted - setpoint)
    assert Actor(bundle.layers, bundle.policy, env)(rows) == pytest.approx(expected, abs=1e-6)


def test_features_of_another_version_are_refused(folder):
    description = read_bundle(folder).policy.model_copy(update={"features": ["error_2deg", *FEATURES[1:]]})
    bundle = read_bundle(folder)
    with pytest.raises(AmulettError, match=r"features are not those of this .*error_1\.5deg, error_2deg"):
        write_bundle(folder, bundle.layers, description, bundle.env, {})
