"""YAML: scalars are read as YAML 1.2 means them, and what is written is read back as the same."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from amulett_gym.errors import AmulettError
from amulett_gym.storage.safe_yaml import parse_yaml, to_yaml

TEXT = (
    *("yes", "No", "on", "OFF", "y", "tRUE", "1:30", "1:30.5", "2024-01-01", "010", "-07", "1__0", "_1", "1_", "0b11"),
    *("1e", "e5", ".", "+", "=", "infinity", "nan", "1e3.0"),
)
INTEGERS = {"0": 0, "-0": 0, "+12": 12, "0o17": 15, "0xFf": 255, "3_000_000": 3_000_000}
FLOATS = {"1.": 1.0, ".5": 0.5, "007.5": 7.5, "1e-3": 0.001, "5E6": 5e6, "-1.5e+3": -1500.0, "1_0.2_5": 10.25}
INFINITE = {".inf": float("inf"), "-.INF": float("-inf"), "+.Inf": float("inf")}
TAGGED = {"!!float 5": 5.0, "!!str 5": "5", "'5'": "5", '"true"': "true"}
OTHER = {"true": True, "True": True, "FALSE": False, "null": None, "~": None, "": None}
SCALARS: dict[str, Any] = {text: text for text in TEXT} | INTEGERS | FLOATS | INFINITE | TAGGED | OTHER


@pytest.mark.parametrize("text", SCALARS)
def test_scalars_are_those_of_yaml_1_2(text):
    for value in (parse_yaml(text, "text"), parse_yaml(f"key: [{text}]", "text")["key"][0] if text else None):
        assert value == SCALARS[text]
        assert type(value) is type(SCALARS[text])


def test_keys_are_text_too():
    assert parse_yaml("on: 1\nno: 2\n1e3: 3", "text") == {"on": 1, "no": 2, 1000.0: 3}


def test_nan_is_a_number():
    assert parse_yaml(".NaN", "text") != parse_yaml(".NaN", "text")


@pytest.mark.parametrize(
    "text", ["!!int 010", "!!int 5.0", "!!int ''", "!!bool yes", "!!float 1:30", "!!timestamp 2024"]
)
def test_explicit_tags_are_no_way_around(text):
    with pytest.raises(AmulettError, match="not valid YAML"):
        parse_yaml(text, "text")


@pytest.mark.parametrize(
    "value", [*SCALARS, 5e6, 1e-300, 3, -0.0, True, None, "<<", "é", "a: b", "#", [[]], {"no": "1e3"}]
)
def test_what_is_written_is_read_back(value):
    shared = {"one": value, "again": value, "list": [value, (value,)]}
    text = to_yaml(shared)
    assert "&" not in text.replace("'&", "")
    plain = {"one": value, "again": value, "list": [value, [value]]}
    assert parse_yaml(text, "text") == yaml.safe_load(text) == plain
