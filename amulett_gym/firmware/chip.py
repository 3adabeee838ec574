"""A simulated ATmega2560 that runs a hex file: the port of a board, with cycle counts and memory."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.board import TRIES
from amulett_gym.firmware.toolchain import BAUD_RATE, FREQUENCY, build_chip

_ANSWER_TIME = 0.1  # [s] of the chip, after which it counts as silent
_BOOT_TIME = 0.01  # [s] of the chip, before which nothing is sent to it
_WAITING = 4096


@dataclass(frozen=True)
class Measurement:
    """What was measured in a simulated chip.

    Attributes
    ----------
    cycles : int
        CPU cycles since the reset.
    ticks : int
        Control ticks measured.
    last, most, mean : float
        CPU cycles of the last, the longest, and the mean of the ticks, interrupts within included.
    flash, static, stack : int
        Bytes of the program, of static memory, and the most that the stack has had.
    """

    cycles: int
    ticks: int
    last: int
    most: int
    mean: float
    flash: int
    static: int
    stack: int

    def share_of_period(self, period: float) -> float:
        """Return the longest tick as a share of a control period [s]."""
        return self.most / (FREQUENCY * period)

    @property
    def memory(self) -> int:
        """Bytes of memory in all."""
        return self.static + self.stack


class Chip:
    """A simulated ATmega2560 with a program: a :class:`board.Port`.

    Time passes only in :meth:`receive` and :meth:`wait`.

    Parameters
    ----------
    hex_file : Path

    Raises
    ------
    AmulettError
        If simavr is missing or the file cannot be read.
    """

    label = "the simulated ATmega2560"
    hello_tries = TRIES

    def __init__(self, hex_file: Path) -> None:
        self._library = _library()
        self._chip = self._library.chip_open(str(hex_file).encode(), FREQUENCY, BAUD_RATE)
        if not self._chip:
            raise AmulettError(f"'{hex_file}' is no program for the ATmega2560 in Intel's hex format")
        self._out = ctypes.create_string_buffer(_WAITING)
        self.wait(_BOOT_TIME)

    def send(self, data: bytes) -> None:
        """Let bytes arrive at the serial port, at its speed."""
        if self._library.chip_send(self._handle, data, len(data)) < len(data):
            raise OSError(f"more than {_WAITING} bytes wait for its serial port")

    def receive(self) -> bytes:
        """Let the chip run until it has sent a zero, at most for 0.1 s; return what it has sent."""
        return self._run(int(_ANSWER_TIME * FREQUENCY))

    def wait(self, seconds: float) -> bytes:
        """Let the chip run for a time [s]; return what it has sent."""
        end, sent = self.measure().cycles + round(seconds * FREQUENCY), b""
        while (left := end - self.measure().cycles) > 0:
            sent += self._run(left)
        return sent

    def measure(self) -> Measurement:
        """Return what was measured since the reset, or :meth:`restart_measuring`."""
        found = (ctypes.c_uint64 * 8)()
        self._library.chip_measure(self._handle, found)
        cycles, ticks, last, most, total, flash, static, stack = found
        return Measurement(cycles, ticks, last, most, total / max(ticks, 1), flash, static, stack)

    def set_sensors(self, encoder: int | None, biceps: int, triceps: int) -> None:
        """Connect sensors of its own: counts of the joint encoder (None: there is none) and of both potentiometers."""
        self._library.chip_set_sensors(self._handle, -1 if encoder is None else encoder % 2**14, biceps, triceps)

    def pulses(self) -> tuple[float, float] | None:
        """Return the lengths of both drives' servo pulses [microseconds], None while there are none."""
        found = (ctypes.c_uint32 * 2)()
        return (found[0] / 2.0, found[1] / 2.0) if self._library.chip_pulses(self._handle, found) else None

    def reset(self) -> None:
        """Reset the processor; its memory stays."""
        self._library.chip_reset(self._handle)
        self.wait(_BOOT_TIME)

    def restart_measuring(self) -> None:
        """Forget the ticks measured so far."""
        self._library.chip_restart_measuring(self._handle)

    def close(self) -> None:
        """Free the chip; it is gone for later calls."""
        if self._chip:
            self._library.chip_close(self._chip)
            self._chip = None

    @property
    def _handle(self) -> int:
        if not self._chip:
            raise OSError("it is closed")
        return int(self._chip)

    def _run(self, cycles: int) -> bytes:
        count = self._library.chip_run(self._handle, cycles, self._out)
        if count < 0:
            raise OSError("its program has crashed")
        return self._out.raw[:count]


_loaded: list[ctypes.CDLL] = []


def _library() -> ctypes.CDLL:
    """Return the simulation, compiled once per process."""
    if not _loaded:
        with TemporaryDirectory() as folder:
            library = ctypes.CDLL(str(build_chip(Path(folder))))
        pointer, word = ctypes.c_void_p, ctypes.c_uint32
        library.chip_open.restype, library.chip_open.argtypes = pointer, [ctypes.c_char_p, word, word]
        library.chip_send.restype, library.chip_send.argtypes = word, [pointer, ctypes.c_char_p, word]
        library.chip_run.restype = ctypes.c_int32
        library.chip_run.argtypes = [pointer, ctypes.c_uint64, ctypes.c_char_p]
        library.chip_measure.argtypes = [pointer, ctypes.POINTER(ctypes.c_uint64)]
        library.chip_set_sensors.argtypes = [pointer, ctypes.c_int32, word, word]
        library.chip_pulses.restype, library.chip_pulses.argtypes = word, [pointer, ctypes.POINTER(word)]
        for name in ("chip_close", "chip_restart_measuring", "chip_reset"):
            getattr(library, name).argtypes = [pointer]
        for name in ("chip_close", "chip_measure", "chip_restart_measuring", "chip_set_sensors", "chip_reset"):
            getattr(library, name).restype = None
        _loaded.append(library)
    return _loaded[0]
