"""Compile ``amulett.wasm``: the tick in C with all control loops, which the scripts run.

``python -m amulett_gym.live.core.build`` does it, with the compiler of the package `ziglang`. The file is part of the
package, so that only who changes the C texts needs the compiler. The same compiler gives the same bytes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import resources, util
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym import FAILURES
from amulett_gym.c.build import declarations, define
from amulett_gym.envs import transition
from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.reward import COST_TERMS
from amulett_gym.errors import AmulettError, ToolMissing, install_extra
from amulett_gym.laws.bundle import PolicyDescription
from amulett_gym.laws.features import FEATURES
from amulett_gym.laws.memory import MEMORY, SPANS
from amulett_gym.laws.parametric import EQ6_TUNED, PARAMETRIC, Law
from amulett_gym.live.core.hex import FIRMWARE, OTHER_DEVICE
from amulett_gym.model.plant import GRAVITY
from amulett_gym.simulation import layout
from amulett_gym.storage.writing import atomic_path
from amulett_gym.tasks.scenario import Scenario

WASM = "amulett.wasm"

SECTION = "amulett.layout"
"""Custom section of the file: the layout of its records, names and constants that the scripts need, as JSON."""

NO_COMPILER = (
    f"there is no package 'ziglang', whose compiler makes {WASM}: {install_extra('live')}. The package holds the file; "
    "only a change of the C texts needs the compiler"
)

_FLAGS = ("-std=gnu11", "-ffp-contract=off")
_C = Path(__file__).parents[2] / "c"

_CONSTANTS: dict[str, Any] = {
    "MEMORY": 96,  # 64-bit words of a loop's memory
    "MOST_PARTS": 4096,  # of a setpoint's path
    "ENTRIES": len(transition.OBSERVATIONS),
    "READINGS": 7,
    "OUTSIDE": -2,  # the loop's index if it is the firmware's
    "PATH_MINIMUM_JERK": layout.MINIMUM_JERK,
    "NOISE_STREAM": transition._NOISE_STREAM,
    **{f"OBSERVED_{name.upper()}": scale for name, scale in transition.OBSERVATION_SCALES.items()},
}

_NO_GAINS = (
    *("loop", "force_table", "position_table", "slope_table"),
    *("integral_weight", "angle_weight", "rate_weight", "torque_weight"),  # the regulator's gains follow from them
)


def read_wasm() -> bytes:
    """Return the package's ``amulett.wasm``."""
    return resources.files("amulett_gym.live.core").joinpath(WASM).read_bytes()


def build() -> bytes:
    """Return ``amulett.wasm``, compiled from the C texts.

    Raises
    ------
    ToolMissing
        If there is no compiler.
    AmulettError
        If it refuses.
    """
    if util.find_spec("ziglang") is None:
        raise ToolMissing(NO_COMPILER)
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-O3"]
    with tempfile.TemporaryDirectory(prefix="amulett-wasm-") as temporary:
        folder = Path(temporary)
        found = objects(folder, compiler)
        # -s: no names and no paths of this computer
        options = ["-mexec-model=reactor", "-Wl,-z,stack-size=65536", "-s"]
        _run([*compiler, *options, *found, "-o", str(folder / WASM)])
        return with_section((folder / WASM).read_bytes(), SECTION, json.dumps(description()).encode())


def objects(folder: Path, compiler: Sequence[str]) -> list[str]:
    """Return the paths of the compiled C texts in a folder; AmulettError if the compiler, with its options, refuses."""
    (folder / "layout.h").write_text(declarations(alone=True))
    (folder / "device.h").write_text(device_header())
    texts = [("live.c", "live.o", []), *(("live_loop.c", f"loop_{k}.o", [f"-DLOOP={k}"]) for k in _loops())]

    def compile_text(text: tuple[str, str, list[str]]) -> str:
        source, name, options = text
        _run([*compiler, *_FLAGS, *options, f"-I{folder}", "-c", str(_C / source), "-o", str(folder / name)])
        return str(folder / name)

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(compile_text, texts))


def device_header() -> str:
    """Return ``device.h``: constants, the loops' indices, and a loop's gains as fields of a record, not as numbers."""
    names = ("force_table", "position_table", *(n for n in layout.LOOP_PARAMETERS.names or () if n not in _NO_GAINS))
    lines = [
        *define(_CONSTANTS),
        "#define LOOP_INDICES(of) " + " ".join(f"of({k})" for k in _loops()),
        "#define GAINS " + ", ".join(f".{name} = l->{name}" for name in names),
    ]
    return "\n".join(lines) + "\n"


def description() -> dict[str, Any]:
    """Return the content of the file's own section: where records have their fields, names, constants."""
    records = {
        "device": layout.PARAMETERS,
        "loop": layout.LOOP_PARAMETERS,
        "scenario": layout.SCENARIO,
        "state": layout.STATE,
        "part": layout.PATH,
    }
    return {
        "records": {name: _fields(dtype) for name, dtype in records.items()},
        "loops": layout.CONTROLS,
        "tensionLaws": layout.TENSION_LAWS,
        "laws": {law.name: _parameters(law) for law in (EQ6_TUNED, PARAMETRIC)},
        "schemas": {
            name: _plain(model.model_json_schema())
            for name, model in (("scenario", Scenario), ("policy", PolicyDescription))
        },
        "firmware": {"loop": FIRMWARE, "otherDevice": OTHER_DEVICE},
        "byStiffness": layout.BY_STIFFNESS,
        "failures": FAILURES,
        "families": layout.FAMILIES,
        "orientations": layout.ORIENTATIONS,
        "factors": layout.DEVICE_FACTORS,
        "observations": transition.OBSERVATIONS,
        "scales": transition.OBSERVATION_SCALES,
        "features": FEATURES,
        "memory": MEMORY,
        "spans": SPANS,
        "costTerms": COST_TERMS,
        "tensionRange": TENSION_RANGE,
        "feedForwardRange": FEED_FORWARD_RANGE,
        "shapes": {name: getattr(layout, name) for name in ("MINIMUM_JERK", "LINEAR", "STEPS")},
        "constants": {
            **{name: _CONSTANTS[name] for name in ("MEMORY", "MOST_PARTS", "READINGS", "OUTSIDE")},
            **{name: getattr(layout, name) for name in ("CELLS", "MAX_MOVES", "MAX_PUSHES", "ON_PATH", "RUNNING")},
            "GRAVITY": GRAVITY,
        },
    }


def _parameters(law: Law) -> list[dict[str, Any]]:
    """Return what a page shows of a law's parameters, with the ranges that they have in any loop."""
    names = ("name", "unit", "low", "high", "logarithmic", "meaning")
    found = [{name: getattr(parameter, name) for name in names} for parameter in law.parameters]
    for entry, wide in zip(found, law.over(FEED_FORWARD_RANGE).parameters, strict=True):
        entry["low"], entry["high"] = min(entry["low"], wide.low), max(entry["high"], wide.high)
    return found


def _plain(schema: Any) -> Any:
    """Return a JSON schema without titles and descriptions, which the scripts do not read."""
    if isinstance(schema, list):
        return [_plain(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    names = schema.get("properties")  # a property may be called "title", too
    plain = {k: _plain(v) for k, v in schema.items() if k not in ("title", "description", "properties")}
    return plain if names is None else {**plain, "properties": {key: _plain(value) for key, value in names.items()}}


def with_section(wasm: bytes, name: str, content: bytes) -> bytes:
    """Return a WebAssembly file with a custom section at its end."""
    body = _leb128(len(name)) + name.encode() + content
    return wasm + b"\0" + _leb128(len(body)) + body


def _leb128(value: int) -> bytes:
    """Return a number as WebAssembly writes it: seven digits a byte, the lowest first."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def _fields(dtype: np.dtype[Any]) -> dict[str, Any]:
    """Return a record's size and its fields: name -> type, offset [bytes], number of values."""
    fields = {}
    for name, (kind, offset, *_) in (dtype.fields or {}).items():
        base, shape = kind.subdtype or (kind, ())
        fields[name] = [base.str[1:], offset, int(np.prod(shape, dtype=int))]
    return {"size": dtype.itemsize, "fields": fields}


def _loops() -> Iterable[int]:
    return range(len(layout.LOOPS))


def _run(command: Sequence[str]) -> None:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise AmulettError(f"the compiler cannot build the live twin's C texts:\n{result.stderr[-2000:]}")


def main() -> None:
    """Compile the file and write it into the package."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    path = Path(__file__).with_name(WASM)
    parser.add_argument("--out", type=Path, default=path, help="file to write; by default the package's own")
    out = parser.parse_args().out
    with atomic_path(out) as temporary:
        temporary.write_bytes(build())
    print(f"{out}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
