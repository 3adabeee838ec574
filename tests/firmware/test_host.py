"""The controller begins from readings alone, refuses unsound inputs, and lets the strings go at a bounded rate."""

import numpy as np
import pytest

from amulett_gym.firmware.device import LET_GO_RATE
from amulett_gym.firmware.host import BAD_SENSOR, BAD_SETPOINT, LETTING_GO, SLACK, read_defines
from amulett_gym.firmware.readme import begin_record
from amulett_gym.model.spring import build_tables, estimate_force
from amulett_gym.profile import load_profile

PERIOD = 0.0025


def first_of(controller, recording, ticks, device=0):
    """Begin a device's recorded episode and return its first inputs."""
    controller.start(begin_record(controller, recording, device))
    return controller.inputs({name: values[:ticks, device] for name, values in recording.readings.items()})


@pytest.fixture(params=["double", "float"])
def controller(request, firmware):
    made = firmware("eq6-held", suite="mixed", split="shifted")
    return made.controller(request.param), made.record(steps=20)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3.0])
@pytest.mark.parametrize("field", ["setpoint", "jump"])
def test_an_unsound_setpoint_is_not_taken(controller, field, bad):
    controller, recording = controller
    inputs = first_of(controller, recording, 100)
    inputs[field][40:60] = bad if field == "setpoint" else 2.0 * bad
    found = controller.run(inputs)
    assert (found["status"][40:60] & BAD_SETPOINT).all() and not (found["status"][60:] & BAD_SETPOINT).any()
    assert np.isfinite(found["command"]).all()
    held = first_of(controller, recording, 100)
    held["setpoint"][40:60] = held["setpoint"][39]
    held["flags"][40:60] &= 2
    np.testing.assert_array_equal(controller.run(held)["command"], found["command"])


@pytest.mark.parametrize(("field", "bad"), [("encoder", 8000), ("encoder", -(2**31)), ("slider", -1), ("slider", 1025)])
def test_a_reading_out_of_range_stops_the_computation(controller, field, bad):
    controller, recording = controller
    inputs = first_of(controller, recording, 100)
    inputs[field][50] = bad
    found = controller.run(inputs)
    assert found["status"][50] & BAD_SENSOR and not (np.delete(found["status"], 50) & BAD_SENSOR).any()
    np.testing.assert_array_equal(found["command"][50], found["command"][49])
    again = first_of(controller, recording, 100)
    np.testing.assert_array_equal(
        controller.run(np.delete(again, 50))["command"], np.delete(found["command"], 50, axis=0)
    )


def test_strings_are_let_go_at_a_bounded_rate(controller):
    controller, recording = controller
    output = controller.run(first_of(controller, recording, 100))[-1]
    mean, apart = output["command"].mean(), np.ptp(output["command"])
    assert apart > 0.1
    periods = 0
    while not output["status"] & SLACK:
        last, output = output["command"].copy(), controller.let_go(output)
        assert output["status"] & LETTING_GO
        assert np.abs(output["command"] - last).max() <= LET_GO_RATE * PERIOD * 1.001
        periods += 1
    assert periods == np.ceil(0.5 * apart / (LET_GO_RATE * PERIOD))
    np.testing.assert_allclose(output["command"], mean, rtol=1e-6)
    np.testing.assert_allclose(controller.let_go(output)["command"], mean, rtol=1e-6)


def test_an_episode_begins_from_a_reading_alone(controller):
    controller, recording = controller
    inputs = first_of(controller, recording, 1)
    begin = controller.begin_here(inputs[0], recording.begin["command"][0])
    known, tables = recording.begin, build_tables(load_profile("testbed").spring)
    assert begin["angle"] == pytest.approx(known["averaged_angle"][0], abs=2e-3)
    assert begin["agonist"] == (1 if begin["difference"] >= 0 else -1)  # at rest without a load, noise decides
    for k, name in enumerate(("biceps", "triceps")):
        force = estimate_force(tables.estimated_force, recording.readings[name][0, 0], tables.max_spring_deflection)
        assert begin["estimate"][k] == pytest.approx(max(force, 5.0), rel=1e-5)
    controller.start(begin)
    first = controller.run(inputs)[0]
    # The commands continue where the drives are, but for the setpoint's first step.
    held = inputs.copy()
    held["setpoint"] = begin["angle"]
    controller.start(begin)
    assert np.abs(controller.run(held)[0]["command"] - known["command"][0]).max() < 0.05
    assert np.isfinite(first["command"]).all()


def test_the_numbers_of_a_header_are_read(firmware):
    numbers = read_defines((firmware("eq6").folder / "device.h").read_text())
    assert numbers["CONTROL_PERIOD"] == PERIOD and numbers["LAW_TICKS"] == 8 and numbers["SLIDER_MOST"] == 1024
