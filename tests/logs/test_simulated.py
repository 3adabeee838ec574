"""What is logged of a simulation is, to the last bit, what its controller read and sent."""

import numpy as np
import pytest
from helpers import device

from amulett_gym.logs import read_log, write_log
from amulett_gym.logs.simulated import log_of
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.suites import sample


def test_a_simulated_log_is_read_back_to_the_same_values(tmp_path):
    profile = device("testbed")
    simulation = Simulation(profile, 1, "decentralized", "eq6")
    simulation.reset(sample("mixed", np.array([3], dtype=np.uint64), profile))
    trajectory = record(simulation, 400)
    log = log_of(trajectory)
    assert np.array_equal(log["angle"], trajectory["measured_angle"][:-1])
    assert np.array_equal(log["command_biceps"], trajectory["command_biceps"][1:])
    assert log.period == pytest.approx(profile.loop.control_period) and not log.gaps.size
    for name, most in (("log.npz", 0.0), ("log.csv", 1e-11)):
        write_log(tmp_path / name, log)
        again = read_log(tmp_path / name)
        assert list(again.columns) == list(log.columns)
        for column, values in log.columns.items():
            np.testing.assert_allclose(again[column], values, rtol=most, err_msg=column)
