"""Search vectors and parameters turn into each other, and every vector into devices that a profile allows."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulett_gym.identification.parameters import (
    OWN,
    PARAMETERS,
    SPRING_ENDS,
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


def test_names_and_sources_make_no_other_device():
    testbed = load_profile("testbed")
    renamed = testbed.model_copy(update={"name": "mine", "description": "", "base": "testbed"})
    assert same_device(renamed, testbed)
    assert not same_device(load_profile({"base": "testbed", "name": "mine", "drives": {"lag": 0.1}}), testbed)
