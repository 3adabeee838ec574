"""The observer of the joint's motion: what it converges to, and how much less noise it has than a difference."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.joint_observer import observe


def follow(angles, periods, bandwidth=60.0, model=0.0):
    """Return angle, rate and disturbance after readings, with a constant acceleration of the model [rad/s2]."""
    angle, velocity, disturbance = angles[0], 0.0, 0.0
    rates = []
    for measured, period in zip(angles[1:], periods, strict=True):
        angle, velocity, change = observe(angle, velocity, model + disturbance, measured, bandwidth, period)
        disturbance += change
        rates.append(velocity)
    return angle, velocity, disturbance, np.array(rates)


def test_it_finds_rate_and_disturbance_also_when_ticks_are_late():
    periods = np.where(np.arange(300) % 7 == 0, 0.005, 0.0025)
    times = np.concatenate([[0.0], np.cumsum(periods)])
    angle, velocity, disturbance, _ = follow(0.2 + 1.5 * times**2, periods, model=1.0)  # 3 rad/s2, of which 2 unknown
    assert angle == pytest.approx(0.2 + 1.5 * times[-1] ** 2, abs=1e-6)
    assert velocity == pytest.approx(3.0 * times[-1], rel=1e-4)
    assert disturbance == pytest.approx(2.0, rel=1e-3)


def test_a_model_without_error_leaves_no_delay():
    times = np.arange(41) * 0.0025
    _, velocity, disturbance, _ = follow(times**2, np.full(40, 0.0025), model=2.0)
    assert velocity == pytest.approx(2.0 * times[-1], abs=1e-12)
    assert disturbance == pytest.approx(0.0, abs=1e-9)


def test_its_rate_has_a_tenth_of_the_noise_of_a_difference():
    readings = np.random.default_rng(0).normal(0.0, 4e-4, 4001)
    *_, rates = follow(readings, np.full(4000, 0.0025), bandwidth=80.0)
    assert rates[400:].std() < 0.1 * np.diff(readings).std() / 0.0025
