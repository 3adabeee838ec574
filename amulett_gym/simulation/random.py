"""Counter-based random numbers: pure functions of a 64-bit key with a counter.

SplitMix64 (Steele, Lea and Flood, 2014) as a function: its n-th output is a mix of ``key + n * golden``. A device's
noise depends on its own key and clock only, not on its neighbours, their number or the order of calls.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_30, _27, _31 = np.uint64(30), np.uint64(27), np.uint64(31)
_11, _16, _32, _48 = np.uint64(11), np.uint64(16), np.uint64(32), np.uint64(48)
_LOW = np.uint64(0xFFFF)
_WORD = 2**64 - 1
_SEED_STREAM = 0x5EED

# The sum of four uniform 16-bit integers: mean and standard deviation.
_MEAN = 2.0 * (2.0**16 - 1.0)
_DEVIATION = math.sqrt(4.0 * (2.0**32 - 1.0) / 12.0)


@compiled
def random_bits(key: np.uint64, counter: np.uint64) -> np.uint64:
    """Return 64 random bits for a key and a counter."""
    z = np.uint64(key) + (np.uint64(counter) + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@compiled
def noise(key: np.uint64, counter: np.uint64) -> float:
    """Return a bell-shaped random number with mean 0 and standard deviation 1.

    The scaled sum of four uniform numbers: close to normal, and bounded by 3.47, like a converter's noise.
    """
    bits = random_bits(key, counter)
    total = float(bits & _LOW) + float((bits >> _16) & _LOW) + float((bits >> _32) & _LOW) + float(bits >> _48)
    return (total - _MEAN) / _DEVIATION


@compiled
def _fill_uniform(keys: NDArray[np.uint64], numbers: NDArray[np.float64]) -> None:
    for row in range(numbers.shape[0]):
        for column in range(numbers.shape[1]):
            numbers[row, column] = float(random_bits(keys[row], np.uint64(column)) >> _11) * 2.0**-53


@compiled
def _derive(keys: NDArray[np.uint64], counters: NDArray[np.uint64], derived: NDArray[np.uint64]) -> None:
    for row in range(keys.shape[0]):
        derived[row] = random_bits(random_bits(keys[row], np.uint64(0xA3)), counters[row])


@compiled
def _fill_noise(keys: NDArray[np.uint64], counters: NDArray[np.uint64], numbers: NDArray[np.float64]) -> None:
    columns = np.uint64(numbers.shape[1])
    for row in range(numbers.shape[0]):
        for column in range(numbers.shape[1]):
            numbers[row, column] = noise(keys[row], counters[row] * columns + np.uint64(column))


def uniform(keys: NDArray[np.uint64], count: int) -> NDArray[np.float64]:
    """Return `count` uniform numbers in [0, 1) for each key, shape (len(keys), count)."""
    numbers = np.empty((keys.size, count))
    _fill_uniform(keys, numbers)
    return numbers


def normal(keys: NDArray[np.uint64], counters: NDArray[np.uint64], count: int) -> NDArray[np.float64]:
    """Return `count` numbers of `noise` for each key at its counter, shape (len(keys), count)."""
    numbers = np.empty((keys.size, count))
    _fill_noise(keys, counters, numbers)
    return numbers


def derive_keys(keys: NDArray[np.uint64], counters: NDArray[np.uint64] | int) -> NDArray[np.uint64]:
    """Return one new key for each key and counter, e.g. for a device's episodes and an episode's streams."""
    derived = np.empty_like(keys)
    derived[...] = counters  # each is then replaced by its key
    _derive(keys, derived, derived)
    return derived


def keys_from_seeds(seeds: NDArray[np.object_]) -> NDArray[np.uint64]:
    """Return one key for each seed, an integer of at least 0 and of any size.

    Different seeds below 2**64 give different keys: the mix is a bijection. The further words of a larger seed are
    mixed in one by one.
    """
    keys = derive_keys((seeds & _WORD).astype(np.uint64), _SEED_STREAM)
    rest = seeds >> 64
    while rest.any():
        more = rest != 0
        keys[more] = derive_keys(keys[more] ^ (rest[more] & _WORD).astype(np.uint64), _SEED_STREAM)
        rest = rest >> 64
    return keys
