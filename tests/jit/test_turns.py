"""Threads that count a number together lose no count, and see what was counted."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from amulett_gym.jit.compiled import compiled
from amulett_gym.jit.turns import count, count_once, new_number, reaches

COUNTS = 20_000


@compiled
def take(number, taken):
    """Take turns until there are no more; note them in order."""
    for n in range(taken.size):
        taken[n] = count(number)


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
    number, seen = new_number(), []
    watcher = threading.Thread(target=lambda: seen.append(reaches(number, 3, 10**12)), daemon=True)
    watcher.start()
    assert [count_once(number) for _ in range(2)] == [0, 1]
    assert watcher.is_alive() and not seen
    count_once(number)
    watcher.join(30.0)
    assert seen == [True]


@pytest.mark.parametrize(("goal", "looks", "reached"), [(0, 1, True), (0, 0, False), (1, 1, False), (1, 1000, False)])
def test_looks_end(goal, looks, reached):
    assert reaches(new_number(), goal, looks) == reached
