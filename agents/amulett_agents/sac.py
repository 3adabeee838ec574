"""SAC of Stable-Baselines3, made from a recipe."""

from __future__ import annotations

import math

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.networks import Inputs, policy_keywords
from amulett_agents.schedules import learning_rate

_NEARLY_ONE = 0.999
"""Where tanh is cut off: a first policy at an end of the range has to be a finite number before it."""


def make_sac(config: TrainConfig, env: VecEnv, first_action: float, inputs: Inputs | None) -> SAC:
    """Make SAC from a recipe.

    Parameters
    ----------
    config : TrainConfig
    env : VecEnv
    first_action : float
        What its first policy does in every state, but for the exploration.
    inputs : Inputs or None
        What observations are like; None: they are taken as they are.
    """
    sac = config.sac
    model = SAC(
        "MlpPolicy",
        env,
        learning_rate=learning_rate(sac.learning_rate, sac.anneal),
        buffer_size=sac.buffer_size,
        learning_starts=sac.learning_starts,
        batch_size=sac.batch_size,
        tau=sac.tau,
        gamma=sac.gamma,
        train_freq=sac.train_freq,
        gradient_steps=sac.gradient_steps,
        ent_coef=f"auto_{sac.initial_ent_coef}" if sac.ent_coef is None else sac.ent_coef,
        target_entropy=sac.target_entropy,
        stats_window_size=config.num_envs,
        policy_kwargs=policy_keywords(config.network, "qf", inputs),
        seed=config.seed,
        device="cpu",
    )
    actor = model.policy.actor
    mean = math.atanh(min(max(first_action, -_NEARLY_ONE), _NEARLY_ONE))
    with torch.no_grad():
        for layer, value in ((actor.mu, mean), (actor.log_std, math.log(sac.initial_std))):
            assert isinstance(layer, torch.nn.Linear)
            layer.weight.zero_()
            layer.bias.fill_(value)
    return model
