"""The drives' model within a loop: exact for a first-order lag, limited in its rate."""

from __future__ import annotations

import math

import pytest

from amulett_gym.control.drive_model import next_angle


def test_it_is_the_exact_response_of_a_lag():
    angle, share = 0.0, 1.0 - math.exp(-0.0025 / 0.14)
    for _ in range(100):
        angle = next_angle(angle, 2.0, share, math.inf)
    assert angle == pytest.approx(2.0 * (1.0 - math.exp(-0.25 / 0.14)), rel=1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_its_rate_is_limited(sign):
    assert next_angle(0.5, 0.5 + sign * 3.0, 0.5, 0.1) == pytest.approx(0.5 + sign * 0.1)


def test_an_ideal_drive_is_where_it_is_commanded():
    assert next_angle(0.0, 1.2, 1.0, math.inf) == 1.2
