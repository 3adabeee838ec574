"""The drives' model within a loop: exact for a first-order lag, limited in its rate."""

from __future__ import annotations

import math

import pytest

from amulett_gym.control.drive_model import drive_command, next_angle


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


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_a_command_brings_a_drive_to_a_moving_angle_faster_by_its_factor(factor):
    lag, period, rate, angle = 0.14, 1e-4, 2.0, 0.0
    share = 1.0 - math.exp(-period / lag)
    for tick in range(1000):
        wanted = 1.0 + rate * tick * period
        angle = next_angle(angle, drive_command(angle, wanted, factor, rate, lag), share, math.inf)
    behind = 1.0 + rate * 1000 * period - angle
    assert behind == pytest.approx(math.exp(-factor * 0.1 / lag), rel=5e-3)
