"""The reference motion: boundary conditions, and the closed form of its effort."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.control.reference_motion import remaining_offset


def test_it_begins_as_it_is_and_ends_at_rest():
    assert remaining_offset(-0.8, 1.5, -4.0, 0.0, 0.3) == pytest.approx((-0.8, 1.5, -4.0))
    assert remaining_offset(-0.8, 1.5, -4.0, 0.3, 0.3) == (0.0, 0.0, 0.0)
    assert remaining_offset(-0.8, 1.5, -4.0, 0.3 - 1e-9, 0.3) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


def test_rate_and_acceleration_are_the_derivatives():
    times, step = np.linspace(0.01, 0.29, 15), 1e-5
    for time in times:
        before, now, after = (remaining_offset(0.5, -3.0, 20.0, time + shift, 0.3) for shift in (-step, 0.0, step))
        assert (after[0] - before[0]) / (2 * step) == pytest.approx(now[1], rel=1e-6, abs=1e-6)
        assert (after[1] - before[1]) / (2 * step) == pytest.approx(now[2], rel=1e-6, abs=1e-4)


def test_its_integrated_square_of_the_rate_is_the_closed_form():
    # A minimum jerk over A in T costs (10/7) A^2/T (eq. 8), and a lead T_l adds T_l^2 (120/7) A^2/T^3.
    amplitude, duration = 0.7, 0.4
    times = np.linspace(0.0, duration, 4001)
    rates = np.array([remaining_offset(-amplitude, 0.0, 0.0, time, duration) for time in times])
    assert np.trapezoid(rates[:, 1] ** 2, times) == pytest.approx(10 / 7 * amplitude**2 / duration, rel=1e-6)
    assert np.trapezoid(rates[:, 2] ** 2, times) == pytest.approx(120 / 7 * amplitude**2 / duration**3, rel=1e-5)
