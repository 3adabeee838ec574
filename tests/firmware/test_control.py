"""Each loop of the literature as firmware: with the simulation's readings it commands what the simulation's does."""

import shutil
import subprocess
from contextlib import closing
from itertools import cycle

import numpy as np
import pytest
from firmware.boards import chip_or_skip, on_host_and_chip
from firmware.test_network import write
from helpers import device, keep_network

from amulett_gym import DRIVES_ID
from amulett_gym.c.build import find_compiler
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import hil
from amulett_gym.firmware.control import APART, CYCLES, LOOP_FILES, TABLES
from amulett_gym.firmware.export import export
from amulett_gym.firmware.host import BAD_SENSOR, FLAGS, read_defines
from amulett_gym.firmware.measuring import Remote
from amulett_gym.firmware.readme import begin_record, compare
from amulett_gym.gains import group_name
from amulett_gym.laws.features import FEATURES
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.tasks.suites import suite_names

LAWS = ("eq6-printed", "eq6-held", "parametric", "eq6-tuned", "eq6-held-printed")
EQUAL = {"command": 0.0, "tension": 0.0}

OTHER_DEVICES = {
    "vertical": {"plant": {"orientation": "vertical"}, "sensors": {"potentiometer_bits": 0}},
    "critically-damped": {"reference": "critically-damped", "drives": {"command_limit_deg": 300}},
    "first-order": {"reference": "first-order", "drives": {"lag": 0.0, "rate_limit_deg": None}},
    "preload": {"damping": {"preload": "smaller"}, "sensors": {"below_floor": "ignore"}},
    "structure": {"structure": {"stiffness": 2e4}},
}
OTHERS = {
    "vertical": ("feedback-linearisation", "cascade", "minimal-motion"),
    "critically-damped": ("feedback-linearisation", "feedforward-feedback"),
    "first-order": ("torque-stiffness", "feedback-linearisation"),
    "preload": ("torque", "cascade"),
    "structure": ("equilibrium-point", "torque-stiffness", "feedback-linearisation", "computed-torque"),
}


@pytest.mark.parametrize("control", LOOPS)
def test_in_double_the_commands_are_the_simulations_in_every_suite(firmware, control):
    made = firmware("eq6", control=control)
    controller = made.controller()
    for suite in suite_names():
        recording = made.record(steps=30, num_devices=4, suite=suite, split="shifted")
        assert compare(controller, recording) == EQUAL, suite
        assert np.ptp(recording.outputs["biceps"], axis=0).max() > 1e-3, suite


@pytest.mark.parametrize(("control", "law"), list(zip(LOOPS, cycle(LAWS), strict=False)))
def test_with_every_law(firmware, control, law):
    made = firmware(law, control=control, suite="mixed", split="shifted")
    recording = made.record(steps=40)
    assert recording.readings["late"].any() and recording.readings["jump"].any()
    assert compare(made.controller(), recording) == EQUAL


@pytest.mark.parametrize("control", LOOPS)
def test_of_the_simulated_device_with_exact_sensors(firmware, control):
    made = firmware("constant:8", "simulation", control, suite="mixed")
    assert compare(made.controller(), made.record(steps=25)) == EQUAL


@pytest.mark.parametrize("name", OTHER_DEVICES)
def test_of_other_devices_and_references(firmware, name, tmp_path):
    changes = dict(OTHER_DEVICES[name])
    reference = changes.pop("reference", "minimum-jerk")
    for control in OTHERS[name]:
        group = {group_name(control): {"reference": reference}}
        (folder := tmp_path / control).mkdir()
        profile = device("testbed", loops=group, **changes)
        made = type(firmware("eq6"))(folder, "eq6-held", profile, control, suite="mixed", split="shifted")
        assert compare(made.controller(), made.record(steps=30, num_devices=4)) == EQUAL, control


@pytest.mark.parametrize("control", LOOPS)
def test_in_float_the_commands_are_near(firmware, control):
    made = firmware("constant:10", control=control)
    found = compare(made.controller("float"), made.record(steps=30, suite="steps"))
    assert 0.0 < found["command"] < APART and found["tension"] < 1e-5


@pytest.mark.parametrize("jump", [0.2, 0.5])
@pytest.mark.parametrize("control", LOOPS)
def test_in_float_a_jump_in_the_first_tick_is_no_jump_back_in_the_next(firmware, control, jump):
    made = firmware("constant:10", control=control)
    recording = made.record(steps=30, num_devices=1, suite="steps")
    found = {}
    for real in FLAGS:
        with closing(made.controller(real)) as controller:
            inputs = controller.inputs({name: values[:, 0] for name, values in recording.readings.items()})[:12]
            inputs["jump"], inputs["jump"][0] = 0.0, jump
            inputs["setpoint"] = inputs["setpoint"][0] + jump
            controller.start(begin_record(controller, recording, 0))
            found[real] = controller.run(inputs)["command"]
    # The float build begins the same motion one tick later.
    np.testing.assert_allclose(found["float"][1:], found["double"][:-1], atol=0.02)


def test_only_the_files_of_the_loop_are_in_a_folder(tmp_path, without_chip):
    folder = tmp_path / "firmware"
    found = {}
    for law in ("co-rotation/eq6", "computed-torque/eq6", "eq6"):
        export(law, "testbed", None, folder)
        found[law] = {path.name for path in folder.iterdir()} & set(LOOP_FILES)
    common = {"loops.h", "loop_springs.h", "loop_motion.h", TABLES}
    assert found["co-rotation/eq6"] == common | {"loop_feed_forward.h"}
    assert found["computed-torque/eq6"] == common | {"loop_computed_torque.h"}
    assert found["eq6"] == set()
    assert "loop_motion.h" not in (folder / "README.md").read_text()


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_a_folder_checks_itself_and_shows_its_files(tmp_path):
    export("computed-torque/constant:8", "testbed", None, tmp_path / "firmware")
    done = subprocess.run(["make", "check"], cwd=tmp_path / "firmware", capture_output=True, text=True, check=True)
    assert done.stdout.count("as it should be") == 2
    readme = (tmp_path / "firmware" / "README.md").read_text()
    assert "| control loop | computed-torque |" in readme and "`loop_computed_torque.h`" in readme
    header = tmp_path / "firmware" / "device.h"
    header.write_text(header.read_text().replace(".kd = 5.0", ".kd = 5.1"))
    done = subprocess.run(["make", "check"], cwd=tmp_path / "firmware", capture_output=True, text=True)
    assert "TOO MUCH" in done.stdout


@pytest.mark.parametrize("real", FLAGS)
@pytest.mark.parametrize("control", LOOPS)
def test_sources_compile_without_a_warning(firmware, control, real, tmp_path):
    folder = firmware("eq6", control=control).folder
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Wno-sign-conversion", "-Werror", *FLAGS[real]]
    command = [find_compiler(), *flags, "-c", str(folder / "controller.c"), "-o", str(tmp_path / "out.o")]
    assert subprocess.run(command, capture_output=True, text=True).stderr == ""


def test_a_loop_that_does_not_fit_is_refused_with_numbers(tmp_path):
    message = "'minimal-motion' takes up to [0-9]+ cycles .* leaves 32000, 80% of it.* at least [0-9.]+ ms"
    with pytest.raises(AmulettError, match=message):
        export("eq6", "testbed", "minimal-motion", tmp_path / "firmware")
    with pytest.raises(AmulettError, match="'co-rotation' takes up to .* and [0-9]+ for its law"):
        export("parametric", "testbed", "co-rotation", tmp_path / "firmware")
    assert not (tmp_path / "firmware").exists()
    slow = device("testbed", loop={"control_period": 0.01})
    assert TABLES in export("eq6", slow, "minimal-motion", tmp_path / "firmware")


FITTING = [control for control in LOOPS if CYCLES[control] < 32_000]


@pytest.mark.parametrize("control", FITTING)
def test_the_chip_computes_as_the_host_does_and_in_time(firmware, control):
    made = firmware("eq6", control=control)
    recording = made.record(steps=8, num_devices=1, suite="mixed", split="shifted")
    expected, found, measured = on_host_and_chip(made, recording)
    np.testing.assert_allclose(found["command"], expected["command"], atol=2e-5)
    assert np.ptp(expected["command"]) > 1e-3
    assert 0.7 * CYCLES[control] < measured.most <= CYCLES[control]
    assert measured.flash < 60_000 and measured.memory < 2_000


def test_a_network_gets_the_cycles_that_a_loop_leaves(firmware, tmp_path):
    folder = str(write(tmp_path / "policy", hidden=(16, 16), features=list(FEATURES), activation="relu"))
    found = {}
    for control in ("decentralized", "co-rotation"):
        made = firmware(folder, control=control, numbers="int8")
        most = read_defines(made.files["weights.h"])["NETWORK_SLICE"]
        assert CYCLES[control] + most <= 32_000
        found[control] = most, made.settings.action_delay
    assert found["co-rotation"][0] < found["decentralized"][0] and found["co-rotation"][1] > found["decentralized"][1]
    recording = made.record(steps=8, num_devices=1, suite="mixed")
    with closing(made.controller("float")) as host, closing(chip_or_skip(made.folder)) as loop:
        assert compare(host, recording)["command"] < APART
        compare(Remote(loop, host), recording)
        assert loop.measure().most <= 32_000


def test_a_law_that_drives_both_motors_is_refused(tmp_path):
    about = {"env_id": DRIVES_ID, "mean_angle_range": 258.66, "tension_range": [0.0, 15.0]}
    folder = keep_network(tmp_path / "policy", [(np.zeros((2, 13), "f4"), np.zeros(2, "f4"))], **about)
    with pytest.raises(AmulettError, match="drives both motors directly"):
        export(str(folder), "testbed", None, tmp_path / "firmware")


@pytest.mark.parametrize("control", ["computed-torque", "feedforward-feedback", "torque"])
def test_in_the_loop_of_a_host_the_cost_is_the_simulations(firmware, control):
    found = hil.compare(firmware("eq6", control=control).folder, episodes=2, duration=1.0)
    assert found.kernel.costs.min() > 0.0
    assert found.played[0].costs == pytest.approx(found.kernel.costs, rel=1e-12)


@pytest.mark.parametrize("real", FLAGS)
@pytest.mark.parametrize("control", LOOPS)
def test_a_loop_begins_from_a_reading_alone_and_goes_on_after_one_that_is_unsound(firmware, control, real):
    made = firmware("constant:10", control=control)
    controller = made.controller(real)
    recording = made.record(steps=30, num_devices=1, suite="steps")
    inputs = controller.inputs({name: values[:, 0] for name, values in recording.readings.items()})
    commands = recording.begin["command"][0]
    begin = controller.begin_here(inputs[0], commands)
    inputs["setpoint"] += begin["angle"] - recording.begin["angle"][0]  # as a board sets it: where the joint is read
    controller.start(begin)
    found = controller.run(inputs)
    # At rest the commands go on from where the drives are, and rise to the law's tension with its ramp.
    assert np.abs(found["command"][0] - commands).max() < 0.05
    wanted = np.stack([recording.outputs[name][:, 0] for name in ("biceps", "triceps")], axis=1)
    assert np.abs(found["command"] - wanted).max() < 0.2
    inputs["slider"][100] = -1
    controller.start(begin)
    disturbed = controller.run(inputs)
    assert disturbed["status"][100] & BAD_SENSOR and not disturbed["status"][101] & BAD_SENSOR
    np.testing.assert_array_equal(disturbed["command"][100], disturbed["command"][99])
    assert np.abs(disturbed["command"] - found["command"]).max() < 0.2
    controller.close()
