"""The firmware's controller on this computer: compiled as a library, driven tick by tick."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.errors import AmulettError, ToolMissing
from amulett_gym.storage.reading import user_path

Real = Literal["double", "float"]

SOURCES = ("controller.c", "law.c", "host.c")

FLAGS: dict[Real, tuple[str, ...]] = {
    # As the simulation computes.
    "double": ("-DCONTROLLER_DOUBLE",),
    # As the microcontroller computes, where a double is a float.
    "float": ("-fsingle-precision-constant",),
}

MOVE_BEGINS, LATE = 1, 2
"""Flags of an input."""

BAD_SETPOINT, BAD_SENSOR, LIMITED, LETTING_GO, SLACK, BAD_NUMBER = 1, 2, 4, 8, 16, 32
"""Bits of a status."""


class Controller:
    """A firmware folder's controller, compiled for this computer; each one has a memory of its own.

    Parameters
    ----------
    folder : str or Path
        As `firmware.export.export` writes it.
    real : {"double", "float"}
        ``"double"`` equals the simulation; ``"float"`` computes as the microcontroller does.

    Attributes
    ----------
    begin_type, input_type, output_type : dtype
        Records `controller_begin`, `controller_input` and `controller_output` of ``controller.h``.
    encoder_resolution, slider_resolution : float
        What a count means [rad], [m]; 1 where the sensor is exact.

    Raises
    ------
    AmulettError
        If there is no compiler, or it refuses.
    """

    def __init__(self, folder: str | Path, real: Real = "double") -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="amulett-firmware-")
        library = Path(self._folder.name) / "controller.so"
        compile_controller(user_path(folder), library, real)
        self._library = ctypes.CDLL(str(library))
        numbers = read_defines((user_path(folder) / "device.h").read_text(encoding="utf-8"))
        self.encoder_resolution, self.slider_resolution = numbers["ENCODER_RESOLUTION"], numbers["SLIDER_RESOLUTION"]
        self._exact = bool(numbers["ENCODER_EXACT"]), bool(numbers["SLIDER_EXACT"])
        self.begin_type, self.input_type, self.output_type = record_types(
            "f8" if real == "double" else "f4", *self._exact
        )
        self._library.host_size.restype = ctypes.c_size_t
        for which, kind in enumerate((self.begin_type, self.input_type, self.output_type)):
            assert self._library.host_size(which) == kind.itemsize, kind
        self._library.host_run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
        self._library.host_run.restype = None
        for name in ("controller_start", "controller_let_go"):
            getattr(self._library, name).argtypes = [ctypes.c_void_p]
            getattr(self._library, name).restype = None
        self._library.controller_begin_here.argtypes = [ctypes.c_void_p] * 3
        self._library.controller_begin_here.restype = None

    def start(self, begin: NDArray[np.void]) -> None:
        """Begin an episode from a record of `begin_type`, shape ()."""
        self._library.controller_start(np.ascontiguousarray(begin).ctypes.data)

    def begin_here(self, first: NDArray[np.void], commands: tuple[float, float]) -> NDArray[np.void]:
        """Return where an episode begins by a first reading, of `input_type`, and the drives' angles [rad] alone."""
        begin = np.zeros((), dtype=self.begin_type)
        both = np.array(commands, dtype=self.begin_type["command"].base)
        self._library.controller_begin_here(
            np.ascontiguousarray(first).ctypes.data, both.ctypes.data, begin.ctypes.data
        )
        return begin

    def run(self, inputs: NDArray[np.void]) -> NDArray[np.void]:
        """Do one tick for each record of `input_type`, shape (ticks,); return records of `output_type`."""
        inputs = np.ascontiguousarray(np.atleast_1d(inputs))
        outputs = np.zeros(inputs.shape, dtype=self.output_type)
        self._library.host_run(inputs.ctypes.data, outputs.ctypes.data, inputs.size)
        return outputs

    def let_go(self, output: NDArray[np.void]) -> NDArray[np.void]:
        """Return what follows the last output, a record of `output_type`, in one control period of letting go."""
        output = np.array(output, dtype=self.output_type)
        self._library.controller_let_go(output.ctypes.data)
        return output

    def inputs(self, readings: dict[str, NDArray[Any]]) -> NDArray[np.void]:
        """Return records of `input_type` from readings in SI units (`recording.Recording.readings`)."""
        found = np.zeros(readings["setpoint"].shape, dtype=self.input_type)
        angle, sliders = readings["angle"], np.stack([readings["biceps"], readings["triceps"]], axis=-1)
        found["encoder"] = angle if self._exact[0] else np.rint(angle / self.encoder_resolution)
        found["slider"] = sliders if self._exact[1] else np.rint(sliders / self.slider_resolution)
        found["setpoint"], found["jump"] = readings["setpoint"], readings["jump"]
        found["flags"] = MOVE_BEGINS * readings["begins"] + LATE * readings["late"]
        return found

    def close(self) -> None:
        """Delete the library's file."""
        self._folder.cleanup()


def record_types(real: str, encoder_exact: bool, slider_exact: bool) -> tuple[np.dtype[Any], ...]:
    """Return the records of ``controller.h`` as numpy sees them."""
    begin = [("command", real, 2), ("angle", real), ("tension", real), ("estimate", real, 2), ("difference", real)]
    begin += [("output", real), ("offset", real, 2), ("tension_integral", real), ("averaged_angle", real)]
    begin += [("averaged_slider", real, 2), ("agonist", "i1")]
    readings: list[tuple[Any, ...]] = [("encoder", real if encoder_exact else "i4")]
    readings += [("slider", real if slider_exact else "i4", 2), ("setpoint", real), ("jump", real), ("flags", "u1")]
    output = [("command", real, 2), ("tension_setpoint", real), ("agonist", "i1"), ("status", "u1")]
    return tuple(np.dtype(fields, align=True) for fields in (begin, readings, output))


def compile_controller(folder: Path, library: Path, real: Real = "double") -> None:
    """Compile a firmware folder's controller as a shared library (errors as `Controller`)."""
    compiler = find_compiler()
    if compiler is None:
        raise ToolMissing(NO_COMPILER.replace("tick in C", "firmware"))
    sources = [str(folder / name) for name in SOURCES]
    flags = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", *FLAGS[real])
    command = [compiler, *flags, *sources, "-o", str(library), "-lm"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise AmulettError(f"{compiler} cannot build the firmware in '{folder}':\n{result.stderr[-2000:]}")


def read_defines(header: str) -> dict[str, float]:
    """Return the numbers that a generated header's text defines."""
    found = {}
    for line in header.splitlines():
        words = line.split()
        if len(words) == 3 and words[0] == "#define":
            try:
                found[words[1]] = float(words[2].strip("()u").replace("INFINITY", "inf"))
            except ValueError:
                continue
    return found


def firmware_id(header: str) -> int:
    """Return the identity of a firmware's sources from the text of its ``device.h``; AmulettError without one."""
    numbers = read_defines(header)
    if "FIRMWARE_ID" not in numbers:
        raise AmulettError("the folder's device.h has no FIRMWARE_ID; export the firmware again")
    return int(numbers["FIRMWARE_ID"])
