"""What changes over a training run: the learning rate, the exploration, and whether the policy learns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


def learning_rate(rate: float, anneal: bool) -> float | Callable[[float], float]:
    """Return what SB3 takes for a learning rate: `rate`, or what falls from it to 0 with the share of the run left."""
    # The last rollout may end beyond total_steps: there the share is negative.
    return (lambda left: max(left, 0.0) * rate) if anneal else rate


class FadingExploration(BaseCallback):
    """Lets the exploration fall from its initial to a final standard deviation over a run, by a constant factor a step.

    Parameters
    ----------
    initial, final : float
        Standard deviation of the exploration, in the action's unit.
    """

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
    """Lets PPO's critic learn alone at the beginning of a run.

    An untrained critic's advantages are noise, by which a policy that starts from a bundle would get worse.

    Parameters
    ----------
    steps : int
        The policy learns, too, from the first rollout on that begins after so many.
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
