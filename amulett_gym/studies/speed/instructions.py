"""Count the arithmetic instructions of the stages of tick and loops: how many of them work on several lanes at once.

Functions of the C library are named, too: a vectorised stage calls them for every lane, whatever it needs.

::

    python -m amulett_gym.studies.speed.instructions
    python -m amulett_gym.studies.speed.instructions --target x86-64-v3 --json counts.json
    python -m amulett_gym.studies.speed.instructions --record

A count is no speed, but the same on every machine: a stage is compiled for a named processor, whether or not this is
one. `instructions.json` holds the counts of two kinds of processor, with the version of LLVM; a test compares.
`--record` renews it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import types

from amulett_gym.errors import AmulettError
from amulett_gym.reporting.table import Table
from amulett_gym.simulation import commands, kernel, layout, loops, metrics, setpoint, worn
from amulett_gym.simulation.layout import (
    DRIVES,
    LOOP_BLOCK,
    LOOP_PARAMETERS,
    LOOPS,
    PARAMETERS,
    SCENARIO_BLOCK,
    STATE_BLOCK,
)
from amulett_gym.simulation.worn_layout import ARM_BLOCK, FITTING, PERSON_BLOCK, WORN_BLOCK
from amulett_gym.storage.writing import write_json

RECORDED = "instructions.json"
TARGETS = ("x86-64-v3", "icelake-server")
"""Processors without and with AVX-512, as LLVM names them."""

Counts = dict[str, dict[str, Any]]

_P, _C, _S, _M = map(numba.from_dtype, (PARAMETERS, SCENARIO_BLOCK, STATE_BLOCK, layout.MOTION_BLOCK))
_G, _Q = map(numba.from_dtype, (LOOP_PARAMETERS, LOOP_BLOCK))
_F, _H, _W, _K = map(numba.from_dtype, (FITTING, PERSON_BLOCK, WORN_BLOCK, ARM_BLOCK))
_LANES = types.uint64, types.uint64
_REACH = types.float64, types.float64, types.none
_OF_LOOPS = [
    "observe_device",
    "find_needed_torque",
    "find_torques",
    *(f"run_{name.replace('-', '_')}" for name in (*LOOPS, DRIVES)),
]
STAGES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "start_counting": (metrics.start_counting, (_P, _C, _S, _M, *_LANES)),
    "choose_agonists": (commands.choose_agonists, (_P, _S, _M, *_LANES)),
    "choose_tensions": (commands.choose_tensions, (_P, _S, *_LANES)),
    "control_tensions": (kernel.control_tensions, (_P, _S, _M, *_LANES)),
    "control_positions": (kernel.control_positions, (_P, _S, _M, *_LANES)),
    "begin_motion": (kernel.begin_motion, (_P, _C, _S, _M, *_LANES)),
    "evaluate": (kernel.evaluate, (_P, _C, _S, _M, *_LANES, *_REACH)),
    "step": (kernel.step, (_M, *_LANES, types.float64)),
    "sense": (kernel.sense, (_P, _C, _S, _M, *_LANES, types.none)),
    "follow_moves": (setpoint.follow_moves, (_P, _C, _S, *_LANES)),
    "track_steps": (metrics.track_steps, (_P, _C, _S, _M, *_LANES)),
    "note_setpoints": (loops.note_setpoints, (_P, _G, _S, _Q, *_LANES)),
    **{name: (getattr(loops, name), (_P, _G, _S, _Q, *_LANES)) for name in _OF_LOOPS},
    "worn excite": (worn.excite, (_P, _C, _S, _M, _H, _W, _K, *_LANES)),
    "worn evaluate": (worn.evaluate, (_P, _C, _S, _M, _F, _H, _W, _K, *_LANES, *_REACH)),
}
"""The stages of ticks and loops that do most of the work, with the types of their arguments."""

_ARITHMETIC = re.compile(r"v?(?:add|sub|mul|div|max|min|sqrt|round|rndscale|cmp\w*|and|andn|blendv|blendm)([ps])d")
_LIBRARY = re.compile(r"\b(cos|exp|log|pow|sin|sincos)(?:@PLT)?$")
_WIDTHS = {"zmm": 512, "ymm": 256, "xmm": 128}


def count() -> Counts:
    """Return the instructions on 64-bit floats in each stage, as this process compiles it.

    Returns
    -------
    dict
        Stage -> ``scalar``, ``packed`` (for several lanes), ``bits``, the widest registers of packed ones, and
        ``functions``, the names of those of the C library that it calls.
    """
    return {stage: counted(machine_code(stage)) for stage in STAGES}


def compiler_target() -> dict[str, Any]:
    """Return for what the kernel is compiled here.

    Returns
    -------
    dict
        ``target``: the processor, as LLVM names it; ``vector_bits``: the widest registers in the tick's longest stage,
        None where they cannot be told.
    """
    known = platform.machine() in ("x86_64", "AMD64") and not numba.config.DISABLE_JIT
    return {"target": _own_target(), "vector_bits": counted(machine_code("evaluate"))["bits"] if known else None}


def _own_target() -> str:
    return str(numba.config.CPU_NAME or llvm.get_host_cpu_name())


def machine_code(stage: str) -> str:
    """Return a stage's machine code as this process compiles it; it is compiled anew, and not kept."""
    kept, argument_types = STAGES[stage]
    function = numba.jit(**kept.targetoptions)(kept.py_func)
    function.compile(argument_types)
    (code,) = function.inspect_asm().values()
    return str(code)


def counted(code: str) -> dict[str, Any]:
    """Return the counts of a text of machine code."""
    found: dict[str, Any] = {"scalar": 0, "packed": 0, "bits": 64}
    functions = set()
    for line in code.splitlines():
        name, _, operands = line.strip().partition("\t")
        if match := _ARITHMETIC.fullmatch(name):
            packed = match[1] == "p"
            found["packed" if packed else "scalar"] += 1
            if packed:
                found["bits"] = max([found["bits"], *(bits for name, bits in _WIDTHS.items() if name in operands)])
        if match := _LIBRARY.search(operands.split(",")[0]):
            functions.add(match[1])
    return found | {"functions": sorted(functions)}


def count_for(target: str) -> Counts:
    """Return the counts for a processor, compiled in a process of its own.

    Raises
    ------
    AmulettError
        If it is no processor of this machine's architecture.
    """
    words = [sys.executable, "-m", "amulett_gym.studies.speed.instructions", "--json", "-"]
    environment = {**os.environ, "NUMBA_CPU_NAME": target, "NUMBA_CPU_FEATURES": ""}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AmulettError(
            f"nothing can be compiled here for the processor '{target}'; write LLVM's name of one of this machine's "
            f"architecture, such as {' or '.join(TARGETS)} ({done.stderr.strip().splitlines()[-1]})"
        )
    return dict(json.loads(done.stdout))


def recorded() -> dict[str, Any]:
    """Return `RECORDED`: ``llvm``, its version, and ``counts`` by processor."""
    return dict(json.loads(files(__package__).joinpath(RECORDED).read_text()))


def llvm_version() -> str:
    """Return the version of LLVM that numba uses."""
    return ".".join(map(str, llvm.llvm_version_info))


def text(counts: Mapping[str, Mapping[str, Any]], target: str) -> str:
    """Return counts as a table."""
    rows = [
        [stage, *(str(numbers[key]) for key in ("packed", "scalar", "bits")), ", ".join(numbers["functions"]) or "-"]
        for stage, numbers in counts.items()
    ]
    title = f"Instructions on 64-bit floats, compiled for {target}"
    return Table(title, ("stage", "packed", "scalar", "widest registers [bits]", "of the C library"), rows).text()


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser("python -m amulett_gym.studies.speed.instructions", None, __doc__.split("\n")[0])
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--target", metavar="NAME", help="processor, as LLVM names it (default: this one)")
    what.add_argument("--record", action="store_true", help=f"renew {RECORDED}")
    parser.add_argument("--json", metavar="FILE", help="write the counts as JSON; '-' prints them and nothing else")
    arguments = parser.parse_args()
    if arguments.record:
        content = {"llvm": llvm_version(), "counts": {target: count_for(target) for target in TARGETS}}
        write_json(Path(__file__).with_name(RECORDED), content)
        return 0
    try:
        counts = count() if arguments.target is None else count_for(arguments.target)
    except AmulettError as error:
        parser.error(str(error))
    if arguments.json == "-":
        print(json.dumps(counts))
        return 0
    print(text(counts, arguments.target or _own_target()))
    if arguments.json:
        write_json(arguments.json, counts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
