"""Feedback linearisation against the plant's own equations, differentiated numerically."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.feedback_linearisation import decoupling_determinant, desired_jerk, drive_rates, tautness
from amulett_gym.model.damping import decay_rate, preload_force
from amulett_gym.model.plant import (
    deflection_biceps,
    deflection_triceps,
    inertia,
    joint_acceleration,
    static_torque,
    weight_torque,
)
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile

PROFILE = load_profile("testbed")
TABLES = build_tables(PROFILE.spring)
RADII = PROFILE.plant.drive_pulley_radius, PROFILE.plant.joint_pulley_radius
MASSES = [item.mass for item in PROFILE.plant.masses], [item.arm for item in PROFILE.plant.masses]
INERTIA, WEIGHT = float(inertia(*MASSES)), float(static_torque(*MASSES))
DECAY = 4.0


def drives(angle: float, biceps: float, triceps: float) -> np.ndarray:
    """Return the drive angles [rad] at which the strings have given forces [N]."""
    wound = angle * RADII[1]
    first, second = wound + TABLES.deflection_at(biceps), wound - TABLES.deflection_at(triceps)
    return np.array([first, second]) / RADII[0]


def forces(angle: float, turned: np.ndarray) -> tuple[float, float]:
    first, second = deflection_biceps(turned[0], angle, *RADII), deflection_triceps(turned[1], angle, *RADII)
    return TABLES.force_at(first), TABLES.force_at(second)


def slopes(angle: float, turned: np.ndarray) -> tuple[float, float]:
    first, second = deflection_biceps(turned[0], angle, *RADII), deflection_triceps(turned[1], angle, *RADII)
    return TABLES.stiffness_at(first), TABLES.stiffness_at(second)


def outputs(angle: float, velocity: float, turned: np.ndarray, constant_decay: bool) -> np.ndarray:
    """Return acceleration [rad/s2] and mean tension [N] of the vertical arm."""
    pulls = forces(angle, turned)
    damping = PROFILE.damping
    shift = damping.b * damping.c  # the testbed's fit is the shifted one
    decay = decay_rate(preload_force(*pulls, True), damping.a, damping.b, shift, damping.d)
    decay = DECAY if constant_decay else decay
    acceleration = joint_acceleration(velocity, *pulls, decay, weight_torque(WEIGHT, angle), 0.0, INERTIA, RADII[1])
    return np.array([acceleration, sum(pulls) / 2.0])


def rates(angle, velocity, turned, drive_rate, constant_decay=True, step=1e-6) -> np.ndarray:
    """Return jerk [rad/s3] and the mean tension's rate [N/s] by central differences along the motion."""
    acceleration = outputs(angle, velocity, turned, constant_decay)[0]
    ahead, behind = (
        outputs(
            angle + h * velocity + h * h / 2.0 * acceleration,
            velocity + h * acceleration,
            turned + h * drive_rate,
            constant_decay,
        )
        for h in (step, -step)
    )
    return (ahead - behind) / (2.0 * step)


@pytest.mark.parametrize(("biceps", "triceps"), [(8.0, 8.0), (15.0, 5.0), (4.0, 12.0), (1.0, 18.0)])
def test_the_decoupling_determinant_is_that_of_the_model(biceps, triceps):
    angle = 0.6
    turned = drives(angle, biceps, triceps)
    for velocity, constant_decay in ((0.0, False), (2.0, True)):
        start = rates(angle, velocity, turned, np.zeros(2), constant_decay)
        columns = [rates(angle, velocity, turned, unit, constant_decay) - start for unit in np.eye(2)]
        determinant = np.linalg.det(np.array(columns).T)
        expected = -(RADII[0] ** 2 * RADII[1] / INERTIA) * np.prod(slopes(angle, turned))
        assert determinant == pytest.approx(expected, rel=2e-4)
        assert decoupling_determinant(slopes(angle, turned), INERTIA, *RADII) == pytest.approx(expected, rel=1e-12)


def test_a_slack_string_makes_the_determinant_zero():
    assert decoupling_determinant((5000.0, 0.0), INERTIA, *RADII) == 0.0


@pytest.mark.parametrize(("jerk", "tension_rate"), [(0.0, 0.0), (3000.0, 0.0), (0.0, 40.0), (-2000.0, -25.0)])
def test_jerk_and_tension_rate_come_out_independently(jerk, tension_rate):
    angle, velocity = 0.6, 1.7
    turned = drives(angle, 12.0, 7.0)
    acceleration = outputs(angle, velocity, turned, True)[0]
    needed = jerk + 2.0 * DECAY * acceleration + WEIGHT / INERTIA * np.cos(angle) * velocity
    asked = drive_rates(needed, tension_rate, velocity, slopes(angle, turned), INERTIA, *RADII)
    assert rates(angle, velocity, turned, np.array(asked)) == pytest.approx([jerk, tension_rate], rel=1e-3, abs=0.5)


def test_flexion_and_extension_are_mirrored():
    first = drive_rates(500.0, 3.0, 0.7, (4000.0, 6000.0), INERTIA, *RADII)
    second = drive_rates(-500.0, 3.0, -0.7, (6000.0, 4000.0), INERTIA, *RADII)
    assert first == pytest.approx((-second[1], -second[0]))


def test_the_error_has_a_triple_pole_at_the_bandwidth():
    for power in range(3):  # e = t^n exp(-w t) are the free answers
        w, time = 20.0, 0.07
        error = np.polynomial.Polynomial([0.0] * power + [1.0])
        derivatives = [error]
        for _ in range(3):
            derivatives.append(derivatives[-1].deriv() - w * derivatives[-1])
        now = [float(each(time)) for each in derivatives]
        reference_jerk = 7.0
        assert desired_jerk(*now[:3], reference_jerk, w) == pytest.approx(reference_jerk - now[3])


def test_feed_forward_takes_over_near_slack():
    assert tautness(4.0, 9.0, 4.0) == 1.0
    assert tautness(9.0, 1.0, 4.0) == 0.25
    assert tautness(0.0, 9.0, 4.0) == tautness(-0.1, 9.0, 4.0) == 0.0
