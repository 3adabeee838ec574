"""Calls in processes give their results, their progress and their errors."""

import os
import time

import pytest

from amulett_gym.evaluation.processes import advance, in_processes


def _square(number):
    advance(number)
    if number < 0:
        raise ValueError("negative")
    return number * number, os.getpid()


def _mark(path, seconds):
    time.sleep(seconds)
    path.touch()


def test_results_have_the_names_of_their_calls_and_progress_is_complete():
    units = []
    found = dict(in_processes(_square, {f"of {number}": (number,) for number in range(4)}, 2, units.append))
    assert {name: result for name, (result, _) in found.items()} == {"of 0": 0, "of 1": 1, "of 2": 4, "of 3": 9}
    assert sum(units) == 6
    processes = {process for _, process in found.values()}
    assert os.getpid() not in processes and len(processes) <= 2
    assert dict(in_processes(_square, {}, 2)) == {}


def test_an_error_ends_the_other_calls(tmp_path):
    with pytest.raises(ValueError, match="negative"):
        dict(in_processes(_square, {"wrong": (-1,)}, 1))
    calls = {"short": (tmp_path / "short", 0.0), "long": (tmp_path / "long", 20.0)}
    with pytest.raises(ZeroDivisionError):
        for _ in in_processes(_mark, calls, 2):
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["short"]
