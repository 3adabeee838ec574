"""A training run: PPO or SAC with logs, validation, checkpoints, and the best and the last policy kept as bundles."""

from __future__ import annotations

import csv
import io
import math
import shutil
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from amulett_agents.bundles import describe_policy, save_policy
from amulett_agents.checkpoint import (
    BUNDLES,
    FOLDER,
    Checkpoint,
    RunState,
    newest_checkpoint,
    remove_checkpoints,
    restore,
    write_checkpoint,
)
from amulett_agents.config import TrainConfig, load_train_config
from amulett_agents.model import Model, callbacks, exploration_std, make_model, make_validation_env
from amulett_gym.envs.reward import TERMS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.profile import load_profile
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import COMMAND, differences, read_provenance, software_changes, write_provenance
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import atomic_path, output_folder, write_json, write_text

COLUMNS = ("steps", "seconds", "cost", *TERMS, "failures", "exploration_std")
"""Columns of ``evaluations.csv``; a term is its mean cost per episode."""

RUN_MARKS = ("config.yaml", COMMAND)
"""Files by which a training run's folder is recognised."""

START = "start"
"""Folder of a run for the bundle that it started from."""

FINISHED = "finished.json"
"""File that a run leaves when it has come to its end: its `TrainResult`."""

_LOG_EVERY = 16_384
"""Steps between two entries of SAC's log. PPO logs every rollout."""

_OUTPUTS = (FOLDER, FINISHED, "evaluations.csv", "last_sb3.zip", *BUNDLES, START, "tensorboard")


@dataclass(frozen=True)
class TrainResult:
    """What a training run left behind.

    Attributes
    ----------
    out, best, last : Path
        Folders of the run and of its bundles.
    best_cost, last_cost : float
        Mean capped cost (minus the return) on the validation scenarios; eq. 6's is about 1.
    best_steps, steps : int
        Agent steps behind the best and the last policy.
    seconds : float
        Duration, validation included, compilation not; of a resumed run, without what was lost.
    interrupted : bool
        Whether Ctrl-C or SIGTERM ended the run.
    seed : int
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
    seed: int


def train(
    config: TrainConfig,
    out: str | Path,
    progress: bool = True,
    command: Sequence[str] | None = None,
    overwrite: bool = False,
) -> TrainResult:
    """Train a policy.

    `out` gets ``config.yaml`` (the resolved recipe), ``command.json``, ``evaluations.csv``, ``tensorboard/``, the
    bundles ``best/`` (lowest cost on the validation scenarios) and ``last/``, and, until the run is finished,
    ``checkpoints/``, from which :func:`resume` goes on. Ctrl-C and SIGTERM end the run in good order after the present
    rollout, a second Ctrl-C at once. The same recipe gives the same weights on the same machine, interrupted or not,
    unless `max_seconds` ends it.

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
        If the environment refuses its settings, `out` holds something already, or another process works in it.
    """
    out = user_path(out)
    with output_folder(out, "training run", [RUN_MARKS]) as earlier, locked_folder(out):
        if earlier and not overwrite:
            raise AmulettError(
                f"'{out}' holds a training run already; choose another folder, resume it (--resume), or overwrite it "
                "(--overwrite)"
            )
        with torch_threads(config.threads):
            # A wrong environment is refused before anything of an earlier run is cleared away.
            model, validation = make_model(config), make_validation_env(config)
            warm_up(config)
            _prepare(out, config, command)
            return _learn(model, _Run(config, out, validation, command, progress))


def resume(out: str | Path, progress: bool = True) -> TrainResult:
    """Go on with a run that was interrupted or killed, by its own recipe.

    The weights, the bundles and the validations (their times aside) come out as if nothing had happened, bit for bit,
    with the same versions on the same machine, unless `max_seconds` ends the run. Time since the last checkpoint does
    not count for that.

    Parameters
    ----------
    out : str or Path
        Folder of the run.
    progress : bool
        Draw a progress bar on stderr.

    Returns
    -------
    TrainResult
        Of a finished run, what it said then; nothing is done.

    Raises
    ------
    AmulettError
        If `out` holds no run or no checkpoint that can be used, the recipe or the profile is another one than that of
        the checkpoint, another version wrote it, or another process works in the folder.
    """
    out = user_path(out)
    if not (out / RUN_MARKS[0]).is_file():
        raise AmulettError(f"'{out}' holds no training run: there is no {RUN_MARKS[0]}")
    if is_finished(out):
        with suppress(AmulettError), locked_folder(out):  # it may have been killed just then
            remove_checkpoints(out)
        return _read_result(out)
    with locked_folder(out):
        config = load_train_config(out / RUN_MARKS[0])
        checkpoint = newest_checkpoint(out)
        if checkpoint is None and (out / "evaluations.csv").exists():
            raise AmulettError(f"'{out}' holds no checkpoint to resume from; an earlier version trained it")
        command = _check_versions(out)
        with torch_threads(config.threads):
            model, validation = make_model(config, checkpoint is not None), make_validation_env(config)
            if checkpoint is not None:
                _check_recipe(checkpoint, config, model)
            warm_up(config)
            _remove_leftovers(out)
            if not (out / RUN_MARKS[1]).is_file():  # killed before it was written; the command's words are lost
                _write_note(out, config, None)
            return _learn(model, _Run(config, out, validation, command, progress, checkpoint))


def is_finished(out: str | Path) -> bool:
    """Tell whether a run has come to its end."""
    return (user_path(out) / FINISHED).is_file()


def _learn(model: Model, run: _Run) -> TrainResult:
    """Train until the end, or until somebody interrupts."""
    model.set_logger(_make_logger(run.out / "tensorboard", run.resumed))
    try:
        with _interruptible(run):
            interval = 1 if run.config.algorithm == "ppo" else None  # SB3's SAC logs by single episodes; so we do it
            model.learn(run.config.total_steps, callback=[*callbacks(run.config), run], log_interval=interval)  # type: ignore[arg-type]
    except (KeyboardInterrupt, _Stopped):
        run.interrupted = True
    except OSError as error:  # of TensorBoard's writer; all else that writes says what it could not write
        run.check_folder()
        raise AmulettError(f"cannot write to '{run.out}': {error.strerror or error}") from error
    run.finish(model)
    result = run.result()
    if not run.interrupted:
        write_json(run.out / FINISHED, {**asdict(result), "out": None, "best": None, "last": None})
        remove_checkpoints(run.out)
    return result


class _Stopped(Exception):
    """Raised at the start of a rollout by a run that was asked to stop."""


class _Run(BaseCallback):
    """Watches a run: time budget, logs, progress bar, validation, bundles and checkpoints."""

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
        self.config, self.out, self.validation = config, out, validation
        self.command = None if command is None else list(command)
        self.resumed = resumed
        self.stopping = False
        self._first = True
        self.interrupted = False
        self._checkpointed = -math.inf
        self._checkpointed_steps = -1
        self._started = time.monotonic()
        self._rollout_started = self._started
        self._collected, self._collecting = 0, 0.0
        self._rows: list[dict[str, float]] = []
        self._best = 0
        self._validated_steps = -1
        self._next_validation = 0
        self._episodes: deque[dict[str, float]] = deque(maxlen=config.num_envs)
        self._bar = tqdm(
            total=config.total_steps, disable=not progress, unit=" steps", unit_scale=True, desc=f"seed {config.seed}"
        )

    def _on_rollout_start(self) -> None:
        if self._first:
            self._first = False
            if self.resumed is None:
                self._checkpoint()  # before anything is written that a run from its very beginning would not find
            else:
                self._restore(self.resumed)
        if self.num_timesteps >= self._next_validation:
            self._validate(self.model)
            self._next_validation = self.num_timesteps + self.config.validation.every_steps
        due = time.monotonic() - self._checkpointed >= self.config.checkpoint_seconds
        if (due or self.stopping) and self.num_timesteps > self._checkpointed_steps:
            self._checkpoint()
        if self.stopping:
            raise _Stopped
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
        if self._episodes:
            for term in TERMS:
                self.logger.record(f"reward/{term}", float(np.mean([terms[term] for terms in self._episodes])))
        self._show()
        if is_sac:
            infos = self.model.ep_info_buffer or ()
            for name, key in (("ep_rew_mean", "r"), ("ep_len_mean", "l")):
                if infos:
                    self.logger.record(f"rollout/{name}", float(np.mean([info[key] for info in infos])))
            self.logger.dump(self.num_timesteps)

    def _show(self) -> None:
        """Bring the progress bar up to date."""
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
            seed=self.config.seed,
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

    def check_folder(self) -> None:
        """Refuse to write to a folder that somebody has taken away: what was in it would be missing in a new one."""
        if not (self.out / RUN_MARKS[0]).is_file():
            raise AmulettError(f"the run's folder '{self.out}' has vanished, or its {RUN_MARKS[0]}; training stops")

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Go back to the checkpoint, and bring what the run has written back to it."""
        restore(self.model, checkpoint)  # type: ignore[arg-type]
        state = checkpoint.content.run
        self.num_timesteps = self._checkpointed_steps = self.model.num_timesteps
        self._started = time.monotonic() - state.seconds
        self._checkpointed = time.monotonic()
        self._rows, self._best = list(state.rows), state.best
        self._validated_steps, self._next_validation = state.validated_steps, state.next_validation
        self._episodes.extend(state.episodes)
        for name in BUNDLES:
            put_back(checkpoint.folder / name, self.out / name)
        if self._rows:
            write_text(self.out / "evaluations.csv", _table(self._rows))
        self._bar.update(self.num_timesteps)

    def _validate(self, model: Any) -> None:
        self.check_folder()
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

    def _save(self, model: Model, name: str) -> None:
        provenance = {
            "algorithm": self.config.algorithm.upper(),
            "command": self.command,
            "config": self.config.model_dump(),
            "validation": {"split": "validation", **self.config.validation.model_dump(), **self._rows[-1]},
        }
        save_policy(model, self.out / name, provenance)


@contextmanager
def _interruptible(run: _Run) -> Iterator[None]:
    """Let SIGTERM and the first Ctrl-C stop a run at its next rollout; only the main thread hears of signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: Any) -> None:
        if run.stopping and number == signal.SIGINT:
            raise KeyboardInterrupt
        run.stopping = True

    # Signals that are ignored stay so: shells start what runs in the background that way.
    both = (signal.SIGINT, signal.SIGTERM)
    handled = [number for number in both if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    earlier = {number: signal.signal(number, stop) for number in handled}
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch compute with so many threads for a while."""
    threads = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _make_logger(folder: Path, resumed: Checkpoint | None) -> Logger:
    """Log to TensorBoard; hide what a run has logged beyond the checkpoint that it is resumed from."""
    output = TensorBoardOutputFormat(str(folder))
    if resumed is not None:
        output.writer.close()
        output.writer = SummaryWriter(str(folder), purge_step=resumed.content.model.steps + 1)
    return Logger(str(folder), [output])


def _check_recipe(checkpoint: Checkpoint, config: TrainConfig, model: Model) -> None:
    """Refuse a recipe or a profile that is not the checkpoint's."""
    changed = differences(checkpoint.content.config, config.model_dump())
    if changed:
        raise AmulettError(
            f"the recipe was changed since checkpoint '{checkpoint.folder}': {'; '.join(changed)}; "
            "a run is resumed by its own recipe: put it back, or train anew in another folder"
        )
    env = model.get_env()
    assert env is not None
    changed = differences(checkpoint.content.profile, env.get_attr("profile")[0].model_dump(mode="json"))
    if changed:
        raise AmulettError(
            f"profile '{config.env.profile}' was changed since checkpoint '{checkpoint.folder}': {'; '.join(changed)}"
        )


def _check_versions(out: Path) -> list[str] | None:
    """Return the words of the command that began a run; warn if its bits may differ from now on."""
    if not (out / RUN_MARKS[1]).is_file():  # killed before it was written
        return None
    note = read_provenance(out)
    changed = software_changes(note)
    if changed:
        warnings.warn(
            f"'{out}' is resumed with other software, so that its numbers may differ: {'; '.join(changed)}",
            stacklevel=3,
        )
    return note.command


def _remove_leftovers(out: Path) -> None:
    """Remove half-written files of a process that was killed; the folder has to be locked."""
    for name in ("config", "command", "finished", "evaluations", "last_sb3", *BUNDLES, START):
        for path in out.glob(f".{name}-*"):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def put_back(bundle: Path, place: Path) -> None:
    """Replace a bundle, which may be damaged or missing, by a copy; remove it if there is none to copy."""
    if place.is_dir():
        shutil.rmtree(place)
    if bundle.is_dir():
        shutil.copytree(bundle, place)


def _read_result(out: Path) -> TrainResult:
    path = out / FINISHED
    try:
        result = TrainResult(**read_json(path, "a run's result"))
    except TypeError as error:
        raise AmulettError(f"'{path}' is damaged: {error}") from error
    return replace(result, out=out, best=out / "best", last=out / "last")


def evaluate(model: Model, env: gym.vector.VectorEnv[Any, Any, Any], seed: int) -> dict[str, float]:
    """Return the mean cost per episode of a model's deterministic policy, by the arithmetic of its bundle.

    Parameters
    ----------
    model : PPO or SAC
    env : VectorEnv
        Each of its devices plays one episode.
    seed : int
        Device i is seeded with ``seed + i``.

    Returns
    -------
    dict
        ``cost``, minus the mean return; each reward term's share of it; the number of ``failures``; the present
        ``exploration_std``, of SAC at the first observations.
    """
    act = Actor(*describe_policy(model), env)
    observations, info = env.reset(seed=seed)
    std = exploration_std(model, act.see(observations))
    playing = np.ones(env.num_envs, dtype=bool)
    costs = dict.fromkeys(TERMS, 0.0)
    failures = 0
    while playing.any():
        observations, _, terminated, truncated, info = env.step(act(observations))
        for term in TERMS:
            costs[term] -= float(info["reward_terms"][term][playing].sum()) / env.num_envs
        failures += int((terminated & playing).sum())
        playing &= ~(terminated | truncated)
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
    """Clear away an earlier run, all but its marks, and write down what this one is in their place.

    The bundle that it starts from is kept with it: what it was named by may be another one, or gone, when somebody does
    the same again.
    """
    _remove_leftovers(out)
    start, kept = config.network.start, out / f".{START}-new"
    if start is not None:  # before anything is cleared away: it may be the earlier run's
        shutil.copytree(bundle_folder(start), kept)
    for name in _OUTPUTS:
        path = out / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    if start is not None:
        kept.rename(out / START)
    write_text(out / "config.yaml", to_yaml(config.model_dump()))
    _write_note(out, config, command)


def _write_note(out: Path, config: TrainConfig, command: Sequence[str] | None) -> None:
    profile = load_profile(config.env.profile).model_dump(mode="json")
    write_provenance(out, "train", {"profile": profile}, [config.seed], command)


def _table(rows: list[dict[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
