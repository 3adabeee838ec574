"""Section 2.1: the arm (eqs. 1-5), its friction (Figure 3), obstacles, drives and sensors."""

import math

import numpy as np
import pytest
from helpers import HELD_DRIVES, device, run, start
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.model import damping
from amulett_gym.model.drive import drive_rate, loaded_drive_rate
from amulett_gym.model.plant import (
    contact_torque,
    deflection_biceps,
    deflection_triceps,
    inertia,
    joint_acceleration,
    static_torque,
    weight_torque,
)
from amulett_gym.model.sensors import quantise, read_slider
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation import dynamics
from amulett_gym.simulation.layout import pack_parameters
from amulett_gym.tasks.scenario import load_scenario, pack

angles = st.floats(-2, 2)
rates = st.floats(-50, 50)
forces = st.floats(0, 15)
torques = st.floats(-5, 5)

FIT = load_profile("simulation").damping


def arm_torques(profile, **scenario):
    """Return J and M_m of the arm in a scenario."""
    row = pack(load_scenario(scenario), profile)[0]
    return row["inertia"], row["static_torque"]


def test_eq_2_and_3_by_hand():
    masses, arms = [2.0, 1.0], [0.3, 0.1]
    assert static_torque(masses, arms) == pytest.approx(9.81 * 0.7)
    assert inertia(masses, arms) == pytest.approx(3 * 0.09 / 12 + 0.18 + 0.01)


def test_profiles_share_one_arm():
    assert arm_torques(load_profile("testbed")) == arm_torques(load_profile("simulation"))


def test_payload_adds_to_both_sums_and_gravity_acts_in_the_vertical_plane_only():
    profile = device(plant={"masses": [{"mass": 2.0, "arm": 0.3}]})
    payload = {"mass": 1.0, "arm": 0.1}
    assert arm_torques(profile, payload=payload) == pytest.approx((0.2125, 0.0))
    vertical = device(plant={"masses": [{"mass": 2.0, "arm": 0.3}], "orientation": "vertical"})
    assert arm_torques(vertical, payload=payload) == pytest.approx((0.2125, 9.81 * 0.7))


def test_a_scenario_may_lay_the_arm_down_or_set_it_upright():
    vertical = device(plant={"orientation": "vertical"})
    weight = arm_torques(vertical)[1]
    assert weight > 0
    assert arm_torques(device(), orientation="vertical")[1] == weight
    assert arm_torques(vertical, orientation="horizontal")[1] == 0


def test_eq_4_and_5_flexing_drive_stretches_the_biceps_and_flexed_joint_the_triceps():
    assert deflection_biceps(3.0, 0.5, 0.01, 0.04) == pytest.approx(0.03 - 0.02)
    assert deflection_triceps(3.0, 0.5, 0.01, 0.04) == pytest.approx(0.02 - 0.03)


@given(angles, angles)
def test_a_drive_at_the_wound_angle_leaves_its_string_just_slack(joint, drive):
    assert deflection_biceps(joint * 4, joint, 0.01, 0.04) == pytest.approx(0, abs=1e-15)
    assert deflection_biceps(drive, joint, 0.01, 0.04) == -deflection_triceps(drive, joint, 0.01, 0.04)


def test_eq_1_by_hand():
    # (5 N - 2 N) 0.04 m = 0.12 N m; gravity 0.3 sin 30 deg = 0.15 N m; a push of 0.05 N m; 2 delta x' = 2 * 3 * 0.5
    weight = weight_torque(0.3, math.pi / 6)
    acceleration = joint_acceleration(0.5, 5.0, 2.0, 3.0, weight, 0.05, 0.004, 0.04)
    assert acceleration == pytest.approx((0.12 - 0.15 + 0.05) / 0.004 - 3.0)


@given(angles, rates, forces, forces, torques)
def test_eq_1_is_the_same_for_flexion_and_extension(joint, rate, biceps, triceps, push):
    arm = (0.0035, 0.04)
    flexing = joint_acceleration(rate, biceps, triceps, 4.0, weight_torque(0.2, joint), push, *arm)
    extending = joint_acceleration(-rate, triceps, biceps, 4.0, weight_torque(0.2, -joint), -push, *arm)
    assert flexing == pytest.approx(-extending, rel=1e-12, abs=1e-9)


def decay_rate(preload, fit=FIT):
    parameters = pack_parameters(load_profile("simulation").model_copy(update={"damping": fit}))[0]
    return damping.decay_rate(preload, *(parameters[f"damping_{name}"] for name in "abcd"))


def test_damping_fit_has_the_values_of_figure_3():
    assert decay_rate(5.0) == pytest.approx(3.1245, abs=1e-4)
    assert decay_rate(10.0) == pytest.approx(5.4296, abs=1e-4)
    assert decay_rate(100.0) == FIT.d
    assert decay_rate(4.148) == decay_rate(0.0) == 0
    assert 0 < decay_rate(4.1495) < 0.01


def test_damping_fit_as_printed_is_flat():
    printed = FIT.model_copy(update={"fit": "printed"})
    assert decay_rate(0.0, printed) == pytest.approx(5.436, abs=1e-3)
    assert decay_rate(15.0, printed) == pytest.approx(5.445, abs=1e-3)


@given(forces, forces)
def test_damping_never_falls_with_preload(one, other):
    low, high = sorted((one, other))
    assert 0 <= decay_rate(low) <= decay_rate(high) <= FIT.d


def friction(profile, scenario):
    """Return what a rate of 1 rad/s takes off the joint's acceleration, and J, at rest under 10 N."""
    simulation = start(profile, scenario)
    state, arm = simulation.states[0], simulation.scenarios[0]
    still, moving = (
        dynamics.acceleration(
            simulation.parameters[0],
            arm,
            0,
            state["angle"][0],
            rate,
            state["drive_biceps"][0],
            state["drive_triceps"][0],
            0.0,
            True,
        )
        for rate in (0.0, 1.0)
    )
    return still - moving, arm["inertia"][0]


def test_a_payload_does_not_multiply_friction():
    loaded = {"payload": {"mass": 0.4, "arm": 0.143}}
    nominal, bare = friction(device(), {})
    assert nominal == pytest.approx(2 * decay_rate(10.0))
    slowed, heavy = friction(device(), loaded)
    assert heavy > 2 * bare
    assert slowed * heavy == pytest.approx(nominal * bare)
    assert friction(device(damping={"keeps": "rate"}), loaded)[0] == pytest.approx(nominal)
    doubled = {**loaded, "device": {"damping": 2.0}}
    assert friction(device(damping={"keeps": "rate"}), doubled)[0] == pytest.approx(2 * nominal)


def test_the_microcontroller_takes_the_springs_for_the_profiles():
    simulation = start(device(), {"device": {"spring_biceps": 0.8, "spring_triceps": 1.2}})
    for name, factor in (("biceps", 0.8), ("triceps", 1.2)):
        force = simulation.read(f"force_{name}")[0]
        assert force == pytest.approx(10.0)
        assert simulation.read(f"estimate_{name}")[0] == pytest.approx(force / factor, rel=1e-3)


@pytest.mark.parametrize("preload", ["mean", "smaller"])
def test_friction_follows_the_preload(preload):
    profile = device(plant={"orientation": "vertical"}, damping={"preload": preload})
    posture = {"initial_angle_deg": 60.0, "initial_tension": 5.0}
    biceps = start(profile, posture).read("force_biceps")[0]
    assert biceps > 8
    expected = decay_rate((5.0 + biceps) / 2 if preload == "mean" else 5.0)
    assert friction(profile, posture)[0] == pytest.approx(2 * expected)


def test_small_motion_rings_as_a_damped_oscillator():
    # Drives held: J x'' + 2 delta J x' + R_2^2 (f'_1 + f'_2) x = 0 about the posture at rest.
    profile = device(loop={**HELD_DRIVES, "substeps": 4})
    push = {"time": 0.0, "duration": 0.05, "torque": 2e-3}
    motion = run(profile, {"pushes": [push]}, 0.6)
    tables = build_tables(profile.spring)
    stiffness = 2 * 0.04**2 * tables.stiffness_at(tables.deflection_at(10.0))
    delta, total = decay_rate(10.0), arm_torques(profile)[0]
    omega = math.sqrt(stiffness / total - delta**2)

    def step_response(time):
        time = np.maximum(time, 0.0)
        ringing = np.exp(-delta * time) * (np.cos(omega * time) + delta / omega * np.sin(omega * time))
        return 2e-3 / stiffness * (1 - ringing)

    expected = step_response(motion["time"]) - step_response(motion["time"] - 0.05)
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(motion["angle"], expected, atol=2e-3 * np.abs(expected).max())


@given(angles, rates, angles, st.sampled_from([-1.0, 1.0]), st.floats(0, 100), st.floats(0, 5))
def test_contact_never_pulls_and_acts_inside_the_obstacle_only(joint, rate, angle, side, stiffness, viscosity):
    torque = contact_torque(joint, rate, angle, side, stiffness, viscosity)
    assert torque * side <= 0
    if side * (joint - angle) <= 0:
        assert torque == 0
    assert contact_torque(-joint, -rate, -angle, -side, stiffness, viscosity) == -torque


def test_contact_by_hand():
    assert contact_torque(0.6, 2.0, 0.5, 1.0, 10.0, 0.3) == pytest.approx(-(1.0 + 0.6))
    assert contact_torque(0.6, -2.0, 0.5, 1.0, 10.0, 0.3) == pytest.approx(-(1.0 - 0.6))
    assert contact_torque(0.6, -9.0, 0.5, 1.0, 10.0, 0.3) == 0  # leaving faster than it springs back


def test_drive_lags_within_its_speed_and_an_ideal_one_has_none_to_show():
    assert drive_rate(1.0, 0.9, 1 / 0.05, 10.0) == pytest.approx(2.0)
    assert drive_rate(9.0, 0.0, 1 / 0.05, 10.0) == 10.0
    assert drive_rate(-9.0, 0.0, 1 / 0.05, 10.0) == -10.0
    assert drive_rate(9.0, 0.0, 0.0, math.inf) == 0.0


@given(angles, st.floats(0, 3))
def test_a_loaded_drive_has_the_torque_speed_line_of_a_geared_motor(angle, load):
    # Winding is limited to 1 - load of the speed without load, and beyond stall the load turns the drive back.
    assert loaded_drive_rate(angle + 9.0, angle, 20.0, 10.0, 1.0, load) == pytest.approx(
        max(10.0 * (1.0 - load), -10.0)
    )
    assert loaded_drive_rate(angle - 9.0, angle, 20.0, 10.0, 1.0, load) == pytest.approx(-10.0)
    slow = loaded_drive_rate(angle + 0.1, angle, 20.0, 10.0, 1.0, load)
    assert slow == pytest.approx(max(min(2.0, 10.0 * (1.0 - load)), -10.0))
    assert (
        loaded_drive_rate(-angle - 0.1, -angle, 20.0, 10.0, -1.0, load) == -slow
    )  # the triceps' drive winds backwards
    assert loaded_drive_rate(angle + 0.1, angle, 20.0, 10.0, 1.0, 0.0) == drive_rate(angle + 0.1, angle, 20.0, 10.0)
    assert loaded_drive_rate(angle + 0.1, angle, 0.0, math.inf, 1.0, load) == 0.0


def test_lagging_drive_follows_a_held_command_exponentially():
    profile = device("testbed", drives={"rate_limit_deg": None}, loop=HELD_DRIVES)
    simulation = start(profile)
    turned = simulation.read("drive_biceps")[0]
    simulation.states["offset_biceps"][0, 0] += 0.1
    simulation.advance(10)
    remaining = turned + 0.1 - simulation.read("drive_biceps")[0]
    elapsed = 10 * profile.loop.control_period
    assert remaining == pytest.approx(0.1 * math.exp(-elapsed / profile.drives.lag), rel=1e-5)


@given(st.floats(-10, 10), st.floats(1e-4, 0.1))
def test_quantised_reading_is_the_nearest_multiple_of_a_bit(value, bit):
    reading = quantise(value, bit)
    assert abs(reading - value) <= bit / 2 * (1 + 1e-9)
    assert reading / bit == pytest.approx(round(reading / bit), abs=1e-9)
    assert quantise(value, 0.0) == value


def test_slider_ends_at_its_travel():
    assert read_slider(0.03, 0.0, 0.0, 0.02) == 0.02
    assert read_slider(0.001, -0.002, 0.0, 0.02) == 0
    assert read_slider(0.0104, 0.0002, 0.0, 0.02) == pytest.approx(0.0106)
    assert read_slider(0.0104, 0.0002, 0.001, 0.02) == pytest.approx(0.011)
