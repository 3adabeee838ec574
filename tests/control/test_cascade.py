"""The cascade: what the outer loop asks for, and what the inner loop does with what it knows of the forces."""

from __future__ import annotations

import pytest

from amulett_gym.control.cascade import force_difference, winding
from amulett_gym.control.inverse_statics import string_forces


def test_the_outer_loop_asks_the_agonist_for_a_force_beyond_the_co_contraction():
    difference = force_difference(0.5, 0.2, 8.0, 2.0)
    assert difference == pytest.approx(8.0 * 0.5 - 2.0 * 0.2)
    assert string_forces(0.04 * difference, 6.0, 0.04, 21.7) == pytest.approx((9.6, 6.0))
    assert string_forces(-0.04 * difference, 6.0, 0.04, 21.7) == pytest.approx((6.0, 9.6))


def test_the_inner_loop_winds_a_string_with_too_little_force():
    assert winding(9.0, 7.0, False, 0.01) == pytest.approx(0.02)
    assert winding(5.5, 7.0, False, 0.01) == pytest.approx(-0.015)


def test_an_untrusted_reading_may_wind_a_string_and_not_slacken_it():
    assert winding(9.0, 5.0, True, 0.01) == pytest.approx(0.04)
    assert winding(2.0, 5.0, True, 0.01) == 0.0
