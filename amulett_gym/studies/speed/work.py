"""Count of the operations of a tick, by running the uncompiled kernel on numbers that count their operations.

Python runs the same text that numba compiles, so the count always matches it. Only operations on the devices' numbers
count: what a compiler can compute once for all devices and ticks, such as ``h / 2``, is assumed to be computed once.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import LANES, MOTION_BLOCK

COUNTED = ("add", "multiply", "divide", "compare", "exp", "sin", "sqrt", "floor", "table row")
FUNCTION_COST = 20
"""Additions and multiplications for which an exp or a sin counts (argument reduction, polynomial)."""


def count_work(simulation: Simulation, ticks: int = 20) -> dict[str, float]:
    """Return the mean numbers of operations of a device's tick.

    The keys are `COUNTED`, ``"loads"`` and ``"stores"`` of states and scenarios, and ``"bytes read"`` and ``"bytes
    written"`` of the different fields in them. The simulation, in the middle of its scenarios, does not advance. It
    should be small, as this is plain Python.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name in ("parameters", "scenarios", "states"):
            np.save(Path(folder) / f"{name}.npy", getattr(simulation, name))
        sizes = str(simulation.num_devices), str(ticks)
        command = [sys.executable, "-m", "amulett_gym.studies.speed.work", folder, *sizes]
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
        result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    counts: dict[str, float] = json.loads(result.stdout)
    return counts


def flops(work: dict[str, float]) -> float:
    """Return the floating-point operations of a tick, an exp or sin as `FUNCTION_COST`; comparisons are none."""
    plain = sum(work[name] for name in ("add", "multiply", "divide", "sqrt", "floor"))
    return plain + FUNCTION_COST * (work["exp"] + work["sin"])


_counts: Counter[str] = Counter()
_touched: dict[str, set[str]] = {"read": set(), "written": set()}


class Number(float):
    """A float that counts its operations."""


def _counting(method: str, what: str, times: int = 1) -> Any:
    plain = getattr(float, method)

    def operation(self: float, *others: Any) -> Any:
        _counts[what] += times
        result = plain(self, *others)
        return Number(result) if type(result) is float else result

    return operation


for _method, _what in (
    *((f"__{side}{name}__", "add") for side in ("", "r") for name in ("add", "sub")),
    *((f"__{side}mul__", "multiply") for side in ("", "r")),
    *((f"__{side}truediv__", "divide") for side in ("", "r")),
    *((f"__{name}__", "compare") for name in ("lt", "le", "gt", "ge", "eq", "ne")),
):
    setattr(Number, _method, _counting(_method, _what))
Number.__pow__ = _counting("__pow__", "multiply", 2)  # type: ignore[method-assign] # cubes, fourth powers
Number.__neg__ = lambda self: Number(-float(self))  # type: ignore[method-assign]
Number.__abs__ = lambda self: Number(abs(float(self)))  # type: ignore[method-assign]
Number.__hash__ = float.__hash__  # type: ignore[method-assign]


class _Lanes:
    """A field of a block that counts reads and writes."""

    def __init__(self, name: str, values: np.ndarray[Any, Any]) -> None:
        self.name, self.values = name, values

    def __getitem__(self, index: Any) -> Any:
        _counts["loads"] += 1
        _touched["read"].add(self.name)
        value = self.values[index]
        if value.dtype == np.uint64:
            return value
        return Number(value) if value.dtype.kind == "f" else int(value)

    def __setitem__(self, index: Any, value: Any) -> None:
        _counts["stores"] += 1
        _touched["written"].add(self.name)
        self.values[index] = value


class _Table:
    def __init__(self, values: np.ndarray[Any, Any]) -> None:
        self.values, self.shape = values, values.shape

    def __getitem__(self, index: tuple[int, int]) -> Number:
        _counts["table row"] += index[1] == 3  # every look-up reads the last coefficient of its row
        return Number(self.values[index])


def _function(name: str, plain: Any) -> Any:
    def call(value: float) -> Number:
        _counts[name] += 1
        return Number(plain(value))

    return call


def _count(folder: Path, num_devices: int, ticks: int) -> dict[str, float]:
    """Run the uncompiled kernel (in a process of its own, with ``NUMBA_DISABLE_JIT``)."""
    import math

    from amulett_gym.model import damping, plant, sensors, spring
    from amulett_gym.simulation import kernel, random, setpoint

    counting = SimpleNamespace(**vars(math))
    counting.exp, counting.sin = _function("exp", math.exp), _function("sin", math.sin)
    counting.sqrt, counting.floor = _function("sqrt", math.sqrt), _function("floor", math.floor)
    for module in (damping, plant, spring, kernel, setpoint):
        module.math = counting  # type: ignore[attr-defined]
    sensors.np = counting  # type: ignore[assignment,attr-defined]
    random.float = Number  # type: ignore[attr-defined]
    parameters, scenarios, states = (
        np.load(folder / f"{name}.npy", allow_pickle=False) for name in ("parameters", "scenarios", "states")
    )
    p = SimpleNamespace()
    for name in parameters.dtype.names:
        value = parameters[name][0]
        setattr(p, name, _Table(value) if value.ndim else value.item())
    tick: Any = kernel.tick  # it has no types
    # Values within a tick do not count as read and written: a compiler may keep them in registers.
    m = SimpleNamespace(**{name: [0.0] * LANES for name in MOTION_BLOCK.names or ()})
    blocks = (*(scenarios.dtype.fields or {}).items(), *(states.dtype.fields or {}).items())
    width = {name: kind.base.itemsize for name, (kind, *_) in blocks}
    seen = {"read": 0, "written": 0}
    np.seterr(over="ignore")
    for block in range(len(states)):
        c = SimpleNamespace(**{name: _Lanes(name, scenarios[name][block]) for name in scenarios.dtype.names})
        s = SimpleNamespace(**{name: _Lanes(name, states[name][block]) for name in states.dtype.names})
        for _ in range(ticks):
            for i in range(min(LANES, num_devices - block * LANES)):
                for fields in _touched.values():
                    fields.clear()
                tick(p, c, s, m, None, None, p.extended or None, 0, 0, i, i + 1)
                for kind, fields in _touched.items():
                    seen[kind] += sum(width[field] for field in fields)
    total = num_devices * ticks
    names = (*COUNTED, "loads", "stores")
    return {
        **{name: _counts[name] / total for name in names},
        **{f"bytes {kind}": number / total for kind, number in seen.items()},
    }


if __name__ == "__main__":
    print(json.dumps(_count(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))))
