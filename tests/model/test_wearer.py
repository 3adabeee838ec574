"""The wearer's arm by closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.model.wearer import (
    activation_rate,
    excitations,
    forearm,
    muscle_damping,
    muscle_stiffness,
    muscle_torque,
)

activations = st.floats(0.0, 1.0)
factors = st.floats(0.2, 3.0)


def test_forearm_of_an_average_adult_is_that_of_the_literature() -> None:
    mass, centre, inertia = forearm(70.0, 1.75)
    # MyoHub/myo_sim: 1.534 kg, 0.1815 m, 0.0706 kg m2
    assert mass == pytest.approx(1.534, rel=0.01)
    assert centre == pytest.approx(0.1815, rel=0.05)
    assert inertia == pytest.approx(0.0706, rel=0.03)


@given(activations, activations, st.floats(-1.0, 1.0), factors, factors)
def test_stiffness_and_damping_are_the_torque_s_derivatives(
    flexor: float, extensor: float, angle: float, tone: float, strength: float
) -> None:
    h = 1e-4
    ahead, behind = (muscle_torque(flexor, extensor, angle + sign * h, 0.0, tone, strength) for sign in (1, -1))
    assert -(ahead - behind) / (2 * h) == pytest.approx(muscle_stiffness(flexor, extensor, tone, strength), rel=1e-6)
    moving, still = (muscle_torque(flexor, extensor, angle, speed, tone, strength) for speed in (1.0, 0.0))
    assert still - moving == pytest.approx(muscle_damping(flexor, extensor, tone, strength), rel=1e-6)


def test_stiffness_is_that_of_katayama_and_kawato() -> None:
    # k = 810.8 + 1621.6 u N/m at lever arms of 25 and 35 mm, two muscles with the same activation
    lever = 0.025**2 + 0.035**2
    for u in (0.0, 0.3, 1.0):
        assert muscle_stiffness(u, u, 1.0, 1.0) == pytest.approx(2 * lever * (810.8 + 1621.6 * u), rel=1e-3)
        assert muscle_damping(u, u, 1.0, 1.0) == pytest.approx(2 * lever * (54.1 + 108.1 * u), rel=1e-3)


def test_co_contraction_gives_no_torque_and_full_activation_the_full_one() -> None:
    assert muscle_torque(0.4, 0.4, 0.0, 0.0, 0.7, 1.5) == 0.0
    assert muscle_torque(1.0, 0.0, 0.0, 0.0, 1.0, 1.0) == pytest.approx(1.5 * 3.0 * 0.87)


@given(st.floats(0.0, 0.5), st.floats(-1.0, 1.0), factors, factors)
def test_excitations_give_the_torque_asked_for(habit: float, share: float, tone: float, strength: float) -> None:
    torque = share * muscle_torque(1.0, 0.0, 0.0, 0.0, tone, strength)
    flexor, extensor = excitations(torque, habit, tone, strength)
    assert muscle_torque(flexor, extensor, 0.0, 0.0, tone, strength) == pytest.approx(torque, abs=1e-9)
    assert min(flexor, extensor) == 0.0 or flexor + extensor == pytest.approx(2 * habit)


def test_activation_rises_faster_than_it_falls() -> None:
    assert activation_rate(0.0, 1.0) == pytest.approx(1 / 0.025)
    assert activation_rate(1.0, 0.0) == pytest.approx(-1 / 0.045)
    assert activation_rate(0.3, 0.3) == 0.0


def test_excitations_stay_within_their_range() -> None:
    for torque in (-100.0, 100.0, np.inf, -np.inf):
        assert all(0.0 <= each <= 1.0 for each in excitations(torque, 0.1, 1.0, 1.0))
