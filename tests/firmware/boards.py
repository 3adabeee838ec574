"""A folder with the board's own files and a stub for the controller, for tests of protocol and board alone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import amulett_gym
from amulett_gym.errors import ToolMissing
from amulett_gym.firmware.chip import Measurement
from amulett_gym.firmware.loops import FirmwareLoop, open_loop
from amulett_gym.firmware.measuring import Remote
from amulett_gym.firmware.readme import begin_record
from amulett_gym.firmware.recording import Recording
from amulett_gym.firmware.toolchain import BOARD_FILES, build_chip, build_hex

STUB = Path(__file__).with_name("stub")
BEGIN = [1.0, -1.0, *[0.5] * 12]
"""Numbers of `controller_begin`: commands of 1 and -1 rad."""


def stub_folder(folder: Path) -> Path:
    sources = Path(amulett_gym.__file__).parent / "c"
    for path in [*STUB.iterdir(), *(sources / name for name in ("controller.h", *BOARD_FILES))]:
        shutil.copy(path, folder)
    return folder


def hex_or_skip(folder: Path) -> Path:
    """Return the stub's hex file; skip if avr-gcc or simavr is missing."""
    with skipping():
        build_chip(folder / "chip")
        return build_hex(stub_folder(folder), folder / "build")


def chip_or_skip(folder: Path) -> FirmwareLoop:
    """Return a firmware on the simulated chip; skip if avr-gcc or simavr is missing."""
    with skipping():
        return open_loop(folder, "chip")


def on_host_and_chip(made: Any, recording: Recording) -> tuple[NDArray[np.void], NDArray[np.void], Measurement]:
    """Return what a firmware gives for a recording's first device, on the host and on the chip, and what it needs.

    `made` is a ``conftest.Firmware``.
    """
    with closing(made.controller("float")) as host, closing(chip_or_skip(made.folder)) as loop:
        chip, begin = Remote(loop, host), begin_record(host, recording, 0)
        inputs = host.inputs({key: values[:, 0] for key, values in recording.readings.items()})
        host.start(begin)
        chip.start(begin)
        expected, found, measured = host.run(inputs), chip.run(inputs), loop.measure()
    assert measured is not None
    return expected, found, measured


@contextmanager
def skipping() -> Iterator[None]:
    try:
        yield
    except ToolMissing as error:
        pytest.skip(str(error).splitlines()[0])
