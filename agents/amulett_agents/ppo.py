"""PPO of Stable-Baselines3, made from a recipe."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.bundles import ACTIVATIONS
from amulett_agents.config import TrainConfig
from amulett_agents.networks import Inputs, StandardInputs, TwoSightsPolicy, visible_entries
from amulett_gym.envs.transition import OBSERVATIONS


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
    ppo, network = config.ppo, config.network
    sizes = {"pi": list(network.hidden), "vf": list(network.critic_hidden or network.hidden)}
    about_policy: dict[str, Any] = {
        "net_arch": sizes,
        "activation_fn": ACTIVATIONS[network.activation],
        "log_std_init": float(np.log(ppo.initial_std)),
    }
    if inputs is not None:
        about_policy |= {"features_extractor_class": StandardInputs, "features_extractor_kwargs": {"inputs": inputs}}
    policy: str | type[TwoSightsPolicy] = "MlpPolicy"
    if sees_more(config):
        assert env.observation_space.shape is not None
        shown = env.observation_space.shape[0] // config.env.history
        policy = TwoSightsPolicy
        about_policy["visible"] = visible_entries(shown, len(OBSERVATIONS), config.env.history)

    def falling(left: float) -> float:
        return max(left, 0.0) * ppo.learning_rate  # the last rollout may end beyond total_steps

    model = PPO(
        policy,
        env,
        n_steps=ppo.n_steps,
        batch_size=ppo.batch_size,
        n_epochs=ppo.n_epochs,
        learning_rate=falling if ppo.anneal else ppo.learning_rate,
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
    """Tell whether a recipe's critic sees more than its policy, for which the environment has to show it."""
    return config.algorithm == "ppo" and config.ppo.privileged_critic and not config.env.privileged


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
