"""What eq. 6 costs on a device, by which costs of all laws are divided: measured once, then kept.

eq. 6 (`text`, in the paper's loop) plays 400 training scenarios of 10 s of a suite; of the mixed suite about as many of
each family. With the testbed's control period that takes a core 0.2 s, in the mixed suite 2 s. The costs depend on the
device with the gains of the paper's loop, not on names, sources and gains of other loops. They are kept in memory and
in the folder of compiled code (see `jit.code_cache`), which is another one after any change of the code that they
depend on. Those of the shipped fleets' devices are package data (`FLEET_COSTS`). A computer whose exp or sin rounds
otherwise may find another third digit.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from amulett_gym.envs import transition
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile, device_names, is_shipped, load_profile
from amulett_gym.settings import Group, Sourced
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import FAMILIES, LANES, RUNNING
from amulett_gym.storage.writing import write_text
from amulett_gym.tasks.suites import START, episode_keys, families_of, sample

try:
    from amulett_gym.jit.code_cache import cache_folder
except (ImportError, AttributeError):  # see `jit.compiled`

    def cache_folder() -> Path | None:  # type: ignore[misc]
        """Return that there is no folder."""
        return None


EPISODES = 400
"""Episodes of each family; about as many in a mix. Fewer with short integration steps, see `STEPS`."""

LEAST_EPISODES = 20

STEPS = 4_000_000
"""Integration steps of a family if that leaves `LEAST_EPISODES`: 400 episodes of 10 s with steps of 1 ms."""

MOST_STEPS = 1_000_000
"""Integration steps of an episode above which nothing is measured: a family would take longer than seconds."""

DURATION = 10.0  # [s]

NO_CONTACT = 0.1
"""Cost of the contact where there is none: 0.1 N2 m2 s, a tenth of a second at 1 N m."""

FOLDER = "eq6-costs"

FLEET_COSTS = "eq6_costs.json"
"""File of the shipped fleets with the costs on their devices: `device_digest` -> suite -> `compact` or null."""

_METRICS = {
    "position": ("position_ise",),
    "effort": ("effort_biceps", "effort_triceps"),
    "tension": ("tension_ise",),
    "contact": ("contact_ise",),
    "drive_effort": ("drive_effort",),
}
"""Metrics that add up to a cost."""

Cost = Annotated[float, Field(gt=0)]


class Costs(Group):
    """Mean costs of an episode of 10 s, above 0."""

    position: Cost = Field(description="position ISE [deg2 s]")
    effort: Cost = Field(description="effort of the commands [deg2/s]")
    tension: Cost = Field(description="tension ISE [N2 s]")
    contact: Cost = Field(description="contact ISE [N2 m2 s]")
    drive_effort: Cost = Field(description="effort of the drives' own motion [deg2/s], of the full-control cost")


class Eq6Costs(Group):
    """What eq. 6 costs in a suite."""

    mean: Costs = Field(description="mean of all scenarios")
    families: dict[str, Costs] = Field(description="mean of the scenarios of each family of the suite")
    failed: float = Field(ge=0, le=1, description="share of the scenarios in which the device left its limits")


_known: dict[tuple[str, str], Eq6Costs | None] = {}


def eq6_costs(profile: Profile, suite: str) -> Eq6Costs | None:
    """Return the costs that `measure` finds; it measures only what no process of this user has measured yet."""
    digest = device_digest(profile)
    if (digest, suite) not in _known and suite in (shipped := _fleet_costs().get(digest, {})):
        _known[digest, suite] = _expanded(shipped[suite])
    if (digest, suite) not in _known:
        folder = cache_folder()
        path = None if folder is None else folder / FOLDER / f"{digest}-{suite}.json"
        found = None if path is None else _read(path, suite)
        if found is None and (found := measure(profile, suite)) is not None and path is not None:
            with suppress(AmulettError):  # a read-only or full disk
                write_text(path, found.model_dump_json(indent=2))
        _known[digest, suite] = found
    return _known[digest, suite]


def measure(profile: Profile, suite: str) -> Eq6Costs | None:
    """Return the mean costs of eq. 6 in training scenarios of a suite, rounded to 4 digits.

    The costs of an episode in which eq. 6 fails end at the failure: what is missing counts at the mean rate of all
    episodes. Costs so small that only the rounding of numbers is left count as a least cost, so that no law is divided
    by almost 0.

    Returns
    -------
    Eq6Costs or None
        None if eq. 6 cannot begin the scenarios, fails in all of a family before they begin to count, or an episode has
        more than `MOST_STEPS` integration steps.
    """
    steps = round(DURATION / profile.loop.control_period) * profile.loop.substeps
    if steps > MOST_STEPS:
        return None
    count = min(max(STEPS // steps, LEAST_EPISODES), EPISODES) * len(families_of(suite))
    keys = episode_keys(np.arange(count, dtype=np.uint64), np.zeros(count, dtype=np.uint64), "train")
    rows = sample(suite, keys, profile)
    shares = np.array_split(rows, min(_cores(), -(-count // LANES)))
    try:
        with ThreadPoolExecutor(len(shares)) as pool:
            played = np.concatenate(list(pool.map(partial(_play, profile), shares)), axis=1)
    except AmulettError:
        return None
    of_families = [played[:, rows["family"] == FAMILIES.index(family)] for family in families_of(suite)]
    means = [_mean(profile, part) for part in (played, *of_families)]
    if not np.isfinite([list(mean.values()) for mean in means]).all():
        return None
    mean, *families = (Costs(**mean) for mean in means)
    failed = float(played[-1].mean())
    return Eq6Costs(mean=mean, families=dict(zip(families_of(suite), families, strict=True)), failed=failed)


def compact(costs: Eq6Costs) -> dict[str, Any]:
    """Return costs as short plain data: the numbers of `Costs` in their order, families only if there are several."""
    families = {name: list(own.model_dump().values()) for name, own in costs.families.items()}
    own = {"families": families} if len(families) > 1 else {"family": next(iter(families))}
    return {"failed": costs.failed, "mean": list(costs.mean.model_dump().values()), **own}


def shipped_costs(profile: Profile) -> str | None:
    """Return the name of the shipped profile whose costs of eq. 6 a profile has; None if they have to be measured.

    It is the one that the profile names in `divisors_of`, or one with the same device and gains of the paper's loop.
    What is not compared has no influence on the costs of eq. 6: names, sources and the gains of other loops.
    """
    if profile.divisors_of is not None or is_shipped(profile):
        return profile.divisors_of or profile.name
    return _shipped_digests().get(device_digest(profile))


def device_digest(profile: Profile) -> str:
    """Return the SHA-256 of all in a profile that the costs of eq. 6 depend on."""
    groups = {name: group for name, group in profile if isinstance(group, Sourced)}
    content = {name: group.model_dump(mode="json", exclude={"sources"}) for name, group in groups.items()}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@cache
def _shipped_digests() -> dict[str, str]:
    return {device_digest(load_profile(name)): name for name in device_names()}


@cache
def _fleet_costs() -> dict[str, dict[str, Any]]:
    path = resources.files("amulett_gym") / "fleets" / FLEET_COSTS
    return dict(json.loads(path.read_text("utf-8"))) if path.is_file() else {}


def _expanded(content: Mapping[str, Any] | None) -> Eq6Costs | None:
    """Return the costs of which `compact` returned the content."""
    if content is None:
        return None
    families = content.get("families") or {content["family"]: content["mean"]}
    named = {name: Costs(**dict(zip(_METRICS, own, strict=True))) for name, own in families.items()}
    mean = Costs(**dict(zip(_METRICS, content["mean"], strict=True)))
    return Eq6Costs(mean=mean, families=named, failed=content["failed"])


def _play(profile: Profile, rows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the costs of episodes in the order of `_METRICS`, their counted time [s], and 1 for each failure."""
    simulation = Simulation(profile, len(rows), tension_law="eq6")
    simulation.reset(rows)
    settings = np.zeros(1, dtype=transition.SETTINGS)
    ticks = round(DURATION / simulation.control_period)
    settings["ticks"] = ticks  # a single step, by code that environments need, too
    ignored = np.zeros(len(rows)), np.empty((len(rows), len(transition.OBSERVATIONS)), dtype=np.float32)
    report = np.empty((len(rows), transition.REPORT_SIZE))
    arrays = simulation.parameters, settings, simulation.which, simulation.scenarios, simulation.states
    transition.step(*arrays, None, None, simulation.extended, None, None, *ignored, report)
    readings = dict(zip(transition.READINGS, report.T[transition.FIRST_READING :], strict=False))
    metrics = dict(zip(transition.METRICS, report.T[transition.FIRST_METRIC :], strict=True))
    costs = [np.sum([metrics[name] for name in names], axis=0) for names in _METRICS.values()]
    counted = np.maximum(readings["time"] - START, 0.0)  # a failed device's clock stands still
    return np.stack([*costs, counted, readings["failure"] != RUNNING])


def _mean(profile: Profile, played: NDArray[np.float64]) -> dict[str, float]:
    *costs, counted, _ = played
    with np.errstate(all="ignore"):
        missing = (DURATION - START) / counted.mean()
        found = {term: float(f"{cost.mean() * missing:.4g}") for term, cost in zip(_METRICS, costs, strict=True)}
    # 0.01 deg, 0.3 deg/s, 1e-3 of the nominal tension and 0.3 mN m, rms over 10 s.
    tension = 1e-5 * profile.variable_stiffness.nominal_tension**2
    least = {"position": 1e-3, "effort": 1.0, "tension": tension, "contact": 1e-6, "drive_effort": 1.0}
    found["contact"] = found["contact"] or NO_CONTACT
    return {term: max(cost, least[term]) for term, cost in found.items()}


def _read(path: Path, suite: str) -> Eq6Costs | None:
    """Return the costs that a file holds; None if it is missing or damaged."""
    try:
        found = Eq6Costs.model_validate_json(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return found if list(found.families) == families_of(suite) else None


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
