"""Means and ratios with bootstrap intervals: exact where they have to be, and about as wide as they claim."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from amulett_gym.evaluation.statistics import RESAMPLES, UNDEFINED, draw_weights, mean, ratio_of_sums

costs = st.integers(2, 40).flatmap(lambda count: arrays(float, count, elements=st.floats(0.01, 100.0)))


def weights(values):
    return draw_weights(len(values), resamples=200)


def test_a_resample_draws_as_many_scenarios_as_there_are():
    drawn = draw_weights(7)
    assert drawn.shape == (RESAMPLES, 7)
    assert (drawn.sum(axis=1) == 7).all()
    assert (drawn == draw_weights(7)).all()
    assert (drawn != draw_weights(7, seed=1)).any()


@given(costs)
def test_a_policy_has_a_ratio_of_exactly_one_to_itself(values):
    ratio = ratio_of_sums(values, values.copy(), weights(values))
    assert (ratio.mean, ratio.low, ratio.high) == (1.0, 1.0, 1.0)


@given(costs, st.floats(0.1, 10.0))
def test_twice_the_cost_in_every_scenario_is_twice_the_ratio_without_any_doubt(values, factor):
    ratio = ratio_of_sums(factor * values, values, weights(values))
    np.testing.assert_allclose([ratio.mean, ratio.low, ratio.high], factor, rtol=1e-12)


@given(costs, st.floats(0.1, 10.0))
def test_a_mean_scales_with_its_unit(values, factor):
    plain, scaled = mean(values, weights(values)), mean(factor * values, weights(values))
    expected = factor * np.array([plain.mean, plain.low, plain.high])
    np.testing.assert_allclose([scaled.mean, scaled.low, scaled.high], expected, rtol=1e-9)


@given(costs)
def test_an_interval_contains_its_mean_and_stays_within_the_data(values):
    estimate = mean(values, draw_weights(len(values)))
    assert math.isclose(estimate.mean, values.mean(), rel_tol=1e-12)
    slack = 1e-9 * values.max()
    assert values.min() - slack <= estimate.low <= estimate.mean + slack
    assert estimate.mean - slack <= estimate.high <= values.max() + slack


@pytest.mark.parametrize("count", [30, 100])
def test_the_interval_of_a_mean_contains_the_truth_about_95_times_in_100(count):
    draws = draw_weights(count, resamples=1000)
    samples = np.random.default_rng(1).normal(3.0, 1.0, (400, count))
    inside = [interval.low <= 3.0 <= interval.high for interval in (mean(sample, draws) for sample in samples)]
    assert 0.91 <= np.mean(inside) <= 0.98


def test_the_interval_of_a_ratio_contains_the_truth_about_95_times_in_100():
    draws, random = draw_weights(60, resamples=1000), np.random.default_rng(2)
    inside = []
    for _ in range(400):
        reference = random.gamma(4.0, 1.0, 60)
        ratio = ratio_of_sums(0.8 * reference * random.lognormal(-0.02, 0.2, 60), reference, draws)
        inside.append(ratio.low <= 0.8 <= ratio.high)
    assert 0.91 <= np.mean(inside) <= 0.98


def test_pairing_makes_a_small_difference_clear():
    random = np.random.default_rng(3)
    reference = random.gamma(2.0, 1.0, 100)
    ratio = ratio_of_sums(0.97 * reference, reference, draw_weights(100))
    unpaired = mean(reference, draw_weights(100))
    assert ratio.high < 1.0
    assert unpaired.low < 0.97 * reference.mean() < unpaired.high


def test_values_that_do_not_exist_are_left_out_in_pairs():
    values, reference = [1.0, math.nan, 3.0, 9.0], [2.0, 5.0, 2.0, math.nan]
    drawn = draw_weights(4)
    assert mean(values, drawn).mean == pytest.approx(13.0 / 3.0)
    assert ratio_of_sums(values, reference, drawn).mean == pytest.approx(1.0)


@pytest.mark.parametrize("reference", [[0.0, 0.0], [math.nan, math.nan]])
def test_a_ratio_to_nothing_is_undefined(reference):
    ratio = ratio_of_sums([0.0, 1.0], reference, draw_weights(2))
    assert all(map(math.isnan, (ratio.mean, ratio.low, ratio.high)))
    assert math.isnan(UNDEFINED.mean)


def test_a_reference_that_is_often_zero_leaves_the_ratio_without_an_upper_bound():
    ratio = ratio_of_sums([1.0] * 5, [0.0, 0.0, 0.0, 0.0, 1.0], draw_weights(5))
    assert ratio.mean == 5.0
    assert ratio.high == math.inf


def test_one_scenario_has_no_interval():
    estimate = mean([2.0], draw_weights(1))
    assert estimate.mean == 2.0
    assert math.isnan(estimate.low) and math.isnan(estimate.high)


def test_values_of_other_scenarios_are_refused():
    with pytest.raises(ValueError, match="scenarios"):
        ratio_of_sums([1.0, 2.0], [1.0], draw_weights(2))
