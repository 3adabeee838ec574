"""The PID controllers against closed forms: K_p e + K_i integral e + K_d s/(T s + 1) e."""

import math

import numpy as np
import pytest
from helpers import EXACT_SENSORS, device, run, start
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.control.pid import filtered_derivative, integrate
from amulett_gym.simulation import kernel

KP, KI, KD, FILTER = 3.0, 5.0, 0.2, 0.02
GAINS = {"kp": KP, "ki": KI, "kd": KD, "derivative_filter": FILTER}


def position_controller(errors, **gains):
    """Feed the kernel's position controller with errors; return its output after each."""
    profile = device(loop={"position": {**GAINS, **gains}})
    simulation = start(profile)
    simulation.states["position_integral"][0, 0] = 0.0
    outputs = []
    for error in errors:
        simulation.states["measured_angle"][0, 0] = -error
        kernel.control_position(simulation.parameters[0], simulation.states[0], 0, error)
        outputs.append(simulation.read("position_output")[0])
    return np.array(outputs), profile.loop.control_period


def test_output_on_a_step_of_the_error():
    output, period = position_controller(np.full(200, 0.5))
    tick = np.arange(1, 201)
    kick = KD * 0.5 / (FILTER + period) * (FILTER / (FILTER + period)) ** (tick - 1)
    np.testing.assert_allclose(output, KP * 0.5 + KI * 0.5 * tick * period + kick, rtol=1e-12)


def test_output_on_a_ramp_of_the_error():
    period, slope = 0.001, 4.0
    tick = np.arange(1, 201)
    output, _ = position_controller(slope * tick * period)
    derivative = KD * slope * (1 - (FILTER / (FILTER + period)) ** tick)
    integral = KI * slope * period**2 * tick * (tick + 1) / 2
    np.testing.assert_allclose(output, KP * slope * tick * period + integral + derivative, rtol=1e-12)


def ramp_response(period, duration, slope=4.0):
    derivative = 0.0
    for _ in range(round(duration / period)):
        derivative = filtered_derivative(derivative, slope * period, KD, FILTER, period)
    return derivative


def test_filtered_derivative_tends_to_the_first_order_response():
    exact = KD * 4.0 * (1 - math.exp(-0.03 / FILTER))
    errors = [abs(ramp_response(0.03 / ticks, 0.03) - exact) for ticks in (50, 100, 200, 400)]
    assert errors[-1] < 1e-3
    assert np.array(errors[:-1]) / errors[1:] == pytest.approx(2, abs=0.1)  # backward Euler: first order


def test_without_a_filter_the_derivative_is_the_difference_quotient():
    assert filtered_derivative(123.0, 0.3, 2.0, 0.0, 0.1) == pytest.approx(6.0)


def test_derivative_on_the_measurement_has_no_setpoint_kick():
    scenario = {"moves": [{"time": 0.1, "angle_deg": 10.0}]}
    jumps = {}
    for source in ("error", "measurement"):
        motion = run(device(loop={"position": {**GAINS, "derivative_on": source}}), scenario, 0.2)
        stepped = np.flatnonzero(np.diff(motion["setpoint"]))[0] + 1
        jumps[source] = motion["position_output"][stepped + 1] - motion["position_output"][stepped]
    proportional_and_integral = (KP + KI * 0.001) * np.radians(10)
    assert jumps["measurement"] == pytest.approx(proportional_and_integral, rel=1e-6)
    assert jumps["error"] == pytest.approx(proportional_and_integral + KD * np.radians(10) / 0.021, rel=1e-6)


def tension_controller(agonist, setpoints, estimates, **gains):
    """Feed the kernel's tension controller, which commands radians by gains in degrees; return its output after each.

    The other string's estimate is one that would show.
    """
    profile = device(loop={"agonist": agonist, "tension": {**GAINS, **gains}})
    simulation = start(profile)
    state, follower, other = simulation.states[0], "triceps", "biceps"
    if agonist == "triceps":
        follower, other = other, follower
    simulation.advance(1)  # so that the agonist is chosen
    for name in ("tension_integral", "tension_derivative", "tension_signal"):
        state[name][0] = 0.0
    state["tension_signal"][0] = setpoints[0] - estimates[0] if profile.loop.tension.derivative_on == "error" else 0.0
    if profile.loop.tension.derivative_on == "measurement":
        state["tension_signal"][0] = -estimates[0]
    state[f"estimate_{other}"][0] = 99.0
    outputs = []
    for setpoint, estimate in zip(setpoints[1:], estimates[1:], strict=True):
        state["tension_setpoint"][0], state[f"estimate_{follower}"][0] = setpoint, estimate
        kernel.control_tension(simulation.parameters[0], state, 0, False)
        outputs.append(simulation.read("tension_output")[0])
    return np.degrees(outputs), profile.loop.control_period


@pytest.mark.parametrize("derivative_on", ["error", "measurement"])
@pytest.mark.parametrize("agonist", ["biceps", "triceps"])
def test_tension_derivative_opposes_a_rising_force(agonist, derivative_on):
    rise = np.linspace(8.0, 9.0, 101)  # 0.01 N a tick
    output, period = tension_controller(agonist, np.full(101, 10.0), rise, kp=0.0, ki=0.0, derivative_on=derivative_on)
    filtered = 1 - (FILTER / (FILTER + period)) ** np.arange(1, 101)
    np.testing.assert_allclose(output, -KD * 0.01 / period * filtered, rtol=1e-9)


@pytest.mark.parametrize("derivative_on", ["error", "measurement"])
def test_tension_controller_is_the_pid_of_the_setpoint_minus_the_force(derivative_on):
    setpoint = np.array([8.0, 10.0, 10.0, 10.0])
    output, period = tension_controller("biceps", setpoint, np.full(4, 7.0), derivative_on=derivative_on)
    tick = np.arange(1, 4)
    expected = 3.0 * (KP + KI * period * tick)
    if derivative_on == "error":
        expected += KD * 2.0 / (FILTER + period) * (FILTER / (FILTER + period)) ** (tick - 1)
    np.testing.assert_allclose(output, expected, rtol=1e-9)


@given(st.floats(-5, 5), st.floats(-5, 5), st.booleans(), st.booleans())
def test_integral_moves_only_where_there_is_room(integral, error, up, down):
    after = integrate(integral, error, 2.0, 0.01, up, down)
    room = up if error > 0 else down
    assert after == (integral + 2.0 * error * 0.01 if room else integral)


def test_integral_rests_while_the_drive_is_at_its_end():
    # The setpoint is out of the drives' reach. Without anti-windup the integral would grow by K_i e T every tick.
    profile = device("testbed", drives={"command_limit_deg": 90.0}, sensors=EXACT_SENSORS)
    moves = [{"time": 0.1, "angle_deg": 80.0}, {"time": 4.0, "angle_deg": 10.0}]
    motion = run(profile, {"moves": moves}, 6.0)
    limit = np.radians(90.0)
    error = motion["setpoint"] - motion["measured_angle"]
    stuck = (motion["command_biceps"][:-1] == limit) & (error[:-1] > 0) & (motion["agonist"][1:] == 1)
    assert stuck.sum() > 500
    assert (np.diff(motion["position_integral"])[stuck] == 0).all()
    assert np.abs(motion["command_biceps"]).max() == limit
    back = motion["time"] >= 4.0
    assert motion["command_biceps"][back][3] < limit  # it leaves the end at once
    assert abs(error[-1]) < np.radians(1.0)
