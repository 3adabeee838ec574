"""Persons are drawn from sourced ranges, packed and unpacked without loss, and belong to scenarios of worn devices."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.errors import AmulettError
from amulett_gym.model.wearer import SHIFT, STIFFNESS, muscle_stiffness
from amulett_gym.profile import load_profile
from amulett_gym.settings import SOURCES
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack, pack_worn, unpack, unpack_worn
from amulett_gym.tasks.wearer import POPULATION, Wearer, draw_wearers, pack_wearer, pack_wearers, unpack_wearer

TESTBED = load_profile("testbed")
PERIOD = TESTBED.loop.control_period
KEYS = np.arange(5000, dtype=np.uint64)
DRAWN = {shifted: draw_wearers(KEYS, shifted) for shifted in (False, True)}


def test_every_quantity_has_unit_range_and_source() -> None:
    for name, quantity in POPULATION.items():
        assert quantity.source.split(":")[0] in SOURCES, name
        assert len(quantity.source.split(":", 1)[1]) > 10, name
        assert quantity.unit and quantity.low < quantity.high, name
        low, high = quantity.shifted
        assert low < high < quantity.low or quantity.high < low < high, name


def test_persons_are_within_their_ranges() -> None:
    for shifted, people in DRAWN.items():
        index = people["mass"] / people["height"] ** 2
        drawn = people | {"body_mass_index": index, "relative_strength": people["strength"] * 70.0 / people["mass"]}
        for name, quantity in POPULATION.items():
            low, high = quantity.shifted if shifted else (quantity.low, quantity.high)
            slack = 0.1 if name == "body_mass_index" else 0.03 if name == "relative_strength" else 1e-9  # of rounding
            assert low - slack <= drawn[name].min() < low + 0.1 * (high - low), name
            assert high - 0.1 * (high - low) < drawn[name].max() <= high + slack, name


def test_mass_and_height_go_together() -> None:
    people = DRAWN[False]
    assert np.corrcoef(people["mass"], people["height"])[0, 1] > 0.6
    assert people["mass"].min() > 40.0
    assert people["mass"].max() < 116.0


@pytest.mark.parametrize("shifted", [False, True])
def test_elbows_are_as_stiff_as_those_of_the_sources(shifted: bool) -> None:
    people = {name: values[:300] for name, values in DRAWN[shifted].items()}
    rows = zip(people["tone"], people["strength"], people["co_contraction"], strict=True)
    found = np.array(
        [[muscle_stiffness(a, b, tone, strength) for a, b in ((0, 0), (c, c), (1, 0))] for tone, strength, c in rows]
    )
    relaxed, habitual, full = found.T
    assert relaxed.min() > 1.0
    assert relaxed.max() < (4.0 if shifted else 3.01)
    assert 1.0 < habitual.min() < habitual.max() < 15.0
    assert full.max() < 25.0
    torque = STIFFNESS * (people["tone"] + 2.0 * people["strength"]) * SHIFT
    assert torque.min() > 2.5  # more than a tool's push


def test_persons_do_not_depend_on_the_batch() -> None:
    for k in (0, 17, 4999):
        alone = draw_wearers(KEYS[k : k + 1], False)
        assert {name: float(values[0]) for name, values in alone.items()} == {
            name: float(values[k]) for name, values in DRAWN[False].items()
        }


@given(
    mass=st.floats(20, 250),
    height=st.floats(1, 2.5),
    strength=st.floats(0.05, 20),
    rest=st.integers(-18_000, 18_000).map(lambda hundredths: hundredths / 100),
    delay=st.floats(0, 0.3),
    when=st.floats(0, 100),
    guided=st.booleans(),
    worn=st.booleans(),
)
def test_packing_keeps_a_wearer(
    mass: float, height: float, strength: float, rest: float, delay: float, when: float, guided: bool, worn: bool
) -> None:
    wearer = Wearer(
        mass=mass,
        height=height,
        strength=strength,
        rest_angle_deg=rest,
        reflex_delay=delay,
        payload_time=when,
        guided=guided,
        worn=worn,
        tremor_torque=0.1,
    )
    packed = pack_wearer(wearer, PERIOD, True, 0.2, 0.3)
    again = unpack_wearer(packed[0], PERIOD)
    assert pack_wearer(again, PERIOD, True, 0.2, 0.3) == packed
    rounded = {"reflex_delay": again.reflex_delay, "payload_time": again.payload_time}
    assert wearer.model_copy(update=rounded) == again
    assert abs(again.reflex_delay - delay) <= 0.5001 * PERIOD
    assert abs(again.payload_time - when) <= 0.5001 * PERIOD


def test_the_default_wearer_is_the_middle_of_the_population() -> None:
    wearer = Wearer()
    for name in POPULATION.keys() & Wearer.model_fields.keys():
        quantity = POPULATION[name]
        assert getattr(wearer, name) == pytest.approx(0.5 * (quantity.low + quantity.high), abs=10.0**-quantity.digits)
    index, strength = wearer.mass / wearer.height**2, wearer.strength * 70.0 / wearer.mass
    assert index == pytest.approx(24.5, abs=0.05) and strength == pytest.approx(2.5, abs=0.01)
    for name, values in DRAWN[False].items():
        if name in Wearer.model_fields:
            assert values.min() < getattr(wearer, name) < values.max()


def test_single_values_count_for_all_wearers() -> None:
    verticals, arms = (True, False, True), (0.1, 0.2, 0.3)
    packed = pack_wearers({"mass": 80.0}, PERIOD, verticals, 0.2, arms)
    assert packed.shape == (3,)
    for record, vertical, arm in zip(packed, verticals, arms, strict=True):
        assert pack_wearer(Wearer(mass=80.0), PERIOD, vertical, 0.2, arm)[0] == record
    assert pack_wearers({}, PERIOD, False).shape == (1,)


def test_many_are_packed_as_one_by_one() -> None:
    people = {name: values[:20] for name, values in DRAWN[False].items() if name in Wearer.model_fields}
    vertical = np.arange(20) % 2 == 0
    together = pack_wearers(people, PERIOD, vertical, 0.2, 0.01 * np.arange(20))
    for k, record in enumerate(together):
        wearer = Wearer(**{name: float(values[k]) for name, values in people.items()})
        assert pack_wearer(wearer, PERIOD, bool(vertical[k]), 0.2, 0.01 * k)[0] == record


WORN = {
    "initial_angle_deg": 30.0,
    "moves": [{"time": 0.5, "angle_deg": 50.0, "duration": 0.8}],
    "pushes": [{"time": 1.5, "duration": 0.5, "torque": 1.2, "rise": 0.2}],
    "payload": {"mass": 0.3, "arm": 0.35},
    "orientation": "vertical",
    "noise_seed": 3,
    "wearer": {"mass": 81.5, "rest_angle_deg": 40.0, "payload_time": 2.0, "reflex_delay": 0.04},
}


def test_a_worn_scenario_replays_exactly_from_its_file() -> None:
    scenario = load_scenario(WORN)
    row, wearer = pack_worn(scenario, TESTBED)
    again = Scenario.model_validate_json(unpack_worn(row[0], wearer[0], TESTBED).model_dump_json())
    assert again.model_copy(update={"initial_tension": None}) == scenario
    assert pack_worn(again, TESTBED) == (row, wearer)


def test_the_payload_is_in_the_hand() -> None:
    row, wearer = pack_worn(load_scenario(WORN), TESTBED)
    bare = pack(load_scenario({key: WORN[key] for key in WORN if key not in ("payload", "wearer")}), TESTBED)
    assert row["inertia"] == bare["inertia"]
    assert row["static_torque"] == bare["static_torque"] > 0.0
    assert wearer["load_inertia"] == pytest.approx(0.3 * 0.35**2)
    assert wearer["load_weight"] == pytest.approx(9.81 * 0.3 * 0.35, rel=1e-3)
    assert wearer["load_tick"] == round(2.0 / PERIOD)
    lying = load_scenario({**WORN, "orientation": "profile"})
    _, wearer = pack_worn(lying, TESTBED)
    assert wearer["weight"] == wearer["load_weight"] == 0.0
    upright = load_profile({"name": "upright", "base": "testbed", "plant": {"orientation": "vertical"}})
    _, wearer = pack_worn(lying, upright)
    assert wearer["load_weight"] > 0.0


def test_scenario_without_a_wearer_is_played_by_the_given_one() -> None:
    bare = load_scenario({"noise_seed": 1})
    _, wearer = pack_worn(bare, TESTBED)
    assert wearer == pack_wearer(Wearer(), PERIOD, False)
    _, wearer = pack_worn(bare, TESTBED, Wearer(mass=90.0))
    assert wearer == pack_wearer(Wearer(mass=90.0), PERIOD, False)


def test_content_of_bare_scenarios_is_as_before() -> None:
    bare = Scenario(noise_seed=1)
    assert "wearer" not in bare.model_dump()
    assert "wearer" not in json.loads(bare.model_dump_json())
    assert "wearer" not in unpack(pack(bare, TESTBED)[0]).model_dump()
    assert load_scenario(WORN).model_dump()["wearer"]["mass"] == 81.5
    assert load_scenario({"wearer": None}) == Scenario()


def test_device_that_is_not_worn_refuses_a_wearer() -> None:
    with pytest.raises(AmulettError, match=r"'wearer' is given, and this device is not worn.*'Amulett/Worn-v0'"):
        pack(load_scenario(WORN), TESTBED)
    for name in ("Amulett/Scaling-v0", "Amulett/Tension-v0", "Amulett/Drives-v0"):
        with pytest.raises(AmulettError, match="'wearer' is given, and this device is not worn"):
            gym.make(name).reset(seed=0, options={"scenario": WORN})


def test_obstacle_with_a_wearer_is_refused() -> None:
    obstacle = {"obstacle": {"angle_deg": 40.0, "stiffness": 5.0}}
    with pytest.raises(AmulettError, match=r"scenario: 'obstacle' and 'wearer' are both given.*'pushes'"):
        load_scenario({**WORN, **obstacle})
    with pytest.raises(AmulettError, match=r"scenario: 'obstacle'"):
        pack_worn(load_scenario(obstacle), TESTBED)


@pytest.mark.parametrize(
    ("wearer", "message"),
    [
        ({"masss": 70.0}, "unknown key 'wearer.masss'; did you mean 'mass'"),
        ({"mass": 5.0}, "'wearer.mass' is 5.0"),
        ({"guided": 1}, "'wearer.guided' is 1"),
    ],
)
def test_wrong_wearers_are_refused(wearer: dict[str, Any], message: str) -> None:
    with pytest.raises(AmulettError, match=message):
        load_scenario({"wearer": wearer})


def test_delay_that_is_too_long_names_the_longest() -> None:
    people = {"reflex_delay": np.array([0.05, 0.4])}
    with pytest.raises(AmulettError, match=r"wearer.reflex_delay' is 0.4 s, 160 control ticks.*at most 0.3175 s"):
        pack_wearers(people, PERIOD, False)
