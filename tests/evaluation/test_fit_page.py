"""Tables of `amulett fit`."""

from __future__ import annotations

import pytest

from amulett_gym.evaluation.fit_page import parameter_table, undetermined_lines


def parameter(value, low, high, **changes):
    found = {"name": "lag", "unit": "s", "value": value, "low": low, "high": high, "prior": [0.1, 0.2]}
    return found | {"determined": True, "unlike_prior": False, "of_recording": False} | changes


@pytest.mark.parametrize(
    ("found", "shown"),
    [
        (parameter(0.1388743, 0.1388193, 0.1389293), ("0.138874", "[0.138819, 0.138929]")),
        (parameter(0.00412, 0.00333, 0.00511), ("0.00412", "[0.00333, 0.00511]")),
        (parameter(0.0, -0.001, 0.001), ("0", "[-0.00100, 0.00100]")),
        (parameter(1.0, 1.0, 1.0), ("1.00", "[1.00, 1.00]")),
    ],
)
def test_a_value_has_the_digits_that_its_interval_allows(found, shown):
    (row,) = parameter_table({"parameters": [found], "logs": []}).rows
    assert row[1:3] == shown


@pytest.mark.parametrize(("loop", "noted"), [("open", False), ("closed", True)])
def test_intervals_of_a_log_without_commands_are_called_a_first_guess(loop, noted):
    table = parameter_table({"parameters": [parameter(1.0, 0.5, 2.0)], "logs": [{"loop": loop}]})
    assert ("first guess" in table.note) is noted


def test_a_direction_is_a_sentence():
    both = [parameter(1.0, 0.5, 2.0, name="inertia", unit="kg m2"), parameter(0.0, -1.0, 1.0, of_recording=True)]
    lines = undetermined_lines({"parameters": both, "undetermined": [{"inertia": 0.1, "lag": -0.02}]})
    assert lines == ["inertia +11 % together with lag -0.02 s: the logs hardly see such a change."]
