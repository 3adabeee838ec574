"""The metrics that the kernel adds up, against sums over the recorded trajectory."""

import numpy as np
import pytest
from helpers import BUSY, HELD_DRIVES, PROFILES, device, run, start

from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation import reference
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import METRICS
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import load_scenario, pack
from amulett_gym.tasks.suites import START, sample, suite_names

MARGIN = np.radians(2.0)

SUMS = (
    "position_ise",
    "tension_ise",
    "tension_ise_estimated",
    "isav_biceps",
    "isav_triceps",
    "isav_kick",
    "effort_biceps",
    "effort_triceps",
    "iav_biceps",
    "iav_triceps",
    "drive_effort",
    "drive_work",
)

STEPS = {
    "initial_angle_deg": 20.0,
    "moves": [
        {"time": 0.3, "angle_deg": 50.0},
        {"time": 1.5, "angle_deg": 30.0, "duration": 0.4},
        {"time": 2.0, "angle_deg": 85.0},  # cut off before it gets there
        {"time": 2.1, "angle_deg": 10.0},
    ],
    "noise_seed": 3,
}


@pytest.fixture(params=[(base, law) for base in PROFILES for law in ("agent", "eq6")], ids="-".join)
def motion(request):
    base, law = request.param
    return run(load_profile(base), STEPS, 4.0, tension_law=law)


def antagonist_force(motion):
    return np.where(motion["agonist"] > 0, motion["force_triceps"], motion["force_biceps"])


def test_position_ise_is_the_trapezoid_with_the_setpoint_held_over_each_tick(motion):
    before = motion["setpoint"][:-1] - motion["angle"][:-1]
    after = motion["setpoint"][:-1] - motion["angle"][1:]
    expected = np.cumsum(before**2 + after**2) * motion.control_period / 2
    np.testing.assert_allclose(motion["position_ise"][1:], expected, rtol=1e-11)


def test_tension_ise_is_the_antagonists_at_the_end_of_each_tick(motion):
    error = motion["tension_setpoint"][1:] - antagonist_force(motion)[1:]
    assert motion["tension_ise"][-1] == pytest.approx(np.sum(error**2) * motion.control_period, rel=1e-11)
    estimate = np.where(motion["agonist"] > 0, motion["estimate_triceps"], motion["estimate_biceps"])
    error = motion["tension_setpoint"][1:] - estimate[1:]
    assert motion["tension_ise_estimated"][-1] == pytest.approx(np.sum(error**2) * motion.control_period, rel=1e-11)


@pytest.mark.parametrize("drive", ["biceps", "triceps"])
def test_isav_and_iav_are_sums_over_the_commands_increments(motion, drive):
    increment = np.diff(motion[f"command_{drive}"])
    assert motion[f"isav_{drive}"][-1] == pytest.approx(np.sum(increment**2) / motion.control_period, rel=1e-11)
    assert motion[f"iav_{drive}"][-1] == pytest.approx(np.abs(increment).sum(), rel=1e-11)


def drive_costs(profile, row, motion):
    """Return effort [rad2/s] and work [J] of the drives in a motion: of eq. 8 and of torque times turn."""
    effort = work = 0.0
    for drive, winds in (("biceps", 1.0), ("triceps", -1.0)):
        turn, force = np.diff(motion[f"drive_{drive}"]), motion[f"force_{drive}"]
        torque = winds * profile.plant.drive_pulley_radius * float(row[f"pulley_{drive}_factor"]) * force
        effort += np.sum(turn**2) / profile.loop.control_period
        work += np.sum(np.maximum((torque[:-1] + torque[1:]) / 2 * turn, 0.0))
    return effort, work


UNLIKE = {"spring_biceps": 1.15, "spring_triceps": 0.9, "pulley_biceps": 0.95, "pulley_triceps": 1.08}


@pytest.mark.parametrize("scenario", [STEPS, {**BUSY, "device": UNLIKE}], ids=["steps", "unlike"])
@pytest.mark.parametrize("base", PROFILES)
def test_effort_and_work_of_the_drives_are_those_of_the_reference(base, scenario):
    """By the recorded motion to the last digits, and by that of the independent model under the same commands."""
    profile = load_profile(base)
    row = pack(load_scenario(scenario), profile)[0]
    motion = run(profile, scenario, 1.0, tension_law="eq6")
    found = motion["drive_effort"][-1], motion["drive_work"][-1]
    assert min(found) > 0.0
    assert found == pytest.approx(drive_costs(profile, row, motion), rel=1e-11)
    replayed = reference.replay_motion(profile, row, motion)
    assert found == pytest.approx(drive_costs(profile, row, replayed), rel=2e-5)


@pytest.mark.parametrize("law", ["agent", "eq6"])
def test_effort_of_ideal_drives_is_their_commands_isav(law):
    ideal, lagging = (run(load_profile(base), STEPS, 4.0, tension_law=law) for base in PROFILES)
    isav, more = (motion["isav_biceps"][-1] + motion["isav_triceps"][-1] for motion in (ideal, lagging))
    assert ideal["drive_effort"][-1] == pytest.approx(isav, rel=1e-12)
    assert 0.0 < lagging["drive_effort"][-1] < 0.1 * more


def turned(base, **turns):
    """Return the motion of a device whose drives are commanded to turn [rad] from rest, each tick, without a loop."""
    simulation = start(device(base, loop=HELD_DRIVES), control="position-only")
    rest = {drive: simulation.states[f"offset_{drive}"].copy() for drive in turns}

    def command(tick):
        for drive, turn in turns.items():
            simulation.states[f"offset_{drive}"][...] = rest[drive] + turn[tick]

    return record(simulation, min(map(len, turns.values())), before_tick=command)


def minimum_jerk(period, seconds):
    """Return the ticks' progress of 0 to 1."""
    progress = np.arange(1, round(seconds / period) + 1) * period / seconds
    return progress**3 * (10 - 15 * progress + 6 * progress**2)


@pytest.mark.parametrize("drives", [["biceps"], ["triceps"], ["biceps", "triceps"]], ids="-".join)
def test_effort_of_a_minimum_jerk_is_ten_sevenths_of_its_squared_amplitude_over_its_time(drives):
    amplitude, seconds = 0.6, 0.5
    path = amplitude * minimum_jerk(load_profile("simulation").loop.control_period, seconds)
    motion = turned("simulation", **dict.fromkeys(drives, path))
    expected = len(drives) * 10 / 7 * amplitude**2 / seconds
    assert motion["drive_effort"][-1] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("base", PROFILES)
def test_work_of_the_drives_is_the_energy_that_they_put_into_the_springs(base):
    """Both strings are tightened alike, so the arm rests; when they are loosened, the drives do no work."""
    profile, turn = load_profile(base), 0.5
    period = profile.loop.control_period
    path = turn * np.concatenate([minimum_jerk(period, 0.5), np.ones(round(1.0 / period))])
    path = np.concatenate([path, turn - path])
    motion = turned(base, biceps=path, triceps=-path)
    assert np.abs(motion["angle"]).max() < 1e-9
    tight = path.size // 2
    radius = profile.plant.drive_pulley_radius
    deflection = radius * np.linspace(motion["drive_biceps"][0], motion["drive_biceps"][tight], 2001)
    force = np.vectorize(reference.string_force(profile))(deflection)
    energy = 2 * np.sum((force[1:] + force[:-1]) / 2 * np.diff(deflection))
    assert motion["drive_work"][tight] == pytest.approx(energy, rel=1e-4)
    assert motion["drive_work"][-1] == pytest.approx(energy, rel=1e-4)


@pytest.mark.parametrize("base", PROFILES)
def test_kick_is_what_a_setpoint_step_alone_contributes(base):
    profile = load_profile(base)
    step = np.radians(45.0)
    motion = run(profile, {"moves": [{"time": 0.1, "angle_deg": 45.0}]}, 0.3)
    gains, period = profile.loop.position, profile.loop.control_period
    jump = gains.kd / (gains.derivative_filter + period) * step
    remains = gains.derivative_filter / (gains.derivative_filter + period)
    first = gains.kp * step + jump
    decay = (jump * (1.0 - remains)) ** 2 / (1.0 - remains**2)  # of a geometric series
    assert motion["isav_kick"][-1] == pytest.approx((first**2 + decay) / period, rel=1e-6)


@pytest.mark.parametrize("base", PROFILES)
def test_effort_is_isav_without_the_kick(base):
    """Without a feedback from the arm a step costs nothing but its kick; without a step, effort and ISAV are one."""
    profile = load_profile(base)
    gains, period = profile.loop.position, profile.loop.control_period
    moves = {"moves": [{"time": 0.1, "angle_deg": 45.0}]}
    motion = run(profile, moves, 0.1 + 40 * period)
    first = round(0.1 / period)
    derivative, kick = 0.0, []
    for jump in [np.radians(45.0)] + [0.0] * 39:
        after = (gains.derivative_filter * derivative + gains.kd * jump) / (gains.derivative_filter + period)
        kick.append(gains.kp * jump + after - derivative)
        derivative = after
    for drive in ("biceps", "triceps"):
        left = np.diff(motion[f"command_{drive}"])
        left[first:] -= kick
        assert motion[f"effort_{drive}"][-1] == pytest.approx(np.sum(left**2) / period, rel=1e-9)
        assert motion[f"effort_{drive}"][-1] < motion[f"isav_{drive}"][-1]
    pushed = run(profile, {"pushes": [{"time": 0.1, "duration": 0.1, "torque": 0.05}]}, 0.4)
    assert pushed["effort_triceps"][-1] == pushed["isav_triceps"][-1] > 0.0


def steps_by_hand(motion, moves):
    """Return start, first entry and last entry of each setpoint step, in s (NaN: never), and the largest overshoot."""
    time, angle = motion["time"], motion["angle"]
    starts = [np.flatnonzero(time >= move["time"] - 1e-9)[0] for move in moves]
    ends = [*starts[1:], len(motion)]
    overshoot, found = 0.0, []
    for move, first, end in zip(moves, starts, ends, strict=True):
        target, before = np.radians(move["angle_deg"]), motion["setpoint"][first - 1]
        if target == before:
            continue
        window = angle[first:end]
        outside = np.abs(window - target) > MARGIN
        overshoot = max(overshoot, np.max(np.sign(target - before) * (window - target)))
        rise = np.nan if outside.all() else np.argmin(outside) * motion.control_period
        last_outside = np.flatnonzero(outside)[-1] if outside.any() else -1
        settling = np.nan if outside[-1] else (last_outside + 1) * motion.control_period
        found.append((rise, settling))
    return np.array(found), overshoot


def test_rise_is_the_first_entry_and_settling_the_last(motion):
    found, overshoot = steps_by_hand(motion, STEPS["moves"])
    assert len(found) == motion["step_count"][-1] == 4
    rise, settling = found.T
    assert motion["rise_count"][-1] == np.isfinite(rise).sum()
    assert motion["rise_sum"][-1] == pytest.approx(np.nansum(rise), abs=1e-9)
    # The step in progress is open: the arm may leave again.
    closed, open_since = motion["settling_sum"][-1], motion["inside_since"][-1] - motion["step_start"][-1]
    assert motion["settling_count"][-1] + np.isfinite(open_since) == np.isfinite(settling).sum()
    assert closed + np.nan_to_num(open_since) == pytest.approx(np.nansum(settling), abs=1e-9)
    assert motion["overshoot"][-1] == pytest.approx(overshoot, rel=1e-12)


def test_a_move_to_where_the_setpoint_is_opens_no_step():
    moves = [{"time": 0.1, "angle_deg": 50.0}, {"time": 0.2, "angle_deg": 50.0}]
    motion = run(load_profile("simulation"), {"initial_angle_deg": 20.0, "moves": moves}, 0.3)
    assert motion["step_count"][-1] == 1


def test_a_step_cut_off_on_its_way_counts_as_not_reached():
    motion = run(load_profile("testbed"), STEPS, 4.0)
    assert motion["rise_count"][-1] < motion["step_count"][-1]


@pytest.mark.parametrize("base", PROFILES)
def test_contact_and_push_metrics_are_those_of_the_trajectory(base):
    motion = run(load_profile(base), {**BUSY, "pushes": [{"time": 0.8, "duration": 0.2, "torque": 0.3}]}, 1.5)
    torque = motion["contact_torque"][1:]
    assert np.abs(torque).max() > 0.01
    assert motion["contact_ise"][-1] == pytest.approx(np.sum(torque**2) * motion.control_period, rel=1e-11)
    assert motion["contact_peak"][-1] == np.abs(torque).max()
    pushed = motion["push_torque"][1:] != 0
    assert pushed.sum() == round(0.2 / motion.control_period)
    deflected = np.abs(motion["setpoint"][:-1] - motion["angle"][1:])
    assert motion["push_deflection"][-1] == deflected[pushed].max()


def test_resting_stiffness_is_the_strings_slopes_at_rest():
    profile = device()
    motion = run(profile, {"initial_tension": 8.0}, 0.2)
    tables = build_tables(profile.spring)
    expected = 2 * profile.plant.joint_pulley_radius**2 * tables.stiffness_at(tables.deflection_at(8.0))
    assert motion["resting_time"][-1] == pytest.approx(0.2)
    assert motion["resting_stiffness_sum"][-1] / 0.2 == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("suite", suite_names())
@pytest.mark.parametrize("base", PROFILES)
def test_metrics_of_every_suites_episode(base, suite):
    profile = load_profile(base)
    simulation = Simulation(profile, tension_law="eq6")
    simulation.reset(sample(suite, np.array([5], dtype=np.uint64), profile))
    motion = record(simulation, round(3.0 / simulation.control_period))
    counted = motion["time"][:-1] >= START - 1e-9
    before, after = (motion["setpoint"][:-1] - motion["angle"][rows] for rows in (slice(None, -1), slice(1, None)))
    expected = np.sum((before**2 + after**2)[counted]) * motion.control_period / 2
    assert expected > 0
    assert motion["position_ise"][-1] == pytest.approx(expected, rel=1e-11)
    effort = sum(np.sum(np.diff(motion[f"command_{drive}"])[counted] ** 2) for drive in ("biceps", "triceps"))
    reported = motion["isav_biceps"][-1] + motion["isav_triceps"][-1]
    assert reported == pytest.approx(effort / motion.control_period, rel=1e-11)


def test_nothing_counts_before_the_scenario_says_so():
    profile = load_profile("testbed")
    late = run(profile, {**STEPS, "measure_from": 0.8}, 2.3)
    full = run(profile, STEPS, 2.3)
    before = late["time"] <= 0.8 + 1e-9
    for name in SUMS:
        assert (late[name][before] == 0).all()
        np.testing.assert_allclose(late[name][-1], full[name][-1] - full[name][before][-1], rtol=1e-9)
        assert late[name][-1] > 0
    np.testing.assert_array_equal(late["angle"], full["angle"])


def test_contact_pushes_steps_and_switches_count_from_the_same_moment_on():
    """A scenario whose first half holds more of everything than its second, which alone is counted."""
    moves = [{"time": 0.1, "angle_deg": 40.0}, {"time": 0.8, "angle_deg": 34.0}]
    first = {"moves": moves, "pushes": [{"time": 0.4, "duration": 0.1, "torque": 0.3}]}
    second = {"moves": [{"time": 1.3, "angle_deg": 33.0}], "pushes": [{"time": 1.6, "duration": 0.1, "torque": 0.05}]}
    both = {key: first[key] + second[key] for key in first}
    obstacle = {"angle_deg": 32.0, "stiffness": 2.0, "damping": 0.02}
    scenario = {"initial_angle_deg": 10.0, "initial_tension": 8.0, "obstacle": obstacle, "noise_seed": 7, **both}
    full, late = (run(load_profile("testbed"), {**scenario, "measure_from": start}, 2.0) for start in (0.0, 1.2))
    np.testing.assert_array_equal(late["angle"], full["angle"])
    period, begin = late.control_period, round(1.2 / late.control_period)
    for name in METRICS:
        assert np.nan_to_num(late[name][: begin + 1]).max() == 0, name
    torque = late["contact_torque"][begin + 1 :]
    assert late["contact_ise"][-1] == pytest.approx(np.sum(torque**2) * period, rel=1e-9)
    assert late["contact_peak"][-1] == np.abs(torque).max() < full["contact_peak"][-1]
    pushed = late["push_torque"][begin + 1 :] != 0
    deflected = np.abs(late["setpoint"][begin:-1] - late["angle"][begin + 1 :])
    assert late["push_deflection"][-1] == deflected[pushed].max() < full["push_deflection"][-1]
    assert (late["step_count"][-1], full["step_count"][-1]) == (1, 3)
    switches = np.count_nonzero(np.diff(late["agonist"])[begin:])
    assert late["switch_count"][-1] == switches < full["switch_count"][-1]


def test_the_joint_rests_where_it_is_within_the_margin_of_a_standing_setpoint(motion):
    setpoint, error = motion["setpoint"], motion["setpoint"] - motion["angle"]
    rests = (np.abs(error[1:]) <= MARGIN) & (setpoint[1:] == setpoint[:-1])
    assert 0.1 < rests.mean() < 0.9
    assert ((np.abs(error[1:]) <= MARGIN) & ~rests).any()  # it is near a moving setpoint, too
    assert motion["resting_time"][-1] == pytest.approx(rests.sum() * motion.control_period)
    expected = motion["joint_stiffness"][1:][rests].sum() * motion.control_period
    assert motion["resting_stiffness_sum"][-1] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("base", PROFILES)
def test_a_late_control_tick_loses_no_setpoint_jump(base):
    step = {"moves": [{"time": 0.1, "angle_deg": 30.0}]}
    on_time, late = (
        run(load_profile(base), {**step, "noise_seed": seed, "device": {"late_probability": probability}}, 1.5)
        for seed, probability in ((0, 0.0), (1, 0.8))
    )
    held = np.diff(late["command_biceps"]) == 0
    assert held[np.flatnonzero(np.diff(late["setpoint"]))[0] + 1]  # the tick that would have seen it came too late
    assert late["isav_kick"][-1] == pytest.approx(on_time["isav_kick"][-1], rel=1e-6)


def test_a_reset_starts_all_metrics_from_nothing():
    profile = load_profile("testbed")
    simulation = start(profile, STEPS)
    first = record(simulation, 300)
    simulation.reset(pack(load_scenario(STEPS), profile))
    again = record(simulation, 300)
    for name in METRICS:
        assert again[name][0] == 0
        np.testing.assert_array_equal(first[name], again[name])
