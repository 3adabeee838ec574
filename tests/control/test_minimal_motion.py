"""Minimal motion: of the pairs that give the torque, the nearest by exhaustive search."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.minimal_motion import nearest_pair
from amulett_gym.model.spring import build_tables, find_position, look_up
from amulett_gym.profile import load_profile

TABLES = build_tables(load_profile("testbed").spring)
MOST = TABLES.max_force


def nearest(difference, least, biceps, triceps):
    return nearest_pair(TABLES.force, TABLES.position, difference, least, MOST, biceps, triceps)


def pairs(difference, least):
    """Return pairs on the whole curve, finely."""
    apart = min(abs(difference), MOST - least)
    tensions = np.linspace(least, MOST - apart, 4001)
    agonist = np.array([find_position(TABLES.force, TABLES.position, tension + apart) for tension in tensions])
    antagonist = np.array([find_position(TABLES.force, TABLES.position, tension) for tension in tensions])
    return np.array([agonist, antagonist] if difference >= 0.0 else [antagonist, agonist])


@pytest.mark.parametrize("difference", [-3.0, 0.0, 0.4, 6.0])
@pytest.mark.parametrize("least", [0.5, 5.0])
def test_it_is_the_nearest_pair(difference, least):
    curve = pairs(difference, least)
    for start in (500, 2000, 3500):
        for shift in ((0.01, 0.02), (-0.03, 0.01), (0.04, 0.05)):
            given = curve[:, start] + shift
            best = np.min(np.hypot(*(curve - given[:, None])))
            assert np.hypot(*(nearest(difference, least, *given) - given)) < best + 1e-6


@pytest.mark.parametrize("given", [(1.8, -0.1), (0.05, 1.6), (-0.4, -0.3), (1.4, 1.2)])
def test_from_slack_or_far_beyond_it_is_near_the_nearest(given):
    curve = pairs(2.0, 4.0)
    best = np.min(np.hypot(*(curve - np.array(given)[:, None])))
    assert np.hypot(*(nearest(2.0, 4.0, *given) - np.array(given))) < best + 2e-3


@pytest.mark.parametrize("difference", [-60.0, -4.0, 0.0, 9.0, 60.0])
@pytest.mark.parametrize("least", [0.0, 8.0, MOST])
@pytest.mark.parametrize("given", [(0.5, 0.6), (0.0, 0.0), (-5.0, 7.0), (1.0, 1.0)])
def test_the_torque_and_the_co_contraction_are_exact_in_any_case(difference, least, given):
    biceps, triceps = (look_up(TABLES.force, position) for position in nearest(difference, least, *given))
    limited = np.clip(difference, least - MOST, MOST - least)
    assert biceps - triceps == pytest.approx(limited, abs=1e-6)
    assert min(biceps, triceps) > least - 1e-6


def test_biceps_and_triceps_are_mirrored():
    assert nearest(-3.0, 4.0, 0.5, 0.8) == nearest(3.0, 4.0, 0.8, 0.5)[::-1]


def test_a_pair_on_the_curve_stays():
    biceps, triceps = (find_position(TABLES.force, TABLES.position, force) for force in (12.0, 9.0))
    assert nearest(3.0, 2.0, biceps, triceps) == pytest.approx((biceps, triceps), abs=1e-9)


def test_linear_springs_are_no_exception():
    curve = "deflection_m,force_N\n0,0\n0.002,8\n0.004,16\n"
    tables = build_tables(load_profile({"name": "l", "base": "testbed", "spring": {"measured_curve": curve}}).spring)
    # On a straight curve y_g = y_a + dF/k, the foot of the perpendicular.
    found = nearest_pair(tables.force, tables.position, 4.0, 1.0, tables.max_force, 0.7, 0.3)
    assert found == pytest.approx((0.625, 0.375), abs=1e-9)
