"""The walk covers the parameter sets that are as good as the best, and these say what is determined."""

import numpy as np
import pytest

from amulett_gym.identification.ensemble import ensemble, spread
from amulett_gym.identification.parameters import OWN, PARAMETERS, pack, searched, unpack


def outside_box(vector):
    return float(np.abs(vector - 0.5).max() > 0.2)


def test_the_walk_covers_what_is_as_good_evenly():
    """Without the stretch move's factor of the dimension the walkers would drift outwards or contract."""
    begin = 0.5 + 0.15 * np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(PARAMETERS)))
    members = ensemble(outside_box, 1, begin, limit=0.5, walkers=60, steps=150)
    places = np.array([pack(member) for member in members])
    continuous = [k for k, free in enumerate(PARAMETERS) if not free.choices]
    late = places[len(places) // 2 :, continuous]
    assert np.abs(places - 0.5).max() <= 0.2 + 0.5 / 5  # `choices` are rounded to the middle of theirs
    assert late.mean() == pytest.approx(0.5, abs=0.02)
    assert late.std() == pytest.approx(0.2 / np.sqrt(3.0), rel=0.1)


def test_the_own_parameter_of_an_end_of_the_springs_curve_is_walked_too():
    free = searched("hard-stop")
    begin = np.random.default_rng(0).uniform(0.3, 0.7, (20, len(free)))
    members = ensemble(lambda vector: 0.0, 1, begin, limit=1.0, walkers=20, steps=3, parameters=free)
    assert len({member["stop_stiffness"] for member in members}) > 20
    low, high, _ = spread(members)["stop_stiffness"]
    assert OWN["hard-stop"].low <= low < high <= OWN["hard-stop"].high


def test_the_last_places_of_the_walkers_are_spread_over_what_is_as_good():
    """From walkers close together, as the last generation of a search is."""
    free = searched(loop=False)
    begin = 0.5 + 0.02 * np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(free)))
    found = {"limit": 0.5, "walkers": 60, "steps": 100, "parameters": free}
    last, every = (ensemble(outside_box, 1, begin, **found, last=only) for only in (True, False))
    assert len(last) == 60 and all(member in every for member in last)
    places = np.array([pack(member) for member in last])
    assert places.shape == (60, len(free)) and np.abs(places - 0.5).max() <= 0.2 + 1e-9
    assert places.std() == pytest.approx(0.2 / np.sqrt(3.0), rel=0.1)


def test_no_walk_begins_where_the_cost_is_too_high():
    assert ensemble(outside_box, 1, np.full((5, len(PARAMETERS)), 0.9), limit=0.5, walkers=5, steps=2) == []


def test_a_parameter_is_determined_if_the_sets_are_close_together_and_away_from_the_bounds():
    middle = np.full(len(PARAMETERS), 0.5)
    begin, end = middle.copy(), middle.copy()
    names = [free.name for free in PARAMETERS]
    for name, low, high in (
        ("inertia", 0.4, 0.6),  # close together
        ("radius_ratio", 0.3, 0.6),  # not close
        ("max_force", 0.0, 0.1),  # close, but at the lower bound
        ("max_deflection", 0.9, 1.0),  # and at the upper one
    ):
        begin[names.index(name)], end[names.index(name)] = low, high
    found = spread([unpack(begin), unpack(middle), unpack(end)])
    assert [found[name][2] for name in names[:5]] == [True, False, False, False, True]
    assert found["inertia"][:2] == pytest.approx((unpack(begin)["inertia"], unpack(end)["inertia"]), rel=5e-3)
