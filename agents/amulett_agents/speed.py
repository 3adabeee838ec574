"""How fast learning is: PPO's throughput beside the same PPO on a null environment, and the time to beat eq. 6."""

from __future__ import annotations

import contextlib
import math
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from amulett_agents.config import TrainConfig
from amulett_agents.model import callbacks, make_model
from amulett_agents.validation import evaluate, torch_threads, warm_up
from amulett_gym.envs.action import tension_to_action

TURNS = 9
CONSTANTS = tuple(np.arange(4.0, 15.01, 0.5).tolist())
"""Constant tensions that a policy has to beat [N]: the range of tensions that the environment offers by default."""
HELD_OUT_SEED = 10_000
EVALUATION_PAUSE = 0.5
"""Least training time between two evaluations [s]."""

Watch = Callable[[], object]


class ConstantVecEnv(VecEnv):
    """A null environment: always the same observations and rewards, and no episode ever ends.

    Parameters
    ----------
    num_envs : int
    observation_space, action_space : gymnasium.Space
    """

    def __init__(
        self, num_envs: int, observation_space: gym.Space[Any], action_space: gym.Space[Any], seed: int = 0
    ) -> None:
        super().__init__(num_envs, observation_space, action_space)
        shape = (num_envs, *(observation_space.shape or ()))
        # Not all zeros, which arithmetic might get done more quickly.
        self._observations = np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)
        self._rewards = np.full(num_envs, -0.002, dtype=np.float32)
        self._dones = np.zeros(num_envs, dtype=bool)
        self._infos: list[dict[str, Any]] = [{}] * num_envs

    def reset(self) -> NDArray[np.float32]:
        """Return the observations."""
        return self._observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Do nothing."""

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Return what was always there."""
        return self._observations, self._rewards, self._dones, self._infos

    def close(self) -> None:
        """Do nothing."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return None for each device: there is nothing to ask for."""
        return [None for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Do nothing."""

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Return None for each device."""
        return [None for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each device."""
        return [False for _ in self._get_indices(indices)]


class RolloutClock(BaseCallback):
    """Adds up the time that rollouts take, updates aside [s]."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds, self._started = 0.0, 0.0

    def _on_rollout_start(self) -> None:
        self._started = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self.seconds += time.perf_counter() - self._started

    def _on_step(self) -> bool:
        return True


def ppo_throughput(config: TrainConfig, turns: int = TURNS, watch: Watch = int) -> dict[str, Any]:
    """Let the same PPO learn on our environment and on a null environment, rollout by rollout in turns.

    A turn is as many rollouts of each as an episode takes, so that every turn has its share of episodes' ends, which
    the null environment has none of. Every update takes all its epochs: `target_kl`, which ends one early, would have
    the two do unequal work.

    Parameters
    ----------
    config : TrainConfig
        The recipe of both.
    turns : int
    watch : callable
        Called after each turn, for a progress bar.

    Returns
    -------
    dict
        ``env`` and ``null``, the medians of the agent steps a second; ``ratio``, the median of env to null in the same
        turn, and ``ratio_spread``, its least and most; ``step_ms``, of both, what a step of all devices takes of a
        ``rollout`` and of an ``update`` [ms].
    """
    config = config.model_copy(update={"ppo": config.ppo.model_copy(update={"target_kl": None})})
    with torch_threads(config.threads):
        models = {"env": make_model(config), "null": make_model(config)}
        like = models["null"].get_env()
        assert like is not None
        models["null"].env = ConstantVecEnv(config.num_envs, like.observation_space, like.action_space, config.seed)
        rollout = config.num_envs * config.ppo.n_steps
        for model in models.values():
            model.learn(rollout)  # compile, allocate
        rollouts = math.ceil(config.env.max_episode_steps / config.ppo.n_steps)
        rates: dict[str, list[float]] = {name: [] for name in models}
        clocks = {name: RolloutClock() for name in models}
        for _ in range(turns):
            seconds = dict.fromkeys(models, 0.0)
            for _ in range(rollouts):
                for name, model in models.items():
                    started = time.perf_counter()
                    model.learn(rollout, [*callbacks(config), clocks[name]], reset_num_timesteps=False)
                    seconds[name] += time.perf_counter() - started
            for name, passed in seconds.items():
                rates[name].append(rollouts * rollout / passed)
            watch()
    step_ms = {}
    for name, clock in clocks.items():
        rolling = 1e3 * clock.seconds / (turns * rollouts * config.ppo.n_steps)
        whole = 1e3 * config.num_envs * sum(1.0 / rate for rate in rates[name]) / turns
        step_ms[name] = {"rollout": rolling, "update": whole - rolling}
    ratios = [env / null for env, null in zip(rates["env"], rates["null"], strict=True)]
    return {
        "env": statistics.median(rates["env"]),
        "null": statistics.median(rates["null"]),
        "ratio": statistics.median(ratios),
        "ratio_spread": [min(ratios), max(ratios)],
        "num_envs": config.num_envs,
        "step_ms": step_ms,
    }


def from_the_middle(config: TrainConfig) -> TrainConfig:
    """Return a recipe whose first policy is the middle of the tensions that the environment offers by default.

    A recipe may know where good tensions are and choose from a narrower range; a fair start does not.
    """
    return config.model_copy(
        update={
            "env": config.env.model_copy(update={"tension_range": [CONSTANTS[0], CONSTANTS[-1]]}),
            "network": config.network.model_copy(update={"initial_tension": None}),
        }
    )


@dataclass(frozen=True)
class Lines:
    """What a policy has to cost less than, on fixed scenarios.

    Attributes
    ----------
    eq6 : float
        Cost of eq. 6 inside the loop.
    constant : float
        Cost of the best constant of `CONSTANTS`.
    constant_tension : float
        Which one that is [N].
    """

    eq6: float
    constant: float
    constant_tension: float

    @property
    def lower(self) -> float:
        """The lower of the two costs."""
        return min(self.eq6, self.constant)


@dataclass
class Run:
    """One seed's learning curve.

    Attributes
    ----------
    seed : int
    curve : list of tuple
        Training time [s], agent steps and cost on the validation scenarios.
    eq6, lower : float or None
        Training time after which the policy first cost less than eq. 6, and less than the lower line [s].
    """

    seed: int
    curve: list[tuple[float, int, float]] = field(default_factory=list)
    eq6: float | None = None
    lower: float | None = None


class Referee:
    """Judges policies on fixed scenarios: those of the split `validation`, and, to confirm, `held-out` ones.

    A policy counts as better than a line only if it is so on both: among many looks at a hundred scenarios one might
    be lucky.

    Parameters
    ----------
    config : TrainConfig
        Its environment, and the number and seed of the validation's episodes.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.seeds = {"validation": config.validation.seed, "held-out": HELD_OUT_SEED}
        self.envs = {split: _fixed(config, split, "agent") for split in self.seeds}
        self.lines = {split: self._lines(config, split) for split in self.seeds}

    def cost(self, model: PPO, split: str = "validation") -> float:
        """Return the mean cost of an episode of a model's deterministic policy."""
        return evaluate(model, self.envs[split], self.seeds[split])["cost"]

    def beats(self, model: PPO, cost: float, line: str) -> bool:
        """Return whether a model with this cost on the validation scenarios is below a line on both splits."""
        if cost >= getattr(self.lines["validation"], line):
            return False
        return self.cost(model, "held-out") < getattr(self.lines["held-out"], line)

    def _lines(self, config: TrainConfig, split: str) -> Lines:
        seed = self.seeds[split]
        wide = from_the_middle(config)
        low, high = wide.env.tension_range
        with contextlib.closing(_fixed(wide, split, "agent")) as env:
            actions = tension_to_action(np.array(CONSTANTS), (low, high))
            costs = [held_cost(env, float(action), seed) for action in actions]
        with contextlib.closing(_fixed(wide, split, "eq6")) as env:
            eq6 = held_cost(env, 0.0, seed)
        best = int(np.argmin(costs))
        return Lines(eq6, costs[best], CONSTANTS[best])


def held_cost(env: gym.vector.VectorEnv[Any, Any, Any], action: float, seed: int) -> float:
    """Return the mean cost of an episode in which one action is held."""
    env.reset(seed=seed)
    actions = np.full((env.num_envs, 1), action, dtype=np.float32)
    playing = np.ones(env.num_envs, dtype=bool)
    cost = 0.0
    while playing.any():
        _, rewards, terminated, truncated, _ = env.step(actions)
        cost -= float(rewards[playing].sum()) / env.num_envs
        playing &= ~(terminated | truncated)
    return cost


def time_to_beat(config: TrainConfig, referee: Referee, limit: float, watch: Watch = int) -> Run:
    """Train until the policy costs less than the lower line, and tell after how many seconds it crossed each line.

    The clock runs from the making of the model on, through rollouts and updates; it stands while the policy is judged.
    Compiling is done before.

    Parameters
    ----------
    config : TrainConfig
        The recipe, with its seed.
    referee : Referee
    limit : float
        Training time after which it ends at the latest [s].
    watch : callable
        Called after each evaluation.
    """
    run = Run(config.seed)
    with torch_threads(config.threads):
        warm_up(config)
        clock = _Clock()
        model = make_model(config)
        model.learn(config.total_steps, callback=[*callbacks(config), _Judge(run, referee, clock, limit, watch)])
    return run


def describe_beats(config: TrainConfig, referee: Referee, runs: Sequence[Run], limit: float) -> dict[str, Any]:
    """Return plain data: the seconds of all runs, and what is needed to judge them.

    Returns
    -------
    dict
        ``time_to_beat_s`` and ``time_to_beat_lower_s``, each run's seconds until it was below eq. 6 and below the lower
        line (None where that was not reached), and ``time_to_beat``: lines, curves, recipe.
    """
    low, high = config.env.tension_range
    initial = config.network.initial_tension
    return {
        "time_to_beat_s": [run.eq6 for run in runs],
        "time_to_beat_lower_s": [run.lower for run in runs],
        "time_to_beat": {
            "lines": {split: {**asdict(lines), "lower": lines.lower} for split, lines in referee.lines.items()},
            "episodes": config.validation.episodes,
            "initial_tension": (low + high) / 2 if initial is None else initial,
            "limit_s": limit,
            "cores": available_cores(),
            "runs": [{"seed": run.seed, "eq6_s": run.eq6, "lower_s": run.lower, "curve": run.curve} for run in runs],
            "recipe": config.model_dump(),
        },
    }


def available_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Clock:
    """A stopwatch that can be halted."""

    def __init__(self) -> None:
        self._started, self._halted = time.perf_counter(), 0.0

    def __call__(self) -> float:
        return time.perf_counter() - self._started - self._halted

    @contextlib.contextmanager
    def halted(self) -> Iterator[None]:
        since = time.perf_counter()
        yield
        self._halted += time.perf_counter() - since


class _Judge(BaseCallback):
    """Has the policy judged between an update and the next rollout."""

    def __init__(self, run: Run, referee: Referee, clock: _Clock, limit: float, watch: Watch) -> None:
        super().__init__()
        self.run, self.referee, self.clock, self.limit, self.watch = run, referee, clock, limit, watch
        self._next = 0.0

    def _on_rollout_start(self) -> None:
        passed = self.clock()
        if passed >= self._next:
            self._judge(passed)
            self._next = passed + EVALUATION_PAUSE

    def _on_training_end(self) -> None:
        if self.run.lower is None:
            self._judge(self.clock())

    def _judge(self, passed: float) -> None:
        with self.clock.halted():
            assert isinstance(self.model, PPO)
            cost = self.referee.cost(self.model)
            self.run.curve.append((passed, self.num_timesteps, cost))
            for line in ("eq6", "lower"):
                if getattr(self.run, line) is None and self.referee.beats(self.model, cost, line):
                    setattr(self.run, line, passed)
            self.watch()

    def _on_step(self) -> bool:
        return self.run.lower is None and self.clock() < self.limit


def _fixed(config: TrainConfig, split: str, tension_law: str) -> gym.vector.VectorEnv[Any, Any, Any]:
    return gym.make_vec(
        config.env.id,
        num_envs=config.validation.episodes,
        split=split,
        tension_law=tension_law,
        max_episode_steps=config.env.max_episode_steps,
        **config.env.keywords(),
    )
