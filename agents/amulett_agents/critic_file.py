"""The critic of a bundle, with which another training can begin: ``critic.npz``, numpy's arrays without pickle."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.privileged import FLEET_SCALES, PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import CRITIC, MAX_BYTES, Bundle, Layers
from amulett_gym.laws.worn_inputs import WORN_SCALES
from amulett_gym.storage.reading import parse_arrays

_VERSION = 1
_SCALES = {**WORN_SCALES, **PRIVILEGED_SCALES, **FLEET_SCALES}


@dataclass(frozen=True)
class Critic:
    """PPO's critic: a network from standardised observations to the discounted return.

    Attributes
    ----------
    inputs : tuple of str
        Names of its inputs for one agent step, in order.
    history : int
        Number of stacked observations, the newest last.
    activation : str
        ``tanh`` or ``relu``, of every layer but the last.
    gamma, reward_scale : float
        Discount per agent step and factor on the reward of the returns that it learned.
    means, gains : ndarray of float32, shape (history * len(inputs),)
        An input is standardised as (observation - mean) * gain.
    layers : list of (ndarray, ndarray)
        Weight (outputs, inputs) and bias (outputs,), float32.
    """

    inputs: tuple[str, ...]
    history: int
    activation: str
    gamma: float
    reward_scale: float
    means: NDArray[np.float32]
    gains: NDArray[np.float32]
    layers: Layers

    @property
    def hidden(self) -> list[int]:
        """Sizes of its hidden layers."""
        return [len(bias) for _, bias in self.layers[:-1]]

    @property
    def is_privileged(self) -> bool:
        """Whether it observes what no device measures."""
        return PRIVILEGED[0] in self.inputs


def pack_critic(critic: Critic) -> bytes | None:
    """Return the content of a critic's file; None if no recipe has such hidden layers, or it is too large."""
    if not _allowed(critic.hidden):
        return None
    arrays: dict[str, Any] = {
        "version": np.array(_VERSION),
        "inputs": np.array(critic.inputs),
        "scales": _scales(critic.inputs),
        "history": np.array(critic.history),
        "activation": np.array(critic.activation),
        "gamma": np.array(critic.gamma),
        "reward_scale": np.array(critic.reward_scale),
        "means": critic.means,
        "gains": critic.gains,
    }
    for k, (weight, bias) in enumerate(critic.layers):
        arrays |= {f"layer_{k}.weight": weight, f"layer_{k}.bias": bias}
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue() if content.tell() <= MAX_BYTES else None


def critic_of_bundle(bundle: Bundle) -> Critic | None:
    """Return a bundle's critic; None if it has none.

    Raises
    ------
    AmulettError
        If the file holds something else than a critic, or one of another version or for other scales.
    """
    if bundle.critic is None:
        return None
    what = f"critic '{bundle.folder / CRITIC}'"
    arrays = parse_arrays(bundle.critic, what, MAX_BYTES)
    try:
        return _checked(arrays)
    except (KeyError, ValueError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise AmulettError(
            f"{what} cannot be used: {reason}; train again, or start from a bundle without it"
        ) from error


def _checked(arrays: dict[str, NDArray[Any]]) -> Critic:
    """Return the critic in a file's arrays; raise a KeyError or a ValueError if they are not one's."""
    if (version := _number(arrays, "version", "i")) != _VERSION:
        raise ValueError(f"its version is {version:g}; this amulett-gym reads version {_VERSION}")
    inputs, activation, history = arrays["inputs"], arrays["activation"], int(_number(arrays, "history", "i"))
    if inputs.dtype.kind != "U" or inputs.ndim != 1 or not 1 <= inputs.size == len({*inputs.tolist()}):
        raise ValueError("inputs have to be different names")
    if activation.dtype.kind != "U" or activation.shape != () or str(activation) not in ("tanh", "relu"):
        raise ValueError("activation has to be tanh or relu")
    gamma, reward_scale = _number(arrays, "gamma", "f"), _number(arrays, "reward_scale", "f")
    if not (1 <= history <= 100 and 0.0 <= gamma <= 1.0 and reward_scale > 0.0):
        raise ValueError("history has to be from 1 to 100, gamma from 0 to 1, reward_scale positive")
    names, size = tuple(inputs.tolist()), history * inputs.size
    if not np.allclose(_floats(arrays, "scales", (inputs.size,), np.float64), _scales(names), rtol=1e-12, atol=0.0):
        raise ValueError("the scales of its inputs are not those of this amulett-gym")
    means, gains = (_floats(arrays, name, (size,)) for name in ("means", "gains"))
    if not (gains > 0.0).all():
        raise ValueError("gains have to be positive")
    depth = sum(name.startswith("layer_") for name in arrays) // 2
    if len(arrays) != 9 + 2 * depth:
        raise ValueError("it holds arrays that a critic does not have")
    if not _allowed([arrays[f"layer_{k}.bias"].size for k in range(depth - 1)]):
        raise ValueError("it has to have 1 to 8 hidden layers, of 1 to 1024 units each")
    layers: Layers = []
    for k in range(depth):
        bias = arrays[f"layer_{k}.bias"]
        outputs = 1 if k == depth - 1 else bias.size
        layers.append(
            (_floats(arrays, f"layer_{k}.weight", (outputs, size)), _floats(arrays, f"layer_{k}.bias", (outputs,)))
        )
        size = outputs
    return Critic(names, history, str(activation), gamma, reward_scale, means, gains, layers)


def _allowed(hidden: list[int]) -> bool:
    """Return whether a recipe can have these sizes of hidden layers."""
    return 1 <= len(hidden) <= 8 and all(1 <= size <= 1024 for size in hidden)


def _scales(names: tuple[str, ...]) -> NDArray[np.float64]:
    """Return what an entry of 1 stands for; features and means are what they are."""
    return np.array([_SCALES.get(name, 1.0) for name in names], dtype=np.float64)


def _number(arrays: dict[str, NDArray[Any]], name: str, kind: str) -> float:
    array = arrays[name]
    if array.shape != () or array.dtype.kind != kind or not np.isfinite(array):
        raise ValueError(f"{name} has to be one finite number")
    return array.item()


def _floats(
    arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int, ...], dtype: type[np.floating[Any]] = np.float32
) -> NDArray[Any]:
    array = arrays[name]
    if array.shape != shape or array.dtype != dtype or not np.isfinite(array).all():
        raise ValueError(
            f"{name} is {array.dtype} of shape {array.shape}; it has to be {np.dtype(dtype)} of shape {shape}, finite"
        )
    return array
