"""The content of ``benchmark.json`` of a benchmark over devices: all numbers, with intervals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import __version__
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE
from amulett_gym.evaluation.metrics import UNITS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.evaluation.statistics import (
    LEVEL,
    Draws,
    Estimate,
    count_failures,
    draw_nested,
    nested_mean,
    nested_ratio,
)
from amulett_gym.studies.benchmark.devices.description import (
    ADAPTED,
    CONSTANT,
    EQ6_WITH_GAINS,
    OWN_CONSTANT,
    SPECIALIST,
)
from amulett_gym.studies.benchmark.devices.stages import Entry, Evidence
from amulett_gym.studies.benchmark.runs import learning_curve, outcome

Content = dict[str, Any]

REPORTED = {
    SCHEDULE: ("position_ise", "effort", "tension_ise", "resting_stiffness", "push_deflection", "contact_peak"),
    FULL_CONTROL: ("position_ise", "drive_effort", "resting_stiffness", "push_deflection", "contact_peak"),
}
"""Physical metrics that are reported of every entry, by track."""


def content(evidence: Evidence, command: str | None = None, machine: str | None = None, quick: bool = False) -> Content:
    """Return the content of ``benchmark.json``; a number that does not exist is None.

    `command` and `machine` are reported as they are; `quick` marks the small benchmark, on which no claim is judged.
    Ratios are of sums over devices and scenarios; their intervals resample training seeds, devices and scenarios.
    """
    description, entries = evidence.description, evidence.entries
    return {
        "format": "amulett-devices-benchmark-results",
        "version": 1,
        "description": description.model_dump(mode="json"),
        "seeds": dict(evidence.overlap),
        **({"quick": True} if quick else {}),
        "command": command,
        "machine": machine,
        "versions": {"amulett-gym": __version__, **{name: version(name) for name in ("numba", "numpy", "scipy")}},
        "bootstrap": {"level": LEVEL, **description.bootstrap.model_dump()},
        "track": description.track,
        "units": {metric: UNITS[metric] for metric in REPORTED[description.track]},
        "fleets": {key: [profile.name for profile in fleet] for key, fleet in evidence.fleets.items()},
        "best_learned": description.best_learned,
        "laws": hand_tuned(evidence),
        "entries": {
            name: {"kind": entry.kind, "seeds": list(entry.seeds), "devices": list(entry.devices)}
            for name, entry in entries.items()
        },
        **({} if (gains := _gains(evidence)) is None else {"eq6_gains": gains}),
        "constants": {"of_devices": evidence.own_constants, "tuned": _tension(evidence)},
        "results": {name: _numbers(evidence, entry) for name, entry in entries.items()},
        "devices": {device: _on_device(evidence, device) for device in entries[YARDSTICK].devices},
        "families": _by_family(evidence),
        "adaptation": _adaptation(evidence),
        "training": _training(evidence),
        "validations": _validations(evidence),
    }


def hand_tuned(evidence: Evidence) -> list[str]:
    """Return the entries of eq. 6 and of the laws tuned on the training devices."""
    return [YARDSTICK, *(name for name, entry in evidence.entries.items() if entry.kind == "tuned")]


def opponents(evidence: Evidence, name: str) -> list[str]:
    """Return the entries with which an entry is compared, each on the devices of both."""
    asked = [*hand_tuned(evidence), EQ6_WITH_GAINS, OWN_CONSTANT, SPECIALIST, ADAPTED]
    return [other for other in asked if other in evidence.entries and other != name]


def shared_devices(*entries: Entry) -> tuple[str, ...]:
    """Return the devices on which all of some entries play."""
    return tuple(device for device in entries[0].devices if all(device in entry.members for entry in entries))


def _numbers(evidence: Evidence, entry: Entry) -> Content:
    cost, devices = evidence.values(entry.name), entry.devices
    failed = evidence.values(entry.name, "failed") > 0
    failures = count_failures(failed)
    to_eq6 = cost.mean(axis=0).sum(axis=1) / evidence.values(YARDSTICK, devices=devices)[0].sum(axis=1)
    worst = int(np.argmax(to_eq6))
    draws = _draws(evidence, *cost.shape)
    reported = REPORTED[evidence.description.track]
    metrics = {metric: evidence.values(entry.name, metric) for metric in reported}
    eq6 = {metric: evidence.values(YARDSTICK, metric, devices)[0] for metric in reported}
    others = opponents(evidence, entry.name)
    return {
        "cost": nested_mean(cost, draws).plain(),
        "ratio": {other: ratio(evidence, entry.name, other).plain() for other in (YARDSTICK, *others)},
        "lower_on": {other: _lower_on(evidence, entry.name, other) for other in others},
        "devices": len(devices),
        "worst": {"device": devices[worst], "ratio_to_eq6": float(to_eq6[worst])},
        "failures": asdict(failures),
        "seeds": cost.mean(axis=(1, 2)).tolist(),
        "seed_ratios": {
            other: [ratio(evidence, entry.name, other, member=member).mean for member in range(len(entry.seeds))]
            for other in others
        },
        "metrics": {
            metric: {
                **nested_mean(values, draws).plain(),
                "ratio_to_eq6": nested_ratio(values, eq6[metric], draws).plain(),
            }
            for metric, values in metrics.items()
        },
    }


def ratio(
    evidence: Evidence,
    name: str,
    other: str,
    chosen: NDArray[np.bool_] | None = None,
    member: int | None = None,
    devices: Iterable[str] | None = None,
) -> Estimate:
    """Return the ratio of an entry's costs to another's, on the devices of both.

    Parameters
    ----------
    chosen : ndarray of bool, shape (scenarios,), optional
        Only these scenarios.
    member : int, optional
        Only this member of the entry.
    devices : iterable of str, optional
        Only these devices.
    """
    shared = shared_devices(evidence.entries[name], evidence.entries[other]) if devices is None else tuple(devices)
    costs, others = evidence.values(name, devices=shared), evidence.values(other, devices=shared).mean(axis=0)
    costs = costs if member is None else costs[member : member + 1]
    if chosen is not None:
        costs = np.where(chosen, costs, np.nan)
    return nested_ratio(costs, others, _draws(evidence, *costs.shape))


def _lower_on(evidence: Evidence, name: str, other: str) -> dict[str, int]:
    """Return on how many of the shared devices the entry costs less, in the mean over seeds and scenarios."""
    shared = shared_devices(evidence.entries[name], evidence.entries[other])
    costs, others = (evidence.values(each, devices=shared).mean(axis=(0, 2)) for each in (name, other))
    return {"count": int((costs < others).sum()), "devices": len(shared)}


def _on_device(evidence: Evidence, device: str) -> Content:
    """Return the cost of eq. 6 on a device, and each entry's ratio to it, with intervals over seeds and scenarios."""
    eq6 = evidence.values(YARDSTICK, devices=[device])[0, 0]
    found: Content = {"eq6": float(eq6.mean()), "ratio_to_eq6": {}}
    for name, entry in evidence.entries.items():
        if device in entry.members:
            costs = evidence.values(name, devices=[device])[:, 0]
            draws = _draws(evidence, costs.shape[0], None, costs.shape[1])
            found["ratio_to_eq6"][name] = nested_ratio(costs, eq6, draws).plain()
    return found


def _by_family(evidence: Evidence) -> Content:
    """Return each entry's ratio to eq. 6 in each family, and that of the learned one to each hand-tuned law."""
    found: Content = {}
    best = evidence.description.best_learned
    for family in dict.fromkeys(evidence.families.tolist()):
        chosen = evidence.families == family
        found[family] = {
            "scenarios": int(chosen.sum()),
            "ratio_to_eq6": {name: ratio(evidence, name, YARDSTICK, chosen).plain() for name in evidence.entries},
            "ratio_of_learned": {law: ratio(evidence, best, law, chosen).plain() for law in hand_tuned(evidence)},
        }
    return found


def _adaptation(evidence: Evidence) -> Content:
    """Return by device the costs of the adapted policy, of the one it started from, and of the best constant there."""
    if ADAPTED not in evidence.entries:
        return {}
    best, found = evidence.description.best_learned, {}
    for device in evidence.entries[ADAPTED].devices:
        run = next(run for run in evidence.runs if run.entry == f"{ADAPTED}/{device}")
        start = evidence.values(best, devices=[device])[evidence.start, 0]
        found[device] = {
            "start": float(start.mean()),
            "seconds": outcome(run)["seconds"],
            "best_steps": outcome(run)["best_steps"],
            **{
                name: float(evidence.values(name, devices=[device]).mean())
                for name in (ADAPTED, OWN_CONSTANT, YARDSTICK, SPECIALIST)
                if device in evidence.entries.get(name, evidence.entries[YARDSTICK]).members
                and name in evidence.entries
            },
        }
    return found


def _training(evidence: Evidence) -> Content:
    """Return the price of learning and tuning, by entry."""
    found: Content = {}
    for run in evidence.runs:
        entry = found.setdefault(run.entry, {"runs": {}})
        result = outcome(run)
        entry["runs"][str(run.seed)] = {**result, "episodes": result["steps"] // run.config.env.max_episode_steps}
    for name, tuned in evidence.tuned.items():
        found[name] = {"tuned_episodes": tuned["training_episodes"]}
    return found


def _validations(evidence: Evidence) -> Content:
    """Return the validations of each training run on the training devices, by entry and seed: see `learning_curve`."""
    found: Content = {}
    for run in evidence.runs:
        if run.entry in evidence.description.learned:
            found.setdefault(run.entry, {})[str(run.seed)] = learning_curve(run).tolist()
    return found


def _gains(evidence: Evidence) -> str | None:
    """Return the name of the profile with whose gains eq. 6 also plays; None if it does not."""
    entry = evidence.entries.get(EQ6_WITH_GAINS)
    return None if entry is None or entry.gains is None else entry.gains.name


def _tension(evidence: Evidence) -> float | None:
    """Return the constant tuned on the training devices [N]; None if there is none."""
    tuned = evidence.tuned.get(CONSTANT)
    return None if tuned is None else float(next(iter(tuned["parameters"].values()))["value"])


def _draws(evidence: Evidence, seeds: int, devices: int | None, scenarios: int) -> Draws:
    bootstrap = evidence.description.bootstrap
    return _drawn(seeds, devices, scenarios, bootstrap.resamples, bootstrap.seed)


@cache
def _drawn(seeds: int, devices: int | None, scenarios: int, resamples: int, seed: int) -> Draws:
    return draw_nested(seeds, scenarios, resamples, seed, devices)
