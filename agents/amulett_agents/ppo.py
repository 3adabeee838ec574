"""PPO of Stable-Baselines3, made from a recipe."""

from __future__ import annotations

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.networks import Inputs, TwoSightsPolicy, policy_keywords, visible_entries
from amulett_agents.schedules import learning_rate
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.laws.features import FEATURES


def make_ppo(config: TrainConfig, env: VecEnv, first_action: float, inputs: Inputs | None) -> PPO:
    """Make PPO from a recipe.

    Parameters
    ----------
    config : TrainConfig
    env : VecEnv
    first_action : float
        What its first policy does in every state: changing the tension has to be learned.
    inputs : Inputs or None
        What observations are like; None: they are taken as they are.
    """
    ppo = config.ppo
    about_policy = policy_keywords(config.network, "vf", inputs) | {"log_std_init": float(np.log(ppo.initial_std))}
    policy: str | type[TwoSightsPolicy] = "MlpPolicy"
    if sees_more(config):
        assert env.observation_space.shape is not None
        shown = env.observation_space.shape[0] // config.env.history
        known = len(OBSERVATIONS) + (len(FEATURES) if config.network.features else 0)
        policy = TwoSightsPolicy
        about_policy["visible"] = visible_entries(shown, known, config.env.history)

    model = PPO(
        policy,
        env,
        n_steps=ppo.n_steps,
        batch_size=ppo.batch_size,
        n_epochs=ppo.n_epochs,
        learning_rate=learning_rate(ppo.learning_rate, ppo.anneal),
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip_range,
        target_kl=ppo.target_kl,
        ent_coef=ppo.ent_coef,
        vf_coef=ppo.vf_coef,
        max_grad_norm=ppo.max_grad_norm,
        use_sde=ppo.use_sde,
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
        action_net.bias.fill_(first_action)
    return model


def sees_more(config: TrainConfig) -> bool:
    """Return whether a recipe's critic sees more than its policy does."""
    return config.algorithm == "ppo" and config.ppo.privileged_critic and not config.env.privileged
