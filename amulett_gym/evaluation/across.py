"""Comparison over the devices of a fleet: every contender plays the same scenarios on each of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import ENV_IDS, __version__
from amulett_gym.envs.prices import divisors_are
from amulett_gym.envs.reward import COST_CAP, Track
from amulett_gym.envs.transition import MAY_BE_MISSING
from amulett_gym.evaluation.comparison import Summary
from amulett_gym.evaluation.metrics import COST_OF, METRICS, UNITS
from amulett_gym.evaluation.remarks import fleet_remarks
from amulett_gym.evaluation.runner import YARDSTICK, Protocol, Results, evaluate, labels
from amulett_gym.evaluation.statistics import LEVEL, RESAMPLES, SEED, draw_nested, nested_mean, nested_ratio
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.contenders import CONSTANT, Contender, split_loop
from amulett_gym.profile import Profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.reporting.table import Table, csv_text, fill
from amulett_gym.reporting.words import number, span
from amulett_gym.storage.writing import write_text
from amulett_gym.tasks.scenario import Scenario

Values = NDArray[np.float64]


@dataclass(frozen=True)
class FleetResults:
    """The results of all contenders on each device of a fleet.

    Attributes
    ----------
    devices : dict of str to Results
        By the device's name; contenders, scenarios and noise are the same on each.
    remarks : list of str
        Warnings, those that are alike on several devices once.
    command : str or None
        The command that repeats this comparison.
    """

    devices: dict[str, Results]
    remarks: list[str]
    command: str | None = None

    @property
    def protocol(self) -> Protocol:
        """What the devices share, with the first one as its profile."""
        return self._first.protocol

    @property
    def contenders(self) -> list[str]:
        """Names of the contenders."""
        return list(self._first.values)

    @property
    def track(self) -> Track:
        """As of `runner.Results`."""
        return self._first.track

    @property
    def families(self) -> Mapping[str, NDArray[np.bool_]]:
        """Which scenarios are of a family, by its name; shape (scenarios,)."""
        of_scenarios = np.array(self._first.families)
        return {family: of_scenarios == family for family in dict.fromkeys(self._first.families)}

    @property
    def best_constant(self) -> str | None:
        """The contender that is a constant tension with the lowest cost over all devices; None if there is none."""
        constants = [name for name in self.contenders if split_loop(name)[1].startswith(CONSTANT)]
        return min(constants, key=lambda name: self.values(name, COST_OF[self.track]).sum(), default=None)

    def values(self, contender: str, metric: str) -> Values:
        """Return a contender's values of a metric, shape (devices, scenarios)."""
        return np.array([results.values[contender][metric] for results in self.devices.values()])

    @property
    def _first(self) -> Results:
        return next(iter(self.devices.values()))


def evaluate_fleet(
    policies: Sequence[str | Contender],
    fleet: str | Path | Sequence[str | Path | Mapping[str, Any] | Profile],
    suite: str = "steps",
    episodes: int | None = None,
    seed: int = 0,
    env_id: str = ENV_IDS[0],
    split: str = "held-out",
    duration: float = 10.0,
    agent_period: float = 0.02,
    progress: bool = False,
    scenarios: Sequence[str | Path | Mapping[str, Any] | Scenario] = (),
) -> FleetResults:
    """Return the results of contenders, and of eq. 6, on each device of a fleet in the same scenarios.

    Costs on a device are divided by those of eq. 6 on that device.

    Parameters
    ----------
    fleet
        As of `fleet.load_fleet`.
    policies, suite, episodes, seed, env_id, split, duration, agent_period, progress, scenarios
        As of `runner.evaluate`; `episodes` are those on each device.

    Raises
    ------
    AmulettError
        As `load_fleet` and `evaluate`.
    """
    profiles = load_fleet(fleet)
    shared = (episodes, seed, env_id, split, duration, agent_period, False, scenarios)
    devices = {}
    with Progress(len(profiles), "fleet", "devices", progress) as bar:
        for profile in profiles:
            devices[profile.name] = evaluate(policies, suite, profile, *shared)
            bar.update(note=profile.name)
    remarks = fleet_remarks({name: results.remarks for name, results in devices.items()})
    return FleetResults({name: replace(results, remarks=[]) for name, results in devices.items()}, remarks)


def summarise_fleet(results: FleetResults) -> Summary:
    """Return the content of ``results.json`` of a comparison over a fleet; an undefined number is None.

    ``policies`` is as in a comparison on one device (`comparison.summarise`), over all devices and scenarios; a ratio
    is one of sums, its interval resamples devices and scenarios. With constants among the contenders, ``constant``
    names the one with the lowest cost, and there is a ``ratio_to_constant`` of the cost. Then follow the ``devices``
    and ``families``, each contender's ``worst_device``, and ``lower_than``: on how many devices it costs less.
    """
    protocol, cost, constant = results.protocol, COST_OF[results.track], results.best_constant
    draws = draw_nested(1, protocol.episodes, devices=len(results.devices))
    of_scenarios = draw_nested(1, protocol.episodes)
    costs = {name: results.values(name, cost) for name in results.contenders}
    eq6 = costs[YARDSTICK]

    def entry(name: str, metric: str) -> dict[str, Any]:
        values = results.values(name, metric)
        missing = {"not_reached": int(np.isnan(values).sum())} if metric in MAY_BE_MISSING else {}
        ratio = nested_ratio(values, results.values(YARDSTICK, metric), draws).plain()
        return {**nested_mean(values, draws).plain(), "ratio_to_eq6": ratio, **missing}

    def on_device(name: str, index: int) -> dict[str, Any]:
        ratio = nested_ratio(costs[name][index], eq6[index], of_scenarios).plain()
        failed = float(results.values(name, "failed")[index].mean())
        return {**nested_mean(costs[name][index], of_scenarios).plain(), "ratio_to_eq6": ratio, "failed": failed}

    def in_family(name: str, chosen: NDArray[np.bool_]) -> dict[str, Any]:
        own = np.where(chosen, costs[name], np.nan)
        return {**nested_mean(own, draws).plain(), "ratio_to_eq6": nested_ratio(own, eq6, draws).plain()}

    policies = {name: {metric: entry(name, metric) for metric in UNITS} for name in results.contenders}
    if constant is not None:
        for name in policies:
            ratio = nested_ratio(costs[name], costs[constant], draws).plain()
            policies[name][cost]["ratio_to_constant"] = ratio
    devices = {
        device: {name: on_device(name, index) for name in results.contenders}
        for index, device in enumerate(results.devices)
    }
    others = [YARDSTICK, *([] if constant is None else [constant])]
    ratios = {name: costs[name].sum(axis=1) / eq6.sum(axis=1) for name in results.contenders}
    worst = {name: list(results.devices)[int(np.argmax(found))] for name, found in ratios.items()}
    found: Summary = {
        "fleet": list(results.devices),
        "suite": protocol.suite,
        "task": protocol.task,
        "track": results.track,
        "scenarios": [scenario.model_dump() for scenario in protocol.scenarios],
        **{key: getattr(protocol, key) for key in ("env_id", "split", "seed", "episodes", "duration", "agent_period")},
        "labels": labels(results.contenders),
        "remarks": list(results.remarks),
        "yardstick": {"name": YARDSTICK, "listed": results.devices[next(iter(results.devices))].listed},
        "constant": constant,
        "cost": {
            "divisors_of": "each device's own eq. 6",
            "divisors_are": {
                device: divisors_are(each.protocol.profile, protocol.suite) for device, each in results.devices.items()
            },
            "failure": f"{COST_CAP:g} for each agent step left",
        },
        "bootstrap": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
        "units": dict(UNITS),
        "versions": {"amulett-gym": __version__, "numba": version("numba"), "numpy": version("numpy")},
        "command": results.command,
        "policies": policies,
        "lower_than": {
            name: {other: int((costs[name].sum(axis=1) < costs[other].sum(axis=1)).sum()) for other in others}
            for name in results.contenders
        },
        "worst_device": {name: {"device": device, **devices[device][name]} for name, device in worst.items()},
        "devices": devices,
        "families": {
            family: {
                "scenarios": int(chosen.sum()),
                "policies": {name: in_family(name, chosen) for name in results.contenders},
            }
            for family, chosen in results.families.items()
        },
    }
    return {**found, "verdict": fleet_verdict(found)}


def fleet_verdict(summary: Summary) -> str:
    """Return in a sentence or two which contender has the lowest cost over the fleet, and on how many devices."""
    cost, label = METRICS[COST_OF[summary["track"]]], summary["labels"]
    policies, count = summary["policies"], len(summary["fleet"])
    kind = "own scenarios" if summary["scenarios"] else f"{summary['split']} scenarios of {summary['suite']}"
    where = f"on {count} devices, in {summary['episodes']} {kind} on each"
    ranking = sorted(policies, key=lambda name: policies[name][cost.key]["mean"])
    best = ranking[0]
    if len(ranking) == 1:
        return f"{YARDSTICK} ran alone, at a {cost.name} of {policies[best][cost.key]['mean']:.3g}, {where}."
    if best == YARDSTICK:
        return f"{YARDSTICK} has the lowest {cost.name} {where}."
    worst, numbers = summary["worst_device"][best], policies[best][cost.key]
    return (
        f"{label[best]} has the lowest {cost.name} {where}: {span(numbers['ratio_to_eq6'])} relative to {YARDSTICK}, "
        f"below it on {summary['lower_than'][best][YARDSTICK]} of {count} devices; at most "
        f"{worst['ratio_to_eq6']['mean']:.3g}, on {worst['device']}."
    )


def fleet_table(summary: Summary) -> Table:
    """Return a row for each contender: cost, ratios, on how many devices it costs less, its worst device."""
    cost, label, constant = METRICS[COST_OF[summary["track"]]], summary["labels"], summary["constant"]
    count = len(summary["fleet"])
    head = ["policy", cost.name, "ratio to eq6 [95 %]", "below eq6 on"]
    head += [] if constant is None else [f"ratio to {label[constant]} [95 %]", f"below {label[constant]} on"]
    rows = []
    for name, found in summary["policies"].items():
        lower, worst = summary["lower_than"][name], summary["worst_device"][name]
        row = [label[name], cost.text(found[cost.key]["mean"]), span(found[cost.key]["ratio_to_eq6"])]
        row.append("" if name == YARDSTICK else f"{lower[YARDSTICK]}/{count}")
        if constant is not None:
            same = name == constant
            row.append(span(found[cost.key]["ratio_to_constant"]))
            row.append("" if same else f"{lower[constant]}/{count}")
        row += [f"{cost.text(worst['ratio_to_eq6']['mean'])} ({worst['device']})", f"{found['failed']['mean']:.0%}"]
        rows.append(row)
    return Table("", (*head, "worst ratio to eq6 (device)", "failed"), rows)


def device_table(summary: Summary, text: Callable[[Any], str] = span) -> Table:
    """Return a row for each device: the cost of eq. 6 there, and the ratio of each contender to it, as `text`."""
    cost, others = METRICS[COST_OF[summary["track"]]], [name for name in summary["policies"] if name != YARDSTICK]
    rows = [
        [device, cost.text(found[YARDSTICK]["mean"]), *(text(found[name]["ratio_to_eq6"]) for name in others)]
        for device, found in summary["devices"].items()
    ]
    return Table("", ("device", f"{cost.name} of eq6", *(summary["labels"][name] for name in others)), rows)


def family_table(summary: Summary) -> Table:
    """Return a row for each family: number of scenarios, and the ratio of each contender to eq. 6."""
    others = [name for name in summary["policies"] if name != YARDSTICK]
    rows = [
        [family, str(found["scenarios"]), *(span(found["policies"][name]["ratio_to_eq6"]) for name in others)]
        for family, found in summary["families"].items()
    ]
    return Table("", ("family", "scenarios", *(summary["labels"][name] for name in others)), rows)


def fleet_in_words(summary: Summary) -> str:
    """Return the comparison for the terminal: tables of contenders and devices, verdict, remarks."""
    remarks = list(summary["remarks"])
    if not summary["yardstick"]["listed"]:
        remarks.append(f"{YARDSTICK} was not named; it always runs, as the baseline of the ratios")
    tables = [fleet_table(summary)]
    if len(summary["policies"]) > 1:
        tables.append(device_table(summary, lambda ratio: number(ratio["mean"])))
    lines = [summary["verdict"], *(f"Note: {remark}." for remark in remarks)]
    return "\n\n".join([*(table.text() for table in tables), "\n".join(map(fill, lines))])


def write_fleet_scenarios(results: FleetResults, path: str | Path) -> None:
    """Write one CSV row for each policy, device and scenario: seed, failure, every metric (empty: undefined)."""
    rows = (
        [name, device, i, found.protocol.seed + i, failure, *(float(found.values[name][key][i]) for key in METRICS)]
        for name in results.contenders
        for device, found in results.devices.items()
        for i, failure in enumerate(found.failures[name])
    )
    write_text(path, csv_text(["policy", "device", "scenario", "seed", "failure", *METRICS], rows))
