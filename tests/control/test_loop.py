"""Section 2.2: who is the agonist, how the two controllers share the drives, and the law of eq. 6."""

import numpy as np
import pytest
from helpers import EXACT_SENSORS, PROFILES, device, run, start
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.control.agonist import BICEPS, TRICEPS, select_agonist
from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation import sensors
from amulett_gym.simulation.trajectory import record

BACK_AND_FORTH = {
    "initial_angle_deg": 30.0,
    "moves": [{"time": 0.2 + 0.7 * k, "angle_deg": angle} for k, angle in enumerate([60.0, 20.0, 50.0, 5.0])],
    "noise_seed": 11,
}

HYSTERESIS, TIE_WIDTH, TIE_ERROR = 1e-4, 2.5e-5, 0.02


@pytest.mark.parametrize(
    ("agonist", "difference", "error", "expected"),
    [
        # the more deflected spring's drive, whatever the error
        (TRICEPS, 2e-4, -1.0, BICEPS),
        (BICEPS, -2e-4, 1.0, TRICEPS),
        # a tie: the direction of the desired motion
        (TRICEPS, 0.0, 0.5, BICEPS),
        (BICEPS, 0.0, -0.5, TRICEPS),
        (BICEPS, 2e-5, -0.5, TRICEPS),
        # a tie without a desired motion, or neither a tie nor a clear difference: no change
        (BICEPS, 0.0, -0.01, BICEPS),
        (TRICEPS, 0.0, 0.01, TRICEPS),
        (TRICEPS, 0.0, 0.0, TRICEPS),
        (BICEPS, -5e-5, -0.5, BICEPS),
        (TRICEPS, 5e-5, 0.5, TRICEPS),
    ],
)
def test_agonist_is_selected(agonist, difference, error, expected):
    springs = (0.002 + max(difference, 0.0), 0.002 + max(-difference, 0.0))
    assert select_agonist(agonist, springs[0] - springs[1], error, HYSTERESIS, TIE_WIDTH, TIE_ERROR) == expected


@given(st.lists(st.tuples(st.floats(-9e-5, 9e-5), st.floats(-0.019, 0.019)), max_size=30))
def test_noise_within_the_hysteresis_never_switches(readings):
    agonist = BICEPS
    for difference, error in readings:
        agonist = select_agonist(agonist, difference, error, HYSTERESIS, TIE_WIDTH, TIE_ERROR)
    assert agonist == BICEPS


@given(st.sampled_from([BICEPS, TRICEPS]), st.floats(0, 0.005), st.floats(0, 0.005), st.floats(-2, 2))
def test_selection_is_the_same_for_flexion_and_extension(agonist, biceps, triceps, error):
    chosen = select_agonist(agonist, biceps - triceps, error, HYSTERESIS, TIE_WIDTH, TIE_ERROR)
    assert select_agonist(-agonist, triceps - biceps, -error, HYSTERESIS, TIE_WIDTH, TIE_ERROR) == -chosen


@pytest.mark.parametrize("wiring", ["sum", "tension_only"])
@pytest.mark.parametrize("base", PROFILES)
@pytest.mark.parametrize("law", ["agent", "eq6"])
def test_commands_are_continuous_where_the_agonist_switches(base, wiring, law):
    motion = run(device(base, loop={"wiring": wiring}), BACK_AND_FORTH, 3.0, tension_law=law)
    switched = np.flatnonzero(np.diff(motion["agonist"])) + 1
    assert len(switched) == motion["switch_count"][-1] >= 3
    increment = np.diff(motion["position_output"], prepend=np.nan)[switched]
    shares = {"biceps": np.ones(len(switched)), "triceps": np.ones(len(switched))}
    if wiring == "tension_only":  # the antagonist does not even follow the position controller
        shares["biceps"] = (motion["agonist"][switched] == BICEPS).astype(float)
        shares["triceps"] = 1 - shares["biceps"]
    for drive, share in shares.items():
        change = np.diff(motion[f"command_{drive}"], prepend=np.nan)[switched]
        np.testing.assert_allclose(change, share * increment, rtol=0, atol=1e-12)
    assert (motion["tension_output"][switched] == 0).all()
    # ... although the feedback jumps from one string's force to the other's and had wound up an output before.
    assert np.abs(motion["tension_output"][switched - 1]).max() > 1e-3


@pytest.mark.parametrize("wiring", ["sum", "tension_only"])
def test_antagonist_follows_the_sum_of_both_controllers_or_the_tension_controller_alone(wiring):
    motion = run(device(loop={"wiring": wiring, "agonist": "biceps"}), BACK_AND_FORTH, 1.0, tension_law="eq6")
    position, tension = np.diff(motion["position_output"]), np.diff(motion["tension_output"])
    share = 1.0 if wiring == "sum" else 0.0
    assert np.abs(tension).max() > 0.1
    np.testing.assert_allclose(np.diff(motion["command_biceps"]), position, atol=1e-12)
    np.testing.assert_allclose(np.diff(motion["command_triceps"]), share * position - tension, atol=1e-12)


@pytest.mark.parametrize(("agonist", "sign"), [("biceps", -1.0), ("triceps", 1.0)])
def test_positive_tension_output_pulls_the_antagonist_tighter(agonist, sign):
    simulation = start(device(loop={"agonist": agonist}))
    simulation.command_tension(12.0)
    antagonist = "triceps" if agonist == "biceps" else "biceps"
    before = simulation.read(f"drive_{antagonist}")[0]
    simulation.advance(3)
    assert simulation.read("tension_output")[0] > 0
    assert sign * (simulation.read(f"drive_{antagonist}")[0] - before) > 0
    assert simulation.read(f"force_{antagonist}")[0] > 10.1


@pytest.mark.parametrize("tension", [np.nan, -np.inf, 1.1e6, -1.1e6])
def test_a_tension_beyond_all_strings_is_refused(tension):
    with pytest.raises(AmulettError, match="at most 1,000,000 N are allowed"):
        start(device()).command_tension(tension)


@pytest.mark.parametrize("base", PROFILES)
def test_tension_settles_at_its_setpoint_in_the_antagonist(base):
    simulation = start(device(base, sensors=EXACT_SENSORS))
    for tension in (7.0, 12.0):
        simulation.command_tension(tension)
        simulation.advance(round(8.0 / simulation.control_period))
        antagonist = "triceps" if simulation.read("agonist")[0] == BICEPS else "biceps"
        assert simulation.read(f"force_{antagonist}")[0] == pytest.approx(tension, abs=0.05)


@pytest.mark.parametrize("agonist", ["biceps", "triceps"])
def test_fixed_agonist_never_changes(agonist):
    motion = run(device(loop={"agonist": agonist}), BACK_AND_FORTH, 3.0)
    assert (motion["agonist"] == (BICEPS if agonist == "biceps" else TRICEPS)).all()
    assert motion["switch_count"][-1] == 0


@pytest.mark.parametrize("base", PROFILES)
def test_position_only_control_turns_both_drives_alike_20_deg_apart_from_slack(base):
    motion = run(device(base), BACK_AND_FORTH, 3.0, control="position-only")
    apart = motion["command_biceps"] - motion["command_triceps"]
    np.testing.assert_allclose(np.degrees(apart), 40.0, rtol=1e-12)
    np.testing.assert_allclose(
        motion["command_biceps"] - np.radians(20.0), motion["position_output"], rtol=0, atol=1e-12
    )
    assert motion["force_biceps"][0] == pytest.approx(motion["force_triceps"][0])
    profile = load_profile(base)
    stretched = np.radians(20.0) * profile.plant.drive_pulley_radius
    assert motion["force_biceps"][0] == pytest.approx(build_tables(profile.spring).force_at(stretched), abs=1e-4)
    assert motion["tension_setpoint"] == pytest.approx(motion["force_triceps"][0])


def test_position_only_control_has_its_own_gains():
    scenario = {"moves": [{"time": 0.1, "angle_deg": 10.0}], "noise_seed": 0}
    profile = device("testbed", sensors=EXACT_SENSORS)
    for control, gains in (("position-only", profile.loop.position_only), ("decentralized", profile.loop.position)):
        motion = run(profile, scenario, 0.2, control=control)
        stepped = np.flatnonzero(np.diff(motion["setpoint"]))[0] + 1
        period, step = profile.loop.control_period, np.radians(10.0)
        kick = (gains.kp + gains.ki * period + gains.kd / (gains.derivative_filter + period)) * step
        jump = motion["position_output"][stepped + 1] - motion["position_output"][stepped]
        assert jump == pytest.approx(kick, rel=1e-4)


PARAMETERS = (10.0, 4.0, 30.0)  # sigma and sigma_min in N, d_offset in deg (Figure 6)


@pytest.mark.parametrize(
    ("error_deg", "text", "printed"),
    [
        (0, 1.0, 0.4),
        (15, 0.6 / 16 + 0.4, 0.6 / 16 + 0.4),
        (30, 0.4, 1.0),
        (45, 0.4, 1.0),
        (10, 0.6 * (2 / 3) ** 4 + 0.4, 0.6 * (1 / 3) ** 4 + 0.4),
    ],
)
def test_eq_6_as_the_text_has_it_and_as_it_is_printed(error_deg, text, printed):
    for error in (error_deg, -error_deg):
        assert scaling_factor(error, *PARAMETERS) == pytest.approx(text)
        assert scaling_factor_printed(error, *PARAMETERS) == pytest.approx(printed)


@given(st.floats(0, 90), st.floats(0, 90))
def test_eq_6_text_slackens_and_printed_tightens_with_the_error(one, other):
    near, far = sorted((one, other))
    assert 0.4 <= scaling_factor(far, *PARAMETERS) <= scaling_factor(near, *PARAMETERS) <= 1
    assert 0.4 <= scaling_factor_printed(near, *PARAMETERS) <= scaling_factor_printed(far, *PARAMETERS) <= 1


@pytest.mark.parametrize(("law", "formula"), [("eq6", scaling_factor), ("eq6-printed", scaling_factor_printed)])
@pytest.mark.parametrize("base", PROFILES)
def test_eq_6_inside_the_loop_sees_every_ticks_measured_error(base, law, formula):
    motion = run(load_profile(base), BACK_AND_FORTH, 2.0, tension_law=law)
    error = np.degrees(motion["setpoint"] - motion["measured_angle"])[:-1]
    expected = [10.0 * formula(e, *PARAMETERS) for e in error]
    np.testing.assert_allclose(motion["tension_setpoint"][1:], expected, rtol=1e-12)
    assert min(expected) < 4.1 and max(expected) > 9.9


@pytest.mark.parametrize("below_floor", ["clamp", "hold", "ignore"])
def test_force_estimates_below_the_floor(below_floor):
    # The strings are let go of, from 8 N to a setpoint of 3 N, under the floor of 5 N.
    profile = device("testbed", sensors={**EXACT_SENSORS, "below_floor": below_floor}, loop={"agonist": "biceps"})
    simulation = start(profile, {"initial_tension": 8.0})
    motion = record(simulation, 150, before_tick=lambda tick: simulation.command_tension(3.0))
    blind, estimate = motion["untrusted_triceps"] == 1, motion["estimate_triceps"]
    assert blind.sum() > 20
    np.testing.assert_array_equal(blind, motion["force_triceps"] < 5.0)
    # In no case does the integral unwind any further on a force that nobody knows.
    assert (np.diff(motion["tension_integral"])[blind[:-1]] >= 0).all()
    if below_floor == "ignore":
        assert estimate.min() < 4.95
        no_error = motion["tension_integral"] + motion["tension_derivative"]
        np.testing.assert_array_equal(motion["tension_output"][1:][blind[:-1]], no_error[1:][blind[:-1]])
    else:
        assert estimate.min() >= 5
    if below_floor == "hold":
        assert (np.diff(estimate)[blind[1:]] == 0).all()


def test_trust_is_what_the_floor_says():
    for below_floor, expected in (("clamp", 5.0), ("hold", 7.7), ("ignore", 3.2)):
        parameters = start(device("testbed", sensors={"below_floor": below_floor})).parameters[0]
        assert sensors.trust(parameters, 3.2, 7.7) == expected
        assert sensors.trust(parameters, 5.0, 7.7) == 5.0
        assert sensors.trust(parameters, 9.9, 7.7) == 9.9


@pytest.mark.parametrize("base", PROFILES)
def test_tension_integral_rests_where_the_spring_is_at_its_end(base):
    # 30 N is more than the springs can give: beyond the table the force, and the reading, are held.
    simulation = start(device(base, loop={"agonist": "biceps"}))
    some_time = round(0.2 / simulation.control_period)
    simulation.command_tension(30.0)
    simulation.advance(some_time)
    assert simulation.read("force_triceps")[0] == simulation.max_force
    wound_up = simulation.read("tension_integral")[0]
    simulation.advance(some_time)
    assert simulation.read("tension_integral")[0] == wound_up
    simulation.command_tension(10.0)
    simulation.advance(20 * some_time)
    forces = []
    for _ in range(50):  # the testbed's noise moves it by half a newton
        simulation.advance(some_time // 10)
        forces.append(simulation.read("force_triceps")[0])
    assert np.mean(forces) == pytest.approx(10.0, abs=0.1)


def test_commands_stay_within_the_drives_limits():
    limits = {"command_limit_deg": 150.0, "rate_limit_deg": 300.0}
    motion = run(device("testbed", drives=limits), BACK_AND_FORTH, 3.0)
    for drive in ("biceps", "triceps"):
        assert np.abs(motion[f"command_{drive}"]).max() <= np.radians(150.0)
    assert motion["command_biceps"].max() == np.radians(150.0)
    rate = np.diff(motion["drive_biceps"]) / motion.control_period
    assert np.abs(rate).max() == pytest.approx(np.radians(300.0))
