"""Lines to boards: a serial port, and the board's program in a process of its own."""

from __future__ import annotations

import os
import select
import subprocess
from pathlib import Path

from amulett_gym.errors import AmulettError, install_extra
from amulett_gym.firmware.board import TRIES
from amulett_gym.firmware.toolchain import BAUD_RATE

_WRITE_TIME = 5.0  # [s]; a board that takes no bytes for longer is gone


class SerialPort:
    """A real board, or a pseudo-terminal: a :class:`board.Port`.

    An Arduino Mega 2560 resets when its port is opened, and answers about two seconds later.

    Parameters
    ----------
    path : str
        As ``/dev/ttyACM0`` or ``COM3``.
    timeout : float
        Time to wait for an answer [s].

    Raises
    ------
    AmulettError
        If pyserial is missing or the port cannot be opened.
    """

    hello_tries = 10

    def __init__(self, path: str, timeout: float = 0.5) -> None:
        try:
            import serial
        except ImportError:
            raise AmulettError(f"a serial port needs pyserial: {install_extra('board')}") from None
        self.label = path
        try:
            self._serial = serial.Serial(path, BAUD_RATE, timeout=timeout, write_timeout=_WRITE_TIME)
        except (OSError, ValueError) as error:
            raise AmulettError(f"the serial port '{path}' cannot be opened: {error}") from None

    def send(self, data: bytes) -> None:
        """Send bytes."""
        self._serial.write(data)

    def receive(self) -> bytes:
        """Return received bytes, up to a zero; none after the timeout."""
        return bytes(self._serial.read_until(b"\0"))

    def close(self) -> None:
        """Close the port."""
        self._serial.close()


class ProcessPort:
    """The board's program on the host, over pipes: a :class:`board.Port`.

    Parameters
    ----------
    program : Path
        Of `toolchain.build_board`.
    timeout : float
        Time to wait for an answer [s].
    """

    label = "the host"
    hello_tries = TRIES

    def __init__(self, program: Path, timeout: float = 5.0) -> None:
        self._timeout = timeout
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)

    def send(self, data: bytes) -> None:
        """Send bytes."""
        assert self._process.stdin is not None
        self._process.stdin.write(data)

    def receive(self) -> bytes:
        """Return received bytes, none after the timeout."""
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], self._timeout)[0]:
            return b""
        data = os.read(self._process.stdout.fileno(), 4096)
        if not data:
            raise OSError("its program has ended")
        return data

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
