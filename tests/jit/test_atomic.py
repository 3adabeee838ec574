"""Threads that count a number together lose no count, and see what was counted; arrays are found by their addresses."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

from amulett_gym.jit.atomic import add, pointer, read, write
from amulett_gym.jit.compiled import compiled

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs the compiler")

COUNTS = 20_000


@compiled
def take(number, taken):
    """Take turns until there are no more; note them in order."""
    for n in range(taken.size):
        taken[n] = add(number, 1)


@compiled
def take_together(number, taken, here, other):
    """Take turns at the same time as the other thread, awake when both are."""
    write(here, 1)
    while read(other) == 0:
        pass
    for n in range(taken.size):
        taken[n] = add(number, 1)


@compiled
def reaches(number, goal, looks):
    while looks > 0 and read(number) < goal:
        looks -= 1
    return looks > 0


@compiled
def change(number, by, value):
    before = add(number, by)
    after = read(number)
    write(number, value)
    return before, after


@compiled
def array_at(address, size):
    return numba.carray(pointer(address), (size,), np.float32).sum()


def test_two_threads_at_the_same_time_lose_no_count():
    number, taken, here = np.zeros(1, dtype=np.int64), np.full((2, COUNTS), -1), np.zeros((2, 1), dtype=np.int64)
    take_together(number.copy(), taken[0, :0], number.copy(), np.ones(1, dtype=np.int64))  # compiled
    other = threading.Thread(target=take_together, args=(number, taken[1], here[0], here[1]))
    other.start()
    take_together(number, taken[0], here[1], here[0])
    other.join()
    assert number[0] == 2 * COUNTS


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_no_two_threads_get_the_same_turn(threads):
    number, taken = np.zeros((2, 3), dtype=np.int64), np.full((threads, COUNTS), -1)
    take(number.copy(), taken[0])  # compiled, so that all begin together
    meeting = threading.Barrier(threads, timeout=30.0)

    def work(row):
        meeting.wait()
        take(number, row)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, taken))
    np.testing.assert_array_equal(np.sort(taken, axis=None), np.arange(threads * COUNTS))
    assert (np.diff(taken) > 0).all()
    assert number.tolist() == [[threads * COUNTS, 0, 0], [0, 0, 0]]


def test_one_sees_what_another_counts_meanwhile():
    number, seen = np.zeros(1, dtype=np.int64), []
    assert not reaches(number, 3, 1000)
    watcher = threading.Thread(target=lambda: seen.append(reaches(number, 3, 10**12)), daemon=True)
    watcher.start()
    take(number, np.empty(2, dtype=np.int64))
    assert watcher.is_alive() and not seen
    take(number, np.empty(1, dtype=np.int64))
    watcher.join(30.0)
    assert seen == [True]


@pytest.mark.parametrize("row", [0, 1])
def test_only_the_first_entry_is_changed(row):
    numbers = np.array([[5, 6], [7, 8]])
    expected = numbers.copy()
    expected[row, 0] = -3
    before = int(numbers[row, 0])
    assert change(numbers[row], -1, -3) == (before, before - 1)
    np.testing.assert_array_equal(numbers, expected)


def test_an_array_is_found_by_its_address():
    values = np.arange(7, dtype=np.float32)
    assert array_at(values.ctypes.data, values.size) == 21.0
