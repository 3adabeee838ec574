"""Conversion of Stable-Baselines3's policies to bundles, data that needs neither torch nor trust."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecEnv, VecFrameStack, unwrap_vec_wrapper
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy

from amulett_agents.critic_file import Critic, critic_of_bundle, pack_critic
from amulett_agents.networks import ACTIVATIONS, AsymmetricPolicy, StandardInputs, policy_inputs, visible_entries
from amulett_agents.wrappers import ActorView, ScaledRewards
from amulett_gym import WORN_ID
from amulett_gym.envs.privileged import FLEET_PRIVILEGED, FLEET_SCALES, PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.envs.settings import NO_LIMIT, VectorSettings
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import name_or_contents
from amulett_gym.laws.bundle import MAX_WEIGHT, Bundle, Layers, Network, PolicyDescription, TrainingEnv, write_bundle
from amulett_gym.laws.card import model_card
from amulett_gym.laws.features import FEATURES, WORN_FEATURES
from amulett_gym.laws.memory import MEMORY, WORN_MEMORY
from amulett_gym.laws.worn_inputs import WORN_ACTIONS, WORN_SCALES
from amulett_gym.storage.provenance import git_revision, versions


def extract_network(policy: BasePolicy) -> tuple[Layers, Network]:
    """Return the weights of a policy's deterministic action with the description of its network.

    Raises
    ------
    AmulettError
        If the policy is not an ``MlpPolicy`` of PPO, A2C, SAC, TD3 or DDPG with tanh or ReLU.
    """
    hidden: Iterable[torch.nn.Module]
    if isinstance(policy, ActorCriticPolicy):
        extractor, hidden, last = policy.features_extractor, policy.mlp_extractor.policy_net, policy.action_net
        networks, squashes = policy.mlp_extractor, policy.squash_output
    elif isinstance(policy, SACPolicy):
        extractor, hidden, last = policy.actor.features_extractor, policy.actor.latent_pi, policy.actor.mu
        networks, squashes = None, True
    elif isinstance(policy, TD3Policy):  # DDPG's, too
        *hidden, last, _ = policy.actor.mu  # the end is a tanh
        extractor, networks, squashes = policy.actor.features_extractor, None, True
    else:
        raise AmulettError(
            f"only an MlpPolicy of PPO, A2C, SAC, TD3 or DDPG can become a bundle, not {type(policy).__name__}"
        )
    if not isinstance(extractor, FlattenExtractor):
        raise AmulettError(f"only an MlpPolicy can become a bundle, not {type(policy).__name__}")
    kind = policy.activation_fn
    if kind not in ACTIVATIONS.values():
        raise AmulettError(f"a bundle cannot hold the activation {kind.__name__}; use Tanh or ReLU")
    if not isinstance(last, torch.nn.Linear):
        raise AmulettError("a bundle cannot hold a policy whose action is not a linear function of its features")
    linear = [*(module for module in hidden if isinstance(module, torch.nn.Linear)), last]
    layers = [(_array(layer.weight), _array(layer.bias)) for layer in linear]
    if isinstance(extractor, StandardInputs):  # become part of the first layer
        means, gains = policy_inputs(extractor, networks)
        raw = layers[0][0].astype(np.float64) * gains
        layers[0] = raw.astype(np.float32), (layers[0][1] - raw @ means).astype(np.float32)
    sizes = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    activation: Literal["tanh", "relu"] = "tanh" if kind is ACTIVATIONS["tanh"] else "relu"
    return layers, Network(layers=sizes, activation=activation, output="tanh" if squashes else "clip")


def has_diverged(model: BaseAlgorithm) -> bool:
    """Return whether a model has a weight that is not finite, or its policy one too large for a bundle."""
    if not all(bool(torch.isfinite(weights).all()) for weights in model.policy.parameters()):
        return True
    layers, _ = extract_network(model.policy)
    return any(np.abs(values).max() > MAX_WEIGHT for layer in layers for values in layer)


def save_policy(model: BaseAlgorithm, folder: str | Path, provenance: Mapping[str, Any] | None = None) -> Path:
    """Write a model's policy as a bundle; return its folder. `amulett_gym.load_policy` reads it without torch.

    The critic of PPO is written with it, for a training that starts from the bundle.

    Works for PPO, A2C, SAC, TD3 and DDPG with an ``MlpPolicy``, trained on ``gym.make`` or on `make_sb3_env`, also
    within a `recipe_view` or a `VecFrameStack`. Other wrappers that change the size or the range of observations or
    actions are refused; those that change values within the same range are not detected.

    Parameters
    ----------
    model : BaseAlgorithm
        With its environment.
    folder : str or Path
        Replaced if it holds a bundle.
    provenance : mapping, optional
        JSON-serialisable; versions, seed, training steps and the name of the environment's `reward_fn` are added.

    Raises
    ------
    AmulettError
        If the policy or the environment cannot be described by a bundle, or `folder` cannot be written.
    """
    env = model.get_env()
    if env is None:
        raise AmulettError("the model has no environment, which defines its actions; make it with one")
    if model.get_vec_normalize_env() is not None:
        raise AmulettError("a bundle cannot hold VecNormalize's running statistics; train without it")
    if not env.has_attr("tension_range"):
        raise AmulettError("the model was not trained in an AMULETT environment")
    _check_spaces(model, env)
    layers, description = describe_policy(model)
    origin = {"seed": model.seed, "steps": int(model.num_timesteps)}
    about = {**(provenance or {}), **origin, "versions": versions(), "git_revision": git_revision()}
    reward_fn = env.get_attr("settings")[0].reward_fn
    if reward_fn is not None:  # code, which a bundle does not hold
        about["reward_fn"] = getattr(reward_fn, "__qualname__", repr(reward_fn))
    training_env = describe_env(env)
    if not description.is_privileged:
        training_env.keywords.pop("privileged", None)
    card = model_card(description, training_env, about)
    critic = pack_critic(describe_critic(model)) if isinstance(model, PPO) and not has_diverged(model) else None
    return write_bundle(folder, layers, description, training_env, about, card, critic)


def _check_spaces(model: BaseAlgorithm, env: VecEnv) -> None:
    """Raise an AmulettError if a wrapper has changed the bounds of actions or observations."""
    if isinstance(env.get_attr("settings")[0], VectorSettings):
        return
    own = env.get_attr("unwrapped")[0]
    for what, found, expected in (
        ("actions", model.action_space, own.action_space),
        ("observations", model.observation_space, own.observation_space),
    ):
        if found.shape == expected.shape and found != expected:
            raise AmulettError(
                f"a wrapper changes the range of the {what}, which a bundle cannot hold; train without it"
            )


def describe_policy(model: BaseAlgorithm) -> tuple[Layers, PolicyDescription]:
    """Return the weights of a model's deterministic action with the complete description of its policy.

    Raises
    ------
    AmulettError
        If the policy or the environment cannot be described by a bundle.
    """
    env = model.get_env()
    assert env is not None
    layers, network = extract_network(model.policy)
    settings = env.get_attr("settings")[0]
    worn = env.get_attr("env_id")[0] == WORN_ID
    names: tuple[str, ...] = WORN_OBSERVATIONS if worn else OBSERVATIONS
    scales = WORN_SCALES if worn else OBSERVATION_SCALES
    if settings.privileged and not isinstance(model.policy, AsymmetricPolicy):
        names, scales = OBSERVATIONS + PRIVILEGED, {**OBSERVATION_SCALES, **PRIVILEGED_SCALES}
        if settings.fleet is not None:
            names, scales = names + FLEET_PRIVILEGED, {**scales, **FLEET_SCALES}
    stack = unwrap_vec_wrapper(env, VecFrameStack)
    history = 1 if stack is None else stack.stacked_obs.n_stack
    view = unwrap_vec_wrapper(env, ActorView)
    seen, remembered = _added(view)
    if view is not None and view.mean_unit != 1.0:
        layers[-1] = tuple(_scaled(values, view.mean_unit) for values in layers[-1])  # type: ignore[assignment]
    size = len(names) + len(seen) + len(remembered)
    if network.layers[0] != history * size:
        raise AmulettError(
            f"the policy has {network.layers[0]} inputs, its environment {history} times {size}; of "
            "the wrappers that change the observation, a bundle can hold VecFrameStack and our own ActorView"
        )
    return layers, PolicyDescription(
        network=network,
        observations=list(names),
        observation_scales=dict(scales),
        features=list(seen),
        actions=list(WORN_ACTIONS) if worn else None,
        memory=list(remembered) or None,
        follow=1.0 if view is None else view.share,
        history=history,
        tension_range=[float(bound) for bound in env.get_attr("tension_range")[0]],
        mean_angle_range=settings.mean_angle_deg,
        setpoint_gain=None if view is None else view.setpoint_gain,
        agent_period=env.get_attr("episodes")[0].agent_period,
    )


def start_from(model: PPO, bundle: Bundle) -> None:
    """Give PPO the policy of a bundle; observations that the bundle did not have get the weight 0.

    Raises
    ------
    AmulettError
        If the two differ in their hidden layers, or in the meaning of their observations or actions.
    """
    (_, mine), theirs = describe_policy(model), bundle.policy
    for what, own, given in (
        ("the activation", mine.network.activation, theirs.network.activation),
        ("the output", mine.network.output, theirs.network.output),
        ("hidden layers", mine.network.layers[1:-1], theirs.network.layers[1:-1]),
        ("observations of the hidden state (privileged)", mine.is_privileged or not theirs.is_privileged, True),
        ("actions", mine.actions, theirs.actions),
        ("features", bool(mine.features), bool(theirs.features)),
        ("memory", bool(mine.memory), bool(theirs.memory)),
        ("history", mine.history, theirs.history),
        ("tension_range", mine.tension_range, theirs.tension_range),
        ("mean_angle_range", mine.mean_angle_range, theirs.mean_angle_range),
        ("setpoint_gain", mine.setpoint_gain, theirs.setpoint_gain),
        ("agent_period", mine.agent_period, theirs.agent_period),
        ("agent_period / follow_time", round(mine.follow, 6), round(theirs.follow, 6)),
    ):
        if own != given:
            raise AmulettError(
                f"network.start: the policy of '{bundle.folder}' has {what} {given}; this recipe's has {own}"
            )
    policy = model.policy
    linear = [module for module in policy.mlp_extractor.policy_net if isinstance(module, torch.nn.Linear)]
    known = visible_entries(mine.size, theirs.size, mine.history)
    layers = [(weight.astype(np.float64), bias.astype(np.float64)) for weight, bias in bundle.layers]
    first, bias = np.zeros((len(layers[0][1]), mine.history * mine.size)), layers[0][1]
    first[:, known] = layers[0][0]
    if isinstance(policy.features_extractor, StandardInputs):
        means, gains = policy_inputs(policy.features_extractor, policy.mlp_extractor)
        first, bias = first / gains, bias + first @ means
    layers[0] = first, bias
    view = unwrap_vec_wrapper(model.get_env(), ActorView)  # type: ignore[arg-type]
    if view is not None and view.mean_unit != 1.0:
        layers[-1] = tuple(_scaled(values, 1.0 / view.mean_unit) for values in layers[-1])  # type: ignore[assignment]
    _set_layers([*linear, policy.action_net], layers)


def describe_critic(model: PPO) -> Critic:
    """Return the weights of PPO's critic with the meaning of its inputs; `describe_policy` accepts the model."""
    env, policy = model.get_env(), model.policy
    assert env is not None
    settings = env.get_attr("settings")[0]
    view, stack = unwrap_vec_wrapper(env, ActorView), unwrap_vec_wrapper(env, VecFrameStack)
    scaled, extractor = unwrap_vec_wrapper(env, ScaledRewards), policy.vf_features_extractor
    # in the order of `laws.features.with_features`
    names: tuple[str, ...] = WORN_OBSERVATIONS if env.get_attr("env_id")[0] == WORN_ID else OBSERVATIONS
    names += sum(_added(view), ())
    if settings.privileged:
        names += PRIVILEGED + (() if settings.fleet is None else FLEET_PRIVILEGED)
    linear = [module for module in policy.mlp_extractor.value_net if isinstance(module, torch.nn.Linear)]
    history = 1 if stack is None else stack.stacked_obs.n_stack
    means, gains = np.zeros(history * len(names), np.float32), np.ones(history * len(names), np.float32)
    if isinstance(extractor, StandardInputs):
        means, gains = _array(extractor.means), _array(extractor.gains)
    return Critic(
        inputs=names,
        history=history,
        activation="tanh" if policy.activation_fn is ACTIVATIONS["tanh"] else "relu",
        gamma=float(model.gamma),
        reward_scale=1.0 if scaled is None else float(scaled.factor),
        means=means,
        gains=gains,
        layers=[(_array(layer.weight), _array(layer.bias)) for layer in (*linear, policy.value_net)],
    )


def start_critic(model: PPO, bundle: Bundle) -> bool:
    """Give PPO the critic of a bundle, if there is one of the same kind; return whether it has it.

    Its inputs have to be among those of the model's critic; others get the weight 0. Those that describe the device
    itself, which only a fleet has, are constant on one device: its own values become part of the bias.
    """
    theirs, mine = critic_of_bundle(bundle), describe_critic(model)
    if theirs is None:
        return False
    env = model.get_env()
    assert env is not None
    constants: dict[str, float] = {}
    if env.get_attr("settings")[0].fleet is None:
        constants = dict(zip(FLEET_PRIVILEGED, env.get_attr("episodes")[0].described[0].tolist(), strict=True))
    lacking = [name for name in theirs.inputs if name not in mine.inputs and name not in constants]
    for what, own, given in (
        ("inputs that this one does not have", [], lacking),
        ("history", mine.history, theirs.history),
        ("the activation", mine.activation, theirs.activation),
        ("hidden layers", mine.hidden, theirs.hidden),
        ("ppo.gamma", mine.gamma, theirs.gamma),
        ("ppo.reward_scale", mine.reward_scale, theirs.reward_scale),
    ):
        if own != given:
            shown = f"{given[:3]}" if given is lacking else f"{given}; this recipe's has {own}"
            message = f"the critic of '{bundle.folder}' has {what}: {shown}. A new critic learns instead"
            warnings.warn(message, stacklevel=3)
            return False
    weight, bias = (values.astype(np.float64) for values in theirs.layers[0])
    raw = weight * theirs.gains
    bias = bias - raw @ theirs.means
    first = np.zeros((len(bias), mine.history * len(mine.inputs)))
    for column in range(raw.shape[1]):
        frame, entry = divmod(column, len(theirs.inputs))
        name = theirs.inputs[entry]
        if name in mine.inputs:
            first[:, frame * len(mine.inputs) + mine.inputs.index(name)] = raw[:, column]
        else:
            bias += raw[:, column] * constants[name]
    layers: list[tuple[NDArray[Any], NDArray[Any]]] = [(first / mine.gains, bias + first @ mine.means)]
    layers += theirs.layers[1:]
    linear = [module for module in model.policy.mlp_extractor.value_net if isinstance(module, torch.nn.Linear)]
    _set_layers([*linear, model.policy.value_net], layers)
    return True


def _added(view: ActorView | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the features and of the means that a network sees."""
    if view is None:
        return (), ()
    features, memory = (WORN_FEATURES, WORN_MEMORY) if view.worn else (FEATURES, MEMORY)
    return features if view.features else (), memory if view.memory is not None else ()


def _set_layers(modules: Sequence[torch.nn.Module], layers: Sequence[tuple[NDArray[Any], NDArray[Any]]]) -> None:
    with torch.no_grad():
        for module, (weight, bias) in zip(modules, layers, strict=True):
            assert isinstance(module, torch.nn.Linear)
            module.weight.copy_(torch.as_tensor(weight))
            module.bias.copy_(torch.as_tensor(bias))


def _scaled(values: NDArray[Any], factor: float) -> NDArray[Any]:
    """Return the last layer's weights or biases with those of the mean drive angle, the first action, scaled."""
    scaled = values.copy()
    scaled[0] *= factor
    return scaled


def _array(tensor: torch.Tensor) -> NDArray[np.float32]:
    return tensor.detach().cpu().numpy().copy()


def describe_env(env: VecEnv) -> TrainingEnv:
    """Return the id and keywords for making an environment again.

    Shipped profiles and fleets are names; others are complete.
    """
    settings = env.get_attr("settings")[0]
    keywords = settings.keywords()
    if settings.fleet is not None:
        keywords["fleet"] = name_or_contents(settings.fleet)
    if isinstance(settings, VectorSettings):
        steps = settings.max_episode_steps
    else:  # of Gymnasium's wrapper
        steps = env.get_attr("_max_episode_steps")[0] if env.has_attr("_max_episode_steps") else NO_LIMIT
    return TrainingEnv(id=env.get_attr("env_id")[0], keywords=keywords, max_episode_steps=int(steps))
