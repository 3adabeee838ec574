"""The optimal reference for full control: its own model agrees with the simulation, limits, causality, results kept."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import CONTROL_TERMS, control_prices
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search import optimal as module
from amulett_gym.evaluation.search.optimal import Options, optimal_costs, optimise, read_course
from amulett_gym.evaluation.search.transcription import grid, spring_polynomial
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.tasks.scenario import Scenario, pack

TESTBED = load_profile("testbed")
ONE_START = Options(starts=((0.25, 0.45),))
STEP = {"moves": [{"time": 0.2, "angle_deg": 25.0}], "noise_seed": 1}
PRICES = control_prices(TESTBED, "steps")[0]


@pytest.fixture(autouse=True)
def needs_casadi(request):
    if "without_casadi" not in request.node.name:
        pytest.importorskip("casadi", reason="casadi (the extra 'optimal') is missing")


def row_of(profile=TESTBED, **content):
    return pack(Scenario.model_validate({**STEP, **content}), profile)[0]


def found_in(profile=TESTBED, ticks=320, options=ONE_START, prices=PRICES, **content):
    return optimise(profile, row_of(profile, **content), prices, ticks, options)


@pytest.fixture(scope="module")
def found():
    return found_in()


def test_the_polynomial_is_the_springs_table_without_casadi():
    for name in ("testbed", "simulation"):
        tables = build_tables(load_profile(name).spring)
        coefficients, error = spring_polynomial(tables)
        share = 0.613
        force = share * np.polynomial.polynomial.polyval(share, coefficients)
        assert force == pytest.approx(tables.force_at(share * tables.max_deflection), abs=1e-4)
        assert error < 1e-4


def test_intervals_begin_at_all_breaks_without_casadi():
    assert grid([0, 10, 13], 4).tolist() == [0, 4, 8, 10, 13]


def test_without_casadi_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(AmulettError, match=r"CasADi: pip install .*\[optimal\]"):
        optimal_costs(scenarios=[0])


CASES = {
    "step": {},
    "turning back": {"moves": [{"time": 0.1, "angle_deg": 40.0}, {"time": 0.303, "angle_deg": 10.0}]},
    "push and shake": {
        "moves": [],
        "pushes": [{"time": 0.2, "duration": 0.2, "torque": 0.2}],
        "shake": {"rms": 0.05, "bandwidth": 3.0, "duration": 5.0},
    },
    "contact": {
        "moves": [{"time": 0.1, "angle_deg": 30.0, "duration": 0.4}],
        "obstacle": {"angle_deg": 20.0, "stiffness": 15.0, "damping": 0.05},
    },
    "payload on another device": {
        "moves": [{"time": 0.1, "angle_deg": 30.0, "duration": 0.5}],
        "orientation": "vertical",
        "payload": {"mass": 0.05, "arm": 0.2},
        "device": {"spring_biceps": 0.9, "spring_triceps": 1.1, "pulley_biceps": 1.02, "inertia": 1.1, "damping": 0.8},
    },
}


@pytest.mark.parametrize("case", CASES)
def test_predicted_costs_are_those_of_the_independent_simulation(case):
    """Within 1 % of the cost: integration steps of 5 ms and rounded kinks in the one, 1 ms and none in the other."""
    prices = PRICES
    if case == "contact":  # it and effort cost little, so that the arm presses
        prices = control_prices(TESTBED, "contact")[0] * [1.0, 0.05, 0.01]
    result = found_in(prices=prices, **CASES[case])
    assert result.success
    assert prices @ result.predicted > 1e-6
    assert prices @ result.predicted == pytest.approx(prices @ result.played, rel=0.01)
    if case == "contact":
        assert result.played[2] > 0.01
        assert result.predicted[2] == pytest.approx(result.played[2], rel=0.03)


def test_ideal_drives_follow_lines_to_their_commands():
    profile = load_profile("simulation")
    prices = control_prices(load_profile("testbed"), "steps")[0]  # not those of a loop that jumps
    result = found_in(profile, 600, prices=prices)
    assert result.success
    np.testing.assert_allclose(result.predicted, result.played, rtol=0.01)


@pytest.mark.slow
def test_half_the_interval_changes_the_cost_by_less_than_a_thousandth():
    """With all starts: one alone may find another local optimum."""
    coarse, fine = (found_in(options=Options(interval=interval)) for interval in (0.02, 0.01))
    assert PRICES @ fine.played == pytest.approx(PRICES @ coarse.played, rel=1e-3)
    assert PRICES @ fine.played < PRICES @ coarse.played  # more freedom


def test_slow_motion_costs_what_the_closed_form_says():
    """A quasi-static arm, x = r (e1 + e2) / 2, is a linear problem: from a step D on it costs sqrt(p q) tanh(H/T) D^2.

    p and q are the costs per deg2 s of error and per deg2/s of the joint's rate, T = sqrt(q/p), H the time left.
    """
    prices, left = PRICES * [1.0, 20.0, 1.0], 0.6
    plant = TESTBED.plant
    p, q = prices[0], 2.0 * prices[1] * (plant.joint_pulley_radius / plant.drive_pulley_radius) ** 2
    closed_form = np.sqrt(p * q) * np.tanh(left * np.sqrt(p / q)) * 25.0**2
    assert prices @ found_in(prices=prices).played == pytest.approx(closed_form, rel=0.005)


def test_changes_of_its_commands_do_not_lower_the_cost(found):
    row = row_of()
    course, rng = read_course(TESTBED, row, 320), np.random.default_rng(0)
    best = PRICES @ found.played
    for _ in range(4):
        changes = np.repeat(rng.normal(scale=0.02, size=(40, 2)), 8, axis=0)  # in the intervals of 8 ticks
        changes[:80] = 0.0  # before the jump they would anticipate it
        changed, _ = module.play(TESTBED, row, course, found.commands + changes)
        assert PRICES @ changed > best


@pytest.mark.slow
def test_its_cost_is_at_most_that_of_equilibrium_point_control():
    """On the paper's step, with any co-contraction of 6 to 14 N."""
    row = Trials(Protocol(TESTBED, "paper-step", episodes=1, duration=2.0)).rows[0]
    prices = control_prices(TESTBED, "paper-step")[int(row["family"])]
    result = optimise(TESTBED, row, prices, 800)
    assert result.success
    tensions = np.arange(6.0, 15.0, 2.0)
    simulation = Simulation(TESTBED, tensions.size, "equilibrium-point")
    simulation.reset(np.repeat(row, tensions.size))
    simulation.command_tension(tensions)
    simulation.advance(800)
    raw = np.array([simulation.read(name) for name in ("position_ise", "drive_effort", "contact_ise")])
    costs = prices @ (raw * np.degrees(1.0) ** 2)
    assert prices @ result.played < costs.min()


def test_drives_stay_within_their_limits(found):
    limits = {"rate_limit_deg": 250.0, "command_limit_deg": 150.0}
    profile = load_profile({"name": "slow", "base": "testbed", "drives": limits})
    cheap = PRICES * [1.0, 1e-3, 1.0]  # effort costs little, so that the limits matter
    slow, fast = (found_in(device, prices=cheap) for device in (profile, TESTBED))
    assert slow.success
    assert np.abs(np.degrees(slow.commands)).max() <= 150.0 + 1e-6 < np.abs(np.degrees(fast.commands)).max()
    np.testing.assert_allclose(slow.predicted, slow.played, rtol=0.01)
    effort_at_limit = 2 * 250.0**2 * 0.6  # both drives, in the 0.6 s since the begin
    assert slow.played[1] < effort_at_limit < fast.played[1]
    assert slow.played[0] > fast.played[0]


def test_commands_before_a_jump_do_not_depend_on_it(found):
    jump = 80  # 0.2 s
    other = found_in(moves=[{"time": 0.2, "angle_deg": -10.0}])
    np.testing.assert_array_equal(other.commands[:jump], found.commands[:jump])
    assert (other.commands[jump] != found.commands[jump]).all()


def test_with_anticipation_the_arm_moves_before_the_jump_and_costs_less(found):
    early = found_in(options=replace(ONE_START, causal=False))
    assert PRICES @ early.played < 0.8 * PRICES @ found.played
    assert np.abs(early.commands[79] - found.commands[79]).max() > np.radians(10.0)


def test_ticks_before_measure_from_do_not_count():
    result = found_in(measure_from=0.4)
    whole = found_in()
    assert result.played[0] < 0.9 * whole.played[0]
    np.testing.assert_array_equal(result.commands[:80], whole.commands[:80])


def test_a_sampled_setpoint_is_refused():
    scenario = Scenario.model_validate({"setpoint": {"time": [0.0, 1.0], "angle_deg": [0.0, 10.0]}})
    with pytest.raises(AmulettError, match="sampled setpoint"):
        read_course(TESTBED, pack(scenario, TESTBED)[0], 10)


def test_a_device_that_the_model_does_not_know_is_refused():
    for changes in ({"spring": {"beyond": "continued"}}, {"drives": {"stall_torque": 0.3}}, {"structure": {}}):
        device = load_profile({"name": "mine", "base": "testbed", **changes})
        with pytest.raises(AmulettError, match="the optimal control of 'mine' cannot be computed"):
            optimise(device, pack(Scenario(), device)[0], PRICES, 10)


def test_results_are_kept_and_used_again(tmp_path, monkeypatch):
    arguments = {"suite": "mixed", "scenarios": [3, 4], "folder": tmp_path, "duration": 0.7, "options": ONE_START}
    notes = []
    first = optimal_costs(**arguments, report=notes.append)
    assert [note.split(":")[0] for note in notes] == ["scenario 3", "scenario 4"]
    assert list(first.terms) == list(CONTROL_TERMS)
    assert first.success.all()
    np.testing.assert_allclose(first.predicted_cost, first.cost, rtol=0.05)
    families = [int(Trials(Protocol(TESTBED, "mixed", episodes=1, seed=k)).rows[0]["family"]) for k in (3, 4)]
    prices = control_prices(TESTBED, "mixed")[families]
    np.testing.assert_allclose(first.cost, (prices * np.array(list(first.terms.values())).T).sum(axis=1))
    monkeypatch.setattr(module, "optimise", lambda *arguments: pytest.fail("it is searched again"))
    again = optimal_costs(**arguments)
    np.testing.assert_array_equal(again.cost, first.cost)
    monkeypatch.setattr(module, "optimise", lambda *arguments: (_ for _ in ()).throw(InterruptedError))
    with pytest.raises(InterruptedError):  # other options, other results
        optimal_costs(**{**arguments, "options": replace(ONE_START, interval=0.025)})
