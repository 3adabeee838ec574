"""Behaviour cloning: a network learns the actions of a data set, by supervised learning alone.

It sees what the device measures, as a policy of a recipe does, and learns the action that was taken there. Nothing acts
while it learns. So it knows only states that the recorded policies came to: where its own errors lead, it may never
have seen (Ross and Bagnell, 2010, "Efficient reductions for imitation learning"). A policy that needs more than the
network sees, such as a memory, cannot be cloned exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from amulett_agents.networks import LEAST_DEVIATION
from amulett_agents.regression import regress
from amulett_agents.validation import torch_threads
from amulett_gym import WORN_ID
from amulett_gym.datasets.reading import Demonstrations, read_demonstrations
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import (
    MANIFEST,
    Layers,
    Network,
    PolicyDescription,
    check_replaceable,
    forward,
    write_bundle,
)
from amulett_gym.laws.card import model_card
from amulett_gym.laws.features import FEATURES, WORN_FEATURES, with_features
from amulett_gym.laws.memory import MEMORY, WORN_MEMORY, Memory
from amulett_gym.laws.worn_inputs import WORN_ACTIONS, WORN_SCALES
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import Group
from amulett_gym.storage.provenance import git_revision, versions
from amulett_gym.storage.reading import user_path

_APART = 10
"""Every tenth episode is kept apart, to measure errors in it."""


class CloneSettings(Group):
    """Settings of behaviour cloning."""

    hidden: list[int] = Field([64, 64], min_length=1, max_length=8, description="sizes of the network's layers")
    memory: bool = Field(False, description="also see means over the episode so far (laws.memory)")
    gradient_steps: int = Field(5000, ge=1, le=10**7, description="gradient steps [1]")
    batch_size: int = Field(1024, ge=1, le=10**6, description="samples in a gradient step [1]")
    learning_rate: float = Field(3e-3, gt=0, le=1, description="Adam's learning rate, which falls to 0 [1]")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the network and of the samples [1]")


@dataclass(frozen=True)
class Cloned:
    """A cloned policy.

    Attributes
    ----------
    folder : Path
        Of its bundle.
    dataset : str
    policies : dict of str to int
        What it imitates: policy -> number of episodes.
    episodes, steps : int
        From which it learned.
    recorded_return : float
        Mean return of the recorded episodes.
    split : str
        Of the recorded scenarios.
    errors : dict of str to float
        Root mean square differences of its actions from the recorded ones, in episodes kept apart: ``tension`` [N],
        and where there is one ``mean_drive_angle`` [deg] or ``assistance`` [1].
    """

    folder: Path
    dataset: str
    policies: dict[str, int]
    episodes: int
    steps: int
    recorded_return: float
    split: str
    errors: dict[str, float]


def clone(
    dataset: str,
    out: str | Path,
    settings: CloneSettings | None = None,
    policy: str | None = None,
    root: str | Path | None = None,
    overwrite: bool = False,
    progress: bool = False,
    command: Sequence[str] | None = None,
) -> Cloned:
    """Clone the policies of a data set; write the result as a policy bundle.

    Parameters
    ----------
    dataset : str
        Its name or folder.
    out : str or Path
        Folder of the bundle.
    settings : CloneSettings, optional
    policy : str, optional
        Imitate only the episodes of this one.
    root : str or Path, optional
        Folder of all data sets; None: what MINARI_DATASETS_PATH names, or else Minari's own.
    overwrite : bool
        Replace a bundle in `out`.
    progress : bool
        Show progress on stderr.
    command : sequence of str, optional
        Words of the command, which are kept in the bundle.

    Raises
    ------
    AmulettError
        If the data set cannot be read (`read_demonstrations`) or has a single episode, or `out` is not free.
    """
    settings = settings or CloneSettings()
    check_replaceable(out)
    if (user_path(out) / MANIFEST).is_file() and not overwrite:
        raise AmulettError(f"'{out}' holds a policy already; choose another folder, or replace it (--overwrite)")
    data = read_demonstrations(dataset, policy, root)
    if len(data.actions) < 2:
        raise AmulettError(f"the data set '{dataset}' has 1 episode; cloning needs 2: it keeps every tenth apart")
    apart = set(range(len(data.actions))[_APART - 1 :: _APART] or [len(data.actions) - 1])
    learned = [index for index in range(len(data.actions)) if index not in apart]
    inputs = _inputs(data, settings.memory)
    with torch_threads(1), Progress(settings.gradient_steps, "cloning", "steps", progress) as bar:
        layers = _fit(_joined(inputs, learned), _joined(data.actions, learned), settings, bar)
    description = _describe(data, layers, settings.memory)
    chosen = forward(layers, description.network, _joined(inputs, sorted(apart)))
    differences = chosen.astype(np.float64) - _joined(data.actions, sorted(apart))
    errors = dict(zip(_units(description), np.sqrt(np.mean(differences**2, axis=0)).tolist(), strict=True))
    found = Cloned(
        folder=user_path(out),
        dataset=data.name,
        policies=data.policies,
        episodes=len(learned),
        steps=sum(len(data.actions[index]) for index in learned),
        recorded_return=data.mean_return,
        split=data.settings.split,
        errors={name: unit * errors[name] for name, unit in _units(description).items()},
    )
    about = {
        "algorithm": "behaviour cloning",
        "command": None if command is None else list(command),
        "config": settings.model_dump(),
        "dataset": {"name": data.name, "policies": data.policies},
        "seed": settings.seed,
        "steps": found.steps,
        "versions": versions(),
        "git_revision": git_revision(),
    }
    limit = (
        f"It imitates {', '.join(data.policies)} in states that these came to, by the data set {data.name}; its "
        f"tension setpoint differs from theirs by {found.errors['tension']:.2g} N (root mean square)."
    )
    write_bundle(out, layers, description, data.env, about, model_card(description, data.env, about, [limit]))
    return found


def _inputs(data: Demonstrations, memory: bool) -> list[NDArray[np.float32]]:
    """Return the network's inputs in each step of each episode."""
    worn, shown = data.env.id == WORN_ID, data.settings.tension_range
    size = len(WORN_OBSERVATIONS if worn else OBSERVATIONS)
    rows = [observations[:, :size].astype(np.float64) for observations in data.observations]
    means: list[Any] = _remembered(rows, worn) if memory else [None] * len(rows)
    return [
        with_features(own, shown, remembered, worn).astype(np.float32)
        for own, remembered in zip(rows, means, strict=True)
    ]


def _remembered(rows: Sequence[NDArray[np.float64]], worn: bool) -> list[NDArray[np.float32]]:
    """Return what a policy remembers in each step of each episode."""
    memory, lengths = Memory(len(rows), worn), np.array([len(own) for own in rows])
    found = [np.empty((length, memory.means.shape[1]), dtype=np.float32) for length in lengths.tolist()]
    for step in range(lengths.max()):
        running = np.flatnonzero(lengths > step)
        means = memory.add(np.stack([rows[index][step] for index in running.tolist()]), running)
        for index, own in zip(running.tolist(), means, strict=True):
            found[index][step] = own
    return found


def _fit(inputs: NDArray[np.float32], actions: NDArray[np.float32], settings: CloneSettings, bar: Progress) -> Layers:
    """Return the weights of a network that maps inputs to actions, by their squared difference."""
    torch.manual_seed(settings.seed)
    generator = np.random.default_rng(settings.seed)
    means = inputs.mean(axis=0, dtype=np.float64)
    gains = 1.0 / np.maximum(inputs.std(axis=0, dtype=np.float64), LEAST_DEVIATION)
    shown = ((inputs - means) * gains).astype(np.float32)
    sizes = [inputs.shape[1], *settings.hidden, actions.shape[1]]
    linear = [torch.nn.Linear(*pair) for pair in pairwise(sizes)]
    network = torch.nn.Sequential(*[part for layer in linear[:-1] for part in (layer, torch.nn.ReLU())], linear[-1])
    regress(network, network.parameters(), shown, actions, settings, generator, bar)
    layers = [(_array(layer.weight), _array(layer.bias)) for layer in linear]
    first, bias = layers[0]
    raw = first * gains  # the standardisation becomes part of the first layer
    layers[0] = raw, bias - raw @ means
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in layers]


def _describe(data: Demonstrations, layers: Layers, memory: bool) -> PolicyDescription:
    worn, settings = data.env.id == WORN_ID, data.settings
    remembered = list(WORN_MEMORY if worn else MEMORY)
    return PolicyDescription(
        network=Network(layers=_sizes(layers), activation="relu", output="clip"),
        observations=list(WORN_OBSERVATIONS if worn else OBSERVATIONS),
        observation_scales=dict(WORN_SCALES if worn else OBSERVATION_SCALES),
        features=list(WORN_FEATURES if worn else FEATURES),
        actions=list(WORN_ACTIONS) if worn else None,
        memory=remembered if memory else None,
        tension_range=list(settings.tension_range),
        mean_angle_range=settings.mean_angle_deg,
        agent_period=settings.agent_period,
    )


def _units(description: PolicyDescription) -> dict[str, float]:
    """Return, for each entry of an action in order, its name and what a difference of 1 stands for."""
    low, high = description.tension_range
    tension = {"tension": 0.5 * (high - low)}
    if description.is_worn:
        return {**tension, "assistance": 0.5}
    angle = description.mean_angle_range
    return tension if angle is None else {"mean_drive_angle": angle, **tension}


def _sizes(layers: Layers) -> list[int]:
    return [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]


def _joined(parts: Sequence[NDArray[np.float32]], indices: Sequence[int]) -> NDArray[np.float32]:
    return np.concatenate([parts[index] for index in indices])


def _array(tensor: torch.Tensor) -> NDArray[np.float64]:
    return tensor.detach().numpy().astype(np.float64)
