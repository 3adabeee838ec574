"""Logs of hidden devices: simulated, with noise and quantisation, at a coarse control period to save time."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.fleet import load_fleet
from amulett_gym.identification.from_logs.recording import Recording
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import Scenario, pack, pack_path

COARSE = {"loop": {"control_period": 0.01}}


def simulate_log(device, duration=16.0, seed=0, payload=None, name="steps.csv", every=1.6):
    """Return what a device logs of steps at several tensions."""
    rng = np.random.default_rng(seed)
    count = int(duration / every)
    moves = [{"time": 0.5 + every * k, "angle_deg": float(each)} for k, each in enumerate(rng.uniform(-40, 40, count))]
    scenario = Scenario(moves=moves, noise_seed=seed, payload=payload)
    simulation, path = Simulation(device), pack_path(scenario)
    simulation.reset(pack(scenario, device), paths=[path] if path.size else None)
    ticks = round(duration / device.loop.control_period)
    tension = np.repeat([8.0, 14.0, 6.0, 11.0], -(-ticks // 4))
    moved = record(simulation, ticks, before_tick=lambda tick: simulation.command_tension(tension[tick]))
    columns = {"time": moved["time"][:-1], "setpoint": moved["setpoint"][:-1], "angle": moved["measured_angle"][:-1]}
    columns |= {f"slider_{side}": moved[f"measured_{side}"][:-1] for side in ("biceps", "triceps")}
    columns |= {f"force_{side}": moved[f"estimate_{side}"][:-1] for side in ("biceps", "triceps")}
    columns |= {name: moved[name][1:] for name in ("command_biceps", "command_triceps", "tension_setpoint")}
    return Recording(name, columns, payload)


@pytest.fixture(scope="session")
def base():
    return load_profile({"base": "testbed", "name": "coarse", **COARSE})


@pytest.fixture(scope="session")
def fleet():
    return load_fleet("plausible")[:12]


@pytest.fixture(scope="session")
def hidden(base):
    """Return a plausible device that is not in the fleet, with the coarse loop."""
    device = load_fleet("plausible-held-out")[0]
    return device.model_copy(update={"name": "hidden", "loop": base.loop})


@pytest.fixture(scope="session")
def log(hidden):
    return simulate_log(hidden)
