"""The value of what follows an episode's time limit, added to PPO's rewards for all devices at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


class ValuesAtTimeLimits(BaseCallback):
    """Adds to an episode's last reward what its end would have been worth, if only the time limit ended it.

    SB3's rollouts do the same, one device after the other: a hundredth of the time that learning takes where episodes
    end together. What is added here is no longer marked as truncated, so that SB3 does not add it once more. For PPO:
    SAC's buffer wants the marks.
    """

    def _on_step(self) -> bool:
        assert isinstance(self.model, PPO)
        infos: list[dict[str, Any]] = self.locals["infos"]
        rewards: NDArray[np.float32] = self.locals["rewards"]
        ended = np.flatnonzero(self.locals["dones"]).tolist()
        truncated = [device for device in ended if infos[device].get("TimeLimit.truncated", False)]
        if truncated:
            last = np.stack([infos[device]["terminal_observation"] for device in truncated])
            with torch.no_grad():
                values = self.model.policy.predict_values(torch.as_tensor(last, device=self.model.device))
            rewards[truncated] += self.model.gamma * values.numpy(force=True)[:, 0]
            for device in truncated:
                infos[device]["TimeLimit.truncated"] = False
        return True
