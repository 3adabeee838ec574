"""The tick in C that the kernel's speed is measured against is the kernel's tick."""

import re

import numpy as np
import pytest
from helpers import device

from amulett_gym.c.build import BUILDS, NO_COMPILER, aligned, build, declarations, find_compiler
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import ANGLE_LIMIT, NOT_FINITE, RUNNING, STATE_BLOCK
from amulett_gym.studies.speed.work import count_work, flops
from amulett_gym.studies.speed.yardstick import PROFILES, check, deviations, mixed_simulation, race

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason=NO_COMPILER)


@pytest.fixture(scope="module", params=BUILDS)
def yardstick(request, tmp_path_factory):
    """Each build's name and its advance()."""
    return request.param, build(request.param, tmp_path_factory.mktemp("build"))


@needs_compiler
@pytest.mark.parametrize("law", ["eq6", "eq6-printed", "agent"])
@pytest.mark.parametrize("profile", PROFILES)
def test_c_advances_as_the_kernel_does(yardstick, profile, law):
    name, advance = yardstick
    deviation, field = check(advance, profile, law, num_devices=27)
    assert deviation <= BUILDS[name].tolerance, field


@needs_compiler
@pytest.mark.parametrize("spring", [{"beyond": "continued"}, {"beyond": "hard-stop", "stop_stiffness": 3e4}])
@pytest.mark.parametrize("base", PROFILES)
def test_c_knows_what_a_string_does_beyond_its_table_and_a_drive_beyond_its_stall(yardstick, base, spring):
    name, advance = yardstick
    # Soft springs, so that most of their strings go beyond the table, and nearly all drives stall.
    profile = device(base, spring={**spring, "stiffness": 6500.0}, drives={"stall_torque": 0.2})
    deviation, field = check(advance, profile, "eq6", num_devices=27)
    assert deviation <= BUILDS[name].tolerance, field


@needs_compiler
def test_c_has_strings_with_an_elastic_structure(yardstick):
    name, advance = yardstick
    profile = device("testbed", structure={"stiffness": 2e4}, spring={"beyond": "continued"})
    deviation, field = check(advance, profile, "eq6", num_devices=27)
    assert deviation <= BUILDS[name].tolerance, field


@needs_compiler
def test_c_stops_the_devices_that_the_kernel_stops(yardstick):
    name, advance = yardstick
    simulation = mixed_simulation("testbed", 27)
    simulation.states["angle"][1, 2] = 10.0
    simulation.states["velocity"][2, 5] = np.nan
    simulation.states["velocity"][2, 7] = 1e120
    scenarios, states = aligned(simulation.scenarios), aligned(simulation.states)
    advance(simulation.parameters, simulation.which, scenarios, states, None, None, None, 27, 50)
    simulation.advance(50)
    failure = states["failure"].ravel()[:27]
    assert failure[10] == ANGLE_LIMIT and (failure[[21, 23]] == NOT_FINITE).all() and (failure != RUNNING).sum() == 3
    assert max(deviations(simulation.states, states).values()) <= BUILDS[name].tolerance


def test_a_deviation_of_any_field_is_found():
    states = mixed_simulation("testbed", 8).states
    other = states.copy()
    other["inside_since"][0, 3] = 1.0
    assert deviations(states, other)["inside_since"] == np.inf
    other = states.copy()
    other["iav_biceps"][0, 0] += 1e-3
    assert deviations(states, other)["iav_biceps"] == pytest.approx(1e-3)


def test_c_sees_every_field_of_a_state():
    struct = re.search(r"typedef struct \{([^}]*)\} states;", declarations())
    assert struct is not None
    assert re.findall(r"(\w+)\[LANES / WIDTH\];", struct[1]) == list(STATE_BLOCK.names)


@needs_compiler
def test_race_gives_ratios_to_the_reference(tmp_path):
    advance = build("scalar", tmp_path)
    speeds = race({"scalar": advance, "again": advance}, "testbed", 16, turns=2, seconds=0.0)
    assert speeds["scalar"].ratio == (1.0, 1.0, 1.0)
    assert all(0 < least <= median <= most for median, least, most in (speeds["again"].rate, speeds["again"].ratio))


def test_work_counts_what_a_tick_does():
    profile = load_profile("testbed")
    simulation = mixed_simulation("testbed", 3)
    simulation.scenarios["static_torque"][0, 0] = 0.05  # the others lie horizontally: nobody needs their sine
    work = count_work(simulation, ticks=4)
    accelerations = 4 * profile.loop.substeps
    assert work["exp"] == 3 * work["sin"] == accelerations
    assert work["floor"] == 3  # two sliders and the encoder are quantised
    assert work["sqrt"] == 2  # one estimated force each
    assert work["table row"] >= 2 * accelerations + 6  # two springs; the sensors' tables and the forces at the end
    assert flops(work) > 20 * (work["exp"] + work["sin"])
    assert 0 < work["bytes written"] <= work["bytes read"] < 2 * STATE_BLOCK.itemsize / 8


def test_counting_leaves_the_simulation_alone():
    simulation = mixed_simulation("testbed", 2)
    before = simulation.states.copy()
    count_work(simulation, ticks=2)
    assert simulation.states.tobytes() == before.tobytes()
