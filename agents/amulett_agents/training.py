"""Training runs, new or resumed: one, or one with each of several seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from amulett_agents.bundles import has_diverged
from amulett_agents.checkpoint import Checkpoint, devices_of, newest_checkpoint, remove_checkpoints, steps_of
from amulett_agents.config import RecipeError, TrainConfig, load_train_config, parse_train_config
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
    remove_run,
    with_start,
    write_note,
    write_result,
)
from amulett_agents.validation import make_validation_env, torch_threads, warm_up
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json, user_path, visible
from amulett_gym.storage.writing import output_folder, write_json
from amulett_gym.workers.call import ALONE, Call, Workers
from amulett_gym.workers.run import results

SEEDS = "seeds.json"
"""File by which a folder of several seeds is recognised."""

Report = Callable[[TrainResult], object]


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
    with _new_run(out, overwrite), torch_threads(config.threads):
        model, validation = _made(config, progress)
        prepare(out, config, command)
        return _learn(model, Run(config, out, validation, command, progress))


def begin(
    config: TrainConfig,
    out: str | Path,
    command: Sequence[str] | None = None,
    overwrite: bool = False,
    check: bool = True,
) -> None:
    """Write what :func:`resume` needs to train a policy, as :func:`train` does, from the beginning.

    Parameters and errors are those of :func:`train`. Without `check`, or with a teacher, whose imitation takes long,
    only :func:`resume` finds out whether the environment and the networks accept the recipe.
    """
    out = user_path(out)
    with _new_run(out, overwrite):
        if check:
            _check(config)
        prepare(out, config, command)


def _check(config: TrainConfig) -> None:
    """Raise a RecipeError if the environment or the networks refuse a recipe; with a teacher, it is not tried."""
    if config.teacher is None:
        with torch_threads(config.threads):
            model, validation = _made(config, progress=False)
        model.get_env().close()  # type: ignore[union-attr]
        validation.close()


@contextmanager
def _new_run(out: Path, overwrite: bool) -> Iterator[None]:
    """Reserve the folder of a new run during the block; refuse one that holds a run, unless it may be overwritten."""
    with output_folder(out, "training run", [RUN_MARKS]) as earlier, locked_folder(out):
        if earlier and not overwrite:
            raise AmulettError(
                f"'{out}' holds a training run already; choose another folder, resume it (--resume), or overwrite it "
                "(--overwrite)"
            )
        yield


def _made(config: TrainConfig, progress: bool) -> tuple[Model, Any]:
    """Return a recipe's model and validation environment; RecipeError if they refuse it."""
    try:  # before anything of an earlier run is removed
        warm_up(config)
        return make_model(config, progress=progress), make_validation_env(config)
    except AmulettError as error:
        raise RecipeError(str(error)) from error


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


def resume_all(
    folders: Sequence[Path], workers: Workers = ALONE, progress: bool = True, what: str = "training"
) -> Iterator[tuple[Path, TrainResult]]:
    """Continue several runs by workers as by :func:`resume`; yield each folder and its result as it is finished.

    Parameters
    ----------
    folders : sequence of Path
        Of runs, from :func:`begin` or :func:`train`. Finished ones are not repeated.
    workers : Workers
        They change no result. On a cluster, the checkpoints are copied to the folders here.
    progress : bool
        Show the progress of all runs together on stderr.
    what : str
        Name of the work in it.

    Raises
    ------
    AmulettError
        As :func:`resume`, for one of the runs, which it names. The other ones are ended; their checkpoints are kept.
    KeyboardInterrupt
        If Ctrl-C, or SIGTERM to a run in this process, ended the runs. Their checkpoints are kept.
    """
    runs = {f"training run '{folder}'": folder for folder in folders}
    steps = {name: load_train_config(folder / CONFIG).total_steps for name, folder in runs.items()}
    done = sum(min(steps_of(folder), steps[name]) for name, folder in runs.items())
    missing = {name: folder for name, folder in runs.items() if not is_finished(folder)}
    calls = {name: Call(_resume_in, (), folder) for name, folder in missing.items()}
    for folder in folders:
        if is_finished(folder):
            yield folder, resume(folder)
    with (
        Progress(sum(steps.values()), what, "steps", progress, done) as bar,
        closing(results(calls, workers, bar.update)) as finished,
    ):
        for name, _ in finished:
            yield runs[name], read_result(missing[name])


def _resume_in(folder: Path) -> None:
    if resume(folder, progress=False).interrupted:
        raise KeyboardInterrupt


def train_seeds(
    config: TrainConfig,
    seeds: Sequence[int],
    out: str | Path,
    workers: Workers = ALONE,
    progress: bool = True,
    command: Sequence[str] | None = None,
    overwrite: bool = False,
    report: Report = lambda result: None,
) -> list[TrainResult]:
    """Train a policy with each of several seeds, each in its own folder as by :func:`train`.

    Parameters
    ----------
    config : TrainConfig
        Its own seed is not used.
    seeds : sequence of int
    out : str or Path
        Folder of ``seed-<k>``, made if it does not exist.
    workers : Workers
        They change no result, unless `max_seconds` ends runs.
    progress, command, overwrite
        As of :func:`train`.
    report : callable
        Called with each result as it is there.

    Returns
    -------
    list of TrainResult
        In the order of the seeds.

    Raises
    ------
    AmulettError
        As by :func:`train`, if seeds are equal or negative, or if `out` holds something else.
    KeyboardInterrupt
        If Ctrl-C ended the runs; :func:`resume_seeds` continues them.
    """
    wrong = [seed for seed in seeds if not 0 <= seed < 2**31]
    if not seeds or len(set(seeds)) < len(seeds) or wrong:
        raise AmulettError(f"seeds are {[*seeds]}; they have to differ and be from 0 to 2147483647")
    out = user_path(out)
    with output_folder(out, "training runs of several seeds", [[SEEDS]]) as earlier, locked_folder(out):
        if earlier and not overwrite:
            raise AmulettError(
                f"'{out}' holds training runs already; choose another folder, resume them (--resume), or overwrite "
                "them (--overwrite)"
            )
        _check(config)
        if earlier:
            _remove_runs(out, config)
        words = None if command is None else [*command]
        write_json(out / SEEDS, {"seeds": [*seeds], "config": config.model_dump(), "command": words})
        write_provenance(out, "seeds", {}, seeds, command)
        return _finish(out, config, seeds, workers, progress, command, report)


def resume_seeds(
    out: str | Path, workers: Workers = ALONE, progress: bool = True, report: Report = lambda result: None
) -> list[TrainResult]:
    """Continue the runs of :func:`train_seeds` that are not finished; parameters and errors as there."""
    out = user_path(out)
    content = read_json(out / SEEDS, "file of seeds")
    try:
        seeds, command = [int(seed) for seed in content["seeds"]], content["command"]
        config = parse_train_config(content["config"], f"the recipe in '{out / SEEDS}'")
    except (KeyError, TypeError, ValueError) as error:
        raise AmulettError(f"'{out / SEEDS}' is damaged: {error!r}") from error
    with locked_folder(out):
        return _finish(out, config, seeds, workers, progress, command, report)


def holds_seeds(out: str | Path) -> bool:
    """Return whether a folder is of :func:`train_seeds`."""
    return (user_path(out) / SEEDS).is_file()


def _remove_runs(out: Path, config: TrainConfig) -> None:
    """Remove the earlier runs with any seed, so that none is taken for one of the new recipe."""
    start = config.network.start
    if start is not None and out.resolve() in bundle_folder(start).resolve().parents:
        raise AmulettError(f"'{start}' is in '{out}', which would be overwritten; choose another folder for --out")
    for folder in visible(out, "seed-*"):
        with locked_folder(folder):
            remove_run(folder)
        with suppress(OSError):  # it holds files that are not the run's
            folder.rmdir()


def _finish(
    out: Path,
    config: TrainConfig,
    seeds: Sequence[int],
    workers: Workers,
    progress: bool,
    command: Sequence[str] | None,
    report: Report,
) -> list[TrainResult]:
    """Begin the runs that are not begun, and continue all of them."""
    for seed, folder in zip(seeds, _folders(out, seeds), strict=True):
        if not (folder / CONFIG).is_file():
            begin(config.model_copy(update={"seed": seed}), folder, command, check=False)
    found = {}
    for folder, result in resume_all(_folders(out, seeds), workers, progress, f"training, {len(seeds)} seeds"):
        found[folder] = result
        report(result)
    return [found[folder] for folder in _folders(out, seeds)]


def _folders(out: Path, seeds: Sequence[int]) -> list[Path]:
    return [out / f"seed-{seed}" for seed in seeds]


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
