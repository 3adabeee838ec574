"""A policy's network as C: its weights as whole numbers with a scale for each layer, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.numbers import array, defines
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import Bundle
from amulett_gym.laws.memory import SPANS

Numbers = Literal["float", "int16", "int8"]

DIGITS: dict[Numbers, tuple[int, int]] = {"int16": (12, 15), "int8": (7, 7)}
"""Binary digits of an activation and of a weight, beside their sign."""

SUM_DIGITS: dict[Numbers, int] = {"int16": 31, "int8": 23}
"""Binary digits of a sum, beside its sign (`dot` in ``law_network.c``)."""

SLICE = 14_600
"""Cycles that a slice of the law may take: what a control tick of 2.5 ms at 16 MHz has left beside the loop."""

COSTS: dict[str, int] = {"OBSERVATION": 5000, "TANH": 1450, "EXP": 2700, "SUM": 250, "QUANTITIES": 7700, "MEANS": 7000}
"""How many cycles an ATmega2560 takes for a job, measured with simavr."""

FILL_COSTS: dict[Numbers, int] = {"float": 100, "int16": 520, "int8": 465}
"""The same for an input of the first layer."""

NEURON_COSTS: dict[Numbers, tuple[int, int]] = {"float": (600, 1600), "int16": (600, 400), "int8": (470, 400)}
"""The same for a neuron beside its weights, and for its tanh."""

WEIGHT_COSTS: dict[Numbers, int] = {"float": 350, "int16": 36, "int8": 16}
"""The same for each weight of a neuron."""

_CELLS, _END = 512, 8.0  # of the table of tanh
_TANH_END = 16383  # largest argument of a tanh as a whole number; 2048 is 1
_ROOM = 1.1  # an activation's range over the largest recorded one


@dataclass(frozen=True)
class Layer:
    """A layer in whole numbers.

    Attributes
    ----------
    weights, biases : ndarray of int
        Shapes (outputs, inputs) and (outputs,).
    scale : float
        What one unit of a sum stands for.
    most : int
        Sum from which an activation is at the end of its range.
    shift, factor : int
        A sum in this range becomes an activation, or the argument of a tanh, by ``(sum >> shift) * factor >> 15``.
    """

    weights: NDArray[np.int64]
    biases: NDArray[np.int64]
    scale: float
    most: int = 0
    shift: int = 0
    factor: int = 0


def recorded_inputs(bundle: Bundle, settings: Settings, steps: int = 150, num_devices: int = 24) -> NDArray[np.float64]:
    """Return inputs of a policy's network, shape (steps * num_devices, inputs), from `mixed`, split train."""
    own = {"tension_range": settings.tension_range, "suite": "mixed", "split": "train"}
    env = TensionVectorEnv(**{**settings.given, **own}, num_envs=num_devices)
    actor, found = Actor(bundle.layers, bundle.policy, env), list[NDArray[np.float64]]()
    observations, _ = env.reset(seed=0)
    for _ in range(steps):
        found.append(actor.inputs(observations))
        observations, *_ = env.step(actor(observations))
    return np.concatenate(found)


def quantised(bundle: Bundle, inputs: NDArray[np.float64], numbers: Numbers) -> list[Layer]:
    """Return the layers in whole numbers; ranges of activations are those of the inputs, and some more.

    No sum can overflow.
    """
    digits, weight_digits = DIGITS[numbers]
    largest, tanh = 2**digits - 1, bundle.policy.network.activation == "tanh"
    values, unit, found = inputs, 1.0 / largest, list[Layer]()
    for k, (weight, bias) in enumerate(bundle.layers):
        w, b = weight.astype(np.float64), bias.astype(np.float64)
        steepest = max(float(np.abs(w).max()), 1e-30)
        reach = float((np.abs(w).sum(axis=1) * largest + np.abs(b) / unit).max())
        scale = max(steepest / (2**weight_digits - 1), reach / (2 ** SUM_DIGITS[numbers] - 2 ** (digits + 12)), 1e-30)
        layer = {"weights": np.rint(w / scale).astype(np.int64), "scale": scale * unit}
        layer["biases"] = np.rint(b / (scale * unit)).astype(np.int64)
        if k == len(bundle.layers) - 1:
            found.append(Layer(**layer))
            break
        sums = values @ w.T + b
        values = np.tanh(sums) if tanh else np.maximum(sums, 0.0)
        end = _TANH_END / 2048.0 if tanh else _ROOM * max(float(values.max()), 1e-3)
        most = min(int(end / (scale * unit)), 2**31 - 2)
        target = _TANH_END if tanh else largest
        fast = [shift for shift in (0, 8, 16) if target < most >> shift < 2**15]
        shift = fast[-1] if fast else max(most.bit_length() - 15, 0)
        factor = min(round(target * 2**15 / max(most >> shift, 1)), 2**15 - 1)
        found.append(Layer(**layer, most=most, shift=shift, factor=factor))
        unit = 1.0 / largest if tanh else end / largest
    return found


def forward_numbers(
    layers: list[Layer], bundle: Bundle, inputs: NDArray[np.float64], numbers: Numbers
) -> tuple[NDArray[np.float64], int]:
    """Return the network's output in whole numbers as the firmware computes it, and how many activations saturated."""
    largest, tanh = 2 ** DIGITS[numbers][0] - 1, bundle.policy.network.activation == "tanh"
    scaled = inputs.astype(np.float32) * np.float32(largest)
    values = (np.sign(scaled) * np.floor(np.abs(scaled) + np.float32(0.5))).astype(np.int64)
    table = tanh_numbers(largest)
    saturated = 0
    for layer in layers[:-1]:
        sums = values @ layer.weights.T + layer.biases
        over = np.abs(sums) > layer.most
        saturated += int((over & ((sums > 0) | tanh)).sum())
        sums = np.clip(sums, -layer.most, layer.most)
        values = ((sums >> layer.shift) * layer.factor + 16384) >> 15
        if tanh:
            size = np.abs(values)
            cell = size >> 6
            values = np.sign(values) * (table[cell] + (((table[cell + 1] - table[cell]) * (size & 63)) >> 6))
        else:
            values = np.maximum(values, 0)
    last = layers[-1]
    output = (values @ last.weights.T + last.biases) * last.scale
    return (np.tanh(output) if bundle.policy.network.output == "tanh" else np.clip(output, -1.0, 1.0)), saturated


def jobs(bundle: Bundle, numbers: Numbers) -> list[int]:
    """Return about how many cycles an ATmega2560 takes for each job of an action, in order (`law_network.c`)."""
    policy, sizes = bundle.policy, bundle.policy.network.layers
    found = (
        [COSTS["TANH"]] * 6 + [COSTS["EXP"]] * 2 + [COSTS["SUM"]] * 7 + [COSTS["TANH"]] * 6 if policy.features else []
    )
    if policy.memory:
        found += [COSTS["MEANS"], COSTS["QUANTITIES"], COSTS["MEANS"], COSTS["MEANS"]]
    found += [FILL_COSTS[numbers]] * policy.size
    for size, outputs in pairwise(sizes):
        found += [_neuron_cost(bundle, numbers) + WEIGHT_COSTS[numbers] * size] * outputs
    return found


def _neuron_cost(bundle: Bundle, numbers: Numbers) -> int:
    plain, tanh = NEURON_COSTS[numbers]
    return plain + (tanh if bundle.policy.network.activation == "tanh" else 0)


def slices(costs: list[int]) -> int:
    """Return in how many slices the firmware does the jobs: as many as fit into each, at least one."""
    count, spent = 1, COSTS["OBSERVATION"] + costs[0]
    for cost in costs[1:]:
        if spent + cost > SLICE:
            count, spent = count + 1, 0
        spent += cost
    return count


def choose_numbers(bundle: Bundle, ticks: int, wanted: Numbers | None) -> Numbers:
    """Return the numbers in which a network fits an agent period of so many control ticks: those wanted, or the finest.

    Raises
    ------
    AmulettError
        If none fits.
    """
    kinds: tuple[Numbers, ...] = ("float", "int16", "int8") if wanted is None else (wanted,)
    for kind in kinds:
        costs = jobs(bundle, kind)
        if slices(costs) <= ticks and max(costs) <= SLICE:
            return kind
    sizes, costs = " x ".join(map(str, bundle.policy.network.layers)), jobs(bundle, kinds[-1])
    raise AmulettError(
        f"the network {sizes} of '{bundle.folder}' does not fit: in {kinds[-1]} an action takes about {sum(costs)} "
        f"cycles of an ATmega2560, {slices(costs)} slices of at most {SLICE}; an agent period has {ticks} control "
        "ticks. Train a smaller one, for example with network.hidden=[32, 32] and without memory, or with a longer "
        "env.agent_period"
    )


def weights_header(bundle: Bundle, layers: list[Layer] | None, numbers: Numbers) -> str:
    """Return ``weights.h``."""
    policy, network = bundle.policy, bundle.policy.network
    values: dict[str, float | int] = {
        "NETWORK_BITS": {"float": 0, "int16": 16, "int8": 8}[numbers],
        "NETWORK_FEATURES": int(bool(policy.features)),
        "NETWORK_MEMORY": int(policy.memory is not None),
        "NETWORK_HISTORY": policy.history,
        "NETWORK_SIZE": policy.size,
        "NETWORK_LAYERS": len(bundle.layers),
        "NETWORK_WIDEST": max(network.layers[1:]),
        "NETWORK_TANH": int(network.activation == "tanh"),
        "NETWORK_OUTPUT_TANH": int(network.output == "tanh"),
        "NETWORK_FOLLOW": policy.follow,
        "NETWORK_SHORT": SPANS[0],
        "NETWORK_LONG": SPANS[1],
        "NETWORK_SLICE": SLICE,
        **{f"NETWORK_COST_{name}": cost for name, cost in COSTS.items()},
        "NETWORK_COST_FILL": FILL_COSTS[numbers],
        "NETWORK_COST_NEURON": _neuron_cost(bundle, numbers),
        "NETWORK_COST_WEIGHT": WEIGHT_COSTS[numbers],
        "LAW_ERROR_DEG": math.degrees(OBSERVATION_SCALES["position_error"]),
        "LAW_VELOCITY_DEG": math.degrees(OBSERVATION_SCALES["joint_velocity"]),
        "LAW_COMMAND_DEG": math.degrees(OBSERVATION_SCALES["command"]),
    }
    head = (
        "/* Generated: the network, its layers one after the other, each with a row of weights for each neuron. */\n\n"
    )
    sizes = array("uint16_t", "network_sizes", np.array(network.layers), flash=False)
    real = _real_weights(bundle)
    if layers is None:
        return f"{head}{defines(values)}\n{sizes}\n{real}\n#ifndef CONTROLLER_DOUBLE\n{_tanh_table()}#endif\n"
    digits = DIGITS[numbers][0]
    values |= {"NETWORK_DIGITS": digits, "NETWORK_SCALE": layers[-1].scale}
    kind = f"{numbers}_t"
    whole = [
        f"typedef {kind} network_weight;\n",
        array("network_weight", "network_numbers", np.concatenate([layer.weights.ravel() for layer in layers])),
        array("int32_t", "network_biases", np.concatenate([layer.biases for layer in layers])),
        array("int32_t", "network_most", np.array([layer.most for layer in layers]), flash=False),
        array("uint8_t", "network_shift", np.array([layer.shift for layer in layers]), flash=False),
        array("int16_t", "network_factor", np.array([layer.factor for layer in layers]), flash=False),
        _tanh_table(),
    ]
    if network.activation == "tanh":
        whole.append(array("int16_t", "tanh_numbers", tanh_numbers(2**digits - 1)))
    return f"{head}{defines(values)}\n{sizes}\n#ifdef CONTROLLER_DOUBLE\n{real}#else\n{''.join(whole)}#endif\n"


def tanh_numbers(largest: int) -> NDArray[np.int64]:
    """Return tanh as a share of `largest` at 257 points from 0 to 8."""
    return np.rint(largest * np.tanh(np.arange(257) / 32.0)).astype(np.int64)


def _tanh_table() -> str:
    return array("table_real", "tanh_table", np.tanh(np.linspace(0.0, _END, _CELLS + 1)).astype(np.float32))


def _real_weights(bundle: Bundle) -> str:
    weights: list[NDArray[Any]] = [weight.ravel() for weight, _ in bundle.layers]
    biases: list[NDArray[Any]] = [bias for _, bias in bundle.layers]
    return array("table_real", "network_weights", np.concatenate(weights)) + array(
        "table_real", "network_bias", np.concatenate(biases)
    )
