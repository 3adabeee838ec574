"""The files of a training run."""

from __future__ import annotations

import csv
import io
import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from amulett_agents.checkpoint import BUNDLES, FOLDER
from amulett_agents.config import TrainConfig
from amulett_gym.envs.reward import TERMS
from amulett_gym.envs.worn_reward import WORN_TERMS
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.storage.provenance import COMMAND, read_provenance, software_changes, write_provenance
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import write_json, write_text

COLUMNS = ("steps", "seconds", "cost", *TERMS, "failures", "exploration_std")
"""Columns of ``evaluations.csv``; a term, of which `Amulett/Worn-v0` has others, is its mean cost per episode."""

CONFIG, EVALUATIONS = "config.yaml", "evaluations.csv"

RUN_MARKS = (CONFIG, COMMAND)
"""A folder with these files is a training run's."""

START = "start"
"""Subfolder with a copy of the bundle that a run starts from."""

FINISHED = "finished.json"
"""File with the `TrainResult` of a finished run."""

_OUTPUTS = (FOLDER, FINISHED, EVALUATIONS, "last_sb3.zip", *BUNDLES, START, "tensorboard")


@dataclass(frozen=True)
class TrainResult:
    """The result of a training run.

    `out`, `best` and `last` are the folders of the run and its two bundles. `best_steps` is the training of `best`, and
    `steps` that of the run [agent steps]. `best_cost` and `last_cost` are mean capped costs (minus the return) on the
    validation scenarios, on which eq. 6 costs about 1 (in `Amulett/Worn-v0`, wearers without the device about 0.8).
    `seconds` includes validation, but neither compilation nor work that a resumed run had lost. `interrupted`: Ctrl-C
    or SIGTERM ended the run. `diverged`: the agent steps after which a weight was not finite, or too large to store,
    which ended the run (else None); the bundles are those of the validations before.
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
    diverged: int | None = None


def prepare(out: Path, config: TrainConfig, command: Sequence[str] | None) -> None:
    """Remove an earlier run, and write this one's recipe, note and the bundle that it starts from."""
    remove_leftovers(out)
    start, kept = config.network.start, out / f".{START}-new"
    if start is not None:  # first: it may be the earlier run's
        shutil.copytree(bundle_folder(start), kept)
    for name in _OUTPUTS:
        _remove(out / name)
    if start is not None:
        kept.rename(out / START)
    write_text(out / CONFIG, to_yaml(config.model_dump()))
    write_note(out, config, command)


def remove_run(out: Path) -> None:
    """Remove a run, its recipe last: until then the folder is known as a run's."""
    for name in (*_OUTPUTS, COMMAND, CONFIG):
        _remove(out / name)


def write_note(out: Path, config: TrainConfig, command: Sequence[str] | None) -> None:
    """Write ``command.json``."""
    devices = [device.model_dump(mode="json") for device in config.env.devices]
    content = {"profile": devices[0]} if config.env.fleet is None else {"fleet": devices}
    write_provenance(out, "train", content, [config.seed], command)


def with_start(config: TrainConfig, out: Path) -> TrainConfig:
    """Return a run's recipe that starts from the copy in its folder instead of the original bundle."""
    return starting_from(config, str((out / START).resolve())) if (out / START).is_dir() else config


def starting_from(config: TrainConfig, start: str) -> TrainConfig:
    """Return a recipe that starts from another bundle."""
    return config.model_copy(update={"network": config.network.model_copy(update={"start": start})})


def remove_leftovers(out: Path) -> None:
    """Remove half-written files of a killed process; the folder has to be locked."""
    for name in ("config", "command", "finished", "evaluations", "last_sb3", *BUNDLES, START):
        for path in out.glob(f".{name}-*"):
            _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def put_back(bundle: Path, place: Path) -> None:
    """Replace a bundle, which may be damaged or missing, by a copy; remove it if there is no copy."""
    if place.is_dir():
        shutil.rmtree(place)
    if bundle.is_dir():
        shutil.copytree(bundle, place)


def write_validations(out: Path, rows: Sequence[Mapping[str, float]]) -> None:
    """Write ``evaluations.csv``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _columns(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(out / EVALUATIONS, text.getvalue())


def _columns(row: Mapping[str, float]) -> tuple[str, ...]:
    """Return the columns for rows like this one, by the terms that it has."""
    return (*COLUMNS[:3], *(WORN_TERMS if WORN_TERMS[0] in row else TERMS), *COLUMNS[-2:])


def is_finished(out: str | Path) -> bool:
    """Return whether a run is finished."""
    return (user_path(out) / FINISHED).is_file()


def write_result(result: TrainResult) -> None:
    """Write ``finished.json``, without the folders: a run may be moved."""
    write_json(result.out / FINISHED, {**asdict(result), "out": None, "best": None, "last": None})


def read_result(out: Path) -> TrainResult:
    """Return a finished run's result."""
    path = out / FINISHED
    try:
        result = TrainResult(**read_json(path, "a run's result"))
    except TypeError as error:
        raise AmulettError(f"'{path}' is damaged: {error}") from error
    return replace(result, out=out, best=out / "best", last=out / "last")


def check_versions(out: Path) -> list[str] | None:
    """Return the words of the command that began a run; warn if the software differs."""
    if not (out / RUN_MARKS[1]).is_file():  # killed before it was written
        return None
    note = read_provenance(out)
    if changed := software_changes(note):
        message = f"'{out}' is resumed with other software, so that its numbers may differ: {'; '.join(changed)}"
        warnings.warn(message, stacklevel=3)
    return note.command
