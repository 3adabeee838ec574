"""Means and ratios with bootstrap intervals: exact where they have to be, and about as wide as they claim."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import binomtest, trim_mean

from amulett_gym.evaluation.statistics import (
    RESAMPLES,
    UNDEFINED,
    count_failures,
    draw_nested,
    draw_weights,
    interquartile_mean,
    mean,
    nested_mean,
    nested_ratio,
    performance_profile,
    probability_of_improvement,
    ratio_of_sums,
    worst_mean,
)

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


def learned(seeds=10, scenarios=40, seed=4, share=0.7):
    """Return a reference's costs and those of a learner that pays `share` of them, with seeds that differ."""
    random = np.random.default_rng(seed)
    reference = random.gamma(4.0, 0.25, scenarios)
    luck = random.normal(1.0, 0.1, (seeds, 1)) * random.lognormal(-0.005, 0.1, (seeds, scenarios))
    return share * reference * luck, reference


def test_a_nested_resample_is_each_drawn_seed_in_every_drawn_scenario():
    values, reference = learned(3, 5)
    draws = draw_nested(3, 5, resamples=200)
    ratios = []
    for seeds, scenarios in zip(draws.seeds.astype(int), draws.scenarios.astype(int), strict=True):
        rows, columns = np.repeat(np.arange(3), seeds), np.repeat(np.arange(5), scenarios)
        drawn = values[np.ix_(rows, columns)]
        ratios.append(drawn.sum() / (2 * reference[columns].sum()))
    estimate = nested_ratio(values, reference, draws)
    assert estimate.mean == pytest.approx(values.sum() / (3 * reference.sum()))
    expected = np.percentile(ratios, [2.5, 97.5], method="nearest")
    np.testing.assert_allclose([estimate.low, estimate.high], expected, rtol=1e-12)


def test_one_seed_is_the_ratio_of_a_law():
    values, reference = learned(1, 30)
    nested = nested_ratio(values, reference, draw_nested(1, 30))
    plain = ratio_of_sums(values[0], reference, draw_weights(30))
    np.testing.assert_allclose([nested.mean, nested.low, nested.high], [plain.mean, plain.low, plain.high])


def test_seeds_that_differ_widen_the_interval_and_pairing_narrows_it():
    values, reference = learned(10, 100)
    draws = draw_nested(10, 100)
    alike = np.tile(values.mean(axis=0), (10, 1))
    wide, narrow = nested_ratio(values, reference, draws), nested_ratio(alike, reference, draws)
    assert wide.high - wide.low > 2.0 * (narrow.high - narrow.low)
    unpaired = nested_mean(values, draws)
    assert (wide.high - wide.low) / wide.mean < (unpaired.high - unpaired.low) / unpaired.mean
    same = nested_ratio(values, values, draws)
    assert (same.mean, same.low, same.high) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("seeds", "least", "most"), [(30, 0.90, 0.98), (10, 0.87, 0.97), (3, 0.75, 0.92)])
def test_the_interval_over_seeds_and_scenarios_contains_the_truth_about_as_often_as_it_says(seeds, least, most):
    draws = draw_nested(seeds, 60, resamples=500)
    inside = []
    for trial in range(300):
        ratio = nested_ratio(*learned(seeds, 60, seed=trial), draws)
        inside.append(ratio.low <= 0.7 <= ratio.high)
    assert least <= np.mean(inside) <= most


def test_missing_cells_are_left_out_on_both_sides():
    values = np.array([[1.0, math.nan], [3.0, 4.0]])
    draws = draw_nested(2, 2)
    assert nested_ratio(values, [2.0, 8.0], draws).mean == pytest.approx(8.0 / 12.0)
    assert nested_mean(values, draws).mean == pytest.approx(8.0 / 3.0)
    assert worst_mean(values, draws, 1.0).mean == pytest.approx(8.0 / 3.0)
    assert math.isnan(nested_mean(np.full((2, 2), math.nan), draws).mean)
    assert math.isnan(interquartile_mean(np.full((2, 2), math.nan), draws).mean)


@given(arrays(float, (4, 5), elements=st.floats(-50.0, 50.0)))
def test_the_interquartile_mean_is_scipys_where_nothing_is_cut_in_two(values):
    draws = draw_nested(4, 5, resamples=100)
    assert interquartile_mean(values, draws).mean == pytest.approx(trim_mean(values, 0.25, axis=None), abs=1e-9)


@given(arrays(float, (2, 10), elements=st.floats(-50.0, 50.0)), st.integers(1, 20))
def test_the_worst_mean_is_that_of_the_largest_values(values, count):
    draws = draw_nested(2, 10, resamples=50)
    expected = np.sort(values, axis=None)[-count:].mean()
    assert worst_mean(values, draws, count / 20).mean == pytest.approx(expected, abs=1e-9)


def test_a_value_on_the_border_counts_in_part():
    draws = draw_nested(1, 3, resamples=50)
    assert interquartile_mean([0.0, 1.0, 5.0], draws).mean == pytest.approx((0.25 * 0 + 1.0 + 0.25 * 5.0) / 1.5)
    assert worst_mean([0.0, 1.0, 5.0], draws, 0.5).mean == pytest.approx((5.0 + 0.5 * 1.0) / 1.5)


def test_means_of_ranks_resample_what_they_rank():
    values, _ = learned(3, 7)
    draws = draw_nested(3, 7, resamples=100)
    brute = []
    for seeds, scenarios in zip(draws.seeds.astype(int), draws.scenarios.astype(int), strict=True):
        rows, columns = np.repeat(np.arange(3), seeds), np.repeat(np.arange(7), scenarios)
        brute.append(np.sort(values[np.ix_(rows, columns)], axis=None)[-7:].mean())
    estimate = worst_mean(values, draws, 0.5)
    expected = np.percentile(brute, [2.5, 97.5], method="nearest")
    np.testing.assert_allclose([estimate.low, estimate.high], expected, rtol=1e-12)


def test_the_worst_decile_of_a_normal_sample_is_its_closed_form():
    values = np.random.default_rng(6).normal(0.0, 1.0, (10, 200))
    estimate = worst_mean(values, draw_nested(10, 200, resamples=500))
    assert estimate.low < 1.755 < estimate.high  # density at the 90 % quantile over 0.1
    assert interquartile_mean(values, draw_nested(10, 200, resamples=500)).mean == pytest.approx(0.0, abs=0.05)


def test_a_performance_profile_is_the_distribution_function():
    values = np.random.default_rng(7).uniform(0.0, 1.0, (5, 400))
    profile = performance_profile(values, [-1.0, 0.25, 0.5, 2.0], draw_nested(5, 400, resamples=500))
    assert [profile[0].mean, profile[3].mean] == [0.0, 1.0]
    for estimate, truth in zip(profile[1:3], (0.25, 0.5), strict=True):
        assert estimate.low < truth < estimate.high


def test_the_probability_of_improvement_counts_wins_and_half_the_ties():
    draws = draw_nested(2, 3)
    values = np.array([[1.0, 2.0, 3.0], [0.0, 5.0, 5.0]])
    assert probability_of_improvement(values, [2.0, 2.0, 2.0], draws).mean == pytest.approx(2.5 / 6.0)
    assert probability_of_improvement(values, values, draws).mean == pytest.approx(0.5)
    brute = np.mean([[(a < b) + 0.5 * (a == b) for a, b in zip(x, y, strict=True)] for x in values for y in values[:1]])
    assert probability_of_improvement(values, values[:1], draws).mean == pytest.approx(brute)
    with pytest.raises(ValueError, match="some values are NaN"):
        probability_of_improvement(np.full((2, 3), math.nan), [2.0, 2.0, 2.0], draws)


@pytest.mark.parametrize(("failures", "total"), [(0, 50), (3, 50), (50, 50)])
def test_failures_come_with_their_exact_interval(failures, total):
    counted = count_failures(np.arange(total).reshape(5, -1) < failures)
    exact = binomtest(failures, total).proportion_ci(0.95, "exact")
    assert (counted.count, counted.total) == (failures, total)
    np.testing.assert_allclose([counted.low, counted.high], [exact.low, exact.high], atol=1e-12)


def over_devices(seeds=5, devices=20, scenarios=40, seed=8, share=0.7):
    """Return a reference's costs on a fleet and a learner's, whose advantage differs by device, seed and scenario."""
    random = np.random.default_rng(seed)
    reference = random.gamma(4.0, 0.25, scenarios) * random.lognormal(0.0, 0.2, (devices, 1))
    training = random.normal(1.0, 0.05, (seeds, 1, 1)) if seeds > 1 else 1.0
    luck = training * random.normal(1.0, 0.1, (devices, 1))
    return share * reference * luck * random.lognormal(-0.005, 0.1, (seeds, devices, scenarios)), reference


def test_a_resample_over_a_fleet_is_each_drawn_seed_on_every_drawn_device_in_every_drawn_scenario():
    values, reference = over_devices(3, 4, 5)
    draws = draw_nested(3, 5, resamples=200, devices=4)
    assert draws.devices is not None and (draws.devices.sum(axis=1) == 3).all()
    ratios = []
    for counts in zip(draws.seeds.astype(int), draws.devices.astype(int), draws.scenarios.astype(int), strict=True):
        s, d, k = (np.repeat(np.arange(each.size), each) for each in counts)
        ratios.append(values[np.ix_(s, d, k)].sum() / (2 * reference[np.ix_(d, k)].sum()))
    estimate = nested_ratio(values, reference, draws)
    assert estimate.mean == pytest.approx(values.sum() / (3 * reference.sum()))
    expected = np.percentile(ratios, [2.5, 97.5], method="nearest")
    np.testing.assert_allclose([estimate.low, estimate.high], expected, rtol=1e-12)
    plain = draw_nested(3, 5, resamples=200)
    assert plain.devices is None
    np.testing.assert_array_equal(plain.seeds, draws.seeds)
    np.testing.assert_array_equal(plain.scenarios, draws.scenarios)


@pytest.mark.parametrize(
    ("seeds", "devices", "least", "most"), [(1, 32, 0.90, 0.98), (10, 32, 0.90, 0.98), (1, 6, 0.82, 0.95)]
)
def test_the_interval_over_devices_contains_the_truth_about_as_often_as_it_says(seeds, devices, least, most):
    draws, inside = draw_nested(seeds, 30, resamples=400, devices=devices), []
    for trial in range(200):
        ratio = nested_ratio(*over_devices(seeds, devices, 30, seed=trial), draws)
        inside.append(ratio.low <= 0.7 <= ratio.high)
    assert least <= np.mean(inside) <= most


def test_a_law_on_a_fleet_needs_no_axis_of_seeds_and_missing_cells_are_left_out():
    values = np.array([[1.0, 2.0, math.nan], [4.0, math.nan, 3.0]])
    draws = draw_nested(1, 3, devices=2)
    assert nested_mean(values, draws).mean == pytest.approx(10.0 / 4.0)
    assert nested_ratio(values, np.full((2, 3), 2.0), draws).mean == pytest.approx(10.0 / 8.0)
    with pytest.raises(ValueError, match="seeds, devices and scenarios"):
        nested_mean(values.T, draws)


def test_values_of_other_seeds_are_refused():
    with pytest.raises(ValueError, match="seeds and scenarios"):
        nested_mean(np.ones((3, 4)), draw_nested(4, 3))
    with pytest.raises(ValueError, match="share"):
        worst_mean(np.ones((2, 2)), draw_nested(2, 2), 0.0)
