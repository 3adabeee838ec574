"""What would make ticks or calls slow without changing a result: checked without a clock."""

import numpy as np
import pytest

from amulett_gym.profile import load_profile
from amulett_gym.simulation import layout
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.simulation.worn_layout import FITTING
from amulett_gym.tasks.suites import sample
from amulett_gym.tasks.worn_suites import sample_worn

KEYS = np.arange(16, dtype=np.uint64)
ENTRY = 20
"""Ticks between two looks."""


def subnormal(blocks):
    """Return the fields of records that hold a number other than 0 below the normal ones."""
    values = {name: blocks[name] for name in blocks.dtype.names if blocks[name].dtype == np.float64}
    least = np.finfo(np.float64).tiny
    return {name for name, numbers in values.items() if np.any((np.abs(numbers) < least) & (numbers != 0.0))}


def played(simulation):
    """Yield all records of an episode of 10 s."""
    for _ in range(int(10.0 / simulation.control_period) // ENTRY):
        simulation.advance(ENTRY)
        yield simulation.states
        if simulation.loop is not None:
            yield simulation.loop[1]


@pytest.mark.parametrize("control", ["decentralized", "position-only", *LOOPS])
@pytest.mark.parametrize("profile", ["testbed", "simulation"])
def test_no_state_decays_to_subnormal_numbers(profile, control):
    device = load_profile(profile)
    simulation = Simulation(device, KEYS.size, control, "eq6")
    simulation.reset(sample("steps", KEYS, device))
    assert set().union(*(subnormal(blocks) for blocks in played(simulation))) == set()


def test_no_state_of_a_wearer_decays_to_subnormal_numbers():
    device = load_profile("worn")
    simulation = WornSimulation(device, KEYS.size, "co-rotation")
    rows, wearers = sample_worn("assembly", KEYS, device)
    simulation.reset(rows, wearers=wearers)
    simulation.command_tension(6.0)
    found = (subnormal(blocks) | subnormal(simulation.worn[2]) for blocks in played(simulation))
    assert set().union(*found) == set()


@pytest.mark.parametrize("profiles", [["testbed"], ["testbed", "testbed"]])
def test_records_have_the_very_dtypes_for_which_the_kernel_is_compiled(profiles):
    devices = [load_profile(profile) for profile in profiles]
    plain, worn = Simulation(devices, 16, "co-rotation"), WornSimulation(devices, 16)
    assert plain.parameters.dtype is worn.parameters.dtype is layout.PARAMETERS
    assert plain.scenarios.dtype is layout.SCENARIO_BLOCK
    assert plain.states.dtype is layout.STATE_BLOCK
    assert plain.loop[0].dtype is layout.LOOP_PARAMETERS
    assert plain.loop[1].dtype is layout.LOOP_BLOCK
    assert worn.worn[0].dtype is FITTING
    rows, path = sample("reach", KEYS, devices[0]), np.zeros(2, dtype=layout.PATH)
    rows["move_count"][0] = layout.ON_PATH
    plain.reset(rows, paths=[path, *[path[:0]] * 15])
    assert plain.paths[0].dtype is layout.PATH
    assert plain.paths[1].dtype is layout.PLACE_BLOCK
