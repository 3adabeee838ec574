"""A policy's network as firmware: the bundle's in double, and whole numbers that are near it."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import keep_network

import amulett_gym
from amulett_gym.envs.action import action_to_tension
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import network
from amulett_gym.firmware.export import export
from amulett_gym.firmware.host import read_defines
from amulett_gym.firmware.laws import choose
from amulett_gym.firmware.readme import begin_record, compare
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.features import FEATURES
from amulett_gym.laws.memory import MEMORY
from amulett_gym.profile import load_profile

KINDS = {
    "plain": {"activation": "relu"},
    "features": {"features": list(FEATURES), "follow": 0.4},
    "memory": {
        "features": list(FEATURES),
        "memory": list(MEMORY),
        "output": "tanh",
        "activation": "relu",
        "agent_period": 0.04,
    },
    "history": {"history": 3, "tension_range": [5.2, 14.0]},
}


def write(folder, hidden=(12, 8), scale=0.5, **about):
    """Write a bundle with a random network."""
    random = np.random.default_rng(0)
    inputs = about.get("history", 1) * (13 + len(about.get("features", ())) + len(about.get("memory", ())))
    sizes = [inputs, *hidden, 1]
    layers = [
        ((random.normal(size=(m, n)) * scale / np.sqrt(n) * 2).astype("f4"), (0.2 * random.normal(size=m)).astype("f4"))
        for n, m in pairwise(sizes)
    ]
    return keep_network(folder, layers, **about)


@pytest.mark.parametrize("kind", KINDS)
def test_in_double_a_network_is_the_bundles(firmware, kind, tmp_path):
    folder = write(tmp_path / "policy", **KINDS[kind])
    made = firmware(str(folder), numbers="int8", suite="mixed", split="shifted")
    recording = made.record(steps=40)
    assert np.ptp(recording.outputs["tension_setpoint"]) > 1.0
    found = compare(made.controller(), recording)
    assert (
        found["command"] < 1e-6 and found["tension"] < 1e-6
    )  # an action is a 32-bit number: its last digit may differ
    assert compare(made.controller("float"), recording)["tension"] < 0.5


@pytest.mark.parametrize("numbers", ["int16", "int8"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_whole_numbers_are_near(activation, numbers, tmp_path):
    bundle = read_bundle(write(tmp_path, activation=activation, hidden=(32, 32)))
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (400, 13))
    layers = network.quantised(bundle, inputs, numbers)
    found, saturated = network.forward_numbers(layers, bundle, inputs, numbers)
    exact = bundle.act(inputs)
    assert np.abs(found - exact).max() < {"int16": 2e-3, "int8": 0.06}[numbers]
    assert saturated == 0
    digits = network.DIGITS[numbers]
    for layer in layers:
        assert np.abs(layer.weights).max() < 2 ** digits[1]
        assert _largest_sum(layer, numbers) < 2 ** network.SUM_DIGITS[numbers]
        assert 0 <= layer.most < 2**31 and layer.most >> layer.shift < 2**15 and layer.factor < 2**16


@pytest.mark.parametrize("numbers", ["int16", "int8"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_large_weights(activation, numbers, tmp_path):
    weights = np.zeros((4, 13), "f4")
    weights[:, 0], weights[:, 1] = [40.0, 30.0, 20.0, 10.0], [0.0, 3.0, 0.0, 1.0]
    layers = [(weights, np.zeros(4, "f4")), (np.full((1, 4), 0.008, "f4"), np.zeros(1, "f4"))]
    bundle = read_bundle(keep_network(tmp_path, layers, activation=activation))
    inputs = np.zeros((201, 13))
    inputs[:, 0] = np.arange(-100, 101) / 127.0
    found, _ = network.forward_numbers(network.quantised(bundle, inputs, numbers), bundle, inputs, numbers)
    np.testing.assert_allclose(found, bundle.act(inputs), atol={"int16": 0.002, "int8": 0.01}[numbers])


def _largest_sum(layer, numbers):
    """Return the largest sum that a layer can have."""
    largest = 2 ** network.DIGITS[numbers][0] - 1
    return (np.abs(layer.weights).sum(axis=1) * largest + np.abs(layer.biases)).max()


@pytest.mark.parametrize("numbers", ["int16", "int8"])
@pytest.mark.parametrize(("weight", "bias"), [(0.0, 0.0), (1e6, 1e6), (1e-30, 1e6), (1e6, 0.0), (1e-38, 0.0)])
def test_no_sum_overflows_whatever_the_weights(weight, bias, numbers, tmp_path):
    sizes = [13 * 50, 4, 1]
    layers = [(np.full((m, n), weight, "f4"), np.full(m, bias, "f4")) for n, m in pairwise(sizes)]
    bundle = read_bundle(keep_network(tmp_path, layers, activation="relu", history=50))
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, (50, sizes[0]))
    found = network.quantised(bundle, inputs, numbers)
    assert max(_largest_sum(layer, numbers) for layer in found) < 2 ** network.SUM_DIGITS[numbers]
    output, _ = network.forward_numbers(found, bundle, inputs, numbers)
    assert np.isfinite(output).all() and np.abs(output).max() <= 1.0
    header = network.weights_header(bundle, found, numbers)
    assert "nan" not in header and "INFINITY" not in header


def test_saturation_is_counted(tmp_path):
    bundle = read_bundle(write(tmp_path, activation="relu"))
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (400, 13))
    layers = network.quantised(bundle, 0.2 * inputs, "int8")
    assert network.forward_numbers(layers, bundle, inputs, "int8")[1] > 0


@pytest.mark.parametrize("numbers", ["int16", "int8"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_the_controller_computes_these_whole_numbers(firmware, activation, numbers, tmp_path):
    made = firmware(str(write(tmp_path, activation=activation)), numbers=numbers, suite="steps")
    recording = made.record(steps=2, num_devices=1)
    controller = made.controller("float")
    controller.start(begin_record(controller, recording, 0))
    outputs = controller.run(controller.inputs({name: values[:, 0] for name, values in recording.readings.items()}))
    bundle = read_bundle(tmp_path)
    layers = network.quantised(bundle, network.recorded_inputs(bundle, made.settings), numbers)
    # The tension setpoint at the end of the first ramp follows from the episode's first observation.
    end = 7 + network.slices(network.jobs(bundle, numbers)) - 1
    observation, _ = TensionVectorEnv(num_envs=1, suite="steps").reset(seed=0)
    action, _ = network.forward_numbers(layers, bundle, observation.astype(np.float64), numbers)
    assert outputs["tension_setpoint"][end] == pytest.approx(action_to_tension(action[0, 0], (4.0, 15.0)), abs=2e-5)


def test_a_network_that_does_not_fit_is_refused_with_numbers(tmp_path):
    with pytest.raises(AmulettError, match=r"66 x 64 x 64 x 1 .*in int8 .* cycles .* slices .* 8 control ticks"):
        export("pretrained", "testbed", None, tmp_path)
    small = read_bundle(write(tmp_path / "small", hidden=(32, 32), features=list(FEATURES), activation="relu"))
    with pytest.raises(AmulettError, match="in int16"):
        network.choose_numbers(small, 6, 0, "int16")


@pytest.mark.parametrize(("delay", "numbers"), [(0, "int8"), (3, "int8"), (6, "int16"), (66, "float")])
def test_numbers_are_as_fine_as_the_delay_of_the_training_allows(delay, numbers, tmp_path):
    bundle = read_bundle(write(tmp_path, hidden=(32, 32), features=list(FEATURES), activation="relu"))
    assert network.choose_numbers(bundle, 200, delay) == numbers
    assert network.choose_numbers(bundle, 200, delay, "float") == "float"


def test_a_long_history_takes_time_to_move_on(tmp_path):
    short, long = (read_bundle(write(tmp_path / str(n), hidden=(4,), history=n)) for n in (1, 100))
    first, same = network.jobs(short, "int8"), network.jobs(long, "int8")
    assert same[0] - first[0] == 8 * 13 * 99
    header = network.weights_header(long, None, "int8").splitlines()
    assert ["#define", "NETWORK_COST_BEFORE", "15496"] in map(str.split, header)
    with pytest.raises(AmulettError, match="does not fit"):  # 40,000 cycles in one job
        network.choose_numbers(long, 4000, 0, "float")


def test_c_uses_all_numbers_of_the_header(tmp_path):
    bundle = read_bundle(write(tmp_path, hidden=(4,)))
    layers = network.quantised(bundle, np.zeros((1, 13)), "int8")
    names = read_defines(network.weights_header(bundle, layers, "int8")).keys()
    text = (Path(amulett_gym.__file__).parent / "c" / "law_network.c").read_text()
    assert "NETWORK_TANH_CELLS" in names and not [name for name in names if not re.search(rf"\b{name}\b", text)]


def test_weights_beyond_the_near_flash_are_refused(tmp_path):
    bundle = read_bundle(write(tmp_path, hidden=(200, 160)))
    with pytest.raises(AmulettError, match=r"in int8 its weights take 36804 bytes of flash; they may take 32000"):
        network.choose_numbers(bundle, 4000, 0)


def test_nothing_of_a_bundle_but_numbers_reaches_the_sources(tmp_path, without_chip):
    hostile = "*/ $(shell evil) `evil` | [x](http://evil)\n#include <evil.h> \\"
    files = export(str(write(tmp_path / hostile / "policy")), "testbed", None, tmp_path / "firmware")
    assert {name for name, content in files.items() if "evil" in content} <= {"README.md", "manifest.json"}
    assert "<evil.h>" not in files["README.md"]
    for name in ("device.h", "weights.h", "tables.h"):
        lines = [line for line in files[name].splitlines() if line.startswith("#include")]
        assert set(lines) <= {'#include "flash.h"'}


def test_a_range_that_32_bits_cannot_divide_by_is_refused(tmp_path):
    folder = str(write(tmp_path / "policy", tension_range=[4.0, 4.0000001]))
    with pytest.raises(AmulettError, match=r"tension_range is from 4.0 to 4.0000001 N; .* needs 0.01 N"):
        export(folder, "testbed", None, tmp_path / "firmware")


@pytest.mark.parametrize(
    ("delay", "message"),
    [("7; #define X", "valid integer"), (-1, "greater"), (8, "from 0 to 7"), ([1], "valid integer"), (None, None)],
)
def test_a_hostile_delay(delay, message, tmp_path):
    folder = str(write(tmp_path / "policy", keywords={"action_delay": delay}))
    if message is None:  # as if there was none
        assert choose(folder, load_profile("testbed"))[1].action_delay == 0
        return
    with pytest.raises(AmulettError, match=f"action_delay.*{message}"):
        choose(folder, load_profile("testbed"))


@pytest.mark.parametrize("name", ["x; system(0)", "*/", "error_5deg\n#include <evil.h>"])
def test_a_bundle_with_other_names_is_refused(name, tmp_path):
    with pytest.raises(AmulettError):
        export(str(write(tmp_path, features=[name, *FEATURES[1:]])), "testbed", None, tmp_path / "firmware")
