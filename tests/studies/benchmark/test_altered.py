"""Altered scenarios differ from the headline's in one thing."""

from dataclasses import replace

import numpy as np
import pytest

from amulett_gym.evaluation.runner import Protocol, play_alone
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.studies.benchmark import altered
from amulett_gym.studies.benchmark.altered import alter
from amulett_gym.tasks.scenario import pack, unpack

PROTOCOL = Protocol(load_profile("testbed"), "mixed", episodes=40, seed=3, duration=2.0)


def changed(change):
    """Return the ratio of each field of the packed scenarios that differs, and the fields that do not."""
    before = Trials(PROTOCOL).rows
    after = np.concatenate([pack(scenario, PROTOCOL.profile) for scenario in alter(PROTOCOL, change).scenarios])
    return {
        name: after[name] / before[name] for name in before.dtype.names if not np.array_equal(before[name], after[name])
    }


def test_unchanged_scenarios_are_the_suites_own():
    rows = Trials(PROTOCOL).rows
    again = np.concatenate([pack(unpack(row), PROTOCOL.profile) for row in rows])
    assert all(np.array_equal(rows[name], again[name]) for name in rows.dtype.names)


def test_noise_alone():
    ratios = changed("noise-x2")
    assert set(ratios) == {"noise_factor"}
    np.testing.assert_allclose(ratios["noise_factor"], 2.0, rtol=1e-6)


def test_wrong_parameters_alone():
    ratios = changed("wrong-parameters")
    own = {"spring_biceps_factor", "spring_triceps_factor", "damping_factor", "inertia_factor"}
    assert own <= set(ratios) <= own | {"friction", "inertia"}  # which follow
    for name in own:
        assert set(np.round(ratios[name].astype(np.float64), 5).tolist()) == {0.8, 1.2}
    np.testing.assert_array_equal(ratios["spring_biceps_factor"] > 1, ratios["spring_triceps_factor"] > 1)


@pytest.mark.parametrize(("change", "size", "none"), [("noise-x2", "NOISE", 1.0), ("wrong-parameters", "OFF", 0.0)])
def test_a_change_of_nothing_plays_to_the_same_bits(monkeypatch, change, size, none):
    few, eq6 = replace(PROTOCOL, episodes=16), parse_contender("eq6")
    usual = play_alone(few, eq6)
    monkeypatch.setattr(altered, size, none)
    again = play_alone(alter(few, change), eq6)
    for name, values in usual.values.items():
        np.testing.assert_array_equal(again.values[name], values, err_msg=name)
    assert again.families.tolist() == usual.families.tolist() and again.failures == usual.failures


def test_springs_are_not_so_weak_that_a_scenario_cannot_begin():
    full = replace(PROTOCOL, episodes=400, seed=0)  # in some, a weak spring, a weight and an obstacle load one string
    rows = np.concatenate([pack(scenario, full.profile) for scenario in alter(full, "wrong-parameters").scenarios])
    Simulation(full.profile, 400).reset(rows)
    assert 0.4 < (rows["spring_biceps_factor"] < 1.0).mean() < 0.6
