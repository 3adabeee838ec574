"""Piecewise cubics: the numbers of `scipy.interpolate`, to the last bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from amulett_gym.model import cubics

# Whole ones: equal neighbours, turns.
numbers = st.one_of(st.integers(-3, 3).map(float), st.floats(-1e6, 1e6).map(lambda x: round(x, 6)))
widths = st.lists(st.floats(1e-6, 1e3), min_size=1, max_size=30)


@st.composite
def curves(draw):
    """Return knots, values and slopes, and places between and beyond the knots, among them all knots."""
    x = np.cumsum([draw(st.floats(-1e3, 1e3)), *draw(widths)])
    y, slopes = (np.array(draw(st.lists(numbers, min_size=x.size, max_size=x.size))) for _ in range(2))
    places = draw(st.lists(st.floats(-0.5, 1.5), max_size=20))
    return x, y, slopes, np.concatenate([x, x[0] + (x[-1] - x[0]) * np.array(places)])


@given(curves())
def test_monotone_cubics_are_those_of_scipy(curve):
    x, y, _, places = curve
    expected = PchipInterpolator(x, y)
    found = cubics.monotone(x, y)
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, expected.c[::-1].T)
    np.testing.assert_array_equal(cubics.value(x, found, places), expected(places))
    np.testing.assert_array_equal(cubics.slope(x, found, places), expected.derivative()(places))


@given(curves())
def test_cubics_with_given_slopes_are_those_of_scipy(curve):
    x, y, slopes, _ = curve
    np.testing.assert_array_equal(cubics.through(x, y, slopes), CubicHermiteSpline(x, y, slopes).c[::-1].T)


def test_an_extremum_among_the_values_is_one_of_the_curve():
    x, y = np.arange(5.0), np.array([0.0, 1.0, 3.0, 2.0, 2.0])
    assert cubics.monotone_slopes(x, y)[[2, 3, 4]].tolist() == [0.0, 0.0, 0.0]
    assert cubics.value(x, cubics.monotone(x, y), np.linspace(0.0, 4.0, 101)).max() == 3.0


def test_a_place_alone_gives_a_number():
    x, y = np.array([0.0, 1.0, 4.0]), np.array([0.0, 1.0, 16.0])
    assert cubics.value(x, cubics.monotone(x, y), np.float64(2.5)) == pytest.approx(PchipInterpolator(x, y)(2.5))
