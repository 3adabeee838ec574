"""Joint torque control: the torque's setpoint, and the rate at which the plant's own torque approaches it."""

from __future__ import annotations

import pytest

from amulett_gym.control.inverse_statics import drive_angles
from amulett_gym.control.torque import common_rate, desired_torque
from amulett_gym.model.plant import deflection_biceps, deflection_triceps
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile

PROFILE = load_profile("testbed")
TABLES = build_tables(PROFILE.spring)
RADII = PROFILE.plant.drive_pulley_radius, PROFILE.plant.joint_pulley_radius


@pytest.mark.parametrize("velocity", [-2.0, 0.0, 3.0])
@pytest.mark.parametrize("missing", [-0.1, 0.0, 0.2])
def test_the_torque_approaches_its_setpoint_whatever_the_motion(missing, velocity):
    angle, time_constant, step = 0.4, 0.03, 1e-6
    stretches = TABLES.deflection_at(11.0), TABLES.deflection_at(7.0)
    first, second = drive_angles(angle, *stretches, *RADII)
    stiffness = RADII[1] ** 2 * sum(map(TABLES.stiffness_at, stretches))
    rate = common_rate(missing, velocity, stiffness, time_constant, *RADII)

    def torque(time: float) -> float:
        x, turn = angle + velocity * time, rate * time
        biceps = TABLES.force_at(deflection_biceps(first + turn, x, *RADII))
        return RADII[1] * (biceps - TABLES.force_at(deflection_triceps(second + turn, x, *RADII)))

    assert (torque(step) - torque(-step)) / (2.0 * step) == pytest.approx(missing / time_constant, rel=1e-4, abs=1e-4)


def test_the_setpoint_is_that_of_a_spring_a_damper_and_the_load():
    assert desired_torque(0.1, -0.2, 5.0, 0.5, 0.03, 1.0) == pytest.approx(0.5 - 0.1 + 0.03)
    assert desired_torque(0.5, 0.0, 5.0, 0.5, 0.0, 0.8) == 0.8
    assert desired_torque(-0.5, 0.0, 5.0, 0.5, 0.0, 0.8) == -0.8


def test_without_spring_and_damper_the_setpoint_is_the_load_wherever_the_arm_is():
    assert desired_torque(1.0, 2.0, 0.0, 0.0, 0.0, 0.8) == 0.0
    assert desired_torque(1.0, 2.0, 0.0, 0.0, 0.1, 0.8) == 0.1
