"""Training runs, new or resumed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from amulett_agents.bundles import has_diverged
from amulett_agents.checkpoint import Checkpoint, devices_of, newest_checkpoint, remove_checkpoints
from amulett_agents.config import RecipeError, TrainConfig, load_train_config
from amulett_agents.interruption import stop_on_signals
from amulett_agents.model import Model, callbacks, make_model
from amulett_agents.run import Run, Stopped
from amulett_agents.run_folder import (
    CONFIG,
    EVALUATIONS,
    RUN_MARKS,
    TrainResult,
    check_versions,
    is_finished,
    prepare,
    read_result,
    remove_leftovers,
    with_start,
    write_note,
    write_result,
)
from amulett_agents.validation import make_validation_env, torch_threads, warm_up
from amulett_gym.errors import AmulettError
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences
from amulett_gym.storage.reading import user_path
from amulett_gym.storage.writing import output_folder


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
    ``checkpoints/`` for :func:`resume`. Ctrl-C and SIGTERM end the run after the present rollout, with its policies
    saved; a second Ctrl-C ends it at once. A run whose weights are no longer finite has diverged: it ends, and keeps
    the policies of its validations. The same recipe gives the same weights on the same machine, interrupted or not,
    unless `max_seconds` ends it.

    Parameters
    ----------
    config : TrainConfig
    out : str or Path
        Folder, made if it does not exist.
    progress : bool
        Show progress on stderr.
    command : sequence of str, optional
        Words of the command that started the run, which are stored with it.
    overwrite : bool
        Replace a run that is already in `out`.

    Raises
    ------
    RecipeError
        If the environment or the networks refuse the recipe.
    AmulettError
        If `out` is not empty, or another process works in it.
    """
    out = user_path(out)
    with output_folder(out, "training run", [RUN_MARKS]) as earlier, locked_folder(out):
        if earlier and not overwrite:
            raise AmulettError(
                f"'{out}' holds a training run already; choose another folder, resume it (--resume), or overwrite it "
                "(--overwrite)"
            )
        with torch_threads(config.threads):
            try:  # a wrong recipe is refused before anything of an earlier run is removed
                warm_up(config)
                model, validation = make_model(config, progress=progress), make_validation_env(config)
            except AmulettError as error:
                raise RecipeError(str(error)) from error
            prepare(out, config, command)
            return _learn(model, Run(config, out, validation, command, progress))


def resume(out: str | Path, progress: bool = True) -> TrainResult:
    """Continue a run that was interrupted or killed, with its own recipe.

    The weights, the bundles and the validations (except their times) are the same, bit for bit, as without the
    interruption, with the same versions on the same machine, unless `max_seconds` ends the run. Time since the last
    checkpoint does not count towards that limit.

    Parameters
    ----------
    out : str or Path
        Folder of the run.
    progress : bool
        Show progress on stderr.

    Returns
    -------
    TrainResult
        The stored result if the run is finished.

    Raises
    ------
    AmulettError
        If `out` holds no run or no usable checkpoint, the recipe or the profile differs from the checkpoint's, another
        version wrote it, or another process works in the folder.
    """
    out = user_path(out)
    if not (out / CONFIG).is_file():
        raise AmulettError(f"'{out}' holds no training run: there is no {CONFIG}")
    if is_finished(out):
        with suppress(AmulettError), locked_folder(out):  # it may have been killed before it removed them
            remove_checkpoints(out)
        return read_result(out)
    with locked_folder(out):
        config = load_train_config(out / CONFIG)
        checkpoint = newest_checkpoint(out)
        if checkpoint is None and (out / EVALUATIONS).exists():
            raise AmulettError(f"'{out}' holds no checkpoint to resume from; an earlier version trained it")
        command = check_versions(out)
        with torch_threads(config.threads):
            warm_up(config)
            model = make_model(with_start(config, out), checkpoint is not None, progress)
            validation = make_validation_env(config)
            if checkpoint is not None:
                _check_recipe(checkpoint, config, model)
            remove_leftovers(out)
            if not (out / RUN_MARKS[1]).is_file():  # killed before it was written; the command is lost
                write_note(out, config, None)
            return _learn(model, Run(config, out, validation, command, progress, checkpoint))


def _learn(model: Model, run: Run) -> TrainResult:
    """Train until the end, an interruption, or divergence."""
    model.set_logger(_make_logger(run.out / "tensorboard", run.resumed))
    try:
        with stop_on_signals(run.stop):
            interval = 1 if run.config.algorithm == "ppo" else None  # SB3's SAC logs by single episodes; Run logs it
            model.learn(run.config.total_steps, callback=[*callbacks(run.config), run], log_interval=interval)  # type: ignore[arg-type]
    except (KeyboardInterrupt, Stopped):
        run.interrupted = True
    except OSError as error:  # of TensorBoard's writer; our own writers raise an AmulettError
        run.check_folder()
        raise AmulettError(f"cannot write to '{run.out}': {error.strerror or error}") from error
    except ValueError:  # torch refuses a distribution of NaN
        if not has_diverged(model):
            raise
    if has_diverged(model):
        run.diverged, run.interrupted = model.num_timesteps, False
    run.finish(model)
    result = run.result()
    if not run.interrupted:
        write_result(result)
        remove_checkpoints(run.out)
    return result


def _make_logger(folder: Path, resumed: Checkpoint | None) -> Logger:
    """Return a logger to TensorBoard; entries after the checkpoint that the run is resumed from are hidden."""
    output = TensorBoardOutputFormat(str(folder))
    if resumed is not None:
        output.writer.close()
        output.writer = SummaryWriter(str(folder), purge_step=resumed.content.model.steps + 1)
    return Logger(str(folder), [output])


def _check_recipe(checkpoint: Checkpoint, config: TrainConfig, model: Model) -> None:
    """Refuse a recipe or a profile that is not the checkpoint's."""
    env = model.get_env()
    assert env is not None
    since = f"was changed since checkpoint '{checkpoint.folder}'"
    if changed := differences(checkpoint.content.config, config.model_dump()):
        raise AmulettError(
            f"the recipe {since}: {'; '.join(changed)}; a run is resumed with its own recipe: restore it, or train in "
            "another folder"
        )
    if changed := differences(checkpoint.content.profile, devices_of(env)):
        what = f"profile '{config.env.profile}'" if config.env.fleet is None else "the fleet"
        raise AmulettError(f"{what} {since}: {'; '.join(changed)}")
