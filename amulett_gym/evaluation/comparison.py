"""Results as numbers with intervals, as words, and as files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from amulett_gym import __version__
from amulett_gym.envs.reward import COST_CAP, default_weights, divisors, divisors_owner
from amulett_gym.envs.transition import MAY_BE_MISSING
from amulett_gym.evaluation.metrics import METRICS, UNITS
from amulett_gym.evaluation.runner import YARDSTICK, Results, labels
from amulett_gym.evaluation.statistics import LEVEL, RESAMPLES, SEED, Estimate, draw_weights, mean, ratio_of_sums
from amulett_gym.reporting.table import Table, csv_text, fill
from amulett_gym.reporting.words import span
from amulett_gym.storage.writing import write_text

Summary = dict[str, Any]

COMPARISON_MARKS = ("results.json", "scenarios.csv")
"""Files by which a comparison's folder is recognised."""


def summarise(results: Results) -> Summary:
    """Turn results into the content of ``results.json``.

    Returns
    -------
    dict
        ``{"suite", "profile", "env_id", "seed", "episodes", "policies": {name: {metric: {"mean", "low", "high",
        "ratio_to_eq6": {"mean", "low", "high"}}}}}``, and what else it takes to understand and repeat them. A number
        that does not exist is None; metrics that some scenarios do not have count those as ``"not_reached"``.
    """
    protocol = results.protocol
    families = protocol.families
    weights = draw_weights(protocol.episodes)
    yardstick = results.values[YARDSTICK]
    policies: dict[str, dict[str, Any]] = {}
    for name, metrics in results.values.items():
        policies[name] = {}
        for metric, values in metrics.items():
            entry: dict[str, Any] = {
                **mean(values, weights).plain(),
                "ratio_to_eq6": ratio_of_sums(values, yardstick[metric], weights).plain(),
            }
            if metric in MAY_BE_MISSING:
                entry["not_reached"] = sum(map(math.isnan, values.tolist()))
            policies[name][metric] = entry
    return {
        "suite": protocol.suite,
        "task": protocol.task,
        "scenarios": [scenario.model_dump() for scenario in protocol.scenarios],
        "profile": protocol.profile.name,
        "env_id": protocol.env_id,
        "split": protocol.split,
        "seed": protocol.seed,
        "episodes": protocol.episodes,
        "duration": protocol.duration,
        "agent_period": protocol.agent_period,
        "push_suite": results.push_suite,
        "push_failures": dict(results.push_failures),
        "labels": labels(list(results.values)),
        "remarks": list(results.remarks),
        "yardstick": {"name": YARDSTICK, "listed": results.listed},
        "cost": {
            "weights": {family: default_weights(family) for family in families},
            "divisors": {family: divisors(protocol.profile, protocol.suite, family) for family in families},
            "divisors_of": divisors_owner(protocol.profile),
            "failure": f"{COST_CAP:g} for each agent step left",
        },
        "bootstrap": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
        "units": dict(UNITS),
        "versions": {"amulett-gym": __version__, "numba": version("numba"), "numpy": version("numpy")},
        "command": results.command,
        "verdict": verdict(results),
        "policies": policies,
    }


def verdict(results: Results) -> str:
    """Return in a sentence or two which contender has the lowest cost, how sure that is, and which ones failed."""
    protocol = results.protocol
    label = labels(list(results.values))
    costs = {label[name]: values["cost"] for name, values in results.values.items()}
    kind = "own scenarios" if protocol.scenarios else f"{protocol.split} scenarios of {protocol.suite}"
    scenarios = f"{protocol.episodes} {kind} on the {protocol.profile.name}"
    scenarios = scenarios.replace("scenarios", "scenario", 1) if protocol.episodes == 1 else scenarios
    failed = [
        f"{label[name]} failed in {count} of {protocol.episodes}"
        for name, reasons in results.failures.items()
        if (count := sum(reason != "" for reason in reasons))
    ]
    failed += [
        f"{label[name]} failed in {count} of {protocol.episodes} on {results.push_suite}"
        for name, count in results.push_failures.items()
        if count
    ]
    ending = f" Failures: {', '.join(failed)}." if failed else ""
    ranking = sorted(costs, key=lambda name: float(costs[name].mean()))
    best = ranking[0]
    if len(ranking) == 1:
        return f"{YARDSTICK} ran alone, at a cost of {costs[best].mean():.3g}, in {scenarios}.{ending}"
    weights = draw_weights(protocol.episodes)
    against = ratio_of_sums(costs[best], costs[YARDSTICK], weights)
    text = f"{best} has the lowest cost in {scenarios}"
    if best != YARDSTICK:
        text += f": {span(against.plain())} relative to {YARDSTICK}{_doubt(against)}"
    if best == YARDSTICK or ranking[1] != YARDSTICK:
        lead = ratio_of_sums(costs[ranking[1]], costs[best], weights)
        text += f". Next is {ranking[1]}: {span(lead.plain())} relative to {best}{_doubt(lead)}"
    return f"{text}.{ending}"


def in_words(summary: Summary) -> str:
    """Return the comparison for the terminal: table, verdict, and what a reader has to know."""
    remarks = list(summary["remarks"])
    if not summary["yardstick"]["listed"]:
        remarks.append(f"{YARDSTICK} was not asked for; it always runs, as the yardstick")
    lines = [summary["verdict"], *(f"Note: {remark}." for remark in remarks)]
    return "\n".join([table(summary).text(), "", *map(fill, lines)])


def table(summary: Summary) -> Table:
    """Return the comparison as a table: cost, its ratio to eq. 6 with interval, and the main metrics."""
    shown = ("cost", "position_ise", "effort", "tension_ise", "resting_stiffness", "push_deflection")
    cost, *metrics = (METRICS[key] for key in shown)
    rows = [
        [
            summary["labels"][name],
            cost.text(found["cost"]["mean"]),
            span(found["cost"]["ratio_to_eq6"]),
            *(metric.text(found[metric.key]["mean"]) for metric in metrics),
            f"{METRICS['rise_time'].text(found['rise_time']['mean'])} ({risen(found)})",
            f"{found['failed']['mean']:.0%}",
        ]
        for name, found in summary["policies"].items()
    ]
    headings = (metric.heading for metric in metrics)
    return Table("", ("policy", "cost", "ratio to eq6 [95 %]", *headings, "rise time [s] (risen)", "failed"), rows)


def risen(metrics: Mapping[str, Any]) -> str:
    """Return the share of setpoint steps that reached their target: a time is a mean over those only."""
    steps = metrics["setpoint_steps"]["mean"]
    return f"{metrics['steps_risen']['mean'] / steps:.0%}" if steps else "no steps"


def write_scenarios(results: Results, path: str | Path) -> None:
    """Write one CSV row for each policy and scenario: seed, failure, and every metric (empty: not reached)."""
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
