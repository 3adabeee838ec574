"""PPO of Stable-Baselines3: made from a recipe, and kept as a policy bundle."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecFrameStack, unwrap_vec_wrapper

import amulett_gym
from amulett_agents.adapter import make_sb3_env
from amulett_agents.config import TrainConfig
from amulett_gym.config import profile_names
from amulett_gym.envs.privileged import PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import Layers, Network, PolicyDescription, TrainingEnv, write_bundle
from amulett_gym.laws.policies import tension_to_action

_ACTIVATIONS: dict[str, type[torch.nn.Module]] = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
_PACKAGES = ("amulett-gym", "gymnasium", "numpy", "numba", "torch", "stable-baselines3")


class ScaledRewards(VecEnvWrapper):
    """Rewards times a fixed factor: what PPO learns from; the environment inside logs returns as they are."""

    def __init__(self, venv: VecEnv, factor: float) -> None:
        super().__init__(venv)
        self.factor = factor

    def reset(self) -> Any:
        """Start an episode with all devices."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Take one step with all devices."""
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, rewards * np.float32(self.factor), dones, infos


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


def exploration(config: TrainConfig) -> list[BaseCallback]:
    """Return what a recipe's exploration needs besides the model: callbacks for its `learn`."""
    ppo = config.ppo
    return [] if ppo.final_std is None else [FadingExploration(ppo.initial_std, ppo.final_std)]


def make_model(config: TrainConfig, tensorboard: str | Path | None = None) -> PPO:
    """Make PPO and its training environment from a recipe.

    Parameters
    ----------
    config : TrainConfig
    tensorboard : str or Path, optional
        Folder for TensorBoard's files; none are written without.

    Returns
    -------
    stable_baselines3.PPO
        Its first policy is a constant tension.

    Raises
    ------
    AmulettError
        If the environment refuses its settings.
    """
    env_settings, ppo, network = config.env, config.ppo, config.network
    env: VecEnv = make_sb3_env(
        env_settings.id,
        config.num_envs,
        split="train",
        max_episode_steps=env_settings.max_episode_steps,
        **env_settings.keywords(),
    )
    if env_settings.history > 1:
        env = VecFrameStack(env, env_settings.history)

    def falling(left: float) -> float:
        return left * ppo.learning_rate

    model = PPO(
        "MlpPolicy",
        ScaledRewards(env, ppo.reward_scale),
        n_steps=ppo.n_steps,
        batch_size=ppo.batch_size,
        n_epochs=ppo.n_epochs,
        learning_rate=falling if ppo.anneal else ppo.learning_rate,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip_range,
        ent_coef=ppo.ent_coef,
        vf_coef=ppo.vf_coef,
        max_grad_norm=ppo.max_grad_norm,
        use_sde=ppo.use_sde,
        sde_sample_freq=ppo.sde_sample_freq if ppo.use_sde else -1,
        stats_window_size=config.num_envs,
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        policy_kwargs={
            "net_arch": list(network.hidden),
            "activation_fn": _ACTIVATIONS[network.activation],
            "log_std_init": float(np.log(ppo.initial_std)),
        },
        seed=config.seed,
        device="cpu",
    )
    _start_as_constant(model.policy, network.initial_tension, tuple(env_settings.tension_range))
    return model


def extract_network(policy: ActorCriticPolicy) -> tuple[Layers, Network]:
    """Return the weights of a policy's deterministic action, and what they are the weights of.

    Raises
    ------
    AmulettError
        If the policy is no plain ``MlpPolicy`` with tanh or ReLU.
    """
    if not isinstance(policy, ActorCriticPolicy) or not isinstance(policy.features_extractor, FlattenExtractor):
        raise AmulettError(f"only an actor-critic MlpPolicy can become a bundle, not {type(policy).__name__}")
    names = {kind: name for name, kind in _ACTIVATIONS.items()}
    kind = policy.activation_fn
    if kind not in names:
        raise AmulettError(f"the activation {kind.__name__} cannot be kept in a bundle; use Tanh or ReLU")
    linear = [module for module in policy.mlp_extractor.policy_net if isinstance(module, torch.nn.Linear)]
    if not isinstance(policy.action_net, torch.nn.Linear):
        raise AmulettError("the policy's action is no linear function of its features")
    linear.append(policy.action_net)
    layers = [
        (layer.weight.detach().cpu().numpy().copy(), layer.bias.detach().cpu().numpy().copy()) for layer in linear
    ]
    sizes = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    activation: Literal["tanh", "relu"] = "tanh" if names[kind] == "tanh" else "relu"
    return layers, Network(layers=sizes, activation=activation, output="tanh" if policy.squash_output else "clip")


def save_policy(model: OnPolicyAlgorithm, folder: str | Path, provenance: Mapping[str, Any] | None = None) -> Path:
    """Keep a model's policy as a bundle; `amulett_gym.load_policy` reads it without torch.

    Works for any PPO or A2C with an ``MlpPolicy``, trained on `make_sb3_env` or on ``gym.make``.

    Parameters
    ----------
    model : OnPolicyAlgorithm
        With its environment.
    folder : str or Path
        Replaced if it holds a bundle.
    provenance : mapping, optional
        JSON-serialisable; versions, seed and training steps are added.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    AmulettError
        If the policy or the environment cannot be described by a bundle, or `folder` cannot be written.
    """
    env = model.get_env()
    if env is None:
        raise AmulettError("the model has no environment; make it with one, so that the bundle knows what actions mean")
    if model.get_vec_normalize_env() is not None:
        raise AmulettError("VecNormalize's running statistics cannot be kept in a bundle; train without it")
    if not env.has_attr("tension_range"):
        raise AmulettError("the model was not trained in an AMULETT environment")
    layers, network = extract_network(model.policy)
    names, scales = OBSERVATIONS, OBSERVATION_SCALES
    if env.get_attr("episodes")[0].privileged:
        names, scales = OBSERVATIONS + PRIVILEGED, {**OBSERVATION_SCALES, **PRIVILEGED_SCALES}
    stack = unwrap_vec_wrapper(env, VecFrameStack)
    history = 1 if stack is None else stack.stacked_obs.n_stack
    if network.layers[0] != history * len(names):
        raise AmulettError(
            f"the policy sees {network.layers[0]} numbers, its environment shows {history} times {len(names)}; "
            "wrappers that change the observation cannot be kept in a bundle, but for VecFrameStack"
        )
    description = PolicyDescription(
        network=network,
        observations=list(names),
        observation_scales=dict(scales),
        history=history,
        tension_range=[float(bound) for bound in env.get_attr("tension_range")[0]],
        agent_period=env.get_attr("episodes")[0].agent_period,
    )
    about = {
        **(provenance or {}),
        "seed": model.seed,
        "steps": int(model.num_timesteps),
        "versions": versions(),
        "git_revision": git_revision(),
    }
    return write_bundle(folder, layers, description, describe_env(env), about)


def describe_env(env: VecEnv) -> TrainingEnv:
    """Return the id and the keywords that make an environment again; an own profile goes in with all that it says.

    Raises
    ------
    AmulettError
        If the environment was not made by `gym.make` or `gym.make_vec`.
    """
    spec = env.get_attr("spec")[0]
    if spec is None:
        raise AmulettError("the environment has no spec, so that nobody could make it again; make it with gym.make")
    keywords = {
        key: value
        for key, value in spec.kwargs.items()
        if key not in ("num_envs", "max_episode_steps", "vectorization_mode", "render_mode", "threads")
    }
    if "profile" in keywords and keywords["profile"] not in profile_names():
        keywords["profile"] = env.get_attr("profile")[0].model_dump()
    steps = spec.kwargs.get("max_episode_steps", spec.max_episode_steps)
    return TrainingEnv(id=spec.id, keywords=keywords, max_episode_steps=int(steps))


def versions() -> dict[str, str]:
    """Return the versions that a result may depend on."""
    return {"python": platform.python_version(), **{package: version(package) for package in _PACKAGES}}


def git_revision() -> str | None:
    """Return the git revision of the checkout that amulett-gym runs from, ``-dirty`` if edited; None from a wheel."""
    root = Path(amulett_gym.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def make_validation_env(config: TrainConfig) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Make the environment in which policies are compared during training: scenarios that are not trained on."""
    return gym.make_vec(
        config.env.id,
        num_envs=config.validation.episodes,
        split="validation",
        max_episode_steps=config.env.max_episode_steps,
        **config.env.keywords(),
    )


def _start_as_constant(policy: ActorCriticPolicy, tension: float | None, tension_range: tuple[float, ...]) -> None:
    """Make the policy's first mean action one and the same everywhere: changing the tension has to be learned."""
    low, high = tension_range
    action = 0.0 if tension is None else float(tension_to_action(np.array(tension), (low, high)))
    with torch.no_grad():
        action_net = policy.action_net
        action_net.weight.zero_()  # type: ignore[operator]
        action_net.bias.fill_(action)  # type: ignore[operator]
