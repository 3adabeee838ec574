"""The exported controller on a simulated ATmega2560: its numbers, its cycles and its memory."""

import shutil
import subprocess
from contextlib import closing

import numpy as np
import pytest
from firmware.boards import on_host_and_chip, skipping
from firmware.test_network import write

from amulett_gym.firmware.board import Board
from amulett_gym.firmware.chip import Chip
from amulett_gym.firmware.export import text
from amulett_gym.firmware.host import firmware_id
from amulett_gym.firmware.toolchain import AVR_FLAGS, build_chip, check_avr_compiler
from amulett_gym.laws.features import FEATURES
from amulett_gym.laws.memory import MEMORY

MOST_CYCLES = 32_000
"""Four fifths of a control tick of 2.5 ms at 16 MHz."""

MOST_MEMORY = 6000
"""Bytes, the stack included."""

NETWORKS = {
    "network int8": {"hidden": (32, 32), "features": list(FEATURES), "activation": "relu"},
    "network int16": {"hidden": (12, 8), "features": list(FEATURES), "activation": "tanh"},
    "network float": {"hidden": (4,), "activation": "tanh", "output": "tanh"},
    "memory int8": {
        "hidden": (16, 8),
        "features": list(FEATURES),
        "memory": list(MEMORY),
        "activation": "relu",
        "agent_period": 0.04,
    },
    "history int8": {"hidden": (16, 8), "history": 4, "activation": "relu"},
}
SAMPLED = ("eq6-tuned", "memory int8")
"""These follow sampled paths of the setpoint, the others steps."""


@pytest.mark.parametrize("law", ["eq6", "eq6-tuned", "parametric", "pretrained:device", *NETWORKS])
def test_the_chip_computes_as_the_host_does_and_in_time(firmware, law, tmp_path):
    numbers = law.split()[-1] if law in NETWORKS else None
    name = str(write(tmp_path / "policy", **NETWORKS[law])) if law in NETWORKS else law
    made = firmware(name, numbers=numbers, suite="track" if law in SAMPLED else "steps")
    recording = made.record(steps=10, num_devices=1)
    expected, found, measured = on_host_and_chip(made, recording)
    np.testing.assert_allclose(found["command"], expected["command"], atol=2e-5)
    np.testing.assert_allclose(found["tension_setpoint"], expected["tension_setpoint"], atol=2e-4)
    assert law == "eq6" or np.ptp(expected["tension_setpoint"]) > 0.5
    assert (measured.ticks, measured.most < MOST_CYCLES, measured.memory < MOST_MEMORY) == (found.size, True, True)


def test_all_files_of_a_folder_make_the_arduino_sketch(firmware, tmp_path):
    """The Arduino IDE compiles every C file of a folder, and has a main of its own that calls `setup` and `loop`."""
    made = firmware("eq6")
    shutil.copytree(made.folder, tmp_path / "sketch", ignore=shutil.ignore_patterns("build"))
    for name in ("check.c", "host.c"):
        (tmp_path / "sketch" / name).write_text(text(name))
    files = [str(path) for path in sorted((tmp_path / "sketch").glob("*.c"))]
    main = tmp_path / "main.c"
    main.write_text('#include "mega.h"\nint main(void) { mega_begin(); for (;;) mega_loop(); }\n')
    with skipping():
        check_avr_compiler()
        build_chip(tmp_path / "chip")
    elf, hex_file = tmp_path / "sketch.elf", tmp_path / "sketch.hex"
    flags = [*AVR_FLAGS, "-DARDUINO=10819", "-Wl,--gc-sections", f"-I{tmp_path / 'sketch'}"]
    subprocess.run(["avr-gcc", *flags, *files, str(main), "-o", str(elf), "-lm"], check=True)
    subprocess.run(["avr-objcopy", "-O", "ihex", "-R", ".eeprom", str(elf), str(hex_file)], check=True)
    with closing(Board(Chip(hex_file))) as board:
        assert board.hello.firmware_id == firmware_id((made.folder / "device.h").read_text())
