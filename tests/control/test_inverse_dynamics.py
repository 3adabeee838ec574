"""Inverse dynamics: the plant's own equation of motion gives the acceleration back."""

from __future__ import annotations

import pytest

from amulett_gym.control.inverse_dynamics import joint_torque
from amulett_gym.model.plant import joint_acceleration, weight_torque


@pytest.mark.parametrize("acceleration", [-40.0, 0.0, 7.0])
def test_the_plant_accelerates_as_asked(acceleration):
    rate, inertia, decay, weight, radius = -1.5, 0.005, 5.4, weight_torque(0.33, 0.7), 0.04
    torque = joint_torque(acceleration, rate, inertia, decay, weight)
    found = joint_acceleration(rate, 10.0 + torque / radius, 10.0, decay, weight, 0.0, inertia, radius)
    assert found == pytest.approx(acceleration, abs=1e-9)
