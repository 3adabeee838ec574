"""The costs of wearers without the device: frozen as measured, by the arm's own dynamics."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.envs.worn_reward import doffed_costs
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.doffed import PROFILE, measure
from amulett_gym.model.wearer import PASSIVE_DAMPING
from amulett_gym.profile import load_profile
from amulett_gym.simulation.worn import MOVING
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.tasks.suites import episode_keys
from amulett_gym.tasks.worn_suites import WORN_SUITES, sample_worn


@pytest.mark.slow
def test_what_is_frozen_is_what_is_measured():
    assert measure("assembly") == pytest.approx(doffed_costs("assembly"), rel=0.01)


def test_every_suite_has_costs_of_its_size():
    for suite in WORN_SUITES:
        found = measure(suite, episodes=24)
        assert found == pytest.approx(doffed_costs(suite), rel=0.7), suite


def test_an_unknown_suite_is_refused():
    with pytest.raises(AmulettError, match="unknown suite 'steps'"):
        measure("steps", episodes=8)


def test_cost_of_the_cuff_is_that_of_the_torque_that_moves_the_arm():
    """In the horizontal plane, with nothing in the hand, it is J q'' + D q'."""
    profile, keys = load_profile(PROFILE), episode_keys(np.arange(8), np.zeros(8), "train")
    rows, wearers = sample_worn("reaches", keys, profile, "train")
    wearers["worn"] = wearers["tremor_torque"] = 0.0
    simulation = WornSimulation(profile, 8, "equilibrium-point")
    simulation.reset(rows, wearers=wearers)
    period, torque_ise, intended, before = simulation.control_period, np.zeros(8), np.zeros(8), np.zeros(8)
    for _ in range(4000):
        simulation.advance(1)
        rate, intention_rate = simulation.read_worn("elbow_rate"), simulation.read_worn("intention_rate")
        torque = wearers["inertia"] * (rate - before) / period + PASSIVE_DAMPING * 0.5 * (rate + before)
        torque_ise += np.where(np.abs(intention_rate) > MOVING, period * torque**2, 0.0)
        intended += period * np.degrees(intention_rate) ** 2
        before = rate
    found = measure("reaches", episodes=8)
    assert found["cuff"] == pytest.approx(torque_ise.mean(), rel=0.05)
    assert found["intention"] == pytest.approx(intended.mean(), rel=1e-3)
    # A minimum-jerk move of amplitude A in the time T has the squared rate 10/7 A^2 / T.
    ends = np.degrees(np.diff(np.column_stack([rows["initial_angle"], rows["move_angle"]])))
    real = (np.arange(ends.shape[1]) < rows["move_count"][:, None]) & (rows["move_time"] + rows["move_duration"] < 10.0)
    closed = np.where(real, 10.0 / 7.0 * ends**2 / np.where(real, rows["move_duration"], 1.0), 0.0).sum(axis=1)
    assert found["intention"] == pytest.approx(closed.mean(), rel=0.1)  # a last move may not end within 10 s
