"""A replay of logged inputs is the simulation that wrote them."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import LANES
from amulett_gym.simulation.replay import (
    OUTPUTS,
    replay_commands,
    replay_setpoints,
    start_at_commands,
    start_in_balance,
)
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import load_scenario, pack

STALL = {"base": "testbed", "spring": {"beyond": "continued"}, "drives": {"stall_torque": 0.3}, "name": "stalls"}
TICKS = 300


@pytest.fixture(scope="module", params=["testbed", STALL], ids=["plain", "extended"])
def recorded(request):
    profile = load_profile(request.param)
    moves = [{"time": 0.1, "angle_deg": 30.0}, {"time": 0.4, "angle_deg": -20.0}]
    scenario = pack(load_scenario({"moves": moves, "noise_seed": 7}), profile)
    simulation = Simulation(profile)
    simulation.reset(scenario)
    trajectory = record(simulation, TICKS, before_tick=lambda tick: simulation.command_tension(8.0 + 4.0 * (tick > 99)))
    return profile, np.repeat(scenario, 2 * LANES), trajectory


def lanes(values):
    """Return a signal as the inputs of two sets, all lanes alike."""
    return np.tile(values[None, :, None], (2, 1, LANES))


def expected(trajectory):
    return np.stack([trajectory[name][:-1] for name in OUTPUTS], axis=-1)


def test_logged_commands_give_the_same_readings(recorded):
    profile, scenarios, trajectory = recorded
    simulation = Simulation(profile, 2 * LANES)
    start = [np.full(2 * LANES, trajectory[name][0]) for name in ("angle", "drive_biceps", "drive_triceps")]
    start_at_commands(simulation, scenarios, *start)
    commands = [lanes(trajectory[name][1:]) for name in ("command_biceps", "command_triceps")]
    found = replay_commands(simulation, *commands, np.array([1, 0]))
    assert found.shape == (2, TICKS, LANES, len(OUTPUTS))
    sensed = found[..., :3]
    assert np.array_equal(sensed[:, 1:], np.broadcast_to(expected(trajectory)[1:, None, :3], sensed[:, 1:].shape))


def test_logged_setpoints_give_the_same_readings(recorded):
    profile, scenarios, trajectory = recorded
    simulation = Simulation(profile, 2 * LANES)
    start_in_balance(simulation, scenarios)
    inputs = lanes(trajectory["setpoint"][:-1]), lanes(trajectory["tension_setpoint"][1:])
    found = replay_setpoints(simulation, *inputs, np.array([0, 1]))
    assert np.array_equal(found, np.broadcast_to(expected(trajectory)[:, None], found.shape))


def test_each_block_has_the_inputs_chosen_for_it(recorded):
    profile, scenarios, trajectory = recorded
    simulation = Simulation(profile, 2 * LANES)
    biceps, triceps = (lanes(trajectory[name][1:]) for name in ("command_biceps", "command_triceps"))
    biceps[1] += 0.5
    found = []
    for chosen in ([0, 1], [1, 0]):
        start_at_commands(simulation, scenarios, *np.zeros((3, 2 * LANES)))
        found.append(replay_commands(simulation, biceps, triceps, np.array(chosen)))
    assert np.array_equal(found[0], found[1][::-1])
    assert np.abs(found[0][0] - found[0][1])[-1, :, 0].min() > 0.01


def test_the_joint_is_led_at_first(recorded):
    profile, scenarios, trajectory = recorded
    simulation = Simulation(profile, 2 * LANES)
    start_at_commands(simulation, scenarios, *np.zeros((3, 2 * LANES)))
    commands = [lanes(trajectory[name][1:]) for name in ("command_biceps", "command_triceps")]
    joint = [lanes(trajectory[name][:200]) for name in ("angle", "velocity")]
    found = replay_commands(simulation, *commands, np.array([0, 1]), joint)
    wanted = np.broadcast_to(expected(trajectory)[:, None], found.shape)
    # Sensors are read before the joint is set; the drives, which began elsewhere, follow within their lag.
    assert np.abs(found - wanted)[:, 1:200, :, 0].max() < np.radians(0.5)
    assert np.abs(found - wanted)[:, 200, :, 0].max() < np.radians(0.1)


def test_part_of_a_block_is_refused(recorded):
    profile, _, _ = recorded
    with pytest.raises(AmulettError, match="num_devices is 3; a replay needs whole blocks of 8"):
        replay_commands(Simulation(profile, 3), *np.zeros((2, 1, 1, LANES)), np.zeros(1, dtype=int))
