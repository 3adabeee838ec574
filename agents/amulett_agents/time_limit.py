"""Bootstrap values at time limits, for all devices at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


class ValuesAtTimeLimits(BaseCallback):
    """Adds the critic's discounted value to the last reward of an episode that the time limit ended.

    SB3's rollouts do this one device after the other, which is slow where episodes end together. Here the mark
    ``TimeLimit.truncated`` is removed, so that SB3 does not add the value again. For PPO only: SAC needs the marks.
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
