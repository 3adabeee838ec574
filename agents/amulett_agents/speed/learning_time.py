"""Training time until PPO beats its baselines."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from amulett_agents.config import TrainConfig
from amulett_agents.model import callbacks, make_model
from amulett_agents.validation import evaluate, make_validation_env, torch_threads, warm_up
from amulett_gym.envs.action import tension_to_action

CONSTANTS = tuple(np.arange(4.0, 15.01, 0.5).tolist())
"""Constant tensions that a policy has to beat [N]: the environment's default range."""
HELD_OUT_SEED = 10_000
EVALUATION_PAUSE = 0.5
"""Minimum training time between two evaluations [s]."""

Watch = Callable[[], object]


def with_neutral_start(config: TrainConfig) -> TrainConfig:
    """Return a recipe with the environment's default tension range, whose first policy is the middle of it.

    A fair start does not use a recipe's knowledge of good tensions.
    """
    env = config.env.model_copy(update={"tension_range": [CONSTANTS[0], CONSTANTS[-1]]})
    network = config.network.model_copy(update={"initial_tension": None})
    return config.model_copy(update={"env": env, "network": network})


@dataclass(frozen=True)
class Baselines:
    """Costs that a policy has to beat on fixed scenarios."""

    eq6: float  # of eq. 6 inside the loop
    constant: float  # of the best of `CONSTANTS`
    constant_tension: float  # [N]

    @property
    def lower(self) -> float:
        """The lower of the two costs."""
        return min(self.eq6, self.constant)


@dataclass
class Run:
    """One seed's learning curve.

    `curve` holds training time [s], agent steps and cost on the validation scenarios; `eq6` and `lower` are the
    training times [s] until the policy first beat eq. 6 and the lower baseline.
    """

    seed: int
    curve: list[tuple[float, int, float]] = field(default_factory=list)
    eq6: float | None = None
    lower: float | None = None


class Evaluator:
    """Compares policies with the baselines on fixed scenarios of a recipe's environment.

    A policy has to beat a baseline on the split `validation`, then on `held-out`: among many evaluations on the same
    scenarios, one can be better by chance.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.seeds = {"validation": config.validation.seed, "held-out": HELD_OUT_SEED}
        self.envs = {split: make_validation_env(config, split) for split in self.seeds}
        self.baselines = {split: self._baselines(config, split) for split in self.seeds}

    def cost(self, model: PPO, split: str = "validation") -> float:
        """Return the mean cost of an episode of a model's deterministic policy."""
        return evaluate(model, self.envs[split], self.seeds[split])["cost"]

    def beats(self, model: PPO, cost: float, baseline: str) -> bool:
        """Return whether a model with this cost on the validation scenarios beats a baseline on both splits."""
        if cost >= getattr(self.baselines["validation"], baseline):
            return False
        return self.cost(model, "held-out") < getattr(self.baselines["held-out"], baseline)

    def _baselines(self, config: TrainConfig, split: str) -> Baselines:
        seed, wide = self.seeds[split], with_neutral_start(config)
        actions = tension_to_action(np.array(CONSTANTS), (CONSTANTS[0], CONSTANTS[-1]))
        with contextlib.closing(make_validation_env(wide, split)) as env:
            costs = [constant_cost(env, float(action), seed) for action in actions]
        with contextlib.closing(make_validation_env(wide, split, "eq6")) as env:
            eq6 = constant_cost(env, 0.0, seed)
        best = int(np.argmin(costs))
        return Baselines(eq6, costs[best], CONSTANTS[best])


def constant_cost(env: gym.vector.VectorEnv[Any, Any, Any], action: float, seed: int) -> float:
    """Return the mean cost of an episode with a constant action."""
    env.reset(seed=seed)
    actions = np.full((env.num_envs, 1), action, dtype=np.float32)
    playing = np.ones(env.num_envs, dtype=bool)
    cost = 0.0
    while playing.any():
        _, rewards, terminated, truncated, _ = env.step(actions)
        cost -= float(rewards[playing].sum()) / env.num_envs
        playing &= ~(terminated | truncated)
    return cost


def time_to_beat(config: TrainConfig, evaluator: Evaluator, limit: float, watch: Watch = int) -> Run:
    """Train until the policy beats the lower baseline, for at most `limit` seconds; return the learning curve.

    The time includes making the model, rollouts and updates, but neither evaluations, after each of which `watch` is
    called, nor compilation.
    """
    run = Run(config.seed)
    with torch_threads(config.threads):
        warm_up(config)
        clock = _Clock()
        model = make_model(config)
        model.learn(config.total_steps, callback=[*callbacks(config), _Evaluation(run, evaluator, clock, limit, watch)])
    return run


def describe_beats(config: TrainConfig, evaluator: Evaluator, runs: Sequence[Run], limit: float) -> dict[str, Any]:
    """Return the results as JSON types.

    ``time_to_beat_s`` and ``time_to_beat_lower_s`` are each run's seconds until it beat eq. 6 and the lower baseline
    (None: never); ``time_to_beat`` holds baselines, curves, recipe.
    """
    low, high = config.env.tension_range
    initial = config.network.initial_tension
    return {
        "time_to_beat_s": [run.eq6 for run in runs],
        "time_to_beat_lower_s": [run.lower for run in runs],
        "time_to_beat": {
            "lines": {split: {**asdict(costs), "lower": costs.lower} for split, costs in evaluator.baselines.items()},
            "episodes": config.validation.episodes,
            "initial_tension": (low + high) / 2 if initial is None else initial,
            "limit_s": limit,
            "cores": available_cores(),
            "runs": [{"seed": run.seed, "eq6_s": run.eq6, "lower_s": run.lower, "curve": run.curve} for run in runs],
            "recipe": config.model_dump(),
        },
    }


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Clock:
    """A stopwatch that can be paused."""

    def __init__(self) -> None:
        self._started, self._paused = time.perf_counter(), 0.0

    def __call__(self) -> float:
        return time.perf_counter() - self._started - self._paused

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        since = time.perf_counter()
        yield
        self._paused += time.perf_counter() - since


class _Evaluation(BaseCallback):
    """Evaluates the policy between an update and the next rollout."""

    def __init__(self, run: Run, evaluator: Evaluator, clock: _Clock, limit: float, watch: Watch) -> None:
        super().__init__()
        self.run, self.evaluator, self.clock, self.limit, self.watch = run, evaluator, clock, limit, watch
        self._next = 0.0

    def _on_rollout_start(self) -> None:
        passed = self.clock()
        if passed >= self._next:
            self._evaluate(passed)
            self._next = passed + EVALUATION_PAUSE

    def _on_training_end(self) -> None:
        if self.run.lower is None:
            self._evaluate(self.clock())

    def _evaluate(self, passed: float) -> None:
        with self.clock.paused():
            assert isinstance(self.model, PPO)
            cost = self.evaluator.cost(self.model)
            self.run.curve.append((passed, self.num_timesteps, cost))
            for baseline in ("eq6", "lower"):
                if getattr(self.run, baseline) is None and self.evaluator.beats(self.model, cost, baseline):
                    setattr(self.run, baseline, passed)
            self.watch()

    def _on_step(self) -> bool:
        return self.run.lower is None and self.clock() < self.limit
