"""The Bowden cable against the capstan equation."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.model.cable import next_loss, sliding_loss

bends = st.floats(0.0, 2.0)


@given(bends)
def test_sliding_tension_is_that_of_the_capstan(bend: float) -> None:
    assert 1.0 - sliding_loss(bend, True) == pytest.approx(math.exp(-bend))
    assert 1.0 - sliding_loss(bend, False) == pytest.approx(math.exp(bend))


@given(bends, st.lists(st.floats(-1e-2, 1e-2), max_size=20))
def test_loss_stays_within_that_of_sliding(bend: float, ways: list[float]) -> None:
    loss = 0.0
    for way in ways:
        loss = next_loss(loss, bend, way, 3e-4)
        assert sliding_loss(bend, False) - 1e-12 <= loss <= sliding_loss(bend, True) + 1e-12


def test_string_that_rests_sticks() -> None:
    loss = next_loss(0.0, 0.5, 1e-4, 3e-4)
    assert next_loss(loss, 0.5, 0.0, 3e-4) == loss


def test_steps_of_one_direction_add_up() -> None:
    whole = next_loss(-0.2, 0.6, 5e-4, 3e-4)
    parts = -0.2
    for _ in range(10):
        parts = next_loss(parts, 0.6, 5e-5, 3e-4)
    assert parts == pytest.approx(whole, rel=1e-12)


def test_long_ways_slide() -> None:
    assert next_loss(0.0, 0.6, 1.0, 3e-4) == sliding_loss(0.6, True)
    assert next_loss(0.0, 0.6, -1.0, 3e-4) == sliding_loss(0.6, False)
    assert next_loss(0.3, 0.0, 1.0, 3e-4) == 0.0
