"""A policy's network as C: its weights as whole numbers with a scale for each layer, and what that costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.numbers import array, defines
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import Bundle, Layers
from amulett_gym.laws.memory import SPANS

Numbers = Literal["float", "int16", "int8"]

T = TypeVar("T", int, NDArray[np.int64])

DIGITS: dict[Numbers, tuple[int, int]] = {"int16": (12, 15), "int8": (7, 7)}
"""Binary digits of an activation and of a weight, beside their sign."""

SUM_DIGITS: dict[Numbers, int] = {"int16": 31, "int8": 23}
"""Binary digits of a sum, beside its sign (`dot` in ``law_network.c``)."""

SLICE = 18_000
"""Cycles that a slice of the law may take: what a control tick of 2.5 ms at 16 MHz has left beside the paper's loop."""

MOST_WEIGHT_BYTES = 32_000
"""Bytes that weights may take: all tables have to be in the first 64 kB of flash."""

BYTES: dict[Numbers, int] = {"float": 4, "int16": 2, "int8": 1}
"""Bytes of a weight."""

COSTS: dict[str, int] = {"OBSERVATION": 5200, "QUANTITIES": 8000, "MEANS": 14_000, "END": 1700, "BYTE": 8}
"""How many cycles an ATmega2560 takes, measured with simavr: before the first job, for the memory, after the layers.

And for each byte of a history that moves on.
"""

INPUT_COSTS: dict[Numbers, dict[str, int]] = {
    "float": {"ENTRY": 150, "TANH": 1600, "EXP": 2900, "PRODUCT": 250},
    "int16": {"ENTRY": 500, "TANH": 710, "EXP": 710, "PRODUCT": 250},
    "int8": {"ENTRY": 470, "TANH": 710, "EXP": 710, "PRODUCT": 250},
}
"""The same for an observation's entry, and for features."""

NEURON_COSTS: dict[Numbers, tuple[int, int]] = {"float": (300, 1600), "int16": (240, 160), "int8": (220, 160)}
"""The same for a neuron beside its weights, and for its tanh."""

WEIGHT_COSTS: dict[Numbers, int] = {"float": 350, "int16": 36, "int8": 12}
"""The same for each weight of a neuron."""

TOGETHER: dict[Numbers, int] = {"float": 1, "int16": 1, "int8": 4}
"""So many weights are taken at a time: rows are filled up with zeros."""

_CELLS, _END = 512, 8.0  # of the table of tanh
_TANH_END = 16380  # largest argument of a tanh as a whole number, rounded down; 2048 is 1, and tables end at 16384
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
        A sum in this range becomes an activation, or the argument of a tanh, by ``(sum >> shift) * factor >> 16``; a
        negative shift is one to the left.
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
        shift = fast[-1] if fast else most.bit_length() - 15
        factor = round(target * 2**16 / max(_shifted(most, shift), 1)) if most else 0
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
        values = (_shifted(sums, layer.shift) * layer.factor + 2**15) >> 16
        if tanh:
            size = np.abs(values)
            cell = size >> 6
            values = np.sign(values) * (table[cell] + (((table[cell + 1] - table[cell]) * (size & 63)) >> 6))
        else:
            values = np.maximum(values, 0)
    last = layers[-1]
    output = (values @ last.weights.T + last.biases) * last.scale
    return (np.tanh(output) if bundle.policy.network.output == "tanh" else np.clip(output, -1.0, 1.0)), saturated


def _shifted(sums: T, shift: int) -> T:
    return sums >> shift if shift >= 0 else sums << -shift


def jobs(bundle: Bundle, numbers: Numbers) -> list[int]:
    """Return about how many cycles an ATmega2560 takes for each job of an action, in order (`law_network.c`)."""
    policy, sizes = bundle.policy, bundle.policy.network.layers
    entry, tanh, exp, product = INPUT_COSTS[numbers].values()
    found = [entry] * len(policy.observations)
    found[0] += _before(bundle, numbers)
    if policy.features:
        found += [tanh] * 6 + [exp] * 2 + [product] * 7 + [tanh] * 6
    if policy.memory:
        found += [COSTS["MEANS"], COSTS["QUANTITIES"], COSTS["MEANS"], COSTS["MEANS"]]
    for size, outputs in pairwise(sizes):
        found += [_neuron_cost(bundle, numbers) + WEIGHT_COSTS[numbers] * row(size, numbers)] * outputs
    return [*found, COSTS["END"]]


def _before(bundle: Bundle, numbers: Numbers) -> int:
    """Return what the first job takes beside an entry: the observation, and a history that moves on."""
    moved = BYTES[numbers] * bundle.policy.size * (bundle.policy.history - 1)
    return COSTS["OBSERVATION"] + COSTS["BYTE"] * moved


def row(size: int, numbers: Numbers) -> int:
    """Return how many weights a neuron with so many inputs has in the firmware."""
    return -(-size // TOGETHER[numbers]) * TOGETHER[numbers]


def _neuron_cost(bundle: Bundle, numbers: Numbers) -> int:
    plain, tanh = NEURON_COSTS[numbers]
    return plain + (tanh if bundle.policy.network.activation == "tanh" else 0)


def slices(costs: list[int], most: int = SLICE) -> int:
    """Return in how many slices of at most so many cycles the firmware does the jobs, at least one in each."""
    count, spent = 1, costs[0]
    for cost in costs[1:]:
        if spent + cost > most:
            count, spent = count + 1, 0
        spent += cost
    return count


def choose_numbers(bundle: Bundle, ticks: int, delay: int, wanted: Numbers | None = None, most: int = SLICE) -> Numbers:
    """Return the numbers in which a network fits an agent period of so many control ticks: those wanted, or the best.

    These are the finest that need no more slices, of at most `most` cycles, than the `delay` of the policy's training
    [control ticks] allows, else those that need the fewest: a longer delay costs more than coarser numbers.

    Raises
    ------
    AmulettError
        If none fits.
    """
    kinds: tuple[Numbers, ...] = ("float", "int16", "int8") if wanted is None else (wanted,)
    fit = [kind for kind in kinds if not _too_much(bundle, ticks, kind, most)]
    if fit:
        return min(fit, key=lambda kind: max(slices(jobs(bundle, kind), most), delay + 1))
    sizes = " x ".join(map(str, bundle.policy.network.layers))
    raise AmulettError(
        f"the network {sizes} of '{bundle.folder}' does not fit: in {kinds[-1]} "
        f"{_too_much(bundle, ticks, kinds[-1], most)}. "
        "Train a smaller one, for example with configs/device.yaml, or with a longer env.agent_period"
    )


def _too_much(bundle: Bundle, ticks: int, numbers: Numbers, most: int) -> str:
    """Return of what a network needs too much; empty if it fits."""
    costs, sizes = jobs(bundle, numbers), bundle.policy.network.layers
    if slices(costs, most) > ticks or max(costs) > most:
        return (
            f"an action takes about {sum(costs)} cycles of an ATmega2560, {slices(costs, most)} slices of at most "
            f"{most}, one of them {max(costs)} or more; an agent period has {ticks} control ticks"
        )
    flash = sum((BYTES[numbers] * row(size, numbers) + 4) * outputs for size, outputs in pairwise(sizes))
    return (
        f"its weights take {flash} bytes of flash; they may take {MOST_WEIGHT_BYTES}"
        if flash > MOST_WEIGHT_BYTES
        else ""
    )


def weights_header(bundle: Bundle, layers: list[Layer] | None, numbers: Numbers, most: int = SLICE) -> str:
    """Return ``weights.h``; `most` are the cycles that a slice may take."""
    policy, network = bundle.policy, bundle.policy.network
    costs = {name: COSTS[name] for name in ("QUANTITIES", "MEANS", "END")} | INPUT_COSTS[numbers]
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
        "NETWORK_SLICE": most,
        "NETWORK_TOGETHER": TOGETHER[numbers],
        "NETWORK_TANH_CELLS": _CELLS,
        "NETWORK_TANH_END": _END,
        "NETWORK_COST_BEFORE": _before(bundle, numbers),
        **{f"NETWORK_COST_{name}": cost for name, cost in costs.items()},
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
    weights, biases = _joined(bundle.layers)
    real = array("table_real", "network_weights", weights) + array("table_real", "network_biases", biases)
    if layers is None:
        return f"{head}{defines(values)}\n{sizes}\n{real}\n#ifndef CONTROLLER_DOUBLE\n{_tanh_table()}#endif\n"
    digits = DIGITS[numbers][0]
    values |= {"NETWORK_DIGITS": digits, "NETWORK_SCALE": layers[-1].scale}
    kind = f"{numbers}_t"
    whole = [
        f"typedef {kind} network_weight;\ntypedef int32_t network_bias;\n",
        array("network_weight", "network_numbers", np.concatenate([_rows(layer.weights, numbers) for layer in layers])),
        array("int32_t", "network_biases", np.concatenate([layer.biases for layer in layers])),
        array("int32_t", "network_most", np.array([layer.most for layer in layers]), flash=False),
        array("int8_t", "network_shift", np.array([layer.shift for layer in layers]), flash=False),
        array("uint16_t", "network_factor", np.array([layer.factor for layer in layers]), flash=False),
        _tanh_table(),
        array("int16_t", "tanh_numbers", tanh_numbers(2**digits - 1)),
        array("int16_t", "exp_numbers", exp_numbers(2**digits - 1)),
    ]
    return f"{head}{defines(values)}\n{sizes}\n#ifdef CONTROLLER_DOUBLE\n{real}#else\n{''.join(whole)}#endif\n"


def tanh_numbers(largest: int) -> NDArray[np.int64]:
    """Return tanh as a share of `largest` at 257 points from 0 to 8."""
    return np.rint(largest * np.tanh(np.arange(257) / 32.0)).astype(np.int64)


def exp_numbers(largest: int) -> NDArray[np.int64]:
    """Return exp(-x) as a share of `largest` at 257 points from 0 to 8, the last one 0."""
    found = np.rint(largest * np.exp(-np.arange(257) / 32.0)).astype(np.int64)
    found[-1] = 0
    return found


def _rows(weights: NDArray[np.int64], numbers: Numbers) -> NDArray[np.int64]:
    """Return a layer's weights one after the other, each row filled up with zeros."""
    more = row(weights.shape[1], numbers) - weights.shape[1]
    return np.pad(weights, ((0, 0), (0, more))).ravel()


def _tanh_table() -> str:
    return array("table_real", "tanh_table", np.tanh(np.linspace(0.0, _END, _CELLS + 1)).astype(np.float32))


def _joined(layers: Layers) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the weights and the biases of all layers, one after the other."""
    weights, biases = zip(*layers, strict=True)
    return np.concatenate([weight.ravel() for weight in weights]), np.concatenate(biases)
