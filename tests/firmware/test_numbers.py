"""Generated C holds numbers, and names that are checked."""

import math

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.numbers import array, defines, initialiser, number


@pytest.mark.parametrize("value", [0.1, -1e-300, 5e-324, 1.7976931348623157e308, 3.0, np.float64(2.0) / 3.0])
def test_a_number_is_the_same_number_in_c(value):
    assert float(number(value)) == value and set(number(value)) <= set("0123456789+-.e")


def test_whole_numbers_and_infinity():
    assert [number(True), number(np.int64(-7)), number(math.inf), number(-math.inf)] == [
        "1",
        "-7",
        "INFINITY",
        "(-INFINITY)",
    ]
    with pytest.raises(AmulettError, match="NaN"):
        number(math.nan)


@pytest.mark.parametrize("name", ["a b", "a\n#include <x>", "", "1a", 'a"', "a;"])
def test_a_name_is_no_code(name):
    for write in (
        lambda: defines({name: 1}),
        lambda: initialiser({name: 1.0}),
        lambda: array("real", name, np.zeros(2)),
    ):
        with pytest.raises(AmulettError, match="no name"):
            write()
    with pytest.raises(AmulettError, match="no name"):
        initialiser({"table": name})


def test_arrays():
    assert array("real", "a", np.array([[1.0, 0.5]])) == "static const real a[1][2] FLASH = {\n    {1.0, 0.5},\n};\n"
    assert array("int8_t", "a", np.array([-1, 2]), flash=False) == "static const int8_t a[2] = {\n    -1, 2,\n};\n"
    assert max(map(len, array("real", "a", np.arange(100.0)).splitlines())) <= 120
