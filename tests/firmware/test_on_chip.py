"""The exported controller on a simulated ATmega2560: its numbers, its cycles and its memory."""

import numpy as np
import pytest
from firmware.test_network import write

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.board import Board
from amulett_gym.firmware.chip import Chip
from amulett_gym.firmware.readme import begin_record
from amulett_gym.firmware.toolchain import build_chip, build_hex
from amulett_gym.laws.features import FEATURES

MOST_CYCLES = 32_000
"""Four fifths of a control tick of 2.5 ms at 16 MHz."""

NETWORKS = {
    "network int8": {"hidden": (32, 32), "features": list(FEATURES), "activation": "relu"},
    "network int16": {"hidden": (12, 8), "features": list(FEATURES), "activation": "tanh"},
    "network float": {"hidden": (4,), "activation": "tanh", "output": "tanh"},
}


@pytest.mark.parametrize("law", ["eq6", "eq6-tuned", "parametric", *NETWORKS])
def test_the_chip_computes_as_the_host_does_and_in_time(firmware, law, tmp_path):
    numbers = law.split()[-1] if law in NETWORKS else None
    name = str(write(tmp_path / "policy", **NETWORKS[law])) if law in NETWORKS else law
    made = firmware(name, numbers=numbers, suite="steps")
    try:
        build_chip(tmp_path / "chip")
        chip = Chip(build_hex(made.folder, tmp_path / "build"))
    except AmulettError as error:
        if "install it:" not in str(error):
            raise
        pytest.skip(str(error).splitlines()[0])
    recording, controller = made.record(steps=10, num_devices=1), made.controller("float")
    begin = begin_record(controller, recording, 0)
    controller.start(begin)
    inputs = controller.inputs({key: values[:, 0] for key, values in recording.readings.items()})
    expected = controller.run(inputs)
    board = Board(chip)
    board.start([float(x) for key in begin.dtype.names[:-1] for x in np.ravel(begin[key])], int(begin["agonist"]))
    reports = [
        board.tick(
            int(row["encoder"]), *map(int, row["slider"]), float(row["setpoint"]), float(row["jump"]), int(row["flags"])
        )
        for row in inputs
    ]
    np.testing.assert_allclose([report.commands for report in reports], expected["command"], atol=2e-5)
    np.testing.assert_allclose([r.tension_setpoint for r in reports], expected["tension_setpoint"], atol=2e-4)
    assert law == "eq6" or np.ptp(expected["tension_setpoint"]) > 0.5
    assert max(report.cycles for report in reports) < MOST_CYCLES
    chip.close()
