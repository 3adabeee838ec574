"""The non-linear spring assembly (Figure 5a), its look-up tables, and measured curves instead of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import CELLS, assembly_curve, build_tables, estimate_force, look_up
from amulett_gym.profile import Spring, load_profile

SPRING = load_profile("simulation").spring
TABLES = build_tables(SPRING)

springs = st.builds(
    lambda stiffness, width, free, reach: Spring(
        stiffness=stiffness, half_width=width, free_length=free * width, max_deflection=reach * width
    ),
    st.floats(10, 10_000),
    st.floats(0.002, 0.05),
    st.floats(0, 1),
    st.floats(0.1, 3),
)
fractions = st.floats(0, 1)


def closed_form(spring, deflection):
    length = np.sqrt(spring.half_width**2 + deflection**2)
    return 2 * spring.stiffness * (length - spring.free_length) * deflection / length


def test_geometry_in_a_triangle_of_3_4_and_5():
    spring = Spring(stiffness=100.0, half_width=3.0, free_length=3.0, max_deflection=4.0)
    force, spring_deflection = assembly_curve(spring, np.array([0.0, 4.0]))
    assert force.tolist() == pytest.approx([0, 320])  # two springs, stretched by 2 m, pulling at 4/5 along the string
    assert spring_deflection.tolist() == [0, 2]


@given(springs, fractions)
def test_table_follows_the_geometry(spring, fraction):
    tables = build_tables(spring)
    force = tables.force_at(fraction * spring.max_deflection)
    assert force == pytest.approx(closed_form(spring, fraction * spring.max_deflection), abs=2e-5 * tables.max_force)


@given(springs)
def test_force_rises_and_is_interpolated_as_scipy_does(spring):
    tables = build_tables(spring)
    fine = np.linspace(0, spring.max_deflection, 4 * CELLS + 3)
    force = np.array([tables.force_at(y) for y in fine])
    assert (np.diff(force) >= 0).all()
    knots = np.linspace(0, spring.max_deflection, CELLS + 1)
    expected = PchipInterpolator(knots, closed_form(spring, knots))(fine)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-11 * tables.max_force)


@given(springs, st.floats(0.01, 0.999))
def test_inverse_undoes_the_force(spring, fraction):
    tables = build_tables(spring)
    deflection = fraction * tables.max_deflection
    assert tables.deflection_at(tables.force_at(deflection)) == pytest.approx(deflection, rel=1e-9)


def test_largest_force_has_an_inverse():
    tables = build_tables(Spring(stiffness=10.0, half_width=0.002, free_length=0.002, max_deflection=0.00293359375))
    assert tables.deflection_at(tables.force_at(1.0)) == pytest.approx(tables.max_deflection)


@given(st.integers(0, CELLS - 1), st.floats(0.1, 0.9))
def test_slope_is_the_derivative_of_the_force(cell, within):
    width = TABLES.max_deflection / CELLS
    deflection, step = (cell + within) * width, 0.01 * width
    difference = (TABLES.force_at(deflection + step) - TABLES.force_at(deflection - step)) / (2 * step)
    assert TABLES.stiffness_at(deflection) == pytest.approx(difference, rel=1e-5, abs=1e-6 * TABLES.max_force / width)


def test_slack_string_has_no_force_and_beyond_the_table_the_force_is_held():
    assert TABLES.force_at(-0.001) == TABLES.stiffness_at(-0.001) == 0
    assert TABLES.force_at(2 * TABLES.max_deflection) == TABLES.force_at(TABLES.max_deflection) == TABLES.max_force
    assert TABLES.stiffness_at(2 * TABLES.max_deflection) == 0


@pytest.mark.parametrize("force", [-0.1, 100.0, float("nan")])
def test_inverse_refuses_a_force_that_the_springs_cannot_give(force):
    with pytest.raises(AmulettError, match=r"outside what the springs give: 0 to \d+\.\d+ N"):
        TABLES.deflection_at(force)


@given(fractions)
def test_force_is_estimated_from_what_the_potentiometer_sees(fraction):
    deflection = fraction * TABLES.max_deflection
    seen = look_up(TABLES.spring_deflection, fraction)
    estimate = estimate_force(TABLES.estimated_force, seen, TABLES.max_spring_deflection)
    force = TABLES.force_at(deflection)
    # In the first cells the spring's deflection grows with the square of the string's: the tables are coarse there.
    assert estimate == pytest.approx(force, abs=1e-5 if force > 0.5 else 3e-3)


def write_curve(path, columns, rows):
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def measured(path):
    return Spring.model_validate({**SPRING.model_dump(), "measured_curve": path})


def test_measured_curve_of_the_geometric_model_gives_its_tables_back(tmp_path):
    deflection = np.linspace(0, SPRING.max_deflection, CELLS + 1)
    rows = np.column_stack([deflection, *assembly_curve(SPRING, deflection)]).tolist()
    path = write_curve(tmp_path / "curve.csv", ("deflection_m", "force_N", "spring_deflection_m"), rows)
    tables = build_tables(measured(path))
    np.testing.assert_allclose(tables.force, TABLES.force, atol=1e-11)
    np.testing.assert_allclose(tables.spring_deflection, TABLES.spring_deflection, atol=1e-11)
    np.testing.assert_allclose(tables.estimated_force, TABLES.estimated_force, atol=1e-11)
    assert tables.max_deflection == TABLES.max_deflection


def test_without_a_third_column_the_potentiometer_sees_the_string_itself(tmp_path):
    path = write_curve(tmp_path / "curve.csv", ("force_N", "deflection_m"), [(0, 0), (5, 0.002), (10, 0.004)])
    tables = build_tables(measured(path))
    assert tables.force_at(0.003) == pytest.approx(7.5)
    assert tables.max_spring_deflection == tables.max_deflection == 0.004


def test_profile_names_its_measured_curve_relative_to_itself(tmp_path):
    write_curve(tmp_path / "curve.csv", ("deflection_m", "force_N"), [(0, 0), (0.002, 5), (0.004, 10)])
    (tmp_path / "own.yaml").write_text("{name: own, base: testbed, spring: {measured_curve: curve.csv}}")
    assert build_tables(load_profile(tmp_path / "own.yaml").spring).max_force == pytest.approx(10)


def beyond(share, **changes):
    """Return a changed spring's force and its slope at a share of its table's range."""
    tables = build_tables(Spring.model_validate({**SPRING.model_dump(), **changes}))
    deflection = share * tables.max_deflection
    step = 1e-6 * tables.max_deflection
    slope = (tables.force_at(deflection + step) - tables.force_at(deflection - step)) / (2 * step)
    assert tables.stiffness_at(deflection) == pytest.approx(slope, rel=1e-5, abs=1e-6)
    assert tables.stiffness_at(deflection) <= tables.max_stiffness * (1 + 1e-9)
    return tables.force_at(deflection), slope


@given(st.floats(1.01, 10.0))
def test_beyond_the_table_the_law_goes_on_or_a_stop_takes_over(share):
    deflection = share * SPRING.max_deflection
    assert beyond(share) == beyond(share, beyond="held") == (TABLES.max_force, 0.0)
    assert beyond(share, beyond="continued")[0] == pytest.approx(closed_form(SPRING, deflection), rel=1e-12)
    stopped, slope = beyond(share, beyond="hard-stop", stop_stiffness=4e4)
    assert stopped == pytest.approx(TABLES.max_force + 4e4 * (deflection - SPRING.max_deflection), rel=1e-12)
    assert slope == pytest.approx(4e4, rel=1e-5)


@given(fractions)
def test_what_follows_the_table_changes_nothing_in_it(fraction):
    for changes in ({"beyond": "continued"}, {"beyond": "hard-stop", "stop_stiffness": 4e4}):
        tables = build_tables(Spring.model_validate({**SPRING.model_dump(), **changes}))
        deflection = fraction * TABLES.max_deflection
        assert tables.force_at(deflection) == TABLES.force_at(deflection)
        assert tables.max_force == TABLES.max_force  # for the loops that ask how far a string may be pulled
        with pytest.raises(AmulettError, match="outside what the springs give"):
            tables.deflection_at(1.01 * TABLES.max_force)


def test_a_measured_curve_goes_on_with_its_last_slope(tmp_path):
    curve = {"measured_curve": "deflection_m,force_N\n0,0\n0.002,5\n0.004,12\n0.006,20\n"}
    force, slope = beyond(2.0, **curve, beyond="continued")
    assert slope == pytest.approx(PchipInterpolator([0, 0.002, 0.004, 0.006], [0, 5, 12, 20])(0.006, 1), rel=1e-6)
    assert force == pytest.approx(20.0 + 0.006 * slope)
    stopped, _ = beyond(2.0, **curve, beyond="hard-stop", stop_stiffness=1e4)
    assert stopped == pytest.approx(20.0 + 0.006 * 1e4)
