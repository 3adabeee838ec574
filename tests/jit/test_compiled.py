"""Compiled functions: what Python and other compiled code call, and the equations without the compiler."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.core.event import Listener, install_listener

from amulett_gym.jit.compiled import compiled, compiled_for, record, types_of

STEPS = """
import json, gymnasium as gym, numpy as np, amulett_gym
env = gym.make_vec("Amulett/Tension-v0", num_envs=2, suite="mixed", privileged=True)
found = [env.reset(seed=3)[0]]
for action in (0.3, -0.8):
    observations, rewards, *_ = env.step(np.full((2, 1), action, dtype=np.float32))
    found += [observations, rewards]
print(json.dumps([part.tolist() for part in found]))
"""


def played(**variables: str) -> list[list[float]]:
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", STEPS],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_an_environment_steps_without_the_compiler():
    found, expected = played(NUMBA_DISABLE_JIT="1"), played()
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7)


CALLS = """
import json
import numpy as np
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.spring import look_up

table = np.arange(16.0).reshape(4, 4)
table.flags.writeable = False

@compiled
def twice(position):
    return 2.0 * look_up(table, position)

called = twice(0.3)
(code,) = look_up.twin.inspect_llvm().values()
(result,) = look_up.twin.overloads.values()
addresses = [result.library.get_pointer_to_function(result.fndesc.llvm_func_name)]
addresses += [result.codegen._engine.get_function_address(result.fndesc.llvm_func_name)]
loaded = sum(look_up.twin.stats.cache_hits.values())
values = look_up(table, 0.3), look_up.py_func(table, 0.3)
print(json.dumps([called, *values, code.count("@_ZN7cpython"), addresses, loaded]))
"""


def test_what_compiled_code_has_called_is_called_from_python_afterwards(tmp_path):
    """Fresh, and with code from the cache: numba's wrapper, and machine code, are only in the code for Python."""
    for times_loaded in (0, 1):
        done = subprocess.run(
            [sys.executable, "-c", CALLS],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        called, ours, python, wrappers, addresses, loaded = json.loads(done.stdout)
        assert (called, ours, wrappers, addresses) == (2.0 * python, python, 0, [0, 0])
        assert loaded == times_loaded


OBJECTS = """
from amulett_gym.jit.compiled import compiled

@compiled
def show(number):
    print("shown", (number, number))
    if number > 1:
        raise ValueError("too large", number)

@compiled
def show_all(numbers):
    for number in numbers:
        show(number)

try:
    show_all((1, 2))
except ValueError as error:
    print(error.args)
"""


def test_code_that_is_only_linked_finds_its_python_objects():
    command = [sys.executable, "-c", OBJECTS]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines() == ["shown (1, 1)", "shown (2, 2)", "('too large', 2)"]


GATHERS = """
import llvmlite.binding as llvm
from amulett_gym.jit import linked
linked.SLOW_GATHERS = {slow}
from amulett_gym.studies.speed.instructions import STAGES
stage, arguments = STAGES["evaluate"]
stage.twin.compile(arguments)
(code,) = stage.twin.inspect_llvm().values()
print("<8 x double>" in code, "@llvm.masked.gather" in code)
"""


@pytest.mark.skipif(not llvm.get_host_cpu_features().get("avx512f"), reason="other processors may have no gathers")
def test_lanes_are_loaded_one_by_one_where_gathers_are_slow(tmp_path):
    for slow, found in (("()", "True True"), ("(llvm.get_host_cpu_name(),)", "True False")):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / found)}
        command = [sys.executable, "-c", GATHERS.format(slow=slow)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
        assert done.stdout.strip() == found


OTHER_NUMBA = """
import importlib.util, sys
assert importlib.util.find_spec("amulett_gym.jit.{module}")
sys.modules["amulett_gym.jit.{module}"] = None  # cannot be imported
import numpy as np
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.spring import look_up

@compiled
def twice(table, position):
    return 2.0 * look_up(table, position)

table = np.arange(16.0).reshape(4, 4)
print(twice(table, 0.3), 2.0 * look_up.py_func(table, 0.3))
"""


@pytest.mark.parametrize("module", ["code_cache", "twin", "linked"])
def test_functions_compile_where_numba_lacks_what_one_of_our_modules_needs(module):
    command = [sys.executable, "-c", OTHER_NUMBA.format(module=module)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    ours, python = done.stdout.split()
    assert ours == python


RECORDS = np.zeros((4, 6), dtype=record([("near", "f8", (2,)), ("far", "i8")]))
NUMBERS = np.zeros((4, 6))
ARGUMENTS = {
    "nothing": (None,),
    "numbers": (True, 3, 1.5, 2j, np.float32(1.0), np.int8(1)),
    "tuples": ((), (1,), (1, 2.0), (None, (1, (NUMBERS, RECORDS))), (NUMBERS, (None, RECORDS))),
    "numbers of two dimensions": (NUMBERS, NUMBERS.T, NUMBERS[::2], NUMBERS[:1], NUMBERS[:, :1]),
    "numbers of fewer and more": (NUMBERS[0], NUMBERS[:, 0], NUMBERS[0, 0, ...], NUMBERS[None]),
    "types of numbers": tuple(NUMBERS.astype(kind) for kind in ("f4", "i8", "u1", "?", "M8[s]")),
    "records": (RECORDS, RECORDS.T, RECORDS[::2], RECORDS[0], RECORDS[0, 0], RECORDS[0, 0, ...], RECORDS[None]),
    "fields": (RECORDS["near"], RECORDS["far"]),
    "other records": (np.zeros(2, [("near", "f8"), ("far", "i8")]), np.zeros(2, [("near", "i8"), ("far", "f8")])),
    "not aligned": (
        np.zeros(2, [("first", "i1"), ("second", "f8")]),
        np.zeros(2, [("first", "i1"), ("second", "f8")])["second"],
    ),
    "without a fingerprint": (np.dtype("f8"), np.dtype("i4")),
}


def frozen(value):
    """Return a value with all its arrays read-only."""
    if isinstance(value, tuple):
        return tuple(map(frozen, value))
    if isinstance(value, np.ndarray):
        value = value[...]
        value.flags.writeable = False
    return value


@pytest.mark.parametrize("values", ARGUMENTS.values(), ids=ARGUMENTS)
def test_the_types_of_arguments_are_those_of_numba(values):
    """Those found first, and those kept, of one argument and of several."""
    for given in (values, frozen(values), [values], [frozen(values)], *zip(values), *zip(frozen(values))):
        assert types_of(given) == types_of(given) == tuple(map(numba.typeof, given))


def test_types_of_records_are_found_once(monkeypatch):
    types = types_of([RECORDS, 1.0])
    monkeypatch.setattr(numba, "typeof", None)
    assert types_of([np.ones_like(RECORDS), 2.0]) is types


def test_what_is_compiled_for_arguments_takes_others_of_their_types():
    @compiled
    def total(records, factor):
        return factor * records[0, 0].near.sum()

    code = compiled_for(total, (RECORDS, 1.0))
    assert compiled_for(total, (RECORDS, 2.0)) is code and compiled_for(total, (RECORDS[::2], 2.0)) is not code
    assert code(np.ones_like(RECORDS), 3.0) == 6.0


def test_a_function_is_compiled_once_for_all_literal_numbers():
    @compiled
    def power(base, exponent):
        return base**exponent

    @compiled
    def powers(base):
        return power(base, 2) + power(base, 3) + power(exponent=4, base=base)

    assert powers(2.0) == 28.0
    assert len(power.twin.overloads) == 1


@pytest.mark.parametrize("collects", [True, False])
def test_a_compilation_leaves_the_search_for_cycles_as_it_was(collects):
    seen = []

    @compiled
    def twice(number):
        return 2 * number

    before = gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        with install_listener("numba:compile", Watch(seen)):
            assert twice(3) == 6
        with pytest.raises(TypingError):
            twice({})
        assert gc.isenabled() == collects
    finally:
        (gc.enable if before else gc.disable)()
    assert not any(seen) and seen


class Watch(Listener):
    """Records whether Python looks for cycles when a compilation starts."""

    def __init__(self, seen: list[bool]) -> None:
        self.seen = seen

    def on_start(self, event):
        self.seen.append(gc.isenabled())

    def on_end(self, event):
        pass
