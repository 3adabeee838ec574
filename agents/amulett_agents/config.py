"""The training recipe: typed, range-checked settings, whose defaults are the recipe of ``configs/ppo.yaml``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from amulett_gym import ENV_IDS
from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.envs.settings import Suite, TensionList, Weights
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.profile import load_profile, profile_names
from amulett_gym.settings import Group, describe, find_config, merge
from amulett_gym.storage.safe_yaml import parse_yaml, read_yaml


class RecipeError(AmulettError):
    """A recipe whose values are valid one by one, but not for its environment or its networks."""


class EnvSettings(Group):
    """The environment that is trained in."""

    id: str = Field(default=ENV_IDS[0], description="environment; see `amulett list`")
    profile: str | dict[str, Any] = Field(
        default="testbed", description="shipped profile, or a YAML file or mapping, whose content is kept"
    )
    suite: Suite = Field(default="mixed", description="scenarios; see `amulett list`")
    tension_range: TensionList = Field(default=[*TENSION_RANGE], description="tension setpoint at action -1 and +1 [N]")
    agent_period: float = Field(default=0.02, gt=0, le=10, description="time from action to action [s]")
    follow_time: float = Field(
        default=0.05,
        ge=0,
        le=10,
        description="the tension setpoint goes agent_period / follow_time of the way to what the policy wants in each "
        "step [s]; all of it if that is 1 or more",
    )
    max_episode_steps: int = Field(default=500, ge=1, le=10**6, description="length of an episode [agent steps]")
    reward_weights: Weights = Field(
        default={}, description="reward term -> weight, of those that differ from the defaults [1]"
    )
    observation_noise: float = Field(
        default=0.0, ge=0, le=100, description="standard deviation in all entries of the observations [1]"
    )
    history: int = Field(
        default=1,
        ge=1,
        le=100,
        description="number of observations that the policy sees, the newest last [agent steps]",
    )
    privileged: bool = Field(
        default=False, description="also observe what no device can know: for the causal reference"
    )
    threads: int = Field(
        default=2,
        ge=1,
        le=256,
        description="threads that simulate the devices [1]; the results are the same with any number",
    )

    @field_validator("id")
    @classmethod
    def _check_id(cls, name: str) -> str:
        name = name.removeprefix("amulett_gym:")
        if name not in ENV_IDS:
            raise unknown("environment", name, ENV_IDS)
        return name

    @field_validator("profile")
    @classmethod
    def _keep_profile(cls, profile: str | dict[str, Any]) -> str | dict[str, Any]:
        """Return a shipped profile's name, or all that an own one says: its files may change, or be elsewhere."""
        return profile if profile in profile_names() else load_profile(profile).model_dump(mode="json")

    @property
    def share(self) -> float:
        """Share of the way from the present setpoint to the wanted one that is gone in an agent step."""
        return self.agent_period / max(self.follow_time, self.agent_period)

    def keywords(self) -> dict[str, Any]:
        """Return the keywords for `gym.make`, without those that differ between training and validation."""
        return {
            "profile": self.profile,
            "suite": self.suite,
            "tension_range": self.tension_range,
            "agent_period": self.agent_period,
            "reward_weights": self.reward_weights,
            "observation_noise": self.observation_noise,
            "failure_horizon": self.max_episode_steps,
            "threads": self.threads,
            "privileged": self.privileged,
        }


class PpoSettings(Group):
    """Settings of Stable-Baselines3's PPO; see its documentation."""

    n_steps: int = Field(
        default=32, ge=1, le=10**6, description="steps of each device between two updates [agent steps]"
    )
    batch_size: int = Field(default=16384, ge=2, le=10**8, description="samples in a gradient step [agent steps]")
    n_epochs: int = Field(default=8, ge=1, le=1000, description="passes over the rollout in each update [1]")
    learning_rate: float = Field(default=2e-3, gt=0, le=1, description="Adam's learning rate [1]")
    anneal: bool = Field(default=True, description="let the learning rate fall to 0 over total_steps")
    gamma: float = Field(default=0.99, ge=0, le=1, description="discount factor per agent step [1]")
    gae_lambda: float = Field(
        default=0.95, ge=0, le=1, description="GAE lambda: 0 looks one step ahead, 1 to the end [1]"
    )
    clip_range: float = Field(
        default=0.3, gt=0, le=10, description="clip range of PPO's probability ratio, about 1 [1]"
    )
    target_kl: float | None = Field(
        default=0.03,
        gt=0,
        le=100,
        description="an update stops at 1.5 times this KL divergence from the old policy [1]; null: never",
    )
    ent_coef: float = Field(default=0.0, ge=0, le=100, description="weight of the entropy bonus [1]")
    vf_coef: float = Field(default=0.5, ge=0, le=100, description="weight of the value loss [1]")
    max_grad_norm: float = Field(default=0.5, gt=0, le=1e6, description="norm that gradients are clipped to [1]")
    reward_scale: float = Field(
        default=10.0,
        gt=0,
        le=1e6,
        description="fixed factor on what PPO sees [1]: a step of eq. 6 costs 0.002, a whole episode 1",
    )
    initial_std: float = Field(
        default=0.3,
        gt=0,
        le=10,
        description="standard deviation of the exploration at the beginning, in the action's unit [1]",
    )
    final_std: float | None = Field(
        default=0.05,
        gt=0,
        le=10,
        description="standard deviation of the exploration at total_steps [1]; null: it is learned",
    )
    critic_steps: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="steps at the beginning in which only the critic learns: for a policy that starts from a bundle "
        "[agent steps]",
    )
    privileged_critic: bool = Field(
        default=True, description="let the critic, which is needed for training only, see what no device can know"
    )
    use_sde: bool = Field(default=False, description="state-dependent, smooth exploration")
    sde_sample_freq: int = Field(
        default=8,
        ge=-1,
        le=10**6,
        description="steps between two draws of the smooth exploration [agent steps]; -1: once a rollout",
    )


class SacSettings(Group):
    """Settings of Stable-Baselines3's SAC; see its documentation."""

    learning_rate: float = Field(default=1e-3, gt=0, le=1, description="Adam's learning rate [1]")
    anneal: bool = Field(default=False, description="let the learning rate fall to 0 over total_steps")
    buffer_size: int = Field(
        default=500_000, ge=1, le=10**8, description="size of the replay buffer, all devices together [agent steps]"
    )
    learning_starts: int = Field(
        default=10_000, ge=0, le=10**9, description="steps with uniformly random actions at the beginning [agent steps]"
    )
    batch_size: int = Field(default=512, ge=2, le=10**6, description="samples in a gradient step [agent steps]")
    tau: float = Field(
        default=0.02, gt=0, le=1, description="share by which the target critic moves to the critic at each update [1]"
    )
    gamma: float = Field(default=0.99, ge=0, le=1, description="discount factor per agent step [1]")
    train_freq: int = Field(
        default=1, ge=1, le=10**6, description="steps of each device between two updates [agent steps]"
    )
    gradient_steps: int = Field(default=8, ge=1, le=10**6, description="gradient steps in an update [batches]")
    ent_coef: float | None = Field(
        default=None, ge=0, le=100, description="weight of the entropy [1]; null: it is learned"
    )
    initial_ent_coef: float = Field(
        default=0.01, gt=0, le=100, description="weight of the entropy at the beginning, if it is learned [1]"
    )
    target_entropy: float = Field(
        default=-2.0,
        ge=-100,
        le=100,
        description="entropy that its weight is learned for [nat]; -1: an exploration of about 0.1",
    )
    reward_scale: float = Field(default=10.0, gt=0, le=1e6, description="fixed factor on what SAC sees [1]")
    initial_std: float = Field(
        default=0.2,
        gt=0,
        le=10,
        description="standard deviation of the exploration at the beginning, before the tanh [1]",
    )


class NetworkSettings(Group):
    """The networks of policy and critic."""

    hidden: list[int] = Field(
        default=[64, 64], min_length=1, max_length=8, description="sizes of the policy's layers, up to 1024"
    )
    critic_hidden: list[int] | None = Field(
        default=[128, 128],
        min_length=1,
        max_length=8,
        description="sizes of the critic's layers; null: like the policy's",
    )
    standard_inputs: bool = Field(
        default=True, description="standardise each observation by its mean and deviation, measured before training"
    )
    features: bool = Field(default=True, description="also see nonlinear features of the observation (laws.features)")
    activation: Literal["tanh", "relu"] = Field(default="relu", description="activation of the hidden layers")
    initial_tension: float | None = Field(
        default=7.0, gt=0, le=1e6, description="the first policy is this constant [N]; null: the middle of the range"
    )

    start: str | None = Field(
        default=None,
        min_length=1,
        description="PPO's first policy is that of this bundle (a folder, or pretrained) instead of a constant; inputs "
        "that the bundle does not have begin with weight 0",
    )

    @field_validator("hidden", "critic_hidden")
    @classmethod
    def _check_sizes(cls, hidden: list[int] | None) -> list[int] | None:
        if any(not 1 <= size <= 1024 for size in hidden or ()):
            raise ValueError("every size has to be from 1 to 1024")
        return hidden


class ValidationSettings(Group):
    """How the best policy is chosen: on scenarios of the split `validation`, which are never trained on."""

    every_steps: int = Field(
        default=500_000, ge=1, le=10**12, description="steps between two validations [agent steps]"
    )
    episodes: int = Field(default=200, ge=1, le=10**5, description="number of scenarios, one device each [1]")
    seed: int = Field(default=0, ge=0, lt=2**63, description="seed of the first scenario [1]")


class TrainConfig(Group):
    """A training run."""

    algorithm: Literal["ppo", "sac"] = Field(default="ppo", description="algorithm; the other one's group is not read")
    env: EnvSettings = Field(default=EnvSettings(), description="what is trained in")
    ppo: PpoSettings = Field(default=PpoSettings(), description="read if PPO learns")
    sac: SacSettings = Field(default=SacSettings(), description="read if SAC learns")
    network: NetworkSettings = Field(default=NetworkSettings(), description="of policy and critic")
    validation: ValidationSettings = Field(default=ValidationSettings(), description="how the best policy is chosen")
    num_envs: int = Field(default=2048, ge=1, le=10**6, description="devices simulated side by side [1]")
    staggered: bool = Field(
        default=True,
        description="start the devices at different times of their episodes, so that a rollout shows all times",
    )
    total_steps: int = Field(
        default=5_000_000, ge=1, le=10**12, description="length of the training, all devices together [agent steps]"
    )
    max_seconds: float | None = Field(
        default=None, gt=0, le=1e9, description="limit on the training's duration [s]; null: none"
    )
    seed: int = Field(default=0, ge=0, lt=2**31, description="seed of everything random [1]")
    threads: int = Field(default=1, ge=1, le=256, description="torch's threads [1]")
    checkpoint_seconds: float = Field(
        default=10.0, ge=0, le=1e9, description="wall time between two checkpoints to resume from [s]; 0: every rollout"
    )
    checkpoint: bool = Field(default=False, description="also keep last_sb3.zip for Stable-Baselines3 (a pickle)")

    @property
    def first_scenario(self) -> int:
        """Seed of the first device; device i has this plus i, so that no two training seeds share a scenario."""
        return self.seed * self.num_envs

    @model_validator(mode="after")
    def _check_batch(self) -> TrainConfig:
        rollout = self.num_envs * self.ppo.n_steps
        if self.algorithm == "ppo" and rollout < 2:
            raise ValueError("num_envs times ppo.n_steps is 1; PPO needs a rollout of at least 2 steps")
        if self.algorithm == "ppo" and rollout % self.ppo.batch_size:
            raise ValueError(
                f"ppo.batch_size is {self.ppo.batch_size}; it has to divide num_envs times ppo.n_steps, {rollout}"
            )
        last = (math.ceil(self.total_steps / rollout) - 1) * rollout
        if self.ppo.critic_steps is not None and self.ppo.critic_steps > last:
            raise ValueError(
                f"ppo.critic_steps is {self.ppo.critic_steps}; it can be at most {last}, where the last rollout of "
                f"total_steps, {self.total_steps}, begins, or the policy learns nothing"
            )
        if self.ppo.critic_steps is not None and self.ppo.final_std is None:
            raise ValueError(
                "ppo.final_std is null; with ppo.critic_steps it has to be given: what is learned is frozen"
            )
        if self.algorithm == "sac" and self.network.start is not None:
            raise ValueError(f"network.start is '{self.network.start}'; only PPO can start from a bundle, not SAC")
        if self.algorithm == "sac" and self.sac.buffer_size < self.num_envs:
            raise ValueError(
                f"sac.buffer_size is {self.sac.buffer_size}; it has to hold a step of all {self.num_envs} devices"
            )
        low, high = self.env.tension_range
        start = self.network.initial_tension
        if start is not None and not low <= start <= high:
            raise ValueError(
                f"network.initial_tension is {start} N; it has to be in env.tension_range, {low} to {high} N"
            )
        return self


SPRINT = (
    "env.suite=steps",
    "env.tension_range=[4.0, 8.0]",
    # Rarer actions: what a tension costs shows through the drives' lag and the sensors' noise in fewer steps.
    "env.agent_period=0.1",
    "env.max_episode_steps=100",
    # A small network, for its speed.
    "network.hidden=[32, 32]",
    "network.critic_hidden=[32, 32]",
    "network.initial_tension=null",
    "ppo.target_kl=null",
    "validation.episodes=100",
    # 5 s: below the floor of the force estimation strings go slack slowly; a shorter sight runs past good tensions.
    "ppo.gamma=0.98",
    "ppo.gae_lambda=0.9",
    # The first tension is far from good ones, and a ramp smooths what is tried: too little noise, and nothing is found
    # in this time. Noise on the tension is dear, and least so at the ends of the range, where it is clipped: it falls.
    "ppo.initial_std=0.5",
    "ppo.final_std=0.03",
    "ppo.n_epochs=10",
    "total_steps=3_000_000",
)
"""Changes of the default recipe for `amulett bench --time-to-beat`: much learned within seconds."""


def load_train_config(path: str | Path | None = None, overrides: Sequence[str] = ()) -> TrainConfig:
    """Read a recipe.

    Parameters
    ----------
    path : str or Path, optional
        A YAML file with the keys of `TrainConfig` that differ from its defaults; the defaults alone if None.
    overrides : sequence of str
        Changes like ``"ppo.learning_rate=3e-4"``: dotted keys, values in YAML.

    Returns
    -------
    TrainConfig

    Raises
    ------
    AmulettError
        If the file cannot be read, a key is unknown, or a value is wrong.
    """
    content: Mapping[str, Any] = {} if path is None else read_yaml(find_config(path, "recipe"), "recipe")
    for override in overrides:
        content = merge(content, _parse_override(override))
    try:
        return TrainConfig.model_validate(content)
    except ValidationError as error:
        raise describe(error, TrainConfig, "recipe" if path is None else f"recipe '{path}'") from error


def _parse_override(override: str) -> dict[str, Any]:
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise AmulettError(f"'{override}' is no change of a key; write it as key=value, for example ppo.gamma=0.98")
    value = parse_yaml(text, f"'{override[:100]}': the value")
    for part in reversed(parts):
        value = {part: value}
    return value
