"""Direct commands of both drives: closed forms."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulett_gym.control.drives import co_contraction, drive_commands

ANGLES = st.floats(-10.0, 10.0)


@given(ANGLES, st.floats(0.0, 0.02), st.floats(0.005, 0.1))
def test_the_commands_have_the_mean_and_the_co_contraction(mean, deflection, radius):
    biceps, triceps = drive_commands(mean, deflection, radius)
    assert 0.5 * (biceps + triceps) == pytest.approx(mean, abs=1e-12)
    assert co_contraction(biceps, triceps, radius) == pytest.approx(deflection, abs=1e-14)


def test_golden_co_contraction_of_the_testbed():
    biceps, triceps = drive_commands(0.0, 4.612e-3, 4.612e-3 / math.radians(18.98))  # 10 N
    assert math.degrees(biceps) == -math.degrees(triceps) == pytest.approx(18.98)


@given(ANGLES, st.floats(0.0, 0.02))
def test_flexion_and_extension_are_mirrored(mean, deflection):
    biceps, triceps = drive_commands(mean, deflection, 0.02)
    assert drive_commands(-mean, deflection, 0.02) == (-triceps, -biceps)
