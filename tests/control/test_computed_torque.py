"""Computed torque: the error of the position obeys the linear dynamics that its gains set."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.computed_torque import followed_rate, wanted_acceleration
from amulett_gym.control.inverse_dynamics import joint_torque
from amulett_gym.model.plant import weight_torque


def test_the_error_obeys_its_linear_dynamics():
    # e'' = -k_v e' - k_p e - k_i int e, with eq. 1 as the plant: poles at -5, -10 and -20 1/s.
    kd, kp, ki = 35.0, 350.0, 1000.0
    inertia, decay, weight, step = 0.0048, 4.0, 0.33, 1e-5
    angle, rate, integral, errors = 0.3, 0.0, 0.0, []
    for _ in range(40000):
        error, error_rate = 0.5 - angle, -rate
        holding = weight_torque(weight, angle)
        wanted = wanted_acceleration(0.0, error_rate, error, integral, kd, kp)
        torque = joint_torque(wanted, rate, inertia, decay, holding)
        integral += ki * error * step
        rate += step * ((torque - holding) / inertia - 2.0 * decay * rate)
        angle += step * rate
        errors.append(error)
    poles = np.array([-5.0, -10.0, -20.0])
    rows = np.array([np.ones(3), poles, poles**2])
    shares = np.linalg.solve(rows, [0.2, 0.0, -kp * 0.2])
    times = step * np.arange(40000)
    np.testing.assert_allclose(errors, (np.exp(np.outer(times, poles)) @ shares), rtol=0.0, atol=1e-4)


def test_a_reference_that_is_followed_needs_its_own_acceleration():
    assert wanted_acceleration(7.0, 0.0, 0.0, 0.0, 5.0, 1000.0) == 7.0
    assert wanted_acceleration(7.0, 2.0, 0.1, 3.0, 5.0, 1000.0) == pytest.approx(7.0 + 10.0 + 100.0 + 3.0)


def test_the_drives_follow_the_measured_rate_where_the_error_is_beyond_what_the_springs_can_answer():
    assert followed_rate(-8.0, 0.5, 0.3, 0.4) == -8.0
    assert followed_rate(-8.0, 0.5, -0.6, 0.4) == pytest.approx(-3.75)
    assert followed_rate(-8.0, 0.5, 3.0, 0.4) == 0.5
    assert followed_rate(-8.0, 0.5, 3.0, 0.0) == 0.5
