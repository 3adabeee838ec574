"""A training run: PPO with logs, validation, and the best and the last policy kept as bundles."""

from __future__ import annotations

import csv
import io
import shutil
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from tqdm import tqdm

from amulett_agents.config import TrainConfig
from amulett_agents.ppo import (
    exploration,
    extract_network,
    git_revision,
    make_model,
    make_validation_env,
    save_policy,
    versions,
)
from amulett_gym.envs.reward import TERMS
from amulett_gym.errors import AmulettError
from amulett_gym.files import atomic_path, output_folder, write_json, write_text
from amulett_gym.laws.bundle import forward

COLUMNS = ("steps", "seconds", "cost", *TERMS, "failures", "exploration_std")
"""Columns of ``evaluations.csv``; a term is its mean cost per episode."""

RUN_MARKS = ("config.yaml", "command.json")
"""Files by which a training run's folder is recognised."""

_OUTPUTS = (
    *RUN_MARKS,
    "evaluations.csv",
    "last_sb3.zip",
    "best",
    "last",
    "tensorboard",
)


@dataclass(frozen=True)
class TrainResult:
    """What a training run left behind.

    Attributes
    ----------
    out, best, last : Path
        Folders of the run and of its bundles.
    best_cost, last_cost : float
        Minus the mean return on the validation scenarios; eq. 6 costs about 1.
    best_steps, steps : int
        Agent steps behind the best and the last policy.
    seconds : float
        Duration, validation included, compilation not.
    interrupted : bool
        Whether Ctrl-C ended the run.
    """

    out: Path
    best: Path
    last: Path
    best_cost: float
    last_cost: float
    best_steps: int
    steps: int
    seconds: float
    interrupted: bool


def train(
    config: TrainConfig,
    out: str | Path,
    progress: bool = True,
    command: Sequence[str] | None = None,
    overwrite: bool = False,
) -> TrainResult:
    """Train a policy.

    `out` gets ``config.yaml`` (the resolved recipe), ``command.json``, ``evaluations.csv``, ``tensorboard/`` and the
    bundles ``best/`` (lowest cost on the validation scenarios) and ``last/``. Ctrl-C ends the run in good order. The
    same recipe gives the same weights on the same machine, unless `max_seconds` ends it.

    Parameters
    ----------
    config : TrainConfig
    out : str or Path
        Folder, made if it does not exist.
    progress : bool
        Draw a progress bar on stderr.
    command : sequence of str, optional
        The words of the command that started the run, to be kept with it.
    overwrite : bool
        Replace a run that is already in `out`.

    Returns
    -------
    TrainResult

    Raises
    ------
    AmulettError
        If the environment refuses its settings, or `out` holds something already.
    """
    out = Path(out)
    threads = torch.get_num_threads()
    with output_folder(out, "training run", [RUN_MARKS]) as earlier:
        if earlier and not overwrite:
            raise AmulettError(
                f"'{out}' holds a training run already; choose another folder, or overwrite it (--overwrite)"
            )
        torch.set_num_threads(config.threads)
        try:
            model = make_model(config)
            validation = make_validation_env(config)
            warm_up(config)
            _prepare(out, config, command)
            model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))
            run = _Run(config, out, validation, command, progress)
            try:
                model.learn(config.total_steps, callback=[*exploration(config), run])
            except KeyboardInterrupt:
                run.interrupted = True
            run.finish(model)
            return run.result()
        finally:
            torch.set_num_threads(threads)


class _Run(BaseCallback):
    """Watches a run: time budget, logs, progress bar, validation and bundles."""

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        validation: gym.vector.VectorEnv[Any, Any, Any],
        command: Sequence[str] | None,
        progress: bool,
    ) -> None:
        super().__init__()
        self.config, self.out, self.validation = config, out, validation
        self.command = None if command is None else list(command)
        self.interrupted = False
        self._started = time.monotonic()
        self._rollout_started = self._started
        self._rows: list[dict[str, float]] = []
        self._best = 0
        self._validated_steps = -1
        self._next_validation = 0
        self._episodes: deque[dict[str, float]] = deque(maxlen=config.num_envs)
        self._bar = tqdm(
            total=config.total_steps, disable=not progress, unit=" steps", unit_scale=True, desc=f"seed {config.seed}"
        )

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._next_validation:
            self._validate(self.model)
            self._next_validation = self.num_timesteps + self.config.validation.every_steps
        self._rollout_started = time.monotonic()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._episodes.append(info["episode_terms"])
        limit = self.config.max_seconds
        return limit is None or time.monotonic() - self._started < limit

    def _on_rollout_end(self) -> None:
        took = time.monotonic() - self._rollout_started
        steps = self.config.num_envs * self.config.ppo.n_steps
        self.logger.record("time/rollout_steps_per_second", steps / took)
        if self._episodes:
            for term in TERMS:
                self.logger.record(f"reward/{term}", float(np.mean([terms[term] for terms in self._episodes])))
        self._bar.update(min(self.num_timesteps, self.config.total_steps) - self._bar.n)
        episodes = self.model.ep_info_buffer or ()
        shown = {"cost": f"{self._rows[-1]['cost']:.3f}", "best": f"{self._rows[self._best]['cost']:.3f}"}
        if episodes:
            shown = {"return": f"{np.mean([episode['r'] for episode in episodes]):.3f}", **shown}
        self._bar.set_postfix(shown)

    def finish(self, model: Any) -> None:
        """Judge and keep the last policy."""
        if model.num_timesteps > self._validated_steps:
            self._validate(model)
            model.logger.dump(model.num_timesteps)
        if self.config.checkpoint:
            with atomic_path(self.out / "last_sb3.zip") as path:
                model.save(path)
        self.validation.close()
        model.get_env().close()
        model.logger.close()
        self._bar.close()

    def result(self) -> TrainResult:
        """Return what the run left behind."""
        best, last = self._rows[self._best], self._rows[-1]
        return TrainResult(
            out=self.out,
            best=self.out / "best",
            last=self.out / "last",
            best_cost=best["cost"],
            last_cost=last["cost"],
            best_steps=int(best["steps"]),
            steps=int(last["steps"]),
            seconds=time.monotonic() - self._started,
            interrupted=self.interrupted,
        )

    def _validate(self, model: Any) -> None:
        scores = evaluate(model, self.validation, self.config.validation.seed)
        row = {"steps": model.num_timesteps, "seconds": round(time.monotonic() - self._started, 2), **scores}
        self._rows.append(row)
        if row["cost"] <= self._rows[self._best]["cost"]:
            self._best = len(self._rows) - 1
            self._save(model, "best")
        self._save(model, "last")
        write_text(self.out / "evaluations.csv", _table(self._rows))
        for name, value in scores.items():
            model.logger.record(f"validation/{name}", value)
        self._validated_steps = model.num_timesteps

    def _save(self, model: PPO, name: str) -> None:
        provenance = {
            "algorithm": "PPO",
            "command": self.command,
            "config": self.config.model_dump(),
            "validation": {"split": "validation", **self.config.validation.model_dump(), **self._rows[-1]},
        }
        save_policy(model, self.out / name, provenance)


def evaluate(model: PPO, env: gym.vector.VectorEnv[Any, Any, Any], seed: int) -> dict[str, float]:
    """Return the mean cost per episode of a model's deterministic policy, by the arithmetic of its bundle.

    Parameters
    ----------
    model : PPO
    env : VectorEnv
        Each of its devices plays one episode.
    seed : int
        Device i is seeded with ``seed + i``.

    Returns
    -------
    dict
        ``cost``, minus the mean return; each reward term's share of it; the number of ``failures``; the present
        ``exploration_std``.
    """
    layers, network = extract_network(model.policy)
    observations, info = env.reset(seed=seed)
    playing = np.ones(env.num_envs, dtype=bool)
    costs = dict.fromkeys(TERMS, 0.0)
    failures = 0
    while playing.any():
        observations, _, terminated, truncated, info = env.step(forward(layers, network, observations))
        for term in TERMS:
            costs[term] -= float(info["reward_terms"][term][playing].sum()) / env.num_envs
        failures += int((terminated & playing).sum())
        playing &= ~(terminated | truncated)
    std = float(model.policy.log_std.detach().exp().mean())
    return {"cost": sum(costs.values()), **costs, "failures": failures, "exploration_std": std}


def warm_up(config: TrainConfig) -> None:
    """Let the kernel compile before the clock starts: a time budget is for learning."""
    keywords = {"num_envs": 2, "max_episode_steps": 1, **config.env.keywords()}
    env = gym.make_vec(config.env.id, split="validation", **keywords)
    env.reset(seed=0)
    for _ in range(2):  # the second step starts the next episode
        env.step(np.zeros((2, 1), dtype=np.float32))
    env.close()


def _prepare(out: Path, config: TrainConfig, command: Sequence[str] | None) -> None:
    """Clear away an earlier run, and write down what this one is."""
    for name in _OUTPUTS:
        path = out / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    write_text(out / "config.yaml", yaml.safe_dump(config.model_dump(), sort_keys=False))
    about = {
        "command": None if command is None else list(command),
        "seed": config.seed,
        "versions": versions(),
        "git_revision": git_revision(),
    }
    write_json(out / "command.json", about)


def _table(rows: list[dict[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
