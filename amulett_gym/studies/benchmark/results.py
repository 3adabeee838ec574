"""The content of ``benchmark.json``: all numbers of a benchmark, with intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym import __version__
from amulett_gym.envs.prices import divisors_owner
from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.evaluation.metrics import UNITS, control_cost, control_prices
from amulett_gym.evaluation.remarks import device_remarks
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.evaluation.search.optimal import OptimalCosts
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.evaluation.statistics import (
    LEVEL,
    UNDEFINED,
    Draws,
    Estimate,
    count_failures,
    draw_nested,
    interquartile_mean,
    nested_mean,
    nested_ratio,
    performance_profile,
    probability_of_improvement,
    worst_mean,
)
from amulett_gym.laws.contenders import loops_of
from amulett_gym.laws.parametric import LAWS, tuned_content
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.benchmark.description import PAPERS, loop_of, named
from amulett_gym.studies.benchmark.episodes import Played
from amulett_gym.studies.benchmark.frozen import PRICES_OF
from amulett_gym.studies.benchmark.reference import Searched
from amulett_gym.studies.benchmark.runs import outcome
from amulett_gym.studies.benchmark.stages import Evidence
from amulett_gym.tasks.hashes import VERSION as SUITES_VERSION
from amulett_gym.tasks.scenario import unpack

Content = dict[str, Any]
Values = NDArray[np.float64]

SEARCHED = ("clairvoyant", "foresight")
"""References that are schedules found by a search."""

REPORTED = (
    *(
        "position_ise",
        "effort",
        "isav_biceps",
        "isav_triceps",
        "tension_ise",
        "rise_time",
        "settling_time",
        "overshoot",
    ),
    *("contact_peak", "contact_ise", "push_deflection", "resting_stiffness", "agonist_switches"),
)
"""Physical metrics that are reported of every entry."""

DRIVES = ("drive_effort", "drive_work")
"""Those that are reported on the track *full control*, too."""

PROFILE_COSTS = tuple(round(0.05 * k, 2) for k in range(61))
"""Costs at which performance profiles are evaluated."""

WORST = 10
"""Number of scenarios that are reported: the learned policy's worst."""

WORST_FOLDER = "worst"

TUNED_EQ6, TUNED_LAW, POSITION_ONLY = "eq6-tuned", "parametric", "position-only"
"""Contenders that claims name."""


def content(evidence: Evidence, command: str | None = None, machine: str | None = None, quick: bool = False) -> Content:
    """Return the content of ``benchmark.json``; a number that does not exist is None.

    `command` and `machine` are reported as they are; `quick` marks the small benchmark, on which no claim is judged.
    """
    description = evidence.description
    best = description.best_learned if description.learned else None
    results = {f"{suite}/{split}": _place(evidence, suite, split) for suite, split in evidence.played}
    hand = best_by_hand(evidence)
    return {
        "format": "amulett-benchmark-results",
        "version": 1,
        "description": description.model_dump(mode="json"),
        "hashes": {**evidence.hashes, "suites_version": SUITES_VERSION, "frozen_prices": PRICES_OF[description.track]},
        "seeds": dict(evidence.overlap),
        **({"quick": True} if quick else {}),
        "command": command,
        "machine": machine,
        "versions": {"amulett-gym": __version__, **{name: version(name) for name in ("numba", "numpy", "scipy")}},
        "bootstrap": {"level": LEVEL, **description.bootstrap.model_dump()},
        "remarks": device_remarks(
            evidence.profile,
            [name for name in evidence.entries if name not in evidence.tuned],
            places={name: entry.members[0].policy_name for name, entry in evidence.entries.items()},
            loops=loops_of(member for entry in evidence.entries.values() for member in entry.members),
            suite=description.headline,
        ),
        "track": description.track,
        "units": {metric: UNITS[metric] for metric in reported(evidence)},
        "best_learned": best,
        "best_by_hand": hand,
        "entries": {
            name: {"kind": entry.kind, "seeds": list(entry.seeds), "loop": entry.loop}
            for name, entry in evidence.entries.items()
        },
        "constants": {
            "overall": evidence.best_constant(),
            "tried": evidence.tried,
            "best": {suite: evidence.best_constant(suite) for suite in evidence.tried},
            "best_by_loop": {suite: evidence.best_constants(suite) for suite in evidence.tried},
        },
        "validation": evidence.validation,
        "results": results,
        **({"paper_gains": _paper_gains(evidence)} if evidence.paper_gains else {}),
        "families": _by_family(evidence),
        "profiles": _profiles(evidence),
        "references": _references(evidence, hand),
        "training": _training(evidence),
        "worst": _worst(evidence, best, hand) if best is not None else [],
    }


def best_by_hand(evidence: Evidence) -> str:
    """Return the law or constant of the lowest cost on the headline suite, held-out: the best tuned law, in hindsight.

    Position control alone is none: it has other gains and no tension to schedule, so no schedule's reference bounds it.
    """
    names = [
        name for name, entry in evidence.entries.items() if entry.kind in ("law", "constant") and name != POSITION_ONLY
    ]
    costs = {name: float(evidence.headline()[name].values[evidence.metric].mean()) for name in names}
    return min(costs, key=lambda name: costs[name])


def opponents(evidence: Evidence, suite: str, name: str) -> list[str]:
    """Return the names of the entries with which an entry is compared on a suite: also those of its own loop."""
    loop = evidence.entries[name].loop
    constants = [evidence.best_constant(), evidence.best_constant(suite)]
    own = [each for each in evidence.best_constants() if loop_of(each) == loop]
    laws = [named(each, law) for each in (PAPERS, loop) for law in (YARDSTICK, TUNED_EQ6, TUNED_LAW)]
    asked = (YARDSTICK, *own, *constants, *laws, POSITION_ONLY)
    return [name for name in dict.fromkeys(asked) if name in evidence.entries]


def shown(evidence: Evidence, suite: str | None = None) -> list[str]:
    """Return the entries worth a line: all but the constants that are not the best, overall or on the suite."""
    kept = {*evidence.best_constants(), *([] if suite is None else evidence.best_constants(suite))}
    return [name for name, entry in evidence.entries.items() if entry.kind != "constant" or name in kept]


def write_worst(evidence: Evidence, found: Content, folder: Path) -> None:
    """Write the learned policy's worst scenarios as JSON that can be replayed."""
    if not found["worst"]:
        return
    rows = Trials(evidence.protocol).rows
    for item in found["worst"]:
        write_json(folder / item["file"], unpack(rows[item["scenario"]]).model_dump())


def _place(evidence: Evidence, suite: str, split: str) -> Content:
    """Return the numbers of all entries on a suite's split."""
    results = evidence.played[suite, split]
    full = shown(evidence, suite)
    found: Content = {}
    for name in results:
        against = opponents(evidence, suite, name) if name in full else [YARDSTICK]
        found[name] = _numbers(evidence, results, name, against, name in full)
        if split in evidence.description.altered:
            before, after = (each[name].values[evidence.metric] for each in (evidence.headline(), results))
            found[name]["ratio_to_unaltered"] = _ratio(after, before.mean(axis=0), evidence).plain()
    return found


def _numbers(
    evidence: Evidence, results: dict[str, Played], name: str, against: Iterable[str], everything: bool
) -> Content:
    values = results[name].values
    cost = values[evidence.metric]
    draws = _draws(evidence, *cost.shape)
    others = {other: results[other].values[evidence.metric] for other in against}
    found: Content = {
        "cost": nested_mean(cost, draws).plain(),
        "ratio": {other: _ratio(cost, theirs[0], evidence).plain() for other, theirs in others.items()},
        "failures": _failures(results[name]),
        "seeds": cost.mean(axis=1).tolist(),
        "metrics": {metric: nested_mean(values[metric], draws).plain() for metric in reported(evidence)},
    }
    if not everything:
        return found
    yardstick = results[YARDSTICK].values
    if evidence.description.track == FULL_CONTROL:
        commands, eq6 = (each["cost"] - each["cost_tension"] for each in (values, yardstick))
        found["ratio_of_commands"] = _ratio(commands, eq6[0], evidence).plain()
        found["settling"] = _settling(evidence, values, draws)
    for metric, numbers in found["metrics"].items():
        numbers["ratio_to_eq6"] = _ratio(values[metric], yardstick[metric][0], evidence).plain()
    return {
        **found,
        "iqm": interquartile_mean(cost, draws).plain(),
        "worst_decile": worst_mean(cost, draws).plain(),
        "better_than": {
            other: probability_of_improvement(cost, theirs, draws).plain() for other, theirs in others.items()
        },
        "seed_ratios": {other: (cost.sum(axis=1) / theirs.sum()).tolist() for other, theirs in others.items()},
    }


def _settling(evidence: Evidence, values: dict[str, Values], draws: Draws) -> Content:
    """Return the number of setpoint steps, of those that settled, and the mean time of all.

    A step that did not settle counts as long as an episode.
    """
    steps, settled = values["setpoint_steps"], values["steps_settled"]
    lost = evidence.description.duration * (steps - settled)
    with np.errstate(invalid="ignore"):
        times = (np.nan_to_num(values["settling_time"]) * settled + lost) / np.where(steps > 0, steps, np.nan)
    return {"time": nested_mean(times, draws).plain(), "settled": int(settled.sum()), "steps": int(steps.sum())}


def _failures(played: Played) -> Content:
    found = count_failures(played.values["failed"] > 0)
    reasons = Counter(reason for member in played.reasons for reason in member if reason)
    return {"count": found.count, "total": found.total, "low": found.low, "high": found.high, "reasons": dict(reasons)}


def _paper_gains(evidence: Evidence) -> Content:
    """Return by suite the cost of eq. 6 with the paper's gains, held-out, and entries' costs relative to it.

    The cost has the divisors of the benchmark's profile, as those of all entries have.
    """
    found: Content = {}
    for suite, run in evidence.paper_gains.items():
        prices = control_prices(evidence.profile, suite, run.families)
        eq6 = control_cost(run.values, run.values["cost_failure"], prices)
        results = evidence.played[suite, "held-out"]
        costs = {name: results[name].values[evidence.metric] for name in shown(evidence, suite)}
        found[suite] = {
            "cost": float(eq6.mean()),
            "unit": divisors_owner(evidence.profile, suite),
            "ratio": {name: _ratio(cost, eq6, evidence).plain() for name, cost in costs.items()},
        }
    return found


def _by_family(evidence: Evidence) -> Content:
    """Return each entry's share of eq. 6's cost in each family of the headline suite, held-out."""
    results = evidence.headline()
    families = results[YARDSTICK].families
    found: Content = {}
    for code in np.unique(families):
        chosen = families == code
        found[FAMILIES[code] or evidence.protocol.suite] = {
            "scenarios": int(chosen.sum()),
            "ratio_to_eq6": {name: _share_of(evidence, name, YARDSTICK, chosen) for name in shown(evidence)},
        }
        if evidence.description.track == FULL_CONTROL:
            constants: dict[str, str] = {loop_of(name): name for name in evidence.best_constants()}
            family = found[FAMILIES[code] or evidence.protocol.suite]
            family["ratio_to_constant"] = {
                name: _share_of(evidence, name, constants.get(entry.loop, evidence.best_constant()), chosen)
                for name, entry in evidence.entries.items()
                if name in shown(evidence)
            }
            searched = evidence.searched.get(evidence.protocol.suite)
            if searched is not None:
                goal = searched.run.values[evidence.metric]
                few = chosen[: goal.size]
                constant = results[evidence.best_constant()].values[evidence.metric][0, : goal.size]
                if few.any():
                    family["clairvoyant"] = _ratio(goal[None, few], constant[few], evidence).plain()
    return found


def _share_of(evidence: Evidence, name: str, other: str, chosen: NDArray[np.bool_]) -> Content:
    """Return the ratio of two entries' costs in some headline scenarios, held-out."""
    costs, others = (evidence.headline()[entry].values[evidence.metric][:, chosen] for entry in (name, other))
    return _ratio(costs, others[0], evidence).plain()


def reported(evidence: Evidence) -> tuple[str, ...]:
    """Return the physical metrics that are reported of every entry."""
    return (*REPORTED, *(DRIVES if evidence.description.track == FULL_CONTROL else ()))


def _profiles(evidence: Evidence) -> Content:
    """Return performance profiles on the headline suite, held-out: the share of episodes that cost at most so much."""
    found: Content = {"costs": list(PROFILE_COSTS)}
    for name in shown(evidence):
        if evidence.entries[name].kind != "ablation":
            cost = evidence.headline()[name].values[evidence.metric]
            draws = _draws(evidence, *cost.shape)
            found[name] = [share.plain() for share in performance_profile(cost, PROFILE_COSTS, draws)]
    return found


def _references(evidence: Evidence, hand: str) -> Content:
    """Return scores (0: best constant overall, 1: clairvoyant), and shares of the gap from the best tuned law."""
    searched = evidence.searched
    foreseen = {suite: found.foresight for suite, found in searched.items() if found.foresight is not None}
    causal: Content = {}
    results, metric = evidence.headline(), evidence.metric
    for name, entry in evidence.entries.items():
        if entry.kind == "reference":
            goal, by_hand = results[name].values[metric].mean(axis=0), results[hand].values[metric][0]
            causal[name] = {
                "cost": float(goal.mean()),
                "ratio_to_eq6": _ratio(goal[None], results[YARDSTICK].values[metric][0], evidence).plain(),
                "share_from_hand": {
                    other: _share(by_hand, results[other].values[metric], goal, evidence).plain()
                    for other in shown(evidence)
                    if other != name
                },
            }
    return {
        "from": hand,
        "clairvoyant": {suite: _goal(evidence, suite, found, hand) for suite, found in searched.items()},
        "foresight": {suite: _goal(evidence, suite, found, hand) for suite, found in foreseen.items()},
        "causal": causal,
        **({} if evidence.optimal is None else {"optimal": _optimal(evidence, evidence.optimal, hand)}),
    }


def _optimal(evidence: Evidence, found: OptimalCosts, hand: str) -> Content:
    """Return the costs of the optimal commands, and the ratios of entries to them in the same scenarios."""
    count = found.cost.size
    costs = {name: evidence.headline()[name].values[evidence.metric][:, :count] for name in shown(evidence)}
    shares = {name: _share(costs[hand][0], cost, found.cost, evidence).plain() for name, cost in costs.items()}
    return {
        "scenarios": count,
        "solved": int(found.success.sum()),
        "cost": float(found.cost.mean()),
        "predicted_cost": float(found.predicted_cost.mean()),
        "ratio_to_eq6": _ratio(found.cost[None], costs[YARDSTICK][0], evidence).plain(),
        "entries_to_eq6": {name: _ratio(cost, costs[YARDSTICK][0], evidence).plain() for name, cost in costs.items()},
        "share_from_hand": shares,
    }


def _goal(evidence: Evidence, suite: str, searched: Searched, hand: str) -> Content:
    """Return the search's result on a suite, with each entry's score and share of the way."""
    goal, results = searched.run.values[evidence.metric], evidence.played[suite, "held-out"]
    costs = {name: results[name].values[evidence.metric][:, : goal.size] for name in shown(evidence)}
    start, by_hand, eq6 = (
        results[name].values[evidence.metric][0, : goal.size] for name in (evidence.best_constant(), hand, YARDSTICK)
    )
    return {
        **searched.evidence,
        "cost": float(goal.mean()),
        "ratio_to_eq6": _ratio(goal[None], eq6, evidence).plain(),
        "ratio_to_constant": _ratio(goal[None], start, evidence).plain(),
        "entries_to_eq6": {name: _ratio(cost, eq6, evidence).plain() for name, cost in costs.items()},
        "score": {name: _share(start, cost, goal, evidence).plain() for name, cost in costs.items()},
        "share_from_hand": {name: _share(by_hand, cost, goal, evidence).plain() for name, cost in costs.items()},
        "cost_more_than_an_entry": int(
            (np.min([cost.min(axis=0) for cost in costs.values()], axis=0) < goal * (1 - 1e-9)).sum()
        ),
    }


def _ratio(costs: Values, others: Values, evidence: Evidence) -> Estimate:
    """Return the ratio of the costs of an entry's seeds to those of another entry in the same scenarios."""
    return nested_ratio(costs, others, _draws(evidence, *costs.shape))


def _share(start: Values, costs: Values, goal: Values, evidence: Evidence) -> Estimate:
    """Return the share of the gap from one entry's cost to a lower one's that others close; seeds are resampled, too.

    Undefined if it is not lower: then there is no gap.
    """
    if not goal.mean() < start.mean():
        return UNDEFINED
    return _ratio(start - costs, start - goal, evidence)


def _training(evidence: Evidence) -> Content:
    """Return the cost of learning and tuning, by entry."""
    found: Content = {}
    for run in evidence.runs:
        entry = found.setdefault(run.entry, {"runs": {}, "recipe": run.config.model_dump(mode="json")})
        result = outcome(run)
        episodes = result["steps"] // run.config.env.max_episode_steps + run.config.num_envs * run.config.staggered
        entry["runs"][str(run.seed)] = {**result, "episodes": episodes}
    for name, content in evidence.tuned.items():
        recipe = {key: value for key, value in content["recipe"].items() if key != "profile"}
        found[name] = {"tuned_episodes": content["training_episodes"], "recipe": recipe}
    for name in LAWS:
        if name in evidence.entries and not evidence.entries[name].seeds and name not in evidence.tuned:
            shipped = tuned_content(name, evidence.profile, "mixed")
            found[name] = {"tuned_episodes": shipped["training_episodes"], "recipe": shipped["recipe"]}
    return found


def _worst(evidence: Evidence, best: str, hand: str) -> list[Content]:
    """Return the learned entry's worst scenarios of the headline suite, held-out, compared with the best tuned law."""
    results, metric = evidence.headline(), evidence.metric
    learned, law = results[best].values[metric].mean(axis=0), results[hand].values[metric][0]
    order = np.argsort(law - learned, kind="stable")[:WORST]
    found = []
    for rank, scenario in enumerate(order.tolist()):
        family = FAMILIES[int(results[best].families[scenario])] or evidence.protocol.suite
        found.append(
            {
                "scenario": scenario,
                "seed": evidence.protocol.seed + scenario,
                "family": family,
                "learned": float(learned[scenario]),
                "by_hand": float(law[scenario]),
                "eq6": float(results[YARDSTICK].values[metric][0, scenario]),
                "loses": bool(learned[scenario] > law[scenario]),
                "file": f"{WORST_FOLDER}/{rank + 1:02d}-{family}-seed-{evidence.protocol.seed + scenario}.json",
            }
        )
    return found


def _draws(evidence: Evidence, seeds: int, scenarios: int) -> Draws:
    bootstrap = evidence.description.bootstrap
    return _drawn(seeds, scenarios, bootstrap.resamples, bootstrap.seed)


@cache
def _drawn(seeds: int, scenarios: int, resamples: int, seed: int) -> Draws:
    return draw_nested(seeds, scenarios, resamples, seed)
