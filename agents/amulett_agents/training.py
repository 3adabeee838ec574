"""Training runs: begin one, resume one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from amulett_agents.bundles import has_diverged
from amulett_agents.checkpoint import Checkpoint, newest_checkpoint, remove_checkpoints
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
    ``checkpoints/``, from which :func:`resume` goes on. Ctrl-C and SIGTERM end the run in good order after the present
    rollout, a second Ctrl-C at once. A run whose weights stop being finite numbers has diverged: it ends, and keeps the
    policies of its validations. The same recipe gives the same weights on the same machine, interrupted or not, unless
    `max_seconds` ends it.

    Parameters
    ----------
    config : TrainConfig
    out : str or Path
        Folder, made if it does not exist.
    progress : bool
        Show progress on stderr.
    command : sequence of str, optional
        The words of the command that started the run, to be kept with it.
    overwrite : bool
        Replace a run that is already in `out`.

    Returns
    -------
    TrainResult

    Raises
    ------
    RecipeError
        If the environment or the networks refuse the recipe.
    AmulettError
        If `out` holds something already, or another process works in it.
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
    """Go on with a run that was interrupted or killed, by its own recipe.

    The weights, the bundles and the validations (their times aside) come out as if nothing had happened, bit for bit,
    with the same versions on the same machine, unless `max_seconds` ends the run. Time since the last checkpoint does
    not count for that.

    Parameters
    ----------
    out : str or Path
        Folder of the run.
    progress : bool
        Show progress on stderr.

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
    if not (out / CONFIG).is_file():
        raise AmulettError(f"'{out}' holds no training run: there is no {CONFIG}")
    if is_finished(out):
        with suppress(AmulettError), locked_folder(out):  # it may have been killed just then
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
            if not (out / RUN_MARKS[1]).is_file():  # killed before it was written; the command's words are lost
                write_note(out, config, None)
            return _learn(model, Run(config, out, validation, command, progress, checkpoint))


def _learn(model: Model, run: Run) -> TrainResult:
    """Train until the end, an interruption, or divergence."""
    model.set_logger(_make_logger(run.out / "tensorboard", run.resumed))
    try:
        with stop_on_signals(run.stop):
            interval = 1 if run.config.algorithm == "ppo" else None  # SB3's SAC logs by single episodes; so we do it
            model.learn(run.config.total_steps, callback=[*callbacks(run.config), run], log_interval=interval)  # type: ignore[arg-type]
    except (KeyboardInterrupt, Stopped):
        run.interrupted = True
    except OSError as error:  # of TensorBoard's writer; all else that writes says what it could not write
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
