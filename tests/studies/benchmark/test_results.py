"""Numbers of a benchmark: what is computed of the played episodes."""

from types import SimpleNamespace

import numpy as np

from amulett_gym.evaluation.statistics import draw_nested
from amulett_gym.studies.benchmark.results import _settling


def test_a_step_that_did_not_settle_counts_as_long_as_an_episode():
    evidence = SimpleNamespace(description=SimpleNamespace(duration=10.0))
    values = {
        "settling_time": np.array([[1.0, np.nan, 2.0, np.nan]]),
        "setpoint_steps": np.array([[1.0, 1.0, 2.0, 0.0]]),
        "steps_settled": np.array([[1.0, 0.0, 1.0, 0.0]]),
    }
    found = _settling(evidence, values, draw_nested(1, 4, 100))
    assert (found["settled"], found["steps"]) == (2, 4)
    assert found["time"]["mean"] == (1.0 + 10.0 + (2.0 + 10.0) / 2) / 3  # the last scenario has no step
    none = _settling(evidence, {**values, "steps_settled": np.zeros((1, 4))}, draw_nested(1, 4, 100))
    assert none["time"]["mean"] == 10.0 and none["settled"] == 0
