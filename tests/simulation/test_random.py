"""The counter-based generator: SplitMix64, and the sensor noise made from it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.simulation.random import derive_keys, keys_from_seeds, noise, normal, random_bits, uniform

words = st.integers(min_value=0, max_value=2**64 - 1).map(np.uint64)

SEED_1234567 = (
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
)


def test_random_bits_are_those_of_splitmix64():
    drawn = [int(random_bits(np.uint64(1234567), np.uint64(counter))) for counter in range(5)]
    assert drawn == list(SEED_1234567)


@given(words, words, words)
def test_keys_and_counters_that_differ_give_bits_that_differ(key, other, counter):
    if key != other:
        assert random_bits(key, counter) != random_bits(other, counter)
        assert random_bits(counter, key) != random_bits(counter, other)


def test_noise_has_mean_zero_and_deviation_one_and_is_bounded():
    numbers = normal(np.arange(1000, dtype=np.uint64), np.zeros(1000, dtype=np.uint64), 200).ravel()
    assert numbers.mean() == pytest.approx(0, abs=4 / np.sqrt(numbers.size))
    assert numbers.std() == pytest.approx(1, abs=0.01)
    assert np.abs(numbers).max() < 3.47
    assert np.corrcoef(numbers[:-1], numbers[1:])[0, 1] == pytest.approx(0, abs=0.01)


@given(words, words)
def test_noise_never_exceeds_its_bound(key, counter):
    bound = 4 * (2**15 - 0.5) / np.sqrt((2**32 - 1) / 3)
    assert abs(noise(key, counter)) <= bound < 3.47


def test_uniform_numbers_fill_the_unit_interval_evenly():
    numbers = uniform(np.arange(500, dtype=np.uint64), 400).ravel()
    counts, _ = np.histogram(numbers, bins=20, range=(0.0, 1.0))
    assert counts.sum() == numbers.size
    expected = numbers.size / 20
    assert ((counts - expected) ** 2 / expected).sum() < 43.8  # chi square of 19 degrees of freedom at 0.001


def test_a_row_depends_on_its_own_key_only():
    keys = np.array([3, 1, 4, 1, 5], dtype=np.uint64)
    together = uniform(keys, 7)
    np.testing.assert_array_equal(together[1], together[3])
    np.testing.assert_array_equal(together[2], uniform(keys[2:3], 7)[0])
    np.testing.assert_array_equal(derive_keys(keys, 9)[2], derive_keys(keys[2:3], 9)[0])


@given(words)
def test_derived_keys_of_different_episodes_and_streams_differ(key):
    keys = np.full(64, key, dtype=np.uint64)
    derived = derive_keys(keys, np.arange(64, dtype=np.uint64))
    assert np.unique(derived).size == 64
    assert key not in derived


seeds = st.integers(min_value=0, max_value=2**64 - 1) | st.integers(min_value=2**64 - 3, max_value=2**300)


@given(st.lists(seeds, unique=True))
def test_seeds_of_any_size_give_keys_of_their_own(listed):
    numbers = np.array(listed, dtype=object)
    keys = keys_from_seeds(numbers)
    assert np.unique(keys).size == len(listed)
    for i in range(len(listed)):
        assert keys_from_seeds(numbers[i : i + 1])[0] == keys[i]
