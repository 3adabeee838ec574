"""The study's numbers as plain data, with intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.evaluation.statistics import Estimate, draw_weights, ratio_of_sums
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.studies.wearer.baselines import BASELINES, BY_INTENTION, TWO_ASSISTANCES, TWO_LEVEL
from amulett_gym.studies.wearer.comparison import DOFFED, GUARDS
from amulett_gym.studies.wearer.headroom import Headroom
from amulett_gym.studies.wearer.study import NO_CABLE, Played, Study

Values = NDArray[np.float64]
Content = dict[str, Any]

_COUNTED = 9.5  # [s] of an episode, from the task's begin on


def content(study: Study) -> Content:
    """Return all numbers as plain data: that of ``results.json``."""
    description = study.description
    cells = [_cell(cell, description.resamples) for cell in study.headroom]
    plain = study.played[NO_CABLE]
    return {
        "profile": study.device.name,
        "description": description.model_dump(mode="json"),
        "headroom": cells,
        "suites": _suites(study.headroom, description.headroom.least),
        "best_baseline": study.best,
        "baselines": {
            kind: {
                "control": searches[0].control,
                "values": searches[0].values,
                "searches": [{"train": each.train, "validation": each.validation} for each in searches],
            }
            for kind, searches in study.baselines.items()
        },
        "policies": {each.name: {"control": each.control, "device": each.device.name} for each in study.policies},
        "comparison": {name: _row(study, plain, name) for name in plain if name not in GUARDS},
        "guards": {name: _row(study, plain, name) for name in plain if name in GUARDS},
        "cables": _cables(study),
    }


def _cell(cell: Headroom, resamples: int) -> Content:
    costs = cell.costs
    few = costs["clairvoyant"].size

    def ratio(name: str, reference: str) -> Content:
        count = few if "clairvoyant" in (name, reference) else costs[name].size
        weights = draw_weights(count, resamples)
        return ratio_of_sums(costs[name][:count], costs[reference][:count], weights).plain()

    return {
        "suite": cell.suite,
        "control": cell.control,
        "scenarios": costs["doffed"].size,
        "foreseen": few,
        "costs": {name: float(values.mean()) for name, values in costs.items()},
        "values": {kind: tuned.values for kind, tuned in cell.tuned.items()},
        "over_doffed": {name: ratio(name, "doffed") for name in (*cell.tuned, "clairvoyant")},
        "over_constant": {name: ratio(name, "constant") for name in (*BY_INTENTION, "clairvoyant")},
        "two_levels_over_two_assistances": ratio(TWO_LEVEL, TWO_ASSISTANCES),
    }


def _suites(cells: list[Headroom], least: float) -> Content:
    """Return what each suite's schedules gain over its best constant, each in its best loop.

    That is the loop with the least cost on training scenarios, among those that `Amulett/Worn-v0` has. A clairvoyant,
    whose search is on the held-out scenarios themselves, may choose its loop there, too.
    """
    found: Content = {}
    cells = [cell for cell in cells if cell.control in LOOPS]
    for suite in dict.fromkeys(cell.suite for cell in cells):
        own = [cell for cell in cells if cell.suite == suite]
        best = {name: _least_trained(own, name) for name in ("constant", *BY_INTENTION)}
        best["clairvoyant"] = min(own, key=lambda cell: float(cell.costs["clairvoyant"].mean()))
        gains = {}
        for name in (*BY_INTENTION, "clairvoyant"):
            costs = best[name].costs[name]
            constant = best["constant"].costs["constant"][: costs.size]  # a clairvoyant's are the first ones
            gains[name] = 1.0 - float(costs.mean()) / float(constant.mean())
        stiffness = 1.0 - (1.0 - gains[TWO_LEVEL]) / (1.0 - gains[TWO_ASSISTANCES])
        loops = {name: cell.control for name, cell in best.items()}
        found[suite] = {"control": loops["constant"], "loops": loops, "gains": gains, "gain_of_stiffness": stiffness}
        found[suite]["headroom"] = bool(gains["clairvoyant"] >= least)
    return found


def _least_trained(cells: list[Headroom], kind: str) -> Headroom:
    """Return the cell in which a tuned constant or schedule costs least on training scenarios."""
    return min(cells, key=lambda cell: cell.tuned[kind].train)


def _row(study: Study, played: dict[str, Played], name: str) -> Content:
    values, doffed, best = played[name], played[DOFFED], played[study.best]
    weights = draw_weights(values["cost"].size, study.description.resamples)

    def ratio(key: str, reference: Played) -> dict[str, float | None]:
        found: Estimate = ratio_of_sums(values[key], reference[key], weights)
        return found.plain()

    cost, effort = (values[key] / doffed[key] for key in ("cost", "muscle_effort"))
    moving = values["moving_time"].sum()
    return {
        "cost": float(values["cost"].mean()),
        "terms": {key: float(values[key].mean()) for key in ("muscle", "tracking", "cuff", "drives", "failure")},
        "cost_over_doffed": ratio("cost", doffed),
        "cost_over_best": ratio("cost", best),
        "effort_over_doffed": ratio("muscle_effort", doffed),
        "effort_over_best": ratio("muscle_effort", best),
        "moving_cuff_rms": float(np.sqrt(values["moving_cuff_ise"].sum() / moving)) if moving > 0.0 else None,
        "cuff_peak": float(values["cuff_peak"].mean()),
        "cuff_peak_over_best": ratio("cuff_peak", best),
        "largest_cuff_peak": float(values["cuff_peak"].max()),
        "tracking_rms": float(np.sqrt(values["tracking_ise"].mean() / _COUNTED)),
        "isav": float(values["isav"].mean()),
        "failed": int(values["failed"].sum()),
        "wearers": cost.size,
        "worse_off": {"count": int((cost > 1.0).sum()), "worst": float(cost.max()), "median": float(np.median(cost))},
        "worse_off_by_effort": {"count": int((effort > 1.0).sum()), "worst": float(effort.max())},
        "cost_ratios": cost.tolist(),
    }


def _cables(study: Study) -> Content:
    """Return costs with each cable, and what is left of each contender's lead over the best baseline.

    ``drawn`` has the same of the cables that are drawn for each wearer, or is None.
    """
    plain, drawn = study.played[NO_CABLE], study.description.drawn_cables
    cables = [cable.name for cable in study.description.cables]
    found: Content = {}
    for name in (name for name in plain if name not in GUARDS):
        found[name] = {
            "costs": {cable: float(played[name]["cost"].mean()) for cable, played in study.played.items() if cable},
            "lead": float(1.0 - plain[name]["cost"].sum() / plain[study.best]["cost"].sum()),
            "baseline": name in BASELINES,
            "pairs": _with_cables(study, name, cables) if cables else None,
            "drawn": None if drawn is None else _with_cables(study, name, [drawn.name]),
        }
    return found


def _with_cables(study: Study, name: str, cables: list[str]) -> Content:
    """Return a contender's cost over the best baseline's, its lead, and who is worse off, over several cables."""
    own, best = (np.array([study.played[cable][each]["cost"] for cable in cables]) for each in (name, study.best))
    # The cables of a wearer are resampled together.
    weights = draw_weights(own.shape[1], study.description.resamples)
    ratio = ratio_of_sums(own.sum(axis=0), best.sum(axis=0), weights).plain()
    worse = own > study.played[NO_CABLE][DOFFED]["cost"]
    return {
        "cost_over_best": ratio,
        "lead": float(1.0 - own.sum() / best.sum()),
        "worse_off": {"count": int(worse.sum()), "of": worse.size},
    }
