"""What is read off motions: the rise time of the string force is that of the recorded force."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.evaluation.signals import acting, force_feedback
from amulett_gym.profile import load_profile
from amulett_gym.studies.paper.motion import force_rise_times
from amulett_gym.studies.paper.reproduction import (
    MEASUREMENT_TIME,
    Readings,
    antagonist_force,
    apply_readings,
    follow,
    paper_step,
    start,
)
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES
from amulett_gym.tasks.suites import START

READINGS = Readings()


@pytest.fixture(scope="module")
def rises():
    found = force_rise_times({name: load_profile(name) for name in DEVICES}, READINGS)
    assert [(item.profile, item.configuration) for item in found] == [(d, c) for d in DEVICES for c in CONFIGURATIONS]
    return {(item.profile, item.configuration): item for item in found}


@pytest.mark.parametrize("name", DEVICES)
def test_the_antagonists_force_is_what_the_tension_controller_sees(name):
    device = load_profile(name)  # whose agonist switches
    steps = [paper_step(device, "variable", noise_seed=key) for key in (1, 2)]
    force, setpoint = antagonist_force(start(device, "variable", steps), 1.0, estimated=True)
    path = follow(start(device, "variable", steps[1:]), 1.0)
    np.testing.assert_array_equal(force[:, 1], force_feedback(path)[:-1])
    np.testing.assert_array_equal(setpoint[:, 1], acting(path, "tension_setpoint")[:-1])


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_the_force_reaches_its_margin_when_the_recorded_force_does(rises, configuration):
    device = apply_readings(load_profile("simulation"), READINGS)
    path = follow(start(device, configuration, [paper_step(device, configuration)]), START + MEASUREMENT_TIME)
    setpoint, found = acting(path, "tension_setpoint"), rises["simulation", configuration]
    outside = np.abs(path["force_triceps"] / setpoint - 1.0) > 0.05
    after = path["time"] >= START - 1e-9
    assert found.first_entry == pytest.approx(path["time"][after & ~outside][0] - START)
    assert found.last_entry == pytest.approx(path["time"][after & outside][-1] + path.control_period - START)
    assert (found.inside_at_end, found.repetitions, found.share_inside) == (1, 1, 1.0)


def test_noise_throws_the_testbeds_estimate_out_of_its_margin(rises):
    """Half a newton at 10 N is two standard deviations of the estimate, so that it never settles."""
    found = rises["testbed", "tension-10"]
    assert found.last_entry > MEASUREMENT_TIME - 1.0
    assert 0.8 < found.share_inside < 1.0
    assert found.repetitions == 10
    assert 0.3 < rises["testbed", "variable"].first_entry < 1.0


def test_a_device_that_fails_has_no_rise_time():
    frail = load_profile({"name": "frail", "base": "testbed", "plant": {"velocity_limit_deg": 50.0}})
    for item in force_rise_times(dict.fromkeys(DEVICES, frail), READINGS):
        assert (item.first_entry, item.last_entry, item.inside_at_end, item.share_inside) == (None, None, 0, 0.0)
