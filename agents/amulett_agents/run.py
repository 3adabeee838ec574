"""The callback of a training run: validations, saved policies, checkpoints, logs, progress, time limit."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from amulett_agents.bundles import has_diverged, save_policy
from amulett_agents.checkpoint import BUNDLES, Checkpoint, RunState, restore, write_checkpoint
from amulett_agents.config import TrainConfig
from amulett_agents.model import Model
from amulett_agents.run_folder import CONFIG, TrainResult, put_back, write_validations
from amulett_agents.validation import evaluate, reward_terms
from amulett_gym.errors import AmulettError
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.writing import atomic_path
from amulett_gym.workers import report

_LOG_EVERY = 16_384
"""Steps between two entries of SAC's log. PPO logs every rollout."""


class Stopped(Exception):
    """Raised at the start of a rollout, to end a run that has to stop or has diverged."""


class Run(BaseCallback):
    """Callback of a run in the folder `out`, whose `command` is stored with its policies.

    `validation` is from `validation.make_validation_env`; `progress` is shown on stderr; the run continues from the
    checkpoint `resumed`, if there is one.
    """

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        validation: gym.vector.VectorEnv[Any, Any, Any],
        command: Sequence[str] | None,
        progress: bool,
        resumed: Checkpoint | None = None,
    ) -> None:
        super().__init__()
        self.config, self.out, self.validation, self.resumed = config, out, validation, resumed
        self.command = None if command is None else list(command)
        self.stopping = self.interrupted = False
        self.diverged: int | None = None
        self._first = True
        self._checkpointed, self._checkpointed_steps = -math.inf, -1
        self._started = self._rollout_started = time.monotonic()
        self._collected, self._collecting = 0, 0.0
        self._rows: list[dict[str, float]] = []
        self._best, self._validated_steps, self._next_validation = 0, -1, 0
        self._episodes: deque[dict[str, float]] = deque(maxlen=config.num_envs)
        self._progress: Progress | None = None
        self._show, self._reported = progress, 0

    def stop(self) -> bool:
        """Stop the run at its next rollout; return whether that was requested before."""
        before, self.stopping = self.stopping, True
        return before

    def _on_rollout_start(self) -> None:
        if self._first:
            self._first = False
            if self.resumed is None:
                self._checkpoint()  # before anything is written that a run from the start would not find
            else:
                self._restore(self.resumed)
        elif has_diverged(self.model):
            raise Stopped
        if self.num_timesteps >= self._next_validation:
            self._validate(self.model)
            self._next_validation = self.num_timesteps + self.config.validation.every_steps
        due = time.monotonic() - self._checkpointed >= self.config.checkpoint_seconds
        if (due or self.stopping) and self.num_timesteps > self._checkpointed_steps:
            self._checkpoint()
        if self.stopping:
            raise Stopped
        self._note("acting")
        self._rollout_started, self._rollout_steps = time.monotonic(), self.num_timesteps

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._episodes.append(info["episode_terms"])
        limit = self.config.max_seconds
        return limit is None or time.monotonic() - self._started < limit

    def _on_rollout_end(self) -> None:
        self.check_folder()
        self._collecting += time.monotonic() - self._rollout_started
        self._collected += self.num_timesteps - self._rollout_steps
        is_sac = self.config.algorithm == "sac"
        if is_sac and self.num_timesteps // _LOG_EVERY == self._rollout_steps // _LOG_EVERY:
            return
        self.logger.record("time/rollout_steps_per_second", self._collected / self._collecting)
        self._collected, self._collecting = 0, 0.0
        for term in reward_terms(self.validation):
            self._record_mean(f"reward/{term}", term, self._episodes)
        if is_sac:
            for name, key in (("ep_rew_mean", "r"), ("ep_len_mean", "l")):
                self._record_mean(f"rollout/{name}", key, self.model.ep_info_buffer or ())
            self.logger.dump(self.num_timesteps)
        else:
            self._note("learning")

    def _record_mean(self, name: str, key: str, infos: Collection[Mapping[str, float]]) -> None:
        if infos:
            self.logger.record(name, float(np.mean([info[key] for info in infos])))

    def _note(self, phase: str) -> None:
        """Show the progress; steps count at the next rollout's start, after the update with them."""
        config, done = self.config, min(self.num_timesteps, self.config.total_steps)
        random = config.algorithm == "sac" and done < config.sac.learning_starts
        what = f"{'random actions' if random else 'training'}, seed {config.seed}"
        if self._progress is None or self._progress.what != what:  # one rate for each kind: random actions take no time
            self.close_progress()
            total = min(config.sac.learning_starts, config.total_steps) if random else config.total_steps
            self._progress = Progress(total, what, "steps", self._show, done)
        self._report_steps(done)
        costs = f", cost {self._rows[-1]['cost']:.3f} (best {self._rows[self._best]['cost']:.3f})" if self._rows else ""
        self._progress.update(done - self._progress.done if phase == "acting" else 0, phase + costs)

    def _report_steps(self, done: int) -> None:
        report.advance(done - self._reported)
        self._reported = done

    def close_progress(self) -> None:
        """Stop showing progress."""
        if self._progress is not None:
            self._progress.close()

    def finish(self, model: Any) -> None:
        """Validate and save the last policy, unless it has diverged."""
        if self.diverged is None and model.num_timesteps > self._validated_steps:
            self._validate(model)
            model.logger.dump(model.num_timesteps)
        if self.diverged is None and self.config.checkpoint:
            with atomic_path(self.out / "last_sb3.zip") as path:
                model.save(path)
        self._report_steps(min(model.num_timesteps, self.config.total_steps))
        self.validation.close()
        model.get_env().close()
        model.logger.close()
        self.close_progress()

    def result(self) -> TrainResult:
        """Return the run's result."""
        best, last = self._rows[self._best], self._rows[-1]
        folders, costs = (self.out, self.out / "best", self.out / "last"), (best["cost"], last["cost"])
        done = int(last["steps"]) if self.diverged is None else self.diverged
        seconds = time.monotonic() - self._started
        return TrainResult(
            *folders, *costs, int(best["steps"]), done, seconds, self.interrupted, self.config.seed, self.diverged
        )

    def _checkpoint(self) -> None:
        state = RunState(
            seconds=time.monotonic() - self._started,
            rows=self._rows,
            best=self._best,
            validated_steps=self._validated_steps,
            next_validation=self._next_validation,
            episodes=list(self._episodes),
        )
        self.check_folder()
        write_checkpoint(self.out, self.model, state, self.config.model_dump())  # type: ignore[arg-type]
        self._checkpointed, self._checkpointed_steps = time.monotonic(), self.num_timesteps
        self._report_steps(min(self.num_timesteps, self.config.total_steps))
        report.keep()

    def check_folder(self) -> None:
        """Refuse to write if the folder was removed meanwhile: a new one would lack its files."""
        if not (self.out / CONFIG).is_file():
            raise AmulettError(f"the run's folder '{self.out}' has vanished, or its {CONFIG}; training stops")

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Restore the state of the checkpoint, and the files of the run at that time."""
        restore(self.model, checkpoint)  # type: ignore[arg-type]
        state = checkpoint.content.run
        self.num_timesteps = self._checkpointed_steps = self.model.num_timesteps
        self._reported = min(self.num_timesteps, self.config.total_steps)
        self._started = time.monotonic() - state.seconds
        self._checkpointed = time.monotonic()
        self._rows, self._best = list(state.rows), state.best
        self._validated_steps, self._next_validation = state.validated_steps, state.next_validation
        self._episodes.extend(state.episodes)
        for name in BUNDLES:
            put_back(checkpoint.folder / name, self.out / name)
        if self._rows:
            write_validations(self.out, self._rows)

    def _validate(self, model: Any) -> None:
        self.check_folder()
        scores = evaluate(model, self.validation, self.config.validation.seed, lambda: self._note("validating"))
        row = {"steps": model.num_timesteps, "seconds": round(time.monotonic() - self._started, 2), **scores}
        self._rows.append(row)
        # Of equal costs the first: while only the critic learns, the policy is still the one that it starts from.
        if len(self._rows) == 1 or row["cost"] < self._rows[self._best]["cost"]:
            self._best = len(self._rows) - 1
            self._save(model, "best")
        self._save(model, "last")
        write_validations(self.out, self._rows)
        for name, value in scores.items():
            model.logger.record(f"validation/{name}", value)
        if (doffed := self.config.env.doffed_cost) is not None:  # what the cost is compared with
            model.logger.record("validation/doffed_cost", doffed)
        self._validated_steps = model.num_timesteps

    def _save(self, model: Model, name: str) -> None:
        provenance = {
            "algorithm": self.config.algorithm.upper(),
            "command": self.command,
            "config": self.config.model_dump(),
            "validation": {"split": "validation", **self.config.validation.model_dump(), **self._rows[-1]},
        }
        save_policy(model, self.out / name, provenance)
