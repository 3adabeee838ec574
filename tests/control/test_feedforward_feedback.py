"""The PID of the stiffness."""

from __future__ import annotations

from amulett_gym.control.feedforward_feedback import opening


def test_drives_open_where_the_joint_is_too_soft():
    assert opening(2.0, 0.0, 0.0, 0.01, 0.0) == 0.02
    assert opening(-2.0, 5.0, 0.3, 0.01, 0.1) == -0.02 + 0.3 + 0.5
