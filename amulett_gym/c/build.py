"""Compile the tick in C with the system's compiler, from declarations generated from the kernel's own dtypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control import agonist
from amulett_gym.errors import AmulettError
from amulett_gym.simulation import commands, kernel, layout, random, sensors

COMPILERS = ("cc", "gcc", "clang")
NO_COMPILER = f"no C compiler found (looked for {', '.join(COMPILERS)}): the tick in C cannot be compiled"

Blocks = NDArray[np.void]
Advance = Callable[
    [Blocks, NDArray[np.int64], Blocks, Blocks, layout.Paths | None, layout.Loop | None, bool | None, int, int], None
]
"""Called as `kernel.advance` is."""


@dataclass(frozen=True)
class Build:
    """One way of compiling ``tick.c``.

    Attributes
    ----------
    label : str
    flags : tuple of str
    tolerance : float
        How far its states may be from the kernel's after a second (see `yardstick.deviations`).
    """

    label: str
    flags: tuple[str, ...]
    tolerance: float


_STRICT = ("-O3", "-march=native", "-ffp-contract=off")

BUILDS = {
    "scalar": Build(
        "C, strict scalar", (*_STRICT, "-fno-tree-vectorize", "-fno-tree-slp-vectorize", "-DWIDTH=1"), 1e-9
    ),
    "automatic": Build("C, strict, vectorised by the compiler", (*_STRICT, "-DWIDTH=1"), 1e-9),
    "simd_strict": Build("C, SIMD, strict", (*_STRICT, "-fno-math-errno", "-fno-trapping-math", "-DWIDTH=8"), 1e-9),
    "simd": Build("C, SIMD, fast math: the limit", ("-O3", "-march=native", "-ffast-math", "-DWIDTH=8"), 1e-6),
}

_CONSTANTS: dict[str, Any] = {
    **{name: getattr(layout, name) for name in ("LANES", "CELLS", "MAX_MOVES", "MAX_PUSHES", "TIME_SLACK")},
    **{name: getattr(layout, name) for name in ("AGENT", "EQ6", "EQ6_PRINTED", "CLAMP", "HOLD", "IGNORE")},
    **{name: getattr(layout, name) for name in ("RUNNING", "ANGLE_LIMIT", "VELOCITY_LIMIT", "NOT_FINITE")},
    **{name: getattr(agonist, name) for name in ("BICEPS", "TRICEPS")},
    "FARTHEST": commands.FARTHEST,
    **{name: getattr(kernel, name) for name in ("NEGLIGIBLE", "SHAKE_STREAM")},
    **{
        name: getattr(sensors, name)
        for name in ("SENSOR_STREAMS", "ENCODER", "SLIDER_BICEPS", "SLIDER_TRICEPS", "LATENESS")
    },
    **{name: getattr(random, f"_{name}") for name in ("GOLDEN", "MIX_1", "MIX_2")},
    **{f"NOISE_{name}": getattr(random, f"_{name}") for name in ("MEAN", "DEVIATION")},
}


def find_compiler() -> str | None:
    """Return the path of the system's C compiler, or None."""
    return next((path for name in COMPILERS if (path := shutil.which(name))), None)


def declarations(alone: bool = False) -> str:
    """Return ``layout.h``: the kernel's constants and records as C sees them.

    A record of a block holds one number for each group of lanes: a scalar each, or a vector of them all. `alone`: the
    records are those of one device, with the gains of the loops that are not the paper's.
    """
    constants = {**_CONSTANTS, "LANES": 1} if alone else _CONSTANTS
    scenarios, states = (layout.SCENARIO, layout.STATE) if alone else (layout.SCENARIO_BLOCK, layout.STATE_BLOCK)
    plain = {"f8": "double", "i8": "int64_t"}
    stored = {"f8": "stored_real", "f4": "stored_float", "i1": "stored_byte", "u8": "stored_word"}
    lines = ["#include <assert.h>", "#include <stddef.h>", *define(constants)]
    lines += _struct("parameters", layout.PARAMETERS, plain)
    if alone:
        lines += _struct("loop_parameters", layout.LOOP_PARAMETERS, plain)
    lines += _struct("scenarios", scenarios, stored, "1" if alone else "LANES / WIDTH")
    lines += _struct("states", states, {"f8": "real", "i8": "integer"}, "1" if alone else "LANES / WIDTH")
    return "\n".join(lines) + "\n"


def define(constants: Mapping[str, Any]) -> list[str]:
    """Return lines that define numbers to the last bit."""
    return [
        f"#define {name} {int(value)}{'u' * isinstance(value, np.uint64)}"
        if _whole(value)
        else f"#define {name} {float(value).hex()}"
        for name, value in constants.items()
    ]


def build(name: str, folder: Path) -> Advance:
    """Compile ``tick.c`` one way and load it.

    Parameters
    ----------
    name : str
        Of `BUILDS`.
    folder : Path
        For the generated declarations and the library.

    Raises
    ------
    AmulettError
        If there is no compiler, or it refuses.
    """
    (folder / "layout.h").write_text(declarations())
    function = compile_library("tick.c", BUILDS[name].flags, folder, name).advance
    function.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_int64] * 2
    function.restype = None

    def advance(
        parameters: NDArray[np.void],
        which: NDArray[np.int64],
        scenarios: NDArray[np.void],
        states: NDArray[np.void],
        paths: layout.Paths | None,
        loop: layout.Loop | None,
        extended: bool | None,
        num_devices: int,
        ticks: int,
    ) -> None:
        if paths is not None:
            raise AmulettError(
                "the tick in C follows moves only: a scenario may have no sampled setpoint and at most "
                f"{layout.MAX_MOVES} moves"
            )
        if loop is not None:
            raise AmulettError("the tick in C has the paper's loop only")
        if which.any():
            raise AmulettError("the tick in C has devices of one profile only")
        function(parameters.ctypes.data, scenarios.ctypes.data, states.ctypes.data, num_devices, ticks)

    return advance


def compile_library(source: str, flags: tuple[str, ...], folder: Path, name: str) -> ctypes.CDLL:
    """Compile a file of this package as a shared library and load it (errors as `build`)."""
    compiler = find_compiler()
    if compiler is None:
        raise AmulettError(NO_COMPILER)
    path = Path(__file__).with_name(source)
    library, compiled = folder / f"{name}.so", folder / f"{name}.o"
    # Linked without the flags: with -ffast-math the library would flush subnormal numbers to zero in the whole process.
    for command in (
        [compiler, "-std=gnu11", "-fPIC", *flags, f"-I{folder}", "-c", str(path), "-o", str(compiled)],
        [compiler, "-shared", str(compiled), "-o", str(library), "-lm"],
    ):
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise AmulettError(f"{compiler} cannot build {source} with {' '.join(flags)}:\n{result.stderr[-2000:]}")
    return ctypes.CDLL(str(library))


def aligned(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return a copy that begins on a cache line, where a vector of a block's lanes fits without crossing one."""
    raw = np.zeros(records.nbytes + 64, dtype=np.uint8)
    start = -raw.ctypes.data % 64
    copy: NDArray[np.void] = raw[start : start + records.nbytes].view(records.dtype).reshape(records.shape)
    copy[...] = records
    return copy


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer)


def _struct(name: str, dtype: np.dtype[Any], types: dict[str, str], lanes: str = "") -> list[str]:
    """Declare a record; its size and every offset are asserted, so that C cannot see it otherwise than numpy.

    `lanes` is what C has in the place of numpy's lanes, innermost.
    """
    lines, checks = ["typedef struct {"], [f'static_assert(sizeof({name}) == {dtype.itemsize}, "{name}");']
    for field, (kind, offset, *_) in (dtype.fields or {}).items():
        base, shape = kind.subdtype or (kind, ())
        sizes = [str(size) for size in shape]
        if lanes:
            sizes = [*(sizes if lanes == "1" else sizes[:-1]), lanes]
        lines.append(f"    {types[base.str[1:]]} {field}{''.join(f'[{size}]' for size in sizes)};")
        checks.append(f'static_assert(offsetof({name}, {field}) == {offset}, "{name}.{field}");')
    return [*lines, f"}} {name};", *checks]
