"""A recipe's learner, with its training environment."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv, VecFrameStack

from amulett_agents.adapter import make_sb3_env
from amulett_agents.bundles import start_critic, start_from
from amulett_agents.config import TrainConfig
from amulett_agents.first_policy import first_policy
from amulett_agents.networks import measure_inputs
from amulett_agents.ppo import has_privileged_critic, make_ppo
from amulett_agents.sac import make_sac
from amulett_agents.schedules import CriticFirst, FadingExploration
from amulett_agents.teacher import teach
from amulett_agents.time_limit import ValuesAtTimeLimits
from amulett_agents.wrappers import ActorView, ScaledRewards, Staggered
from amulett_gym import WORN_ID
from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import PRETRAINED, bundle_folder

Model = PPO | SAC


def make_model(config: TrainConfig, resumed: bool = False, progress: bool = False) -> Model:
    """Make a recipe's learner with its training environment.

    Its first policy is a constant tension (see `first_policy`), or that of `network.start`, or that which has imitated
    the recipe's teacher. It has no logger.

    Parameters
    ----------
    config : TrainConfig
    resumed : bool
        A checkpoint's weights will be loaded: `network.start`, which may no longer exist, is not read.
    progress : bool
        Show progress on stderr while inputs are measured and, at the first rollout, devices are staggered.

    Raises
    ------
    AmulettError
        If the environment's settings are wrong, or the policy cannot start as that of `network.start`.
    """
    settings, algorithm = config.env, config.ppo if config.algorithm == "ppo" else config.sac
    keywords = settings.keywords() | {"privileged": settings.privileged or has_privileged_critic(config)}
    steps = settings.max_episode_steps
    low, high = settings.tension_range
    first = first_policy(settings, config.network.initial_tension, config.network.initial_assistance)
    devices = make_sb3_env(settings.id, config.num_envs, split="train", max_episode_steps=steps, **keywords)
    env: VecEnv = Staggered(devices, first.constant, steps, progress) if config.staggered else devices
    mean_angle = devices.venv.settings.mean_angle_deg
    unit = config.ppo.mean_exploration if config.algorithm == "ppo" and mean_angle is not None else 1.0
    network = config.network
    worn = settings.id == WORN_ID
    about_angle = mean_angle, first.gain, unit
    env = ActorView(env, (low, high), network.features, settings.share, *about_angle, network.memory, worn)
    if settings.history > 1:
        env = VecFrameStack(env, settings.history)
    env = ScaledRewards(env, algorithm.reward_scale)
    inputs = None
    if network.standard_inputs:
        shown = (low, high) if network.features else None
        inputs = measure_inputs(
            settings.id, keywords, steps, first, settings.history, shown, progress, memory=network.memory
        )
    model: Model = (make_ppo if config.algorithm == "ppo" else make_sac)(config, env, first, inputs)
    if config.network.start is not None and isinstance(model, PPO) and not resumed:
        bundle = read_bundle(_start_folder(config.network.start))
        start_from(model, bundle)
        start_critic(model, bundle)
    if config.teacher is not None and isinstance(model, PPO) and not resumed:
        teach(model, config, keywords, progress)
    env.seed(config.first_scenario)
    model.set_logger(Logger(None, []))  # SB3's own would create an empty folder
    return model


def _start_folder(start: str) -> Path:
    try:
        return bundle_folder(start)
    except AmulettError as error:
        raise AmulettError(
            f"network.start is '{start}'; it has to be {', '.join(PRETRAINED)}, or the folder of a "
            "policy bundle or of a training run"
        ) from error


def callbacks(config: TrainConfig) -> list[BaseCallback]:
    """Return the callbacks that a recipe's model needs in `learn`."""
    ppo = config.ppo
    if config.algorithm != "ppo":
        return []
    fading = [] if ppo.final_std is None else [FadingExploration(ppo.initial_std, ppo.final_std)]
    first = [CriticFirst(ppo.critic_steps)] if ppo.critic_steps else []
    return [ValuesAtTimeLimits(), *fading, *first]
