"""Springs in series with an elastic structure: closed forms, root finding, limits."""

import numpy as np
import pytest
from helpers import device
from scipy.optimize import brentq

from amulett_gym.model.spring import assembly_curve, build_tables, estimate_force
from amulett_gym.model.structure import in_series, string_tables
from amulett_gym.profile import Spring, Structure, load_profile

SPRING = load_profile("testbed").spring
TABLES = build_tables(SPRING)
STOP = {"beyond": "hard-stop", "stop_stiffness": 3e4}
ENDS = {"held": {}, "continued": {"beyond": "continued"}, "hard-stop": STOP}


def slider(tables, deflection):
    """Return what the potentiometer reads [m], as the kernel looks it up."""
    place = deflection / tables.max_deflection * len(tables.spring_deflection)
    cell = min(int(place), len(tables.spring_deflection) - 1)
    return float(np.polyval(tables.spring_deflection[cell, ::-1], place - cell))


def test_linear_springs_have_the_series_stiffness():
    curve = {"deflection_m": [0.0, 0.005, 0.01], "force_N": [0.0, 10.0, 20.0]}  # 2 kN/m
    profile = device("testbed", spring={"measured_curve": curve, "beyond": "continued"}, structure={"stiffness": 8e3})
    tables, stiffness = string_tables(profile), 2e3 * 8e3 / (2e3 + 8e3)
    assert tables.max_deflection == pytest.approx(0.01 + 20.0 / 8e3)
    assert tables.max_stiffness == pytest.approx(stiffness)
    for deflection in (0.0, 0.004, 0.0124, 0.02):
        assert tables.force_at(deflection) == pytest.approx(stiffness * deflection, abs=1e-12)
        assert tables.stiffness_at(deflection) == pytest.approx(stiffness)
    # The slider is on the spring: without a column of its own, its deflection is that of the spring.
    assert slider(tables, 0.01) == pytest.approx(0.01 * 0.8)
    assert tables.beyond.slider / tables.max_deflection == pytest.approx(0.8)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("stiffness", [8e4, 1e4])
def test_a_string_has_the_force_at_which_springs_and_structure_are_in_balance(end, stiffness):
    profile = device("testbed", spring=ENDS[end], structure={"stiffness": stiffness})
    tables, springs = string_tables(profile), build_tables(profile.spring)
    for deflection in np.linspace(0.0, 2.0 * SPRING.max_deflection, 37):
        own = brentq(lambda y, d=deflection: y + springs.force_at(y) / stiffness - d, 0.0, deflection, xtol=1e-18)
        assert tables.force_at(deflection) == pytest.approx(springs.force_at(own), abs=1e-5)
        if deflection <= tables.max_deflection and own <= SPRING.max_deflection:
            _, stretched = assembly_curve(SPRING, np.array(own))
            assert slider(tables, deflection) == pytest.approx(float(stretched), abs=1e-8)
    assert tables.max_stiffness < min(springs.max_stiffness, stiffness)


def test_far_beyond_their_range_continued_springs_go_on_straight():
    profile = device("testbed", spring=ENDS["continued"], structure={})
    tables, springs = string_tables(profile), build_tables(profile.spring)
    assert tables.max_force == pytest.approx(springs.force_at(4.0 * SPRING.max_deflection))
    last = tables.max_deflection
    series = 1.0 / (1.0 / springs.stiffness_at(4.0 * SPRING.max_deflection) + 1.0 / profile.structure.stiffness)
    for further in (1e-9, 0.01, 0.1):
        assert tables.force_at(last + further) - tables.force_at(last) == pytest.approx(series * further, rel=1e-5)


@pytest.mark.parametrize("end", ["held", "hard-stop"])
def test_a_rigid_structure_is_none(end):
    springs = build_tables(SPRING.model_copy(update=ENDS[end]))
    rigid = in_series(springs, 1e300)
    np.testing.assert_allclose(rigid.force, springs.force, rtol=0, atol=1e-12 * springs.max_force)
    np.testing.assert_allclose(rigid.spring_deflection, springs.spring_deflection, rtol=0, atol=1e-16)
    assert rigid.max_deflection == springs.max_deflection
    assert rigid.beyond == pytest.approx(springs.beyond)


def test_a_rigid_structure_changes_continued_springs_by_their_table_only():
    springs = build_tables(SPRING.model_copy(update=ENDS["continued"]))
    rigid = in_series(springs, 1e300)
    for deflection in np.linspace(0.0, 3.9 * SPRING.max_deflection, 101):
        assert rigid.force_at(deflection) == pytest.approx(springs.force_at(deflection), abs=1e-5)


def test_the_microcontrollers_tables_stay_those_of_the_springs():
    tables = string_tables(device("testbed", structure={"stiffness": 1e4}))
    np.testing.assert_array_equal(tables.estimated_force, TABLES.estimated_force)
    np.testing.assert_array_equal(tables.estimated_slope, TABLES.estimated_slope)
    assert tables.max_spring_deflection == TABLES.max_spring_deflection
    for deflection in np.linspace(0.002, 0.999 * tables.max_deflection, 50):
        estimate = estimate_force(tables.estimated_force, slider(tables, deflection), tables.max_spring_deflection)
        assert estimate == pytest.approx(tables.force_at(deflection), abs=1e-4)
    np.testing.assert_array_equal(string_tables(load_profile("testbed")).force, TABLES.force)


def test_the_default_is_what_its_sources_say():
    stiffness = Structure().stiffness
    slope = TABLES.stiffness_at(TABLES.deflection_at(5.0))
    assert slope / stiffness == pytest.approx(0.05, rel=0.03)  # section 2.2: 5 % of the force
    width, thickness, length, modulus = 0.02, 0.008, 0.04, 2.2e9
    assert stiffness < 3.0 * modulus * (width * thickness**3 / 12.0) / length**3 == pytest.approx(88e3)


def test_very_soft_and_slack_strings_are_sound():
    soft = in_series(build_tables(Spring.model_validate(SPRING.model_dump())), 100.0)
    assert (np.diff([soft.force_at(y) for y in np.linspace(-0.01, soft.max_deflection, 999)]) >= 0.0).all()
    assert soft.force_at(-0.01) == 0.0
    assert soft.max_stiffness < 100.0
