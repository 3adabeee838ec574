"""With the simulation's readings, the firmware's controller commands what the simulation's own loop does."""

import numpy as np
import pytest
from helpers import device

from amulett_gym.firmware.readme import begin_record, compare

LAWS = ("constant:10", "eq6", "eq6-printed", "eq6-held", "eq6-held-printed", "eq6-tuned", "position-only", "parametric")

MEASURED = {"kp": 0.11, "ki": 5.8, "kd": 0.0137, "derivative_filter": 0.0016, "derivative_on": "measurement"}
OTHER_LOOPS = {
    "hold": {"sensors": {"below_floor": "hold"}},
    "ignore": {"sensors": {"below_floor": "ignore", "encoder_bits": 0}},
    "tension only": {"loop": {"wiring": "tension_only", "agonist": "triceps"}},
    "measurement": {
        "loop": {"position": MEASURED, "tension": {**MEASURED, "kp": 4.8}},
        "drives": {"command_limit_deg": 260},
    },
    "vertical": {"plant": {"orientation": "vertical"}, "sensors": {"potentiometer_bits": 0}},
}


@pytest.mark.parametrize("law", LAWS)
def test_in_double_the_commands_are_the_simulations(firmware, law):
    made = firmware(law, suite="mixed", split="shifted")
    recording = made.record()
    assert recording.readings["late"].any() and recording.readings["begins"].any()
    assert compare(made.controller(), recording) == {"command": 0.0, "tension": 0.0}


@pytest.mark.parametrize("suite", ["steps", "reach", "track", "contact", "hold-push", "payload"])
def test_in_every_suite(firmware, suite):
    made = firmware("eq6-held", suite=suite)
    assert compare(made.controller(), made.record(steps=40)) == {"command": 0.0, "tension": 0.0}


@pytest.mark.parametrize("law", ["eq6", "constant:6"])
def test_of_the_simulated_device_with_exact_sensors(firmware, law):
    made = firmware(law, "simulation", suite="mixed")
    assert compare(made.controller(), made.record(steps=25)) == {"command": 0.0, "tension": 0.0}


@pytest.mark.parametrize("name", OTHER_LOOPS)
def test_of_other_devices_and_choices_of_the_loop(firmware, name, tmp_path):
    changed = device("testbed", **OTHER_LOOPS[name])
    made = type(firmware("eq6", suite="mixed"))(tmp_path, "eq6-held", changed, suite="mixed")
    assert compare(made.controller(), made.record(steps=40)) == {"command": 0.0, "tension": 0.0}


def test_a_law_in_slices_begins_its_ramps_later(firmware):
    made = firmware("parametric", suite="steps")
    controller, recording = made.controller("float"), made.record(steps=20, num_devices=1)
    controller.start(begin_record(controller, recording, 0))
    inputs = {name: values[:, 0] for name, values in recording.readings.items()}
    found = controller.run(controller.inputs(inputs))["tension_setpoint"]
    delay = made.settings.action_delay
    assert delay > 0
    np.testing.assert_array_equal(found[:delay], found[0])
    step = found[delay] - found[delay - 1]
    assert abs(step) > 0.01
    np.testing.assert_allclose(np.diff(found[delay - 1 : delay + 8]), step, atol=1e-5)  # one ramp over an agent period


@pytest.mark.parametrize("delay", [2, 5, 7])
@pytest.mark.parametrize("law", ["parametric", "eq6-held"])
def test_in_double_the_commands_are_those_of_a_simulation_with_the_delay(firmware, law, delay):
    made = firmware(law, suite="mixed", split="shifted", action_delay=delay)
    assert made.settings.action_delay == delay
    recording = made.record(steps=40)
    assert recording.readings["late"].any()
    assert compare(made.controller(), recording) == {"command": 0.0, "tension": 0.0}


@pytest.mark.parametrize("law", ["eq6", "eq6-tuned", "constant:10", "parametric"])
def test_in_float_the_commands_are_near(firmware, law):
    made = firmware(law, suite="mixed", split="shifted")
    found = compare(made.controller("float"), made.record())
    assert 0.0 < found["command"] < 1e-4 and found["tension"] < 1e-4


def test_a_recording_is_the_environments_episode(firmware):
    from amulett_gym.envs.vector import TensionVectorEnv

    made = firmware("eq6-held", suite="mixed", split="shifted")
    recording = made.record(steps=10, seed=5)
    env = TensionVectorEnv(num_envs=6, suite="mixed", split="shifted")
    observations, _ = env.reset(seed=5)
    from amulett_gym.laws.policies import load_policy

    act = load_policy("eq6-held", env)
    for _ in range(10):
        observations, *_ = env.step(act(observations))
    for name in ("biceps", "triceps"):
        np.testing.assert_array_equal(recording.outputs[name][-1], env.episodes.simulation.read(f"command_{name}"))
