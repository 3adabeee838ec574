"""Count the arithmetic instructions of the stages of tick and loops: how many of them work on several lanes at once.

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
from amulett_gym.simulation import kernel, layout, loops
from amulett_gym.simulation.layout import (
    DRIVES,
    LOOP_BLOCK,
    LOOP_PARAMETERS,
    LOOPS,
    PARAMETERS,
    SCENARIO_BLOCK,
    STATE_BLOCK,
)
from amulett_gym.storage.writing import write_json

RECORDED = "instructions.json"
TARGETS = ("x86-64-v3", "icelake-server")
"""Processors without and with AVX-512, as LLVM names them."""

Counts = dict[str, dict[str, int]]

_P, _C, _S, _M = map(numba.from_dtype, (PARAMETERS, SCENARIO_BLOCK, STATE_BLOCK, layout.MOTION_BLOCK))
_G, _Q = map(numba.from_dtype, (LOOP_PARAMETERS, LOOP_BLOCK))
_LANES = types.uint64, types.uint64
STAGES: dict[str, tuple[Any, ...]] = {
    "start_counting": (_P, _C, _S, _M, *_LANES),
    "run_paper_loop": (_P, _S, _M, *_LANES),
    "begin_motion": (_P, _C, _S, _M, *_LANES),
    "evaluate": (_P, _C, _S, _M, *_LANES, types.float64, types.float64, types.none),
    "step": (_M, *_LANES, types.float64),
    "sense": (_P, _C, _S, _M, *_LANES, types.none),
    "follow_moves": (_P, _C, _S, *_LANES),
    "track_steps": (_P, _C, _S, _M, *_LANES),
    "observe_device": (_P, _G, _S, _Q, *_LANES),
    **{f"run_{loop.replace('-', '_')}": (_P, _G, _S, _Q, *_LANES) for loop in (*LOOPS, DRIVES)},
}
"""The stages of `simulation.kernel` and `simulation.loops` that do most of the work -> types of their arguments."""

_ARITHMETIC = re.compile(r"v?(?:add|sub|mul|div|max|min|sqrt|round|rndscale|cmp\w*|and|andn|blendv|blendm)([ps])d")
_WIDTHS = {"zmm": 512, "ymm": 256, "xmm": 128}


def count() -> Counts:
    """Return the instructions on 64-bit floats in each stage, as this process compiles it.

    Returns
    -------
    dict
        Stage -> ``scalar``, ``packed`` (for several lanes) and ``bits``, the widest registers of packed ones.
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
    kept = getattr(loops if hasattr(loops, stage) else kernel, stage)
    function = numba.jit(**kept.targetoptions)(kept.py_func)
    function.compile(STAGES[stage])
    (code,) = function.inspect_asm().values()
    return str(code)


def counted(code: str) -> dict[str, int]:
    """Return the counts of a text of machine code."""
    found = {"scalar": 0, "packed": 0, "bits": 64}
    for line in code.splitlines():
        name, _, operands = line.strip().partition("\t")
        if match := _ARITHMETIC.fullmatch(name):
            packed = match[1] == "p"
            found["packed" if packed else "scalar"] += 1
            if packed:
                found["bits"] = max([found["bits"], *(bits for name, bits in _WIDTHS.items() if name in operands)])
    return found


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


def text(counts: Mapping[str, Mapping[str, int]], target: str) -> str:
    """Return counts as a table."""
    rows = [[stage, *(str(numbers[key]) for key in ("packed", "scalar", "bits"))] for stage, numbers in counts.items()]
    title = f"Instructions on 64-bit floats, compiled for {target}"
    return Table(title, ("stage", "packed", "scalar", "widest registers [bits]"), rows).text()


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
