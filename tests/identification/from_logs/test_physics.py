from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.fleet import load_fleet
from amulett_gym.identification.from_logs.physics import NUISANCES, PARAMETERS, device, physics_of
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import pack_parameters
from amulett_gym.tasks.scenario import empty_rows


def test_a_device_with_anothers_values_is_that_device():
    template, other = load_fleet("plausible")[:2]
    found = device(template, physics_of(other))
    packed, wanted = pack_parameters(found), pack_parameters(other)
    same = ("drive_radius", "joint_radius", "inverse_lag", "rate_limit", "stall_torque", "damping_a", "damping_d")
    for name in same:
        assert packed[name] == pytest.approx(wanted[name]), name
    assert empty_rows(1, found)["inertia"] == pytest.approx(empty_rows(1, other)["inertia"])
    for deflection in (1e-3, 3e-3, 5e-3):
        forces = [build_tables(each.spring).force_at(deflection) for each in (found, other)]
        assert forces[0] == pytest.approx(forces[1], rel=1e-4)


def test_the_springs_table_ends_at_the_same_force():
    template = load_fleet("plausible")[0]
    found = device(template, {"stiffness": 2.0 * template.spring.stiffness})
    ends = [build_tables(each.spring).max_force for each in (found, template)]
    assert ends[0] == pytest.approx(ends[1])
    assert found.spring.max_deflection < template.spring.max_deflection


@pytest.mark.parametrize("name", ["simulation", "testbed"])
def test_a_profile_has_what_it_describes(name):
    found = physics_of(load_profile(name))
    assert ("lag" in found) == (name == "testbed")
    assert "max_force" in found  # the shipped springs end there
    assert "stall_torque" not in found


def test_a_spring_that_goes_on_by_the_same_law_has_no_end():
    assert "max_force" not in physics_of(load_fleet("plausible")[0])


def test_a_measured_curve_stays_as_it_is():
    curve = {"deflection_m": [0.0, 0.002, 0.004], "force_N": [0.0, 10.0, 30.0]}
    profile = load_profile({"base": "testbed", "name": "measured", "spring": {"measured_curve": curve}})
    found = physics_of(profile)
    assert "stiffness" not in found
    assert device(profile, {"inertia": 0.01}).spring == profile.spring


def test_values_below_the_least_lag_are_raised():
    testbed = load_profile("testbed")
    assert device(testbed, {"lag": 1e-9}).drives.lag == pytest.approx(0.001)


@pytest.mark.parametrize("seen", [*PARAMETERS, *NUISANCES], ids=lambda each: each.name)
def test_places_and_values_are_inverse(seen):
    low = seen.low if seen.logarithmic else max(seen.low, -1.0)
    for value in (low, low + 0.3 * (min(seen.high, 10.0 * abs(low) + 1.0) - low)):
        assert seen.value(seen.place(value)) == pytest.approx(value)
    assert seen.value(np.inf if not seen.logarithmic else 700.0) == pytest.approx(seen.high)
