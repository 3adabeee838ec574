"""Recording of a data set: policies play episodes, which are written in the format of Minari."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import metadata, version
from pathlib import Path
from typing import Any

from amulett_gym import ENV_IDS
from amulett_gym.datasets.files import check_free, check_minari, check_name, datasets_folder, new_dataset
from amulett_gym.datasets.playing import Stage, make_stage, play_episodes
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import labels
from amulett_gym.laws.contenders import Contender
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.provenance import git_revision, versions

DATA_VERSION = 0
"""Version in the name of a data set that is not given a name."""

MOST_SEED = 2**62
"""Largest seed of a first episode: files hold seeds of 64 bits."""


@dataclass(frozen=True)
class PolicyData:
    """What a policy's episodes of a data set are: their number, their mean return, how many failed."""

    episodes: int
    mean_return: float
    failures: int


@dataclass(frozen=True)
class Recorded:
    """A data set that was recorded.

    Attributes
    ----------
    name : str
    folder : Path
        Its own folder.
    episodes, steps : int
        Their numbers.
    policies : dict of str to PolicyData
    """

    name: str
    folder: Path
    episodes: int
    steps: int
    policies: dict[str, PolicyData]


def record_dataset(
    contenders: Sequence[Contender],
    name: str | None = None,
    *,
    env_id: str = ENV_IDS[0],
    given: Mapping[str, Any] | None = None,
    episodes: int = 100,
    seed: int = 0,
    duration: float = 10.0,
    root: str | Path | None = None,
    overwrite: bool = False,
    about: Mapping[str, Any] | None = None,
    origin: Mapping[str, Any] | None = None,
    progress: bool = False,
) -> Recorded:
    """Play episodes and write them as a data set.

    Minari recovers the environment from it. ``reset(seed=..., options=...)`` with an episode's seed, and with its
    options of a fleet, and the recorded actions give the recorded observations and rewards, bit for bit.

    Parameters
    ----------
    contenders : sequence of Contender
        Policies that act from outside the loop, among them `playing.Random`, by different names. Each plays episodes
        with the same seeds.
    name : str, optional
        Of the data set, such as ``"amulett/scaling/mine-v0"``; by default made of environment, device, suite, policies.
    env_id : str
    given : mapping, optional
        Keywords of the environment: ``profile`` or ``fleet``, ``suite``, ``split`` (default: ``train``).
    episodes : int
        Number of each policy's episodes on each device.
    seed : int
        Of the first episode; each has the seed after that of the one before, over all devices.
    duration : float
        Length of an episode [s].
    root : str or Path, optional
        Folder of all data sets; None: what MINARI_DATASETS_PATH names, or else Minari's own.
    overwrite : bool
        Replace a data set of this name.
    about : mapping, optional
        Of Minari's metadata ``author`` and ``author_email`` (sets of str) and ``description``.
    origin : mapping, optional
        JSON-serialisable, such as the command; kept in the metadata ``amulett`` with versions, seed and policies.
    progress : bool
        Show progress on stderr.

    Raises
    ------
    AmulettError
        If Minari is not installed, a value is wrong, the policies cannot act in one environment, there is a data set of
        this name, or it cannot be written. Nothing is written then.
    """
    check_minari()
    for key, value, least in (("episodes", episodes, 1), ("seed", seed, 0)):
        if value < least:
            raise AmulettError(f"{key} is {value}; it has to be at least {least}")
    if seed > MOST_SEED:
        raise AmulettError(f"seed is {seed}; it has to be at most {MOST_SEED}, as a data set holds it")
    names = [contender.name for contender in contenders]
    if not names or len({*names}) < len(names):
        raise AmulettError(f"the policies are {names}; there has to be at least one, and none twice")
    if name is not None:
        check_name(name)
    stage = make_stage(contenders, env_id, duration, given or {})
    name, root = name or default_name(stage, names), datasets_folder(root)
    check_free(root, name, overwrite)
    described = {"description": _description(stage, names), **(about or {}), **_metadata(stage, names)}
    software = {"versions": versions(), "git_revision": git_revision()}
    described["amulett"] = {"policies": names, "seed": seed, **(origin or {}), **software}
    found, steps = {}, 0
    total = len(names) * len(stage.devices) * episodes
    with (
        new_dataset(root, name, stage, described, overwrite) as writer,
        Progress(total, "record", "episodes", progress) as bar,
    ):
        for contender in contenders:
            returns, failures = [], 0
            for played in play_episodes(stage, contender, seed, episodes):
                writer.add(played)
                returns += [float(each.rewards.sum()) for each in played]
                failures += sum(each.failed for each in played)
                steps += sum(len(each.rewards) for each in played)
                bar.update(len(played), contender.name)
            found[contender.name] = PolicyData(len(returns), sum(returns) / len(returns), failures)
    return Recorded(name, root / name, total, steps, found)


def default_name(stage: Stage, policies: Sequence[str]) -> str:
    """Return a name like ``amulett/scaling/mixed-eq6-held-v0``; a device other than the default comes before."""
    settings = stage.settings
    device = [] if settings.profile.name == type(settings).model_fields["profile"].default else [settings.profile.name]
    if settings.fleet is not None:
        fleet = stage.spec.kwargs["fleet"]
        device = [fleet if isinstance(fleet, str) else f"{len(settings.fleet)}-devices"]
    of_env = stage.spec.id.partition("/")[2].partition("-")[0].lower()
    words = "-".join([*device, settings.suite, *labels(policies).values()])
    return check_name(f"amulett/{of_env}/{re.sub(r'[^-_a-zA-Z0-9]+', '_', words)}-v{DATA_VERSION}")


def _metadata(stage: Stage, policies: Sequence[str]) -> dict[str, Any]:
    """Return Minari's metadata on the policies, the code and the environment for evaluation."""
    held_out = {**stage.spec.kwargs, "split": "held-out"}
    return {
        "minari_version": version("minari"),
        "algorithm_name": ", ".join(policies),
        "code_permalink": _code(),
        "eval_env_spec": replace(stage.spec, kwargs=held_out).to_json(),
        "requirements": [f"amulett-gym=={version('amulett-gym')}"],
    }


def _description(stage: Stage, policies: Sequence[str]) -> str:
    settings = stage.settings
    devices = len(settings.devices)
    where = f"the device {settings.profile.name}" if settings.fleet is None else f"{devices} devices of a fleet"
    return (
        f"Episodes of {', '.join(policies)} in {stage.spec.id}, on {where}, in scenarios of the suite {settings.suite}"
        f", split {settings.split}."
    )


def _code() -> str:
    """Return the link to this version of the code."""
    links = dict(link.split(", ", 1) for link in metadata("amulett-gym").get_all("Project-URL") or ())
    revision = git_revision() or f"v{version('amulett-gym')}"
    return f"{links.get('Repository', '')}/tree/{revision.removesuffix('-dirty')}"
