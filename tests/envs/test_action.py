"""The action and the tension that it means are one map, the same bits in NumPy and in compiled code."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.envs.action import (
    TENSION_RANGE,
    action_of,
    action_to_tension,
    compiled_action_of,
    compiled_tension_of,
    tension_of,
    tension_to_action,
)

BOUNDS = st.tuples(st.floats(0.1, 100.0), st.floats(0.1, 100.0)).map(lambda two: (two[0], two[0] + two[1]))


def test_the_ends_and_the_middle_are_where_they_should_be():
    assert action_to_tension([-1.0, 0.0, 1.0], TENSION_RANGE).tolist() == [4.0, 9.5, 15.0]
    assert tension_to_action([4.0, 9.5, 15.0, 26.0], TENSION_RANGE).tolist() == [-1.0, 0.0, 1.0, 3.0]


@given(st.floats(-1.0, 1.0), BOUNDS)
def test_compiled_and_plain_give_the_same_bits_and_there_and_back_is_the_same_action(action, bounds):
    tension = tension_of(action, *bounds)
    assert compiled_tension_of(action, *bounds) == tension == action_to_tension(action, bounds)
    assert compiled_action_of(tension, *bounds) == action_of(tension, *bounds) == tension_to_action(tension, bounds)
    assert action_of(tension, *bounds) == pytest.approx(action, abs=1e-9 * bounds[1] / (bounds[1] - bounds[0]))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_arrays_keep_their_type_and_the_converters_compute_in_float64(kind):
    actions = np.linspace(-1.0, 1.0, 7, dtype=kind)
    assert tension_of(actions, *TENSION_RANGE).dtype == action_of(actions, *TENSION_RANGE).dtype == kind
    expected = 4.0 + 5.5 * (actions.astype(np.float64) + 1.0)
    np.testing.assert_allclose(action_to_tension(actions, TENSION_RANGE), expected, rtol=1e-15)
