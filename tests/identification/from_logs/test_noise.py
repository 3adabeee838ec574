from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.identification.from_logs.noise import resolution, rough_noise, whiteness

rng = np.random.default_rng(1)
SMOOTH = np.sin(np.linspace(0.0, 20.0, 5000))


def test_noise_is_found_beside_a_motion():
    assert rough_noise(SMOOTH + 0.01 * rng.standard_normal(5000)) == pytest.approx(0.01, rel=0.1)


def test_noise_is_at_least_that_of_rounding():
    assert rough_noise(np.round(SMOOTH / 0.05) * 0.05) >= 0.05 / np.sqrt(12.0)


@pytest.mark.parametrize(("step", "offset"), [(0.022, 0.0), (0.1, 0.03)])
def test_a_converters_bit_is_found(step, offset):
    values = np.round((SMOOTH + 0.02 * rng.standard_normal(5000)) / step) * step + offset
    assert resolution(values) == pytest.approx(step, rel=1e-6)


def test_no_bit_is_found_in_exact_readings():
    assert resolution(SMOOTH) == 0.0


def test_white_residuals_pass():
    found = whiteness([rng.standard_normal(3000), rng.standard_normal(2000)])
    assert found.p > 0.01
    assert abs(found.largest) < 0.05
    assert found.time == pytest.approx(1.0, abs=0.3)


def test_correlated_residuals_do_not_and_count_less():
    white = rng.standard_normal(20_000)
    residuals = np.zeros(20_000)
    for k in range(1, residuals.size):
        residuals[k] = 0.8 * residuals[k - 1] + white[k]
    found = whiteness([residuals])
    assert found.p < 1e-6
    assert found.largest == pytest.approx(0.8, abs=0.03)
    assert found.time == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.25)  # of a first-order process


def test_nothing_left_is_white():
    assert whiteness([np.zeros(100)]).time == 1.0
    assert whiteness([]).p == 1.0
