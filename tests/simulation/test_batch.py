"""A batch whose blocks of devices have different profiles."""

import numpy as np
import pytest
from helpers import device

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import LANES, LOOPS
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.suites import sample

PROFILES = (
    load_profile("testbed"),
    device(
        "simulation",
        plant={"joint_pulley_radius": 0.03, "masses": [{"mass": 0.4, "arm": 0.1}]},
        spring={"stiffness": 15000.0},
        loop={"control_period": 0.0005},
    ),
    device("testbed", drives={"lag": 0.05, "rate_limit_deg": 200.0}, sensors={"below_floor": "ignore"}),
)
WHICH = [2, 0, 1]
KEYS = np.arange(1, 2 * LANES + 4, dtype=np.uint64)
"""The last block is padded."""


def lanes_of(block: int) -> slice:
    return slice(block * LANES, min((block + 1) * LANES, KEYS.size))


def drawn(profile, block):
    return sample("mixed", KEYS[lanes_of(block)], profile)


def fleet(control: str = "decentralized", tension_law: str = "eq6") -> Simulation:
    simulation = Simulation(PROFILES, KEYS.size, control, tension_law)
    simulation.assign(np.arange(3), WHICH)
    simulation.reset(np.concatenate([drawn(PROFILES[which], block) for block, which in enumerate(WHICH)]))
    return simulation


@pytest.mark.parametrize("control", ["decentralized", "position-only", "torque", "minimal-motion"])
def test_devices_of_several_profiles_move_as_those_of_one(control):
    together = fleet(control)
    together.advance(700)
    for block, which in enumerate(WHICH):
        profile = PROFILES[which]
        alone = Simulation(profile, drawn(profile, block).size, control, "eq6")
        alone.reset(drawn(profile, block))
        alone.advance(700)
        lanes = alone.num_devices
        for name in together.states.dtype.names:
            found = together.states[name][block][..., :lanes]
            assert found.tobytes() == alone.states[name][0][..., :lanes].tobytes(), (name, profile.name)
        assert together.profile_of(block * LANES) is profile
        assert together.parameters_of(block * LANES)["control_period"] == profile.loop.control_period


def test_a_trajectory_has_the_device_s_own_period():
    simulation = fleet()
    found = record(simulation, 20, device=2 * LANES + 1)
    profile = PROFILES[WHICH[2]]
    assert (found.profile, found.control_period) == (profile.name, profile.loop.control_period)
    alone = Simulation(profile, 3, tension_law="eq6")
    alone.reset(drawn(profile, 2))
    again = record(alone, 20, device=1)
    np.testing.assert_array_equal(found["joint_stiffness"], again["joint_stiffness"])
    np.testing.assert_array_equal(found["time"], again["time"])


def test_a_snapshot_holds_the_devices():
    simulation = fleet("torque", "agent")
    simulation.advance(100)
    state = simulation.get_state()
    other = Simulation(PROFILES, KEYS.size, "torque")
    other.set_state(state)
    np.testing.assert_array_equal(other.which, WHICH)
    for each in (simulation, other):
        each.advance(100)
    assert other.states.tobytes() == simulation.states.tobytes()
    with pytest.raises(AmulettError, match="devices are testbed, simulation-test, testbed-test; those .* one profile"):
        Simulation(PROFILES[0], KEYS.size, "torque").set_state(state)


@pytest.mark.parametrize("control", ["decentralized", *LOOPS])
def test_a_block_forgets_the_profile_it_had(control):
    upright, lying = device("testbed", plant={"orientation": "vertical"}), PROFILES[0]
    used, new = (Simulation([lying, upright], LANES, control) for _ in range(2))
    used.assign(0, 1)
    used.reset(sample("steps", KEYS[:LANES], upright))
    used.advance(50)
    used.assign(0, 0)
    for each in (used, new):
        each.reset(sample("steps", KEYS[:LANES], lying))
        each.advance(200)
    assert used.states.tobytes() == new.states.tobytes()


def test_a_start_is_checked_by_the_device_s_own_springs():
    strong = sample("paper-step", KEYS, PROFILES[0])
    strong["initial_tension"] = 15.0
    weak = device("testbed", spring={"stiffness": 100.0})
    Simulation(PROFILES[0], KEYS.size).reset(strong)
    simulation = Simulation([PROFILES[0], weak], KEYS.size)
    simulation.reset(strong)
    simulation.assign(1, 1)
    with pytest.raises(AmulettError, match=f"scenario {LANES} starts with a string force of 15.00 N"):
        simulation.reset(strong)


def test_what_differs_is_asked_for_by_device():
    simulation = fleet()
    for name in ("profile", "control_period", "max_force", "max_stiffness"):
        with pytest.raises(AmulettError, match="the devices have 3 profiles"):
            getattr(simulation, name)
    with pytest.raises(AmulettError, match="indices are 3; allowed are 0 to 2"):
        simulation.assign(0, 3)
    with pytest.raises(AmulettError, match="there is no profile"):
        Simulation([])
