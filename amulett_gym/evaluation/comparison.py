"""The summary of a comparison: estimates with intervals, verdict, table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import __version__
from amulett_gym.envs.prices import divisors, divisors_are, divisors_owner
from amulett_gym.envs.reward import COST_CAP, default_weights
from amulett_gym.envs.transition import MAY_BE_MISSING
from amulett_gym.evaluation.metrics import COST_OF, EFFORT_OF, METRICS, UNITS
from amulett_gym.evaluation.runner import YARDSTICK, Results, labels
from amulett_gym.evaluation.statistics import LEVEL, RESAMPLES, SEED, Estimate, draw_weights, mean, ratio_of_sums
from amulett_gym.reporting.table import Table, csv_text, fill
from amulett_gym.reporting.words import span
from amulett_gym.storage.writing import write_text

Summary = dict[str, Any]

COMPARISON_MARKS = ("results.json", "scenarios.csv")
"""Files by which a comparison's folder is recognised."""


def summarise(results: Results) -> Summary:
    """Return the content of ``results.json``.

    Returns
    -------
    dict
        ``{"suite", "profile", "env_id", "seed", "episodes", "policies": {name: {metric: {"mean", "low", "high",
        "ratio_to_eq6": {"mean", "low", "high"}}}}}``, and what is needed to understand and repeat them. An undefined
        number is None; ``"not_reached"`` counts the scenarios in which a metric is undefined.
    """
    protocol = results.protocol
    families = protocol.families
    weights = draw_weights(protocol.episodes)
    yardstick = results.values[YARDSTICK]

    def entry(metric: str, values: NDArray[np.float64]) -> dict[str, Any]:
        missing = {"not_reached": int(np.isnan(values).sum())} if metric in MAY_BE_MISSING else {}
        ratio = ratio_of_sums(values, yardstick[metric], weights).plain()
        return {**mean(values, weights).plain(), "ratio_to_eq6": ratio, **missing}

    return {
        "suite": protocol.suite,
        "task": protocol.task,
        "track": results.track,
        "scenarios": [scenario.model_dump() for scenario in protocol.scenarios],
        "profile": protocol.profile.name,
        **{key: getattr(protocol, key) for key in ("env_id", "split", "seed", "episodes", "duration", "agent_period")},
        "push_suite": results.push_suite,
        "push_failures": dict(results.push_failures),
        "labels": labels(list(results.values)),
        "remarks": list(results.remarks),
        "yardstick": {"name": YARDSTICK, "listed": results.listed},
        "cost": {
            "weights": {family: default_weights(family, results.track) for family in families},
            "divisors": {
                family: divisors(protocol.profile, protocol.suite, family, results.track) for family in families
            },
            "divisors_of": divisors_owner(protocol.profile, protocol.suite),
            "divisors_are": divisors_are(protocol.profile, protocol.suite),
            "failure": f"{COST_CAP:g} for each agent step left",
        },
        "bootstrap": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
        "units": dict(UNITS),
        "versions": {"amulett-gym": __version__, "numba": version("numba"), "numpy": version("numpy")},
        "command": results.command,
        "verdict": verdict(results),
        "policies": {
            name: {metric: entry(metric, values) for metric, values in metrics.items()}
            for name, metrics in results.values.items()
        },
    }


def verdict(results: Results) -> str:
    """Return in a sentence or two which contender has the lowest cost, by how much, and which ones failed."""
    protocol = results.protocol
    label = labels(list(results.values))
    cost = METRICS[COST_OF[results.track]]
    costs = {label[name]: values[cost.key] for name, values in results.values.items()}
    kind = "own scenarios" if protocol.scenarios else f"{protocol.split} scenarios of {protocol.suite}"
    scenarios = f"{protocol.episodes} {kind} on the {protocol.profile.name}"
    scenarios = scenarios.replace("scenarios", "scenario", 1) if protocol.episodes == 1 else scenarios
    counts = [(name, len(reasons) - reasons.count(""), "") for name, reasons in results.failures.items()]
    counts += [(name, count, f" on {results.push_suite}") for name, count in results.push_failures.items()]
    failed = [
        f"{label[name]} failed in {count} of {protocol.episodes}{where}" for name, count, where in counts if count
    ]
    ending = f" Failures: {', '.join(failed)}." if failed else ""
    ranking = sorted(costs, key=lambda name: float(costs[name].mean()))
    best = ranking[0]
    if len(ranking) == 1:
        return f"{YARDSTICK} ran alone, at a {cost.name} of {costs[best].mean():.3g}, in {scenarios}.{ending}"
    weights = draw_weights(protocol.episodes)
    against = ratio_of_sums(costs[best], costs[YARDSTICK], weights)
    text = f"{best} has the lowest {cost.name} in {scenarios}"
    if best != YARDSTICK:
        text += f": {span(against.plain())} relative to {YARDSTICK}{_doubt(against)}"
    if best == YARDSTICK or ranking[1] != YARDSTICK:
        lead = ratio_of_sums(costs[ranking[1]], costs[best], weights)
        text += f". Next is {ranking[1]}: {span(lead.plain())} relative to {best}{_doubt(lead)}"
    return f"{text}.{ending}"


def in_words(summary: Summary) -> str:
    """Return the comparison for the terminal: table, verdict, remarks."""
    remarks = list(summary["remarks"])
    if not summary["yardstick"]["listed"]:
        remarks.append(f"{YARDSTICK} was not named; it always runs, as the baseline of the ratios")
    if summary["push_suite"] != summary["task"]:
        where = "these have" if summary["scenarios"] else f"{summary['task']} has"
        remarks.append(f"the push deflection was measured on the suite {summary['push_suite']}: {where} no pushes")
    lines = [summary["verdict"], *(f"Note: {remark}." for remark in remarks)]
    return "\n".join([table(summary).text(), "", *map(fill, lines)])


def table(summary: Summary) -> Table:
    """Return the comparison as a table: cost, its ratio to eq. 6 with interval, and the main metrics."""
    track = summary["track"]
    shown = (COST_OF[track], "position_ise", EFFORT_OF[track], "tension_ise", "resting_stiffness", "push_deflection")
    cost, *metrics = (METRICS[key] for key in shown)
    rows = [
        [
            summary["labels"][name],
            cost.text(found[cost.key]["mean"]),
            span(found[cost.key]["ratio_to_eq6"]),
            *(metric.text(found[metric.key]["mean"]) for metric in metrics),
            f"{METRICS['rise_time'].text(found['rise_time']['mean'])} ({risen(found)})",
            f"{found['failed']['mean']:.0%}",
        ]
        for name, found in summary["policies"].items()
    ]
    headings = (metric.heading for metric in metrics)
    return Table("", ("policy", cost.name, "ratio to eq6 [95 %]", *headings, "rise time [s] (risen)", "failed"), rows)


def risen(metrics: Mapping[str, Any]) -> str:
    """Return the share of setpoint steps that reached their target: times are means over these steps only."""
    steps = metrics["setpoint_steps"]["mean"]
    return f"{metrics['steps_risen']['mean'] / steps:.0%}" if steps else "no steps"


def write_scenarios(results: Results, path: str | Path) -> None:
    """Write one CSV row for each policy and scenario: seed, failure, and every metric (empty: undefined)."""
    rows = (
        [name, i, results.protocol.seed + i, failure, *(float(metrics[key][i]) for key in METRICS)]
        for name, metrics in results.values.items()
        for i, failure in enumerate(results.failures[name])
    )
    write_text(path, csv_text(["policy", "scenario", "seed", "failure", *METRICS], rows))


def _doubt(ratio: Estimate) -> str:
    if math.isnan(ratio.low):
        return " (from one scenario: no interval)"
    return " (the interval includes 1: no difference is shown)" if ratio.low <= 1.0 <= ratio.high else ""
