"""The training recipe: typed, range-checked settings, whose defaults are the recipe of ``configs/ppo.yaml``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from amulett_agents.critic_file import critic_of_bundle
from amulett_agents.teacher_settings import TeacherSettings
from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.envs.reward import check_weights
from amulett_gym.envs.settings import NO_LIMIT, ActionDelay, ControlLoop, CostTrack, MeanAngle, TensionList
from amulett_gym.envs.worn_reward import DOFFED_SECONDS, check_worn_weights, doffed_cost
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.fleet import load_fleet, name_or_contents
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.profile import Profile, load_profile, profile_names
from amulett_gym.settings import Group, describe, find_config, merge
from amulett_gym.simulation.layout import LANES
from amulett_gym.storage.safe_yaml import parse_yaml, read_yaml
from amulett_gym.tasks.names import check_suite
from amulett_gym.tasks.worn_suites import WORN_SUITES


class RecipeError(AmulettError):
    """A recipe whose values are valid one by one, but not for its environment or its networks."""


def _kept_fleet(fleet: Any) -> Any:
    """Return a shipped fleet's name, or shipped profiles' names and own ones' contents: their files may change."""
    return None if fleet is None else name_or_contents(load_fleet(fleet))


Fleet = Annotated[str | list[str | dict[str, Any]] | None, BeforeValidator(_kept_fleet)]


class EnvSettings(Group):
    """The training environment."""

    id: str = Field(ENV_IDS[0], description="environment; see `amulett list`")
    profile: str | dict[str, Any] = Field("testbed", description="shipped profile, YAML file or mapping (kept whole)")
    fleet: Fleet = Field(
        None, description="devices instead of a profile: a name, a file or a list of profiles (kept whole)"
    )
    suite: str = Field("mixed", description="scenarios; see `amulett list`")
    control: ControlLoop = Field("decentralized", description="control loop; see `amulett list`")
    track: CostTrack = Field("schedule", description="cost in the reward: schedule, or full-control to compare loops")
    tension_range: TensionList = Field([*TENSION_RANGE], description="tension setpoint at action -1 and +1 [N]")
    mean_angle_range: MeanAngle | None = Field(
        None,
        description="mean drive angle at action +1, in Amulett/Drives-v0 only [deg]; null: that of a joint at 90 deg",
    )
    agent_period: float = Field(0.02, gt=0, le=10, description="time from action to action [s]")
    action_delay: ActionDelay = Field(
        0, description="from an agent step's begin to that of its action's ramp [control ticks]"
    )
    follow_time: float = Field(
        0.05,
        ge=0,
        le=10,
        description="each step moves the setpoint by agent_period / follow_time (at most 1) of its distance to the "
        "policy's output [s]",
    )
    max_episode_steps: int = Field(500, ge=1, le=10**6, description="length of an episode [agent steps]")
    reward_weights: dict[str, float] = Field(
        {}, description="reward term -> weight, where it differs from the default [1]"
    )
    observation_noise: float = Field(0.0, ge=0, le=100, description="standard deviation of noise on observations [1]")
    history: int = Field(1, ge=1, le=100, description="observations in the policy's input, newest last [agent steps]")
    privileged: bool = Field(False, description="also observe what no device measures: for the causal reference")
    threads: int = Field(2, ge=1, le=256, description="simulation threads [1]; they do not change the results")

    @model_serializer(mode="wrap")
    def _leave_out(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave the delay out where there is none: records that are older do not have it."""
        content: dict[str, Any] = serialize(self)
        if not content.get("action_delay"):
            content.pop("action_delay", None)
        return content

    @field_validator("id")
    @classmethod
    def _check_id(cls, name: str) -> str:
        name = name.removeprefix("amulett_gym:")
        if name not in ENV_IDS:
            raise unknown("environment", name, ENV_IDS)
        return name

    @model_validator(mode="after")
    def _check_mean_angle(self) -> EnvSettings:
        if self.mean_angle_range is not None and self.id != DRIVES_ID:
            raise ValueError(f"mean_angle_range is {self.mean_angle_range}; only {DRIVES_ID} has it, not {self.id}")
        return self

    @model_validator(mode="before")
    @classmethod
    def _choose_worn(cls, given: Any) -> Any:
        """Give a worn device the defaults of its environment."""
        if not isinstance(given, Mapping) or str(given.get("id")).removeprefix("amulett_gym:") != WORN_ID:
            return given
        names = ("profile", "suite", "control", "tension_range")
        chosen = names if given.get("fleet") is None else names[1:]
        defaults: dict[str, Any] = {name: WornSettings.model_fields[name].default for name in chosen}
        return {**defaults, "tension_range": [*defaults["tension_range"]], **given}

    @field_validator("suite")
    @classmethod
    def _check_suite(cls, name: str, info: ValidationInfo) -> str:
        if info.data.get("id") != WORN_ID:
            return check_suite(name)
        if name not in WORN_SUITES:
            raise unknown("suite", name, WORN_SUITES)
        return name

    @field_validator("reward_weights")
    @classmethod
    def _check_reward_weights(cls, weights: dict[str, float], info: ValidationInfo) -> dict[str, float]:
        return (check_worn_weights if info.data.get("id") == WORN_ID else check_weights)(weights)

    @field_validator("profile")
    @classmethod
    def _keep_profile(cls, profile: str | dict[str, Any]) -> str | dict[str, Any]:
        """Return a shipped profile's name, or an own one's content: its files may change or move."""
        return profile if profile in profile_names() else load_profile(profile).model_dump(mode="json")

    @model_validator(mode="after")
    def _check_devices(self) -> EnvSettings:
        if self.fleet is not None and self.profile != _default("profile"):
            raise ValueError("profile and fleet are both given; give one of them")
        return self

    @property
    def devices(self) -> tuple[Profile, ...]:
        """The fleet, or the one profile."""
        return (load_profile(self.profile),) if self.fleet is None else load_fleet(self.fleet)

    @property
    def doffed_cost(self) -> float | None:
        """Mean cost of an episode of the same wearers without the device, in Amulett/Worn-v0 only.

        Episodes of 10 s are those by which it is known; that of others is proportional to their length.
        """
        if self.id != WORN_ID:
            return None
        return doffed_cost(self.reward_weights) * self.max_episode_steps * self.agent_period / DOFFED_SECONDS

    @property
    def share(self) -> float:
        """Share of the distance to the policy's output by which the setpoint moves in an agent step."""
        return self.agent_period / max(self.follow_time, self.agent_period)

    def keywords(self) -> dict[str, Any]:
        """Return the keywords for `gym.make`, without those that differ between training and validation."""
        names = ("profile", "suite", "tension_range", "agent_period", "reward_weights", "observation_noise")
        own = {name: getattr(self, name) for name in names}
        # Not in the records of the paper's loop, which are older.
        newer = ("control", "track", "action_delay")
        own |= {name: getattr(self, name) for name in newer if getattr(self, name) != _default(name)}
        if self.id == WORN_ID:  # its default is another one, so the paper's loop has to be named, to be refused
            own["control"] = self.control
        if self.fleet is not None:
            own["fleet"] = self.fleet
            del own["profile"]
        if self.mean_angle_range is not None:
            own["mean_angle_range"] = self.mean_angle_range
        more = {"failure_horizon": self.max_episode_steps, "threads": self.threads, "privileged": self.privileged}
        return own | more


def _default(name: str) -> Any:
    return EnvSettings.model_fields[name].default


class PpoSettings(Group):
    """Settings of Stable-Baselines3's PPO; see its documentation."""

    n_steps: int = Field(32, ge=1, le=10**6, description="steps of each device between two updates [agent steps]")
    batch_size: int = Field(16384, ge=2, le=10**8, description="samples in a gradient step [agent steps]")
    n_epochs: int = Field(8, ge=1, le=1000, description="passes over the rollout in each update [1]")
    learning_rate: float = Field(2e-3, gt=0, le=1, description="Adam's learning rate [1]")
    anneal: bool = Field(True, description="let the learning rate fall to 0 over total_steps")
    gamma: float = Field(0.99, ge=0, le=1, description="discount factor per agent step [1]")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="GAE lambda [1]: 0 looks one step ahead, 1 to the end")
    clip_range: float = Field(0.3, gt=0, le=10, description="clip range of PPO's probability ratio around 1 [1]")
    target_kl: float | None = Field(
        0.03, gt=0, le=100, description="an update stops at 1.5 times this KL [1]; null: never"
    )
    ent_coef: float = Field(0.0, ge=0, le=100, description="weight of the entropy bonus [1]")
    vf_coef: float = Field(0.5, ge=0, le=100, description="weight of the value loss [1]")
    max_grad_norm: float = Field(0.5, gt=0, le=1e6, description="norm that gradients are clipped to [1]")
    reward_scale: float = Field(
        10.0,
        gt=0,
        le=1e6,
        description="fixed factor on the reward in PPO [1]; eq. 6 costs 0.002 in a step, 1 in an episode",
    )
    initial_std: float = Field(0.3, gt=0, le=10, description="initial standard deviation of exploration noise [1]")
    final_std: float | None = Field(
        0.05,
        gt=0,
        le=10,
        description="standard deviation of the exploration noise at total_steps [1]; null: it is learned",
    )
    mean_exploration: float = Field(
        0.1,
        gt=0,
        le=1,
        description="exploration noise of the mean drive angle, in Amulett/Drives-v0, as share of the tension's [1]",
    )
    critic_steps: int | None = Field(
        None,
        ge=1,
        le=10**12,
        description="initial steps in which only the critic learns, for a start from a bundle [agent steps]",
    )
    privileged_critic: bool = Field(
        True, description="the critic, which only training needs, also observes quantities that no device measures"
    )
    use_sde: bool = Field(False, description="state-dependent exploration (gSDE), which is smooth")
    sde_sample_freq: int = Field(
        8, ge=-1, le=10**6, description="steps between two draws of gSDE's noise [agent steps]; -1: once a rollout"
    )


class SacSettings(Group):
    """Settings of Stable-Baselines3's SAC; see its documentation."""

    learning_rate: float = Field(1e-3, gt=0, le=1, description="Adam's learning rate [1]")
    anneal: bool = Field(False, description="let the learning rate fall to 0 over total_steps")
    buffer_size: int = Field(500_000, ge=1, le=10**8, description="replay buffer's size, all devices [agent steps]")
    learning_starts: int = Field(10_000, ge=0, le=10**9, description="initial steps with random actions [agent steps]")
    batch_size: int = Field(512, ge=2, le=10**6, description="samples in a gradient step [agent steps]")
    tau: float = Field(0.02, gt=0, le=1, description="share by which an update moves the target to the critic [1]")
    gamma: float = Field(0.99, ge=0, le=1, description="discount factor per agent step [1]")
    train_freq: int = Field(1, ge=1, le=10**6, description="steps of each device between two updates [agent steps]")
    gradient_steps: int = Field(8, ge=1, le=10**6, description="gradient steps in an update [batches]")
    ent_coef: float | None = Field(None, ge=0, le=100, description="weight of the entropy [1]; null: it is learned")
    initial_ent_coef: float = Field(0.01, gt=0, le=100, description="initial weight of the entropy, if learned [1]")
    target_entropy: float = Field(
        -2.0,
        ge=-100,
        le=100,
        description="target entropy of the learned weight [nat]; -1: exploration noise of about 0.1",
    )
    reward_scale: float = Field(10.0, gt=0, le=1e6, description="fixed factor on the reward in SAC [1]")
    initial_std: float = Field(
        0.2, gt=0, le=10, description="initial standard deviation of the exploration noise, before the tanh [1]"
    )


class NetworkSettings(Group):
    """The networks of policy and critic."""

    hidden: list[int] = Field([64, 64], min_length=1, max_length=8, description="sizes of the policy's layers, to 1024")
    critic_hidden: list[int] | None = Field(
        [128, 128], min_length=1, max_length=8, description="sizes of the critic's layers; null: as the policy's"
    )
    standard_inputs: bool = Field(True, description="standardise observations, by statistics from before the training")
    features: bool = Field(True, description="also see nonlinear features of the observation (laws.features)")
    memory: bool = Field(False, description="also see means over the episode so far (laws.memory)")
    activation: Literal["tanh", "relu"] = Field("relu", description="activation of the hidden layers")
    initial_tension: float | None = Field(
        7.0, gt=0, le=1e6, description="initial policy's tension [N]; null: mid-range"
    )
    initial_assistance: float | None = Field(
        None, ge=0, le=1, description="initial policy's assistance, in Amulett/Worn-v0 only [1]; null: 1"
    )
    start: str | None = Field(
        None,
        min_length=1,
        description="bundle (a folder, or pretrained) that PPO starts from instead of a constant; inputs that it lacks "
        "start with weight 0",
    )

    @model_serializer(mode="wrap")
    def _leave_out(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is for worn devices only where it is not given: records that are older do not have it."""
        content: dict[str, Any] = serialize(self)
        if content.get("initial_assistance") is None:
            content.pop("initial_assistance", None)
        return content

    @field_validator("hidden", "critic_hidden")
    @classmethod
    def _check_sizes(cls, hidden: list[int] | None) -> list[int] | None:
        if any(not 1 <= size <= 1024 for size in hidden or ()):
            raise ValueError("every size has to be from 1 to 1024")
        return hidden


class ValidationSettings(Group):
    """How the best policy is chosen: on scenarios of the split `validation`, which are never trained on."""

    fleet: Fleet = Field(
        None, description="devices instead of those of training: a name, a file or a list of profiles (kept whole)"
    )
    every_steps: int = Field(500_000, ge=1, le=10**12, description="steps between two validations [agent steps]")
    episodes: int = Field(
        200,
        ge=1,
        le=10**5,
        description="number of scenarios, one device each [1]; with a fleet as many on each device, rounded up",
    )
    seed: int = Field(0, ge=0, lt=2**63, description="seed of the first scenario [1]")


class TrainConfig(Group):
    """A training run."""

    algorithm: Literal["ppo", "sac"] = Field("ppo", description="algorithm; the group of the other one is ignored")
    env: EnvSettings = Field(EnvSettings(), description="training environment")
    ppo: PpoSettings = Field(PpoSettings(), description="settings of PPO, if it is the algorithm")
    sac: SacSettings = Field(SacSettings(), description="settings of SAC, if it is the algorithm")
    network: NetworkSettings = Field(NetworkSettings(), description="networks of policy and critic")
    teacher: TeacherSettings | None = Field(
        None, description="imitation of a teacher that PPO starts from, in Amulett/Worn-v0 only; null: none"
    )
    validation: ValidationSettings = Field(ValidationSettings(), description="choice of the best policy")
    num_envs: int = Field(2048, ge=1, le=10**6, description="devices simulated in parallel [1]")
    staggered: bool = Field(True, description="start devices at different episode times; a rollout covers all times")
    total_steps: int = Field(5_000_000, ge=1, le=10**12, description="length of training, all devices [agent steps]")
    max_seconds: float | None = Field(None, gt=0, le=1e9, description="longest training time [s]; null: no limit")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of all random numbers [1]")
    threads: int = Field(1, ge=1, le=256, description="torch's threads [1]")
    checkpoint_seconds: float = Field(10.0, ge=0, le=1e9, description="time between checkpoints [s]; 0: every rollout")
    checkpoint: bool = Field(False, description="also keep last_sb3.zip for Stable-Baselines3 (a pickle)")

    @model_serializer(mode="wrap")
    def _leave_out(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave the teacher out where there is none: records that are older do not have it."""
        content: dict[str, Any] = serialize(self)
        if content.get("teacher") is None:
            content.pop("teacher", None)
        return content

    @property
    def validation_keywords(self) -> dict[str, Any]:
        """The keywords for `gym.make_vec` of the environment in which policies are compared."""
        episodes, fleet = self.validation.episodes, self.validation.fleet or self.env.fleet
        keywords = self.env.keywords() | {"max_episode_steps": self.env.max_episode_steps}
        if fleet is not None:
            keywords.pop("profile", None)
            keywords["fleet"], devices = fleet, LANES * len(load_fleet(fleet))  # a block has one device
            episodes = math.ceil(episodes / devices) * devices
        return keywords | {"num_envs": episodes}

    @property
    def first_scenario(self) -> int:
        """Seed of device 0; device i has this plus i, so that no two training seeds share a scenario."""
        return self.seed * self.num_envs

    @model_validator(mode="after")
    def _check_together(self) -> TrainConfig:
        """Refuse values that are valid one by one, but not together."""
        ppo, start, (low, high) = self.ppo, self.network.initial_tension, self.env.tension_range
        rollout = self.num_envs * ppo.n_steps
        last = (math.ceil(self.total_steps / rollout) - 1) * rollout
        if self.algorithm == "ppo" and rollout < 2:
            raise ValueError("num_envs times ppo.n_steps is 1; PPO needs a rollout of at least 2 steps")
        if self.algorithm == "ppo" and rollout % ppo.batch_size:
            raise ValueError(
                f"ppo.batch_size is {ppo.batch_size}; it has to divide num_envs times ppo.n_steps, {rollout}"
            )
        if ppo.critic_steps is not None and ppo.critic_steps > last:
            raise ValueError(
                f"ppo.critic_steps is {ppo.critic_steps}; it can be at most {last}, where the last rollout of "
                f"total_steps, {self.total_steps}, begins, or the policy learns nothing"
            )
        if ppo.critic_steps is not None and ppo.final_std is None:
            raise ValueError("ppo.final_std is null; ppo.critic_steps needs a number: a learned one would be frozen")
        if self.algorithm == "sac" and self.network.start is not None:
            raise ValueError(f"network.start is '{self.network.start}'; only PPO can start from a bundle, not SAC")
        if self.algorithm == "sac" and self.sac.buffer_size < self.num_envs:
            raise ValueError(
                f"sac.buffer_size is {self.sac.buffer_size}; it has to be at least num_envs, {self.num_envs}"
            )
        if self.network.initial_assistance is not None and self.env.id != WORN_ID:
            raise ValueError(f"network.initial_assistance is given; only {WORN_ID} has it, not {self.env.id}")
        if (teacher := self.teacher) is not None:
            if self.env.id != WORN_ID or self.algorithm != "ppo" or self.network.start is not None:
                raise ValueError(f"teacher is given; only PPO in {WORN_ID} has one, without network.start")
            if not low <= min(teacher.moving_tension, teacher.holding_tension):
                raise ValueError(f"the teacher's tensions have to be at least {low} N, as env.tension_range is")
            if not max(teacher.moving_tension, teacher.holding_tension) <= high:
                raise ValueError(f"the teacher's tensions have to be at most {high} N, as env.tension_range is")
        if start is not None and not low <= start <= high:
            raise ValueError(f"network.initial_tension is {start} N; env.tension_range is {low} to {high} N")
        return self


SPRINT = (
    # Rare actions: the cost of a tension shows through drive lag and sensor noise in fewer steps.
    *("env.suite=steps", "env.tension_range=[4.0, 8.0]", "env.agent_period=0.1", "env.max_episode_steps=100"),
    # Small networks are fast.
    *("network.hidden=[32, 32]", "network.critic_hidden=[32, 32]", "network.initial_tension=null"),
    # A horizon of 5 s: below the floor of the force estimation strings go slack slowly; with a longer one PPO passes
    # good tensions.
    *("ppo.gamma=0.98", "ppo.gae_lambda=0.9", "ppo.target_kl=null", "ppo.n_epochs=10"),
    # The initial tension is far from good ones, and a ramp smooths what is tried: it takes much noise to find them in
    # this time. But noise on the tension is costly, least at the ends of the range, where it is clipped: it falls.
    *("ppo.initial_std=0.5", "ppo.final_std=0.03"),
    *("validation.episodes=100", "total_steps=3_000_000"),
)
"""Changes of the default recipe for `amulett bench --time-to-beat`: it learns within seconds."""


ADAPTATION: dict[str, Any] = {
    "num_envs": 1024,
    "total_steps": 3_400_000,
    "max_seconds": 60.0,
    "ppo": {
        # The policy is good already: what is left to gain is small beside the noise of a gradient. So each sample is
        # used once, which leaves the time for many, in large batches and small steps.
        "n_steps": 64,
        "batch_size": 16_384,
        "n_epochs": 1,
        "learning_rate": 2.5e-4,
        "initial_std": 0.1,
        # First none of an untrained critic's advantages.
        "critic_steps": 262_144,
    },
    # Differences to the start are small, too: it takes many scenarios to see them.
    "validation": {"every_steps": 1_150_000, "episodes": 1000},
}
"""What a recipe that starts from a trained policy has instead of the defaults."""

CRITIC_STEPS = 65_536
"""`ppo.critic_steps` of such a recipe if the policy's bundle holds a critic, which only gets used to the device."""


def load_train_config(
    path: str | Path | None = None, overrides: Sequence[str] = (), start: str | None = None
) -> TrainConfig:
    """Read a recipe.

    Parameters
    ----------
    path : str or Path, optional
        A YAML file with the keys of `TrainConfig` that differ from its defaults; the defaults alone if None.
    overrides : sequence of str
        Changes like ``"ppo.learning_rate=3e-4"``: dotted keys, values in YAML.
    start : str, optional
        Policy to adapt, as `network.start`, instead of `path`: the recipe has its inputs, actions and devices, and what
        `ADAPTATION` holds; if its bundle holds a critic, that one's kind and `CRITIC_STEPS`. A profile or a fleet among
        the changes replaces its devices.

    Returns
    -------
    TrainConfig

    Raises
    ------
    AmulettError
        If the file or the policy cannot be read, a key is unknown, or a value is wrong.
    """
    changes: Mapping[str, Any] = {}
    for override in overrides:
        changes = merge(changes, _parse_override(override))
    content: Mapping[str, Any] = {} if path is None else read_yaml(find_config(path, "recipe"), "recipe")
    if start is not None:
        content = _recipe_from(start, changes)
    content = merge(content, changes)
    return parse_train_config(content, "recipe" if path is None else f"recipe '{path}'")


def _recipe_from(start: str, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the recipe that adapts a policy, as far as the changes, which will be made to it, matter."""
    elsewhere = not _group(changes, "env").keys().isdisjoint(("profile", "fleet"))
    try:
        bundle = read_bundle(bundle_folder(start))
        critic = critic_of_bundle(bundle)
    except AmulettError as error:
        raise AmulettError(f"the policy '{start}' to start from: {error}") from error
    policy, trained = bundle.policy, bundle.env
    kept = {"suite", "control", "track", "reward_weights", "action_delay", "observation_noise"}
    kept |= set() if elsewhere else {"profile", "fleet"}
    low, high = policy.tension_range
    tension = NetworkSettings.model_fields["initial_tension"].default
    env = {name: value for name, value in trained.keywords.items() if name in kept and value is not None} | {
        "id": trained.id,
        "tension_range": policy.tension_range,
        "mean_angle_range": policy.mean_angle_range,
        "agent_period": policy.agent_period,
        "follow_time": policy.agent_period / policy.follow,
        "history": policy.history,
        "privileged": policy.is_privileged,
    }
    if trained.max_episode_steps != NO_LIMIT:
        env["max_episode_steps"] = trained.max_episode_steps
    network = {
        "start": start,
        "hidden": policy.network.layers[1:-1],
        "activation": policy.network.activation,
        "features": bool(policy.features),
        "memory": bool(policy.memory),
        "initial_tension": tension if low <= tension <= high else None,
    }
    recipe = {**ADAPTATION, "env": env, "network": network}
    if critic is None:
        return recipe
    kind: dict[str, dict[str, Any]] = {
        "network": {"critic_hidden": critic.hidden},
        "ppo": {
            "gamma": critic.gamma,
            "reward_scale": critic.reward_scale,
            "privileged_critic": critic.is_privileged and not policy.is_privileged,
        },
    }
    usable = merge(
        kind, {group: {k: v for k, v in _group(changes, group).items() if k in kind[group]} for group in kind}
    )
    return merge(merge(recipe, kind), {"ppo": {"critic_steps": CRITIC_STEPS}} if usable == kind else {})


def _group(changes: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    group = changes.get(name)
    return group if isinstance(group, Mapping) else {}


def parse_train_config(content: Mapping[str, Any], what: str) -> TrainConfig:
    """Return the recipe in a mapping, which is called `what` in errors; errors as of `load_train_config`."""
    try:
        return TrainConfig.model_validate(content)
    except ValidationError as error:
        raise describe(error, TrainConfig, what) from error


def _parse_override(override: str) -> dict[str, Any]:
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise AmulettError(f"'{override}' is no change of a key; write it as key=value, for example ppo.gamma=0.98")
    value = parse_yaml(text, f"'{override[:100]}': the value")
    for part in reversed(parts):
        value = {part: value}
    return value
