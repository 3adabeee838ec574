"""Search vectors and parameters turn into each other, and every vector into devices that a profile allows."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulett_gym.identification.parameters import (
    LOOP,
    OWN,
    PARAMETERS,
    SPRING_ENDS,
    UNSEEN,
    allowed,
    devices,
    of,
    pack,
    same_device,
    searched,
    unpack,
)
from amulett_gym.model.plant import inertia
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile

vectors = st.lists(st.floats(0, 1), min_size=len(PARAMETERS), max_size=len(PARAMETERS)).map(np.array)


@given(vectors)
def test_a_search_vector_turns_into_parameters_and_back(vector):
    parameters = unpack(vector)
    assert unpack(pack(parameters)) == pytest.approx(parameters)
    for free in PARAMETERS:
        assert free.low * (1 - 1e-9) <= parameters[free.name] <= free.high * (1 + 1e-9)


def test_the_whole_box_holds_devices_that_a_profile_allows():
    """All corners of every two parameters, the others in the middle or at either end, and what is between.

    An integration step of the longest control period is too long for the shortest lag.
    """
    size = len(PARAMETERS)
    corners = {(base,) * size for base in (0.0, 0.5, 1.0)}
    for base in (0.0, 0.5, 1.0):
        for i, j in itertools.combinations(range(size), 2):
            for one, other in itertools.product((0.0, 1.0), repeat=2):
                corner = [base] * size
                corner[i], corner[j] = one, other
                corners.add(tuple(corner))
    between = np.random.default_rng(0).uniform(size=(100, size))
    for vector in [*map(np.array, sorted(corners)), *between]:
        parameters = unpack(vector)
        devices(parameters)


@given(vectors)
@settings(max_examples=25)
def test_both_devices_get_the_same_mechanics_and_these_mean_what_they_say(vector):
    parameters = unpack(vector)
    found = devices(parameters)
    assert found["simulation"].spring == found["testbed"].spring
    assert found["simulation"].damping == found["testbed"].damping
    plant = found["testbed"].plant
    assert found["simulation"].plant == plant
    assert inertia([plant.masses[0].mass], [plant.masses[0].arm]) == pytest.approx(parameters["inertia"], rel=1e-4)
    assert plant.drive_pulley_radius / plant.joint_pulley_radius == pytest.approx(parameters["radius_ratio"], rel=1e-4)
    # Where the springs are almost in line, the force is a small difference of numbers with five digits.
    assert build_tables(found["testbed"].spring).max_force == pytest.approx(parameters["max_force"], rel=5e-2)


def test_a_lag_too_short_for_the_control_period_is_raised_and_no_candidate():
    names = [free.name for free in PARAMETERS]
    corner = np.full(len(names), 0.5)
    corner[names.index("testbed.lag")], corner[names.index("testbed.control_period")] = 0.0, 1.0
    assert not allowed(corner)
    assert unpack(corner)["testbed.lag"] == 0.004
    corner[names.index("testbed.control_period")] = 0.0
    assert allowed(corner)
    assert unpack(corner)["testbed.lag"] == pytest.approx(0.003)


@pytest.mark.parametrize("end", SPRING_ENDS)
def test_an_end_of_the_springs_curve_has_a_parameter_of_its_own_at_most(end):
    free = searched(end)
    assert free[: len(PARAMETERS)] == PARAMETERS and free[len(PARAMETERS) :] == ((OWN[end],) if end in OWN else ())
    vector = np.full(len(free), 0.5)
    parameters = unpack(vector, free)
    assert of(parameters) == free and allowed(vector, free)
    assert pack(parameters) == pytest.approx(vector, abs=0.11)  # the control period has five places
    for profile in devices(parameters, end).values():
        assert profile.spring.beyond == {"held": None, "stall": "continued"}.get(end, end)
        own = {"stop_stiffness": profile.spring.stop_stiffness, "stall_torque": profile.drives.stall_torque}
        for name, value in own.items():
            assert (value is None) == (name not in parameters)
            assert value is None or value == pytest.approx(parameters[name], rel=1e-4)
    assert devices(parameters)["testbed"] == devices(unpack(vector[: len(PARAMETERS)]))["testbed"]


@pytest.mark.parametrize("end", SPRING_ENDS)
def test_a_set_without_the_loop_leaves_the_testbeds_loop_as_it_is(end):
    free = searched(end, loop=False)
    assert [item.name for item in searched(end) if item not in free] == list(LOOP)
    vector = np.full(len(free), 0.6)
    parameters = unpack(vector, free)
    assert allowed(vector, free) and of(parameters) == free and pack(parameters) == pytest.approx(vector)
    found, testbed = devices(parameters, end)["testbed"], load_profile("testbed")
    assert found.loop == testbed.loop
    names = ("encoder_noise_deg", "potentiometer_travel", "force_filter", "force_floor", "below_floor")
    assert [getattr(found.sensors, name) for name in names] == [getattr(testbed.sensors, name) for name in names]
    assert found.drives.command_limit_deg == testbed.drives.command_limit_deg
    whole = {**unpack(np.full(len(searched(end)), 0.6), searched(end)), **parameters}
    assert devices(whole, end)["simulation"] == devices(parameters, end)["simulation"]


def test_what_no_table_sees_is_in_both_devices_where_they_share_it():
    parameters = {**unpack(np.full(len(PARAMETERS), 0.5)), **{item.name: item.value(0.9) for item in UNSEEN}}
    found = devices(parameters)
    assert found["simulation"].plant == found["testbed"].plant
    plant, sensors = found["testbed"].plant, found["testbed"].sensors
    assert plant.joint_pulley_radius == parameters["joint_pulley_radius"]
    assert plant.masses[0].arm == parameters["mass_arm"]
    assert inertia([plant.masses[0].mass], [plant.masses[0].arm]) == pytest.approx(parameters["inertia"], rel=1e-4)
    assert (sensors.encoder_noise_deg, sensors.potentiometer_travel) == (parameters["encoder_noise"], 0.03)
    assert found["testbed"].drives.command_limit_deg == parameters["command_limit"]
    assert found["simulation"].sensors.encoder_noise_deg == 0.0


def test_names_and_sources_make_no_other_device():
    testbed = load_profile("testbed")
    renamed = testbed.model_copy(update={"name": "mine", "description": "", "base": "testbed"})
    assert same_device(renamed, testbed)
    assert not same_device(load_profile({"base": "testbed", "name": "mine", "drives": {"lag": 0.1}}), testbed)
