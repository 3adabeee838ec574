"""Schedules over a training run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


def learning_rate(rate: float, anneal: bool) -> float | Callable[[float], float]:
    """Return SB3's learning rate: constant, or falling linearly from `rate` to 0."""
    # The last rollout may end beyond total_steps, with a negative share left.
    return (lambda left: max(left, 0.0) * rate) if anneal else rate


class FadingExploration(BaseCallback):
    """Reduces the exploration's standard deviation, in the action's unit, exponentially from `initial` to `final`."""

    def __init__(self, initial: float, final: float) -> None:
        super().__init__()
        self.initial, self.final = initial, final

    def _on_rollout_start(self) -> None:
        passed = 1.0 - self.model._current_progress_remaining
        log_std: torch.nn.Parameter = self.model.policy.log_std  # type: ignore[assignment]
        with torch.no_grad():
            log_std.fill_((1.0 - passed) * np.log(self.initial) + passed * np.log(self.final))
        log_std.requires_grad_(False)

    def _on_step(self) -> bool:
        return True


class CriticFirst(BaseCallback):
    """Trains only PPO's critic until the first rollout that begins after `steps` agent steps.

    An untrained critic's advantages are noise, which would make a policy from a bundle worse.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps

    def _on_rollout_end(self) -> None:  # not at its start: a resumed run's steps are restored there
        model = self.model
        assert isinstance(model, PPO)
        begun = model.num_timesteps - model.n_steps * model.n_envs
        for part in (model.policy.mlp_extractor.policy_net, model.policy.action_net):
            part.requires_grad_(begun >= self.steps)

    def _on_step(self) -> bool:
        return True
