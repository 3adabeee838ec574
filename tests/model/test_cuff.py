"""The cuff between joint and elbow."""

from __future__ import annotations

import pytest

from amulett_gym.model.cuff import cuff_torque


def test_tight_cuff_is_a_spring_and_a_damper() -> None:
    assert cuff_torque(0.1, 0.5, 80.0, 2.0, 0.0) == pytest.approx(80.0 * 0.1 + 2.0 * 0.5)
    assert cuff_torque(-0.1, -0.5, 80.0, 2.0, 0.0) == -cuff_torque(0.1, 0.5, 80.0, 2.0, 0.0)


def test_loose_cuff_has_play() -> None:
    assert cuff_torque(0.049, 3.0, 80.0, 2.0, 0.1) == 0.0
    assert cuff_torque(0.15, 0.0, 80.0, 2.0, 0.1) == pytest.approx(80.0 * 0.1)
    assert cuff_torque(-0.15, 0.0, 80.0, 2.0, 0.1) == pytest.approx(-80.0 * 0.1)


def test_padding_pushes_and_never_pulls() -> None:
    assert cuff_torque(0.06, -10.0, 80.0, 2.0, 0.1) == 0.0
    assert cuff_torque(-0.06, 10.0, 80.0, 2.0, 0.1) == 0.0
