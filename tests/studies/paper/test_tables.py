"""The published numbers are complete, and the shipped profiles use those that the paper prints."""

from __future__ import annotations

from collections import Counter
from functools import reduce

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import pack_parameters
from amulett_gym.studies.paper.tables import (
    CONFIGURATIONS,
    DEVICES,
    PROTOCOL,
    TABLE_1,
    TABLES_2_TO_5,
    printed_parameters,
    published,
)


def test_every_row_of_tables_2_to_5_is_there_once():
    assert Counter(cell.table for cell in TABLES_2_TO_5) == {2: 8, 3: 8, 4: 8, 5: 16}
    places = {(cell.table, cell.row, cell.drive) for cell in TABLES_2_TO_5}
    assert len(places) == len(TABLES_2_TO_5)
    for table in (2, 3, 4, 5):
        rows = sorted({(cell.row, cell.profile, cell.configuration) for cell in TABLES_2_TO_5 if cell.table == table})
        pairs = [(profile, configuration) for profile in DEVICES for configuration in CONFIGURATIONS]
        assert rows == [(row, *pair) for row, pair in enumerate(pairs, start=1)]


def test_table_1_has_eighteen_gains_in_the_printed_order():
    assert [item.source for item in TABLE_1] == [f"Table 1, row {row}" for row in range(1, 19)]


PRINTED = """
Simulation                       0.26  116.21  11.17  89042.2  1.25141e+08
Simulation   x (5 N)             0.25  119.58   7.82  33263.4  1.12419e+08
Simulation   x (10 N)            0.25  117.11   0.15   901.25  9.7497e+07
Simulation   x            x      0.24  115.12   5.45  36866.3  9.92114e+07
Measurement                      1.09  579.23   0.98    18.61  5998.15
Measurement  x (5 N)             1.84  588      0.2     17.22  6485.63
Measurement  x (10 N)            1.19  650.57   0.5     49.14  7237.26
Measurement  x            x      2.43  585.07   2.03   197.06  5726.74
"""
"""Tables 2-5 side by side, as the paper prints them: a second entry of the same numbers."""


def test_the_numbers_are_those_that_the_paper_prints():
    pairs = [(profile, configuration) for profile in DEVICES for configuration in CONFIGURATIONS]
    for (profile, configuration), line in zip(pairs, PRINTED.strip().splitlines(), strict=True):
        rise_time, position_ise, tension_ise, biceps, triceps = map(float, line.split()[-5:])
        assert published("rise_time", profile, configuration).value == rise_time
        assert published("position_ise", profile, configuration).value == position_ise
        assert published("tension_ise", profile, configuration).value == tension_ise
        assert published("isav", profile, configuration, "biceps").value == biceps
        assert published("isav", profile, configuration, "triceps").value == triceps


def test_the_texts_percentages_follow_from_the_tables():
    """Sections 3.1-3.3 quote some of the tables' numbers as changes: a check of the transcription."""

    def change(metric, profile, configuration, drive=None):
        before = published(metric, profile, "position-only", drive).value
        return published(metric, profile, configuration, drive).value / before - 1.0

    assert change("position_ise", "simulation", "tension-5") == pytest.approx(0.029, abs=5e-4)
    assert change("position_ise", "simulation", "tension-10") == pytest.approx(0.0077, abs=5e-5)
    assert change("position_ise", "testbed", "tension-10") == pytest.approx(0.123, abs=5e-4)
    assert change("position_ise", "testbed", "tension-5") == pytest.approx(0.015, abs=5e-4)
    assert change("tension_ise", "simulation", "tension-10") == pytest.approx(-0.987, abs=5e-4)
    assert change("isav", "testbed", "tension-10", "biceps") == pytest.approx(1.64, abs=5e-3)
    assert change("isav", "testbed", "tension-10", "triceps") == pytest.approx(0.2, abs=1e-2)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (("rise_tim", "testbed", "variable"), "did you mean 'rise_time'"),
        (("isav", "testbench", "variable", "biceps"), "did you mean 'testbed'"),
        (("isav", "testbed", "tension-50", "biceps"), "unknown configuration"),
        (("isav", "testbed", "variable"), "drive of 'isav' is None; it has to be biceps or triceps"),
        (("rise_time", "testbed", "variable", "biceps"), "it has to be None"),
    ],
)
def test_a_wrong_name_says_what_is_there(cell, message):
    with pytest.raises(AmulettError, match=message):
        published(*cell)


@pytest.mark.parametrize("device", DEVICES)
def test_shipped_profiles_use_the_printed_parameters(device):
    profile = load_profile(device)
    printed = printed_parameters(device)
    assert len(printed) == 9 + 4 + 3
    for item in printed:
        assert reduce(getattr, item.key.split("."), profile) == item.value, item
        group, key = item.key.split(".")[:2]
        source = getattr(profile, group).sources[key]
        assert item.source.split(",")[0] in source, item
        assert source.startswith(("paper:", "identified:")), item


@pytest.mark.parametrize("device", DEVICES)
def test_the_device_follows_the_protocol(device):
    profile = load_profile(device)
    assert profile.loop.offset_deg == PROTOCOL.position_only_offset_deg
    assert pack_parameters(profile)["margin"][0] * 57.29577951308232 == pytest.approx(PROTOCOL.position_margin_deg)
    assert profile.sensors.force_floor == (PROTOCOL.force_floor if device == "testbed" else 0.0)
