"""Stable-Baselines3's SAC from a recipe."""

from __future__ import annotations

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.first_policy import FirstPolicy
from amulett_agents.networks import Inputs, policy_keywords
from amulett_agents.schedules import learning_rate

_NEARLY_ONE = 0.999
"""Bound on the first action, so that its inverse tanh is finite."""
_SAME = {
    "buffer_size",
    "learning_starts",
    "batch_size",
    "tau",
    "gamma",
    "train_freq",
    "gradient_steps",
    "target_entropy",
}
"""Settings with the same name in Stable-Baselines3."""


def make_sac(config: TrainConfig, env: VecEnv, first: FirstPolicy, inputs: Inputs | None) -> SAC:
    """Return SAC whose first policy has the constant mean of `first`; `inputs` standardise its observations."""
    sac = config.sac
    model = SAC(
        "MlpPolicy",
        env,
        **sac.model_dump(include=_SAME),
        learning_rate=learning_rate(sac.learning_rate, sac.anneal),
        ent_coef=f"auto_{sac.initial_ent_coef}" if sac.ent_coef is None else sac.ent_coef,
        stats_window_size=config.num_envs,
        policy_kwargs=policy_keywords(config.network, "qf", inputs),
        seed=config.seed,
        device="cpu",
    )
    actor = model.policy.actor
    means = np.arctanh(np.clip(first.constant.astype(np.float64), -_NEARLY_ONE, _NEARLY_ONE))
    with torch.no_grad():
        for layer, value in ((actor.mu, means), (actor.log_std, np.log(sac.initial_std))):
            assert isinstance(layer, torch.nn.Linear)
            layer.weight.zero_()
            layer.bias.copy_(torch.as_tensor(value))
    return model
