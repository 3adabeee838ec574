"""Numbers in words: short, and never less than what is needed to see a difference."""

import math

import pytest
from markupsafe import Markup

from amulett_gym.reporting.words import EQUAL, html, interval, number, pretty, span, with_interval


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (math.nan, "-"),
        (0.0, "0"),
        (1.0, "1.00"),
        (0.7861, "0.786"),
        (2267.9, "2270"),
        (4.33e6, "4.33e+06"),
    ],
)
def test_numbers_are_short(value, text):
    assert number(value) == text


def test_numbers_are_pretty():
    assert pretty("-4.33e+06 deg2/s, 1e-07 N2 s, x-2") == "−4.33×10⁶ deg²/s, 1×10⁻⁷ N² s, x-2"


def test_intervals_that_do_not_exist_are_left_out():
    assert interval(0.5, 1.25) == "[0.500, 1.25]"
    assert interval(None, 1.0) == interval(None, None) == ""
    assert with_interval({"mean": 0.5, "low": 0.4, "high": 0.6}) == "0.500 [0.400, 0.600]"
    assert with_interval({"mean": 0.5, "low": None, "high": None}) == "0.500"
    assert with_interval({"mean": 1.0, "low": 1.0, "high": 1.0}) == "1.00"
    assert with_interval({"mean": None, "low": None, "high": None}) == with_interval(None) == "-"


def test_a_ratio_has_the_digits_that_show_a_difference_from_1():
    assert span({"mean": 0.8531, "low": 0.8412, "high": 0.8661}) == "0.853 [0.841, 0.866]"
    assert span({"mean": 0.99996, "low": 0.99995, "high": 0.99997}) == "0.99996 [0.99995, 0.99997]"
    assert span({"mean": 1.0 + 1e-9, "low": 1.0 - 1e-9, "high": 1.0 + 2e-9}) == EQUAL
    assert span({"mean": None, "low": None, "high": None}) == "-"


def test_intervals_are_not_broken_in_html():
    assert html("0.8 [0.7, 0.9] of 1, [1, 2, 3]") == "0.8 [0.7,\N{NO-BREAK SPACE}0.9] of 1, [1, 2, 3]"


def test_html_is_escaped_once():
    assert html("a < `b`, 2e+06 m2") == "a &lt; <code>b</code>, 2×10⁶ m²"
    assert html(Markup("<b>1e+06</b>")) == "<b>1e+06</b>"
