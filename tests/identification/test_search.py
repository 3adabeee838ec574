"""The search finds the least cost, the same way every time."""

import numpy as np
import pytest

from amulett_gym.identification.parameters import OWN, PARAMETERS, pack, searched, unpack
from amulett_gym.identification.search import search

GOAL = np.linspace(0.2, 0.8, len(PARAMETERS))


def bowl(vector):
    return float(np.sum((vector - GOAL) ** 2))


def test_the_least_cost_is_found():
    found = search(bowl, 1, generations=150, population=40)
    assert found.cost < 0.01
    continuous = [k for k, free in enumerate(PARAMETERS) if not free.choices]
    assert pack(found.parameters)[continuous] == pytest.approx(GOAL[continuous], abs=0.1)
    assert found.population.shape == (40, len(PARAMETERS))


def test_a_seed_gives_the_same_search_and_another_one_a_different():
    first, again, other = (search(bowl, seed, generations=2, population=6) for seed in (1, 1, 2))
    assert (first.cost, first.parameters) == (again.cost, again.parameters)
    np.testing.assert_array_equal(first.population, again.population)
    assert other.parameters != first.parameters


def test_other_parameters_can_be_searched():
    free = searched("stall")
    found = search(lambda vector: abs(vector[-1] - 0.7), 1, generations=12, population=20, parameters=free)
    assert found.population.shape == (20, len(PARAMETERS) + 1)
    assert found.parameters["stall_torque"] == pytest.approx(OWN["stall"].value(0.7), rel=0.1)


def test_what_is_fixed_stays_and_a_population_is_where_the_search_begins():
    fixed = unpack(np.full(len(PARAMETERS), 0.3))
    kept = {name: fixed[name] for name in ("inertia", "testbed.lag")}
    begin = np.random.default_rng(0).uniform(0.4, 0.6, (8, len(PARAMETERS)))
    found = search(bowl, 1, generations=0, population=begin, fixed=kept)
    assert {name: found.parameters[name] for name in kept} == pytest.approx(kept)
    names = [free.name for free in PARAMETERS]
    free = [k for k, name in enumerate(names) if name not in kept]
    assert np.sort(found.population[:, free], axis=0) == pytest.approx(np.sort(begin[:, free], axis=0))
