"""The regulator's gains solve the algebraic Riccati equation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from amulett_gym.control.torque_stiffness import regulator_gains

INERTIA = 0.0047
WEIGHTS = [
    (0.0, 400.0, 0.0, 1.0),
    (0.0, 3.0, 0.2, 0.5),
    (100.0, 50.0, 0.0, 1.0),
    (1e4, 1.0, 0.01, 2.0),
    (1e6, 10.0, 1.0, 0.1),
]


@pytest.mark.parametrize("weights", WEIGHTS)
def test_gains_are_those_of_the_riccati_equation(weights):
    integral, angle, rate, torque = weights
    states = 3 if integral > 0.0 else 2  # an integral without a weight is not stabilised
    chain, by_torque = np.diag(np.ones(states - 1), 1), np.zeros((states, 1))
    by_torque[-1] = 1.0 / INERTIA
    cost = np.diag([integral, angle, rate][3 - states :])
    expected = by_torque.T @ solve_continuous_are(chain, by_torque, cost, [[torque]]) / torque
    found = regulator_gains(*weights, INERTIA)
    np.testing.assert_allclose(found[3 - states :], expected[0], rtol=1e-6)
    assert integral > 0.0 or found[0] == 0.0


def test_without_a_weight_of_the_rate_the_damping_ratio_is_that_of_butterworth():
    _, stiffness, damping = regulator_gains(0.0, 400.0, 0.0, 1.0, INERTIA)
    assert stiffness == 20.0
    assert damping / (2.0 * math.sqrt(stiffness * INERTIA)) == pytest.approx(math.sqrt(0.5))
