"""Extensions of SB3's policy networks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Space
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor, create_mlp

from amulett_agents.config import NetworkSettings
from amulett_gym import WORN_ID
from amulett_gym.laws.features import with_features
from amulett_gym.laws.memory import ClockedMemory
from amulett_gym.reporting.progress import Progress

ACTIVATIONS: dict[str, type[torch.nn.Module]] = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}

EPISODES = 256
SEED = 0
LEAST_DEVIATION = 0.2
"""Lower bound on an entry's standard deviation: entries are scaled by a factor of at most five."""


@dataclass(frozen=True)
class Inputs:
    """Means and standard deviations of the networks' inputs before learning, shape (entries,)."""

    means: NDArray[np.float32]
    deviations: NDArray[np.float32]


def measure_inputs(
    env_id: str,
    keywords: dict[str, Any],
    steps: int,
    first: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    history: int,
    tension_range: tuple[float, float] | None = None,
    progress: bool = False,
    memory: bool = False,
) -> Inputs:
    """Return the observations' means and deviations under a first policy, over episodes of `steps` agent steps.

    They are measured once, in fixed training scenarios: nothing drifts, and a bundle holds them within its first
    layer's weights. The environment's own scales cover every possible value, so typical velocities are below 0.04.

    Parameters
    ----------
    env_id : str
    keywords : dict
        Keywords of the environment.
    steps : int
    first : callable
        Maps observations to actions.
    history : int
        Number of stacked observations, to which the same values are applied.
    tension_range : (float, float), optional
        Tensions at action -1 and +1 [N], if features are appended.
    progress : bool
        Show progress on stderr.
    memory : bool
        Whether means over the episode are appended.
    """
    env = gym.make_vec(env_id, num_envs=EPISODES, split="train", max_episode_steps=steps, **keywords)
    remembered = ClockedMemory(env) if memory else None
    observations, seen = env.reset(seed=SEED)[0], []
    with Progress(steps, "measuring the inputs", "steps", progress) as bar:
        for step in range(steps):
            if step:
                observations = env.step(first(observations))[0]
            means = None if remembered is None else remembered.add(observations)
            seen.append(with_features(observations.astype(np.float64), tension_range, means, env_id == WORN_ID))
            bar.update()
    env.close()
    shown = np.concatenate(seen)
    means, deviations = shown.mean(axis=0), np.maximum(shown.std(axis=0), LEAST_DEVIATION)
    return Inputs(np.tile(means, history).astype(np.float32), np.tile(deviations, history).astype(np.float32))


class StandardInputs(FlattenExtractor):
    """Standardises observations by fixed means and deviations; without them, `standardise` gives them later."""

    means: torch.Tensor
    gains: torch.Tensor

    def __init__(self, observation_space: Space[Any], inputs: Inputs | None = None) -> None:
        super().__init__(observation_space)
        self.register_buffer("means", torch.zeros(self.features_dim))
        self.register_buffer("gains", torch.ones(self.features_dim))
        if inputs is not None:
            self.standardise(inputs)

    def standardise(self, inputs: Inputs) -> None:
        """Take new means and deviations."""
        self.means.copy_(torch.as_tensor(inputs.means))
        self.gains.copy_(1.0 / torch.as_tensor(inputs.deviations))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return standardised observations, shape (N, entries)."""
        features: torch.Tensor = super().forward(observations)
        return (features - self.means) * self.gains


def policy_keywords(network: NetworkSettings, critic: Literal["vf", "qf"], inputs: Inputs | None) -> dict[str, Any]:
    """Return SB3's ``policy_kwargs`` for a recipe's networks; `critic` is the algorithm's key for its critic."""
    keywords: dict[str, Any] = {
        "net_arch": {"pi": list(network.hidden), critic: list(network.critic_hidden or network.hidden)},
        "activation_fn": ACTIVATIONS[network.activation],
    }
    if inputs is not None:
        keywords |= {"features_extractor_class": StandardInputs, "features_extractor_kwargs": {"inputs": inputs}}
    return keywords


class AsymmetricNetworks(torch.nn.Module):
    """SB3's ``mlp_extractor`` with a policy that gets only the `visible` features, and a critic that gets all."""

    visible: torch.Tensor

    def __init__(
        self,
        features: int,
        visible: Sequence[int],
        hidden: Sequence[int],
        critic: Sequence[int],
        activation: type[torch.nn.Module],
    ) -> None:
        super().__init__()
        self.register_buffer("visible", torch.tensor(list(visible)))
        self.policy_net = torch.nn.Sequential(*create_mlp(len(visible), -1, list(hidden), activation))
        self.value_net = torch.nn.Sequential(*create_mlp(features, -1, list(critic), activation))
        self.latent_dim_pi, self.latent_dim_vf = hidden[-1], critic[-1]

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the last features of policy and critic."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Return the policy's last features."""
        return self.policy_net(features[:, self.visible])

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """Return the critic's last features."""
        return self.value_net(features)


class AsymmetricPolicy(ActorCriticPolicy):
    """SB3's actor-critic policy with :class:`AsymmetricNetworks`."""

    def __init__(self, *args: Any, visible: Sequence[int], **kwargs: Any) -> None:
        self.visible = list(visible)
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        sizes: Any = self.net_arch
        self.mlp_extractor = AsymmetricNetworks(  # type: ignore[assignment]
            self.features_dim, self.visible, sizes["pi"], sizes["vf"], self.activation_fn
        )


def policy_inputs(inputs: StandardInputs, networks: object) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return means and gains of the policy's inputs, which may be fewer than its critic's."""
    visible = networks.visible.numpy() if isinstance(networks, AsymmetricNetworks) else slice(None)
    return inputs.means.numpy()[visible], inputs.gains.numpy()[visible]


def visible_entries(shown: int, known: int, history: int) -> list[int]:
    """Return the indices of each observation's first `known` entries in a stack of `history`, `shown` entries each."""
    return [frame * shown + entry for frame in range(history) for entry in range(known)]
