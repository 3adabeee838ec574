"""Where a firmware's loop runs: on the host, on a simulated chip, or on a real board."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.firmware.board import Board
from amulett_gym.firmware.chip import Chip, Measurement
from amulett_gym.firmware.host import Controller, Real, firmware_id, record_types
from amulett_gym.firmware.ports import SerialPort
from amulett_gym.firmware.protocol import BoardError, Report
from amulett_gym.firmware.toolchain import build_hex, check_avr_compiler

SERIAL = "serial:"

TRANSPORTS = ("host", "host-float", "chip", "serial:PORT")
"""Where a firmware can run; the host computes in 64 bits, as the simulation does, or in 32 bits, as the chip does."""

BEGIN_FIELDS = record_types("f8", False, False)[0].names or ()
"""Fields of `controller_begin`, the agonist last."""


@dataclass(frozen=True)
class Sample:
    """What a control tick reads: counts of the sensors, or [rad] and [m] of exact ones; setpoint and jump [rad]."""

    encoder: float
    biceps: float
    triceps: float
    setpoint: float
    jump: float
    flags: int


class FirmwareLoop(Protocol):
    """A running firmware.

    Attributes
    ----------
    label : str
        Where it runs.
    """

    label: str

    @property
    def retries(self) -> int:
        """Requests that had to be sent again."""

    def start(self, begin: dict[str, Any]) -> None:
        """Begin an episode by the fields of `controller_begin`, scalars or pairs."""

    def tick(self, sample: Sample) -> Report:
        """Do one control tick."""

    def measure(self) -> Measurement | None:
        """Return cycles and memory, where they can be measured."""

    def close(self) -> None:
        """End it."""


class HostLoop:
    """A firmware on this computer.

    Parameters
    ----------
    folder : Path
    real : {"double", "float"}
    """

    retries = 0

    def __init__(self, folder: Path, real: Real) -> None:
        self.label = "host" if real == "double" else "host, 32 bit"
        self._controller = Controller(folder, real)
        self._input = np.zeros(1, dtype=self._controller.input_type)

    def start(self, begin: dict[str, Any]) -> None:
        """Begin an episode."""
        record = np.zeros((), dtype=self._controller.begin_type)
        for name in BEGIN_FIELDS:
            record[name] = begin[name]
        self._controller.start(record)

    def tick(self, sample: Sample) -> Report:
        """Do one control tick."""
        sliders = sample.biceps, sample.triceps
        self._input[0] = (sample.encoder, sliders, sample.setpoint, sample.jump, sample.flags)
        commands, tension, agonist, status = self._controller.run(self._input)[0].tolist()
        return Report(tuple(commands), tension, agonist, status)

    def measure(self) -> None:
        """Return None: nothing is measured."""

    def close(self) -> None:
        """Delete what was compiled."""
        self._controller.close()


class BoardLoop:
    """A firmware on a board.

    Parameters
    ----------
    board : Board
    folder : Path
        That the board was programmed from.

    Raises
    ------
    BoardError
        If the board has another firmware.
    """

    def __init__(self, board: Board, folder: Path) -> None:
        self.label, self._board = board.port.label, board
        wanted, found = firmware_id((folder / "device.h").read_text(encoding="utf-8")), board.hello.firmware_id
        if found != wanted:
            self.close()
            raise BoardError(
                f"the board on {self.label} has the firmware {found:08x}, '{folder}' is {wanted:08x}; program the "
                "board with the folder's firmware.hex ('make avr'), or name the folder that it was programmed from"
            )

    def start(self, begin: dict[str, Any]) -> None:
        """Begin an episode; a simulated chip from its reset, so that its cycles depend on the episode alone."""
        if isinstance(self._board.port, Chip):
            self._board.port.reset()
        numbers = np.concatenate([np.ravel(begin[name]) for name in BEGIN_FIELDS[:-1]])
        self._board.start(numbers.tolist(), int(begin["agonist"]))

    def tick(self, sample: Sample) -> Report:
        """Do one control tick."""
        encoder, sliders = sample.encoder, (sample.biceps, sample.triceps)
        return self._board.tick(encoder, *sliders, sample.setpoint, sample.jump, sample.flags)

    @property
    def retries(self) -> int:
        """Requests that had to be sent again."""
        return self._board.retries

    def measure(self) -> Measurement | None:
        """Return cycles and memory of a simulated chip."""
        port = self._board.port
        return port.measure() if isinstance(port, Chip) else None

    def close(self) -> None:
        """Close the line to the board."""
        self._board.close()


def open_loop(folder: Path, transport: str) -> FirmwareLoop:
    """Start a firmware folder's loop.

    Parameters
    ----------
    folder : Path
    transport : str
        One of `TRANSPORTS`, with the port's path instead of PORT.

    Raises
    ------
    AmulettError
        If the transport is unknown, a compiler is missing, or no board answers.
    """
    check_transport(transport)
    if transport in ("host", "host-float"):
        return HostLoop(folder, "double" if transport == "host" else "float")
    if transport == "chip":
        build = Path(tempfile.mkdtemp(prefix="amulett-firmware-"))
        try:
            return BoardLoop(Board(Chip(build_hex(folder, build))), folder)
        finally:
            shutil.rmtree(build, ignore_errors=True)
    return BoardLoop(Board(SerialPort(transport.removeprefix(SERIAL))), folder)


def check_transport(transport: str) -> None:
    """Refuse a transport that is unknown or, of the chip, has no compiler, before the work of others.

    Raises
    ------
    AmulettError
        As `open_loop` raises it.
    """
    if transport == SERIAL:
        raise AmulettError("transport 'serial:' names no port; give it, for example serial:/dev/ttyACM0")
    if transport == "chip":
        check_avr_compiler()
    elif transport not in TRANSPORTS and not transport.startswith(SERIAL):
        raise unknown("transport", transport, TRANSPORTS)
