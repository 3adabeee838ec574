"""The reference motion: boundary conditions, and the closed form of its effort."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.reference_motion import (
    CRITICALLY_DAMPED,
    FIRST_ORDER,
    MINIMUM_JERK,
    remaining_jerk,
    remaining_offset,
)

FILTERS = (CRITICALLY_DAMPED, FIRST_ORDER)


def test_it_begins_as_it_is_and_ends_at_rest():
    assert remaining_offset(MINIMUM_JERK, -0.8, 1.5, -4.0, 0.0, 0.3) == pytest.approx((-0.8, 1.5, -4.0))
    assert remaining_offset(MINIMUM_JERK, -0.8, 1.5, -4.0, 0.3, 0.3) == (0.0, 0.0, 0.0)
    assert remaining_jerk(MINIMUM_JERK, -0.8, 1.5, -4.0, 0.3, 0.3) == 0.0
    assert remaining_offset(MINIMUM_JERK, -0.8, 1.5, -4.0, 0.3 - 1e-9, 0.3) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


@pytest.mark.parametrize("shape", [MINIMUM_JERK, *FILTERS])
def test_rate_acceleration_and_jerk_are_the_derivatives(shape):
    times, step = np.linspace(0.01, 0.29, 15), 1e-5
    for time in times:
        before, now, after = (
            remaining_offset(shape, 0.5, -3.0, 20.0, time + shift, 0.3) for shift in (-step, 0.0, step)
        )
        assert (after[0] - before[0]) / (2 * step) == pytest.approx(now[1], rel=1e-6, abs=1e-6)
        assert (after[1] - before[1]) / (2 * step) == pytest.approx(now[2], rel=1e-6, abs=1e-4)
        jerk = remaining_jerk(shape, 0.5, -3.0, 20.0, time, 0.3)
        assert (after[2] - before[2]) / (2 * step) == pytest.approx(jerk, rel=1e-5, abs=1e-2)


def test_its_integrated_square_of_the_rate_is_the_closed_form():
    # A minimum jerk over A in T costs (10/7) A^2/T (eq. 8), and a lead T_l adds T_l^2 (120/7) A^2/T^3.
    amplitude, duration = 0.7, 0.4
    times = np.linspace(0.0, duration, 4001)
    rates = np.array([remaining_offset(MINIMUM_JERK, -amplitude, 0.0, 0.0, time, duration) for time in times])
    assert np.trapezoid(rates[:, 1] ** 2, times) == pytest.approx(10 / 7 * amplitude**2 / duration, rel=1e-6)
    assert np.trapezoid(rates[:, 2] ** 2, times) == pytest.approx(120 / 7 * amplitude**2 / duration**3, rel=1e-5)


@pytest.mark.parametrize("shape", FILTERS)
def test_a_filter_has_two_percent_left_at_its_time(shape):
    assert remaining_offset(shape, -0.8, 0.0, 0.0, 0.0, 0.3)[0] == -0.8
    assert remaining_offset(shape, -0.8, 0.0, 0.0, 0.3, 0.3)[0] == pytest.approx(-0.016, rel=1e-6)


def test_a_critically_damped_answer_goes_on_from_the_rate():
    before = remaining_offset(CRITICALLY_DAMPED, 0.8, -1.0, 0.0, 0.1, 0.3)
    expected = remaining_offset(CRITICALLY_DAMPED, 0.8, -1.0, 0.0, 0.17, 0.3)
    assert remaining_offset(CRITICALLY_DAMPED, *before, 0.07, 0.3) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("shape", "product"), [(MINIMUM_JERK, 0.560), (CRITICALLY_DAMPED, 0.3125), (FIRST_ORDER, 0.25)]
)
def test_the_product_of_ise_and_effort_is_the_closed_form(shape, product):
    times = np.linspace(0.0, 3.0, 30_001)
    offset, rate, _ = np.array([remaining_offset(shape, -1.0, 0.0, 0.0, time, 0.3) for time in times]).T
    assert np.trapezoid(offset**2, times) * np.trapezoid(rate**2, times) == pytest.approx(product, rel=1e-3)
