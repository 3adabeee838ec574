"""Test vectors: a recording of the simulation as C."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulett_gym.firmware.host import LATE, MOVE_BEGINS
from amulett_gym.firmware.numbers import defines, number
from amulett_gym.firmware.recording import Recording

MOST_DOUBLE, MOST_FLOAT = 1e-9, 1e-2
"""Largest differences of a command [rad] and of the tension setpoint [N] that `make check` accepts."""


def vectors_header(
    recording: Recording, encoder_resolution: float, slider_resolution: float, apart: float = 0.0
) -> str:
    """Return ``vectors.h`` with the first device of a recording.

    `encoder_resolution` [rad] and `slider_resolution` [m] are what a count means, 0 of an exact sensor; `apart` [N] is
    by how much a law's whole numbers may change the tension setpoint.
    """
    readings = {name: column[:, 0] for name, column in recording.readings.items()}
    outputs = [recording.outputs[name][:, 0] for name in ("biceps", "triceps", "tension_setpoint")]
    flags = MOVE_BEGINS * readings["begins"] + LATE * readings["late"]
    counts = [_counts(readings["angle"], encoder_resolution)]
    counts += [_counts(readings[name], slider_resolution) for name in ("biceps", "triceps")]
    inputs = zip(*counts, readings["setpoint"], readings["jump"], flags, strict=True)
    lines = [
        f"    {{{number(e)}, {{{number(b)}, {number(t)}}}, {number(r)}, {number(j)}, {int(f)}}},"
        for e, b, t, r, j, f in inputs
    ]
    wanted = [f"    {{{', '.join(map(number, row))}}}," for row in np.stack(outputs, axis=1).tolist()]
    begin = ", ".join(f".{name} = {_braced(np.asarray(values[0]))}" for name, values in recording.begin.items())
    most = {"VECTORS": len(lines), "VECTORS_MOST_DOUBLE": MOST_DOUBLE, "VECTORS_MOST_FLOAT": MOST_FLOAT + apart}
    return (
        "/* Generated: control ticks of the simulation, for check.c. */\n\n"
        f"{defines(most)}\nstatic const controller_begin vectors_begin = {{{begin}}};\n\n"
        "static const controller_input vectors_input[VECTORS] = {\n" + "\n".join(lines) + "\n};\n\n"
        "/* both commands [rad], tension setpoint [N] */\n"
        "static const double vectors_output[VECTORS][3] = {\n" + "\n".join(wanted) + "\n};\n"
    )


def _counts(values: NDArray[np.float64], resolution: float) -> list[float | int]:
    return [int(count) for count in np.rint(values / resolution)] if resolution else values.tolist()


def _braced(values: NDArray[np.generic]) -> str:
    return f"{{{', '.join(map(number, values.tolist()))}}}" if values.ndim else number(values.item())
