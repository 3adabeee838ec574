"""Cache of a benchmark's episodes: one file for each contender, suite, split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS
from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE
from amulett_gym.evaluation.metrics import UNITS, control_prices
from amulett_gym.evaluation.runner import Protocol, Run, Schedule, acts_from_outside, is_bundle, play_alone
from amulett_gym.jit.code_cache import fingerprint
from amulett_gym.laws.bundle import MANIFEST
from amulett_gym.laws.contenders import Contender, Own
from amulett_gym.laws.parametric import is_tuned, tuned_vector
from amulett_gym.profile import load_profile
from amulett_gym.storage.kept import digest, kept
from amulett_gym.studies.benchmark.frozen import PRICES_OF, price_hash
from amulett_gym.tasks.hashes import PROFILE

VERSION = 1
"""Version of the files' content; the fingerprint of the compiled code counts as well."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Played:
    """Episodes of an entry's members (one for a law, else one for each training seed) on a suite's split."""

    values: dict[str, Values]  # metric -> values, shape (members, scenarios); NaN where not reached
    families: NDArray[np.int64]  # indices into `simulation.layout.FAMILIES`, shape (scenarios,)
    reasons: list[list[str]]  # of failures, by member and scenario; empty where none

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Played:
        """Combine the members' runs."""
        values = {metric: np.array([run.values[metric] for run in runs]) for metric in UNITS}
        return cls(values, runs[0].families, [run.failures for run in runs])


@dataclass(frozen=True)
class Play:
    """Episodes of a contender under a protocol, kept in a file of a folder."""

    folder: Path
    label: str
    protocol: Protocol
    contender: Contender
    keeps_schedule: bool = False

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / self.protocol.split / self.protocol.suite / f"{self.label}.npz"

    @property
    def digest(self) -> str:
        """The digest of everything that the episodes depend on."""
        return _digest(self.protocol, self.contender, self.keeps_schedule)

    def run(self) -> Run:
        """Return the run: read from its file, or played and kept.

        A user's callable is played each time: it has no content to compare.
        """
        if isinstance(self.contender, Own):
            return play_alone(self.protocol, self.contender)
        return kept(
            self.path,
            self.digest,
            lambda: play_alone(self.protocol, self.contender),
            partial(_pack, self.keeps_schedule and acts_from_outside(self.contender)),
            _unpack,
        )


def arrays_of(protocol: Protocol, contender: Contender, keep_schedule: bool) -> dict[str, Any]:
    """Play a contender, and return what `Play` keeps of its run."""
    return _pack(keep_schedule and acts_from_outside(contender), play_alone(protocol, contender))


def file_label(name: str) -> str:
    """Return a contender's name as a file name."""
    return "".join(character if character.isalnum() or character in "._-" else "-" for character in name)


def _digest(protocol: Protocol, contender: Contender, keep_schedule: bool) -> str:
    """Return a digest of everything that a run depends on: scenarios, device, prices, code, policy."""
    settings = [
        *(protocol.suite, protocol.split, protocol.episodes, protocol.seed, protocol.duration, protocol.agent_period),
        *(VERSION, _code(), keep_schedule, contender.env_keywords, list(UNITS)),
        prices(protocol.unit or protocol.profile, protocol.suite, track=contender.env_keywords.get("track", SCHEDULE)),
        *_unusual(protocol, contender),
    ]
    settings += [scenario.model_dump_json() for scenario in protocol.scenarios]
    name = contender.policy_name or contender.name
    acting: list[Any] = [name]
    if contender.policy_name is not None and is_bundle(name):
        acting = [(Path(name) / MANIFEST).read_bytes()]
    elif is_tuned(name):
        law, vector = tuned_vector(name, protocol.profile)
        acting = [law.name, vector]
    return digest(protocol.profile.model_dump_json(), settings, *acting)


def _unusual(protocol: Protocol, contender: Contender) -> list[Any]:
    """Return settings of a run that differ from the usual ones; usual ones add nothing, so older digests stay valid."""
    found: list[Any] = []
    if not _prices_are_frozen():
        found.append(control_prices(protocol.unit or protocol.profile, protocol.suite))
    if (env_id := protocol.env_of(contender)) not in (ENV_IDS[0], DRIVES_ID):  # the keyword control names that
        found.append(env_id)
    if protocol.scenarios:
        found.append([scenario.model_dump(mode="json") for scenario in protocol.scenarios])
    return found


@cache
def _prices_are_frozen() -> bool:
    """Return whether the prices of the full-control cost, which is in each run, are those of `PRICES_OF`."""
    return price_hash(load_profile(PROFILE), FULL_CONTROL) == PRICES_OF[FULL_CONTROL]


@cache
def _code() -> str:
    """Return the fingerprint of the code that this process runs, even if its files change later."""
    return fingerprint()


def _pack(with_schedule: bool, run: Run) -> dict[str, Any]:
    schedule = run.schedule
    arrays: dict[str, Any] = {
        "metrics": np.array(list(UNITS)),
        "values": np.array([run.values[metric] for metric in UNITS]),
        "failures": np.array(run.failures),
        "families": run.families,
        "tension_range": np.array(schedule.tension_range),
    }
    if with_schedule:
        arrays |= {
            "error": schedule.error.astype(np.float32),
            "tension": schedule.tension.astype(np.float32),
            "phase": schedule.phase.astype(np.int8),
            "approach": schedule.approach.astype(np.float32),
        }
    return arrays


def _unpack(arrays: Mapping[str, NDArray[Any]]) -> Run:
    values = dict(zip(arrays["metrics"].tolist(), arrays["values"], strict=True))
    low, high = arrays["tension_range"].tolist()
    error, tension, phase, approach = (
        arrays[key].astype(np.float64) if "error" in arrays else np.zeros(0)
        for key in ("error", "tension", "phase", "approach")
    )
    schedule = Schedule(error, tension, phase.astype(np.int64), (low, high), approach)
    return Run(values, arrays["failures"].tolist(), arrays["families"], schedule)
