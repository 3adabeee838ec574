"""Inverse statics: the torque and the co-contraction asked for come out, by the plant's own equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from amulett_gym.control.inverse_statics import affordable_tension, drive_angles, stiff_pair, string_forces
from amulett_gym.model.plant import deflection_biceps, deflection_triceps
from amulett_gym.model.spring import build_tables, find_position, find_positions, inverse_look_up
from amulett_gym.profile import load_profile

PLANT = load_profile("testbed").plant
TABLES = build_tables(load_profile("testbed").spring)


@pytest.mark.parametrize("torque", [-0.3, -0.01, 0.0, 0.2])
@pytest.mark.parametrize("tension", [0.0, 4.0, 10.0])
def test_the_torque_comes_out_and_the_antagonist_has_the_tension(torque, tension):
    biceps, triceps = string_forces(torque, tension, PLANT.joint_pulley_radius, TABLES.max_force)
    assert PLANT.joint_pulley_radius * (biceps - triceps) == pytest.approx(torque, abs=1e-12)
    assert min(biceps, triceps) == tension


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_torque_beyond_the_springs_is_limited_to_what_the_tension_leaves(sign):
    biceps, triceps = string_forces(sign * 5.0, 10.0, PLANT.joint_pulley_radius, TABLES.max_force)
    left = (TABLES.max_force - 10.0) * PLANT.joint_pulley_radius
    assert PLANT.joint_pulley_radius * (biceps - triceps) == pytest.approx(sign * left)
    assert string_forces(sign, 99.0, PLANT.joint_pulley_radius, TABLES.max_force) == (TABLES.max_force,) * 2


def test_drive_angles_give_the_deflections_asked_for():
    radii = PLANT.drive_pulley_radius, PLANT.joint_pulley_radius
    first, second = drive_angles(0.4, 0.003, 0.005, *radii)
    assert deflection_biceps(first, 0.4, *radii) == pytest.approx(0.003)
    assert deflection_triceps(second, 0.4, *radii) == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("force", "stretch", "slope", "stiffness", "turn"),
    [
        (4.0, 3.303, 3399.8, 10.88, 13.60),
        (5.25, 3.641, 4001.1, 12.80, 14.99),
        (8.0, 4.245, 5111.1, 16.36, 17.47),
        (10.0, 4.612, 5793.6, 18.54, 18.98),
        (15.0, 5.380, 7206.8, 23.06, 22.15),
    ],
)
def test_the_testbed_has_the_golden_values_of_an_independent_prototype(force, stretch, slope, stiffness, turn):
    deflection = TABLES.deflection_at(force)
    assert 1000.0 * deflection == pytest.approx(stretch, abs=6e-4)
    assert TABLES.stiffness_at(deflection) == pytest.approx(slope, rel=2e-4)
    assert 2.0 * PLANT.joint_pulley_radius**2 * TABLES.stiffness_at(deflection) == pytest.approx(stiffness, abs=6e-3)
    assert deflection / PLANT.drive_pulley_radius * 57.29578 == pytest.approx(turn, abs=6e-3)


@pytest.mark.parametrize("force", [0.0, 1e-6, 1e-3, 0.02, 0.5, 5.0, 21.0, 100.0])
def test_the_fast_inverse_is_that_by_bisection(force):
    expected = inverse_look_up(TABLES.force, min(force, TABLES.max_force)) if force > 0.0 else 0.0
    assert find_position(TABLES.force, TABLES.position, force) == pytest.approx(
        expected, abs=1e-6 if force < 0.01 else 1e-11
    )


@pytest.mark.parametrize("forces", [(0.7, 12.0), (0.0, 99.0), (-1.0, 5.0)])
def test_a_pair_of_positions_is_that_of_both_forces(forces):
    both = tuple(find_position(TABLES.force, TABLES.position, force) for force in forces)
    assert find_positions(TABLES.force, TABLES.position, *forces) == both


def test_the_fast_inverse_takes_a_curve_with_a_flat_part():
    curve = "deflection_m,force_N\n0,0\n0.001,5\n0.002,5.0001\n0.003,12\n"
    tables = build_tables(load_profile({"name": "flat", "base": "testbed", "spring": {"measured_curve": curve}}).spring)
    for force in (0.5, 4.99, 5.00005, 5.5, 12.0):
        position = find_position(tables.force, tables.position, force)
        assert tables.force_at(position * tables.max_deflection) == pytest.approx(force, abs=0.02)


def stiffness(tables, antagonist, pull):
    """Return K of both strings [N m/rad], the agonist's force greater than the antagonist's by `pull`."""
    deflections = (tables.deflection_at(min(force, tables.max_force)) for force in (antagonist, antagonist + pull))
    return PLANT.joint_pulley_radius**2 * sum(tables.stiffness_at(deflection) for deflection in deflections)


def pair(tables, torque, tension):
    """Return the forces of biceps and triceps [N] and the stiffness [N m/rad] of `stiff_pair`."""
    difference = torque / PLANT.joint_pulley_radius
    *positions, slopes, _ = stiff_pair(tables.force, tables.position, difference, tension, tables.max_force)
    forces = [tables.force_at(position * tables.max_deflection) for position in positions]
    return *forces, slopes * PLANT.joint_pulley_radius**2 / tables.max_deflection


def springs(**changes):
    return build_tables(load_profile({"name": "other", "base": "testbed", "spring": changes}).spring)


OTHERS = {
    "shipped": TABLES,
    "half free": springs(free_length=0.004),
    "wide": springs(half_width=0.03, free_length=0.0299),
    "measured": springs(measured_curve="deflection_m,force_N\n0,0\n0.002,1\n0.004,7\n0.006,20\n"),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("load", [-0.5, -0.06, 0.0, 0.1, 0.3])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_torque_and_stiffness_come_out(name, load, share):
    tables = OTHERS[name]
    tension, pull = share * tables.max_force, abs(load) * tables.max_force
    torque = load * tables.max_force * PLANT.joint_pulley_radius
    wanted = stiffness(tables, tension, 0.0)
    biceps, triceps, found = pair(tables, torque, tension)
    assert PLANT.joint_pulley_radius * (biceps - triceps) == pytest.approx(torque, abs=1e-7)
    lowest, highest = stiffness(tables, 0.0, pull), stiffness(tables, tables.max_force - pull, pull)
    assert found == pytest.approx(min(max(wanted, lowest), highest), rel=2e-3)
    if lowest < wanted < highest:
        expected = brentq(lambda force: stiffness(tables, force, pull) - wanted, 0.0, tables.max_force - pull)
        assert min(biceps, triceps) == pytest.approx(expected, abs=0.03)


def test_torque_comes_before_stiffness():
    most = TABLES.max_force * PLANT.joint_pulley_radius
    assert pair(TABLES, 2.0 * most, 10.0)[:2] == pytest.approx((TABLES.max_force, 0.0), abs=1e-6)
    biceps, triceps, _ = pair(TABLES, -0.9 * most, 20.0)
    assert (biceps, triceps) == pytest.approx((0.1 * TABLES.max_force, TABLES.max_force), abs=1e-6)


def test_a_slack_string_has_no_nan():
    assert np.isfinite([pair(TABLES, torque, 0.0) for torque in (-0.1, 0.0, 0.1)]).all()
    assert pair(TABLES, 0.2, 0.0)[:2] == pytest.approx((5.0, 0.0), abs=1e-3)


@pytest.mark.parametrize(("torque", "expected"), [(0.0, 10.0), (0.4, 10.0), (-0.6, None), (0.8, None), (2.0, 0.0)])
def test_the_tension_gives_way_to_the_torque(torque, expected):
    tension = affordable_tension(torque, 10.0, PLANT.joint_pulley_radius, TABLES.max_force)
    left = TABLES.max_force - abs(torque) / PLANT.joint_pulley_radius
    assert tension == pytest.approx(left if expected is None else expected)
