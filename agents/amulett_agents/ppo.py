"""Stable-Baselines3's PPO from a recipe."""

from __future__ import annotations

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.first_policy import FirstPolicy
from amulett_agents.networks import AsymmetricPolicy, Inputs, policy_keywords, visible_entries
from amulett_agents.schedules import learning_rate
from amulett_gym import WORN_ID
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.laws.features import FEATURES
from amulett_gym.laws.memory import MEMORY

_SAME = {
    *("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "target_kl"),
    *("ent_coef", "vf_coef", "max_grad_norm", "use_sde"),
}
"""Settings with the same name in Stable-Baselines3."""


def make_ppo(config: TrainConfig, env: VecEnv, first: FirstPolicy, inputs: Inputs | None) -> PPO:
    """Return PPO that begins with the policy `first`; `inputs` standardise its observations."""
    ppo = config.ppo
    about_policy = policy_keywords(config.network, "vf", inputs) | {"log_std_init": float(np.log(ppo.initial_std))}
    policy: str | type[AsymmetricPolicy] = "MlpPolicy"
    if has_privileged_critic(config):
        assert env.observation_space.shape is not None
        shown = env.observation_space.shape[0] // config.env.history
        known = len(OBSERVATIONS) + (len(FEATURES) if config.network.features else 0)
        known += len(MEMORY) if config.network.memory else 0
        policy = AsymmetricPolicy
        about_policy["visible"] = visible_entries(shown, known, config.env.history)

    model = PPO(
        policy,
        env,
        **ppo.model_dump(include=_SAME),
        learning_rate=learning_rate(ppo.learning_rate, ppo.anneal),
        sde_sample_freq=ppo.sde_sample_freq if ppo.use_sde else -1,
        stats_window_size=config.num_envs,
        policy_kwargs=about_policy,
        seed=config.seed,
        device="cpu",
    )
    action_net = model.policy.action_net
    assert isinstance(action_net, torch.nn.Linear)
    with torch.no_grad():
        action_net.weight.zero_()
        action_net.bias.copy_(torch.as_tensor(first.constant))
    return model


def has_privileged_critic(config: TrainConfig) -> bool:
    """Return whether a recipe's critic gets more observations than its policy; there are none in `Amulett/Worn-v0`."""
    wanted = config.ppo.privileged_critic and config.env.id != WORN_ID
    return config.algorithm == "ppo" and wanted and not config.env.privileged
