"""Bootstrap values at time limits, for all episodes of a rollout at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


class ValuesAtTimeLimits(BaseCallback):
    """Adds the critic's discounted value to the last reward of an episode that the time limit ended.

    SB3's rollouts do this one device after the other, which is slow where episodes end together. The critic stays the
    same within a rollout, so this does it once, in the rollout's last step; before, rewards lack the values. The mark
    ``TimeLimit.truncated`` is removed, so that SB3 does not add the value again. For PPO only: SAC needs the marks.
    """

    def __init__(self) -> None:
        super().__init__()
        self._places: list[tuple[int, int]] = []
        self._last: list[NDArray[np.float32]] = []

    def _on_rollout_start(self) -> None:
        self._places, self._last = [], []  # those of a rollout that was broken off, too

    def _on_step(self) -> bool:
        assert isinstance(self.model, PPO)
        infos: list[dict[str, Any]] = self.locals["infos"]
        step: int = self.locals["n_steps"]
        for device in np.flatnonzero(self.locals["dones"]).tolist():
            if infos[device].get("TimeLimit.truncated", False):
                infos[device]["TimeLimit.truncated"] = False
                self._places.append((step, device))
                self._last.append(infos[device]["terminal_observation"])
        if step == self.model.n_steps - 1 and self._places:
            self._add_values(self.model, self.locals["rewards"])
        return True

    def _add_values(self, model: PPO, rewards: NDArray[np.float32]) -> None:
        """Add the values to the rewards of the rollout, whose last step's `rewards` are not in the buffer yet."""
        with torch.no_grad():
            values = model.policy.predict_values(torch.as_tensor(np.stack(self._last), device=model.device))
        added = model.gamma * values.numpy(force=True)[:, 0]
        steps, devices = np.array(self._places).T
        model.rollout_buffer.rewards[steps, devices] += added  # SB3 overwrites the last row next
        now = steps == model.n_steps - 1
        rewards[devices[now]] += added[now]
