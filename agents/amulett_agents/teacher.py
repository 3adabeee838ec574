"""Imitation of a teacher that knows the wearer's intention, as the start of a training (DAgger).

The policy sees only what the device measures. In each round it acts, the teacher names the actions that it would have
taken in the same states, and the policy learns them from all rounds so far (Ross, Gordon and Bagnell, 2011, "A
reduction of imitation learning and structured prediction to no-regret online learning"). Thus it also learns what to do
in states to which its own errors lead. In the first round the teacher acts, in the second it still acts with some
devices.
"""

from __future__ import annotations

from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO

from amulett_agents.bundles import describe_policy
from amulett_agents.config import TrainConfig
from amulett_agents.regression import regress
from amulett_agents.teacher_settings import TeacherSettings
from amulett_gym.envs.action import tension_to_action
from amulett_gym.envs.worn_episodes import WornEpisodes
from amulett_gym.laws.actor import Actor, follow
from amulett_gym.reporting.progress import Progress

_SHARES = (1.0, 0.3)
"""Shares of the devices with which the teacher acts in the first rounds."""

_EVERY = 3
"""Agent steps between two samples of an episode: neighbours are alike."""

_CORRECTS = 0.05
"""Measured torque on the cuff that counts as one by which the wearer corrects the device's place [N m]."""

_CHUNK = 50
"""Agent steps between two reports of progress."""


def teach(model: PPO, config: TrainConfig, keywords: dict[str, Any], progress: bool = False) -> None:
    """Let a new model's policy imitate the recipe's teacher, in training scenarios.

    Parameters
    ----------
    model : PPO
        With its environment, `Amulett/Worn-v0`.
    config : TrainConfig
        With a `teacher`.
    keywords : dict
        Keywords of the environment.
    progress : bool
        Show progress on stderr.
    """
    settings, steps = config.teacher, config.env.max_episode_steps
    assert settings is not None
    env = gym.make_vec(config.env.id, num_envs=settings.episodes, split="train", max_episode_steps=steps, **keywords)
    generator = np.random.default_rng(config.seed)
    seen: list[NDArray[np.float32]] = []
    wanted: list[NDArray[np.float32]] = []
    total = settings.rounds * (steps + settings.gradient_steps)
    with closing(env), Progress(total, "imitating", "steps", progress) as bar:
        for number in range(settings.rounds):
            share = _SHARES[number] if number < len(_SHARES) else 0.0
            led = generator.random(settings.episodes) < share
            seed = config.first_scenario + number * settings.episodes
            shown, named = _play(model, config, settings, env, seed, led, bar)
            seen, wanted = [*seen, shown], [*wanted, named]
            _imitate(model, settings, np.concatenate(seen), np.concatenate(wanted), generator, bar)


def _play(
    model: PPO,
    config: TrainConfig,
    settings: TeacherSettings,
    env: gym.vector.VectorEnv[Any, Any, Any],
    seed: int,
    led: NDArray[np.bool_],
    bar: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Play an episode with each device; return the policy's inputs and the teacher's actions.

    The teacher acts with the devices that are `led`, the policy with the others.
    """
    actor = Actor(*describe_policy(model), env)
    observations, _ = env.reset(seed=seed)
    inputs, actions = [], []
    for step in range(config.env.max_episode_steps):
        named = teacher_actions(settings, env, config.env.tension_range)
        shown = np.clip(named, -1.0, 1.0)
        acted = np.where(led[:, None], follow(shown, observations, config.env.share, worn=True), actor(observations))
        if step % _EVERY == 0:
            inputs.append(actor.inputs(observations).astype(np.float32))
            actions.append(named)
        observations = env.step(acted.astype(np.float32))[0]
        if (step + 1) % _CHUNK == 0:
            bar.update(_CHUNK)
    return np.concatenate(inputs), np.concatenate(actions)


def teacher_actions(
    settings: TeacherSettings, env: gym.vector.VectorEnv[Any, Any, Any], tension_range: list[float]
) -> NDArray[np.float32]:
    """Return the teacher's actions at the present intentions, shape (N, 2); the assistance's may be beyond [-1, 1]."""
    episodes = env.unwrapped.episodes  # type: ignore[attr-defined]
    assert isinstance(episodes, WornEpisodes)
    moves = np.abs(np.degrees(episodes.simulation.read_worn("intention_rate"))) > settings.moving_speed
    low, high = tension_range
    tensions = np.where(moves, settings.moving_tension, settings.holding_tension)
    assists = moves if settings.correction is None else moves | _corrects(settings.correction, episodes)
    full = 1.0 + settings.assistance_margin
    named = [tension_to_action(tensions, (low, high)), np.where(assists, full, -full)]
    return np.stack(named, axis=1).astype(np.float32)


def _corrects(distance: float, episodes: WornEpisodes) -> NDArray[np.bool_]:
    """Return whether the cuff's torque would move setpoints to the intentions, from which they are far [deg]."""
    read = episodes.simulation.read_worn
    missing = read("intention") - episodes.simulation.read("setpoint")
    far = np.abs(np.degrees(missing)) > distance
    corrects: NDArray[np.bool_] = far & (np.sign(missing) * read("measured_cuff") > _CORRECTS)
    return corrects


def _imitate(
    model: PPO,
    settings: TeacherSettings,
    seen: NDArray[np.float32],
    wanted: NDArray[np.float32],
    generator: np.random.Generator,
    bar: Progress,
) -> None:
    """Fit the policy's mean actions to the teacher's."""
    policy = model.policy
    learned = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]

    def mean(shown: torch.Tensor) -> torch.Tensor:
        return policy.get_distribution(shown).distribution.mean  # type: ignore[union-attr]

    regress(mean, learned, seen, wanted, settings, generator, bar)
