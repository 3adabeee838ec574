"""Episodes of a benchmark: each contender plays each suite and split once; what it did is kept in a file of its own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.reward import prices
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import UNITS
from amulett_gym.evaluation.runner import Protocol, Run, Schedule, acts_from_outside, is_bundle, play_alone
from amulett_gym.jit.code_cache import fingerprint
from amulett_gym.laws.bundle import MANIFEST
from amulett_gym.laws.contenders import Contender, Own
from amulett_gym.laws.parametric import tuned_names, tuned_vector
from amulett_gym.storage.reading import read_arrays
from amulett_gym.storage.writing import atomic_path

VERSION = 1
"""Of what a file holds and how it came about; the compiled code's own fingerprint counts besides."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Played:
    """What an entry did on a suite's split; of a law, one member, of what was learned one a training seed.

    Attributes
    ----------
    values : dict of str to ndarray, shape (members, scenarios)
        Metric -> value; NaN where not reached.
    families : ndarray of int, shape (scenarios,)
        Indices into `simulation.layout.FAMILIES`.
    reasons : list of list of str
        Why devices failed, empty strings where they did not.
    """

    values: dict[str, Values]
    families: NDArray[np.int64]
    reasons: list[list[str]]

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Played:
        """Put the members' runs together."""
        values = {metric: np.array([run.values[metric] for run in runs]) for metric in UNITS}
        return cls(values, runs[0].families, [run.failures for run in runs])


def played(folder: Path, label: str, protocol: Protocol, contender: Contender, keep_schedule: bool = False) -> Run:
    """Return what a contender does under a protocol: read from its file, or played and kept.

    A policy of one's own is played anew each time, since nobody can tell whether a callable is still the same.

    Raises
    ------
    AmulettError
        If a file is damaged.
    """
    if isinstance(contender, Own):
        return play_alone(protocol, contender)
    path = folder / protocol.split / protocol.suite / f"{label}.npz"
    digest = _digest(protocol, contender, keep_schedule)
    run = _read(path, digest)
    if run is None:
        run = play_alone(protocol, contender)
        _write(path, digest, run, keep_schedule and acts_from_outside(contender))
    return run


def file_label(name: str) -> str:
    """Return a contender's name as a file can be called."""
    return "".join(character if character.isalnum() or character in "._-" else "-" for character in name)


def _digest(protocol: Protocol, contender: Contender, keep_schedule: bool) -> str:
    """Return a SHA-256 of all that a run hangs on: scenarios, device, prices, code, and what acts."""
    content = hashlib.sha256(protocol.profile.model_dump_json().encode())
    settings = [
        *(protocol.suite, protocol.split, protocol.episodes, protocol.seed, protocol.duration, protocol.agent_period),
        *(VERSION, _code(), keep_schedule, contender.env_keywords, list(UNITS)),
        prices(protocol.profile, protocol.suite).tolist(),
    ]
    content.update(json.dumps(settings, default=str).encode())
    name = contender.policy_name or contender.name
    if contender.policy_name is not None and is_bundle(name):
        content.update((Path(name) / MANIFEST).read_bytes())
    elif name in tuned_names():
        law, vector = tuned_vector(name, protocol.profile)
        content.update(law.name.encode() + vector.tobytes())
    else:
        content.update(name.encode())
    return content.hexdigest()


@cache
def _code() -> str:
    """Return the fingerprint of the code that this process runs, whatever happens to its files meanwhile."""
    return fingerprint()


def _write(path: Path, digest: str, run: Run, with_schedule: bool) -> None:
    schedule = run.schedule
    arrays: dict[str, Any] = {}
    if with_schedule:
        arrays = {
            "error": schedule.error.astype(np.float32),
            "tension": schedule.tension.astype(np.float32),
            "phase": schedule.phase.astype(np.int8),
            "approach": schedule.approach.astype(np.float32),
        }
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            sha256=np.array(digest),
            metrics=np.array(list(UNITS)),
            values=np.array([run.values[metric] for metric in UNITS]),
            failures=np.array(run.failures),
            families=run.families,
            tension_range=np.array(schedule.tension_range),
            **arrays,
        )


def _read(path: Path, digest: str) -> Run | None:
    """Return what a file holds, None if it is not there or is about something else."""
    if not path.exists():
        return None
    try:
        arrays = read_arrays(path, "episodes")
        if str(arrays["sha256"]) != digest:
            return None
        values = dict(zip(arrays["metrics"].tolist(), arrays["values"], strict=True))
        low, high = arrays["tension_range"].tolist()
        kept = "error" in arrays
        error, tension, phase, approach = (
            arrays[key].astype(np.float64) if kept else np.zeros(0) for key in ("error", "tension", "phase", "approach")
        )
        schedule = Schedule(error, tension, phase.astype(np.int64), (low, high), approach)
        return Run(values, arrays["failures"].tolist(), arrays["families"], schedule)
    except (ValueError, KeyError, TypeError) as error:
        raise AmulettError(f"cannot read episodes '{path}': {error}; delete it to play them again") from error
