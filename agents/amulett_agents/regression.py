"""Supervised learning of actions, for imitation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from amulett_gym.reporting.progress import Progress

_CHUNK = 50
"""Gradient steps between two reports of progress."""


class Plan(Protocol):
    """How long, and how fast: of `teacher_settings.TeacherSettings` or `cloning.CloneSettings`."""

    @property
    def gradient_steps(self) -> int:
        """Number of gradient steps."""

    @property
    def batch_size(self) -> int:
        """Samples in each."""

    @property
    def learning_rate(self) -> float:
        """Adam's learning rate at the start; it falls to 0."""


def regress(
    predict: Callable[[torch.Tensor], torch.Tensor],
    parameters: Iterable[torch.nn.Parameter],
    inputs: NDArray[np.float32],
    wanted: NDArray[np.float32],
    plan: Plan,
    generator: np.random.Generator,
    bar: Progress,
) -> None:
    """Fit parameters so that what is predicted from inputs has the least squared difference from what is wanted.

    Parameters
    ----------
    predict : callable
        Inputs, shape (batch, entries) -> actions, shape (batch, actions), by the parameters.
    parameters : iterable of Parameter
    inputs, wanted : ndarray of float32, shape (samples, entries) and (samples, actions)
    plan : Plan
    generator : numpy.random.Generator
        Draws the batches.
    bar : Progress
        Advanced by one for each gradient step.
    """
    optimizer = torch.optim.Adam(parameters, plan.learning_rate)
    for step in range(plan.gradient_steps):
        optimizer.param_groups[0]["lr"] = plan.learning_rate * (1.0 - step / plan.gradient_steps)
        batch = generator.integers(len(inputs), size=plan.batch_size)
        shown, named = torch.from_numpy(inputs[batch]), torch.from_numpy(wanted[batch])
        loss = torch.nn.functional.mse_loss(predict(shown), named)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        if (step + 1) % _CHUNK == 0:
            bar.update(_CHUNK)
