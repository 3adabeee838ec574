"""The figure of contenders' responses shows all of every curve, whoever moves farthest."""

import numpy as np

from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.motion_plots import step_response_figure
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.profile import load_profile

CONTENDERS = ("position-only", "constant:5")


def test_no_curve_leaves_its_panel():
    protocol = Protocol(load_profile("testbed"), suite="hold-push")
    trajectories = {name: record_episode(name, protocol).trajectory for name in CONTENDERS}
    angles = [trajectory["angle"] for trajectory in trajectories.values()]
    assert np.ptp(angles[1]) > 1.5 * np.ptp(angles[0])  # the first panel alone has no room for the second curve
    figure = step_response_figure(trajectories)
    for panel in figure.axes:
        low, high = panel.get_ylim()
        for line in panel.lines:
            assert low <= np.nanmin(line.get_ydata()) and np.nanmax(line.get_ydata()) <= high
