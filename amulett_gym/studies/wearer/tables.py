"""Tables of the study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import number, with_interval
from amulett_gym.studies.wearer.baselines import TWO_ASSISTANCES, TWO_LEVEL
from amulett_gym.studies.wearer.comparison import DOFFED, GUARDS
from amulett_gym.studies.wearer.results import Content

_SHORT = {
    "co_contraction": "T",
    "nominal_tension": "sigma",
    "minimum_tension": "sigma_min",
    "moving_tension": "T moving",
}
_SHORT |= {"holding_tension": "T holding", "holding_assistance": "a holding"}


_CABLES = {"pairs": "with cables", "drawn": "with cables drawn for each wearer"}


def tables(found: Content) -> dict[str, Table]:
    """Return all tables by name."""
    all_tables = {
        "headroom": headroom_table(found),
        "baselines": baselines_table(found),
        "comparison": comparison_table(found),
        "wearers": wearers_table(found),
        "guards": guards_table(found),
    }
    for kind, name in (("pairs", "cables"), ("drawn", "drawn_cables")):
        if found["cables"][DOFFED][kind] is not None:
            all_tables[name] = cables_table(found, kind)
    return {name: table for name, table in all_tables.items() if table.rows}


def answer(found: Content) -> list[str]:
    """Return what the numbers say, as sentences."""
    lines = []
    for suite, gained in found["suites"].items():
        of = {name: _percent(gain) for name, gain in gained["gains"].items()}
        gains = f"a clairvoyant gains {of['clairvoyant']} over the best constant, in {gained['control']}; "
        gains += f"two assistances by the true intention {of[TWO_ASSISTANCES]}, with two co-contractions "
        gains += f"{of[TWO_LEVEL]}: stiffness is worth {_percent(gained['gain_of_stiffness'])}"
        lines.append(f"{suite}: {gains}." if gained["headroom"] else f"{suite}: **without headroom**; {gains}.")
    best, rows = found["best_baseline"], found["comparison"]
    row = rows[best]
    lines.append(
        f"The best baseline on validation wearers is {best}. On held-out ones its cost is "
        f"{with_interval(row['cost_over_doffed'])} times, its effort {with_interval(row['effort_over_doffed'])} times "
        "that of the same wearers without the device."
    )
    for name in found["policies"]:
        mine, cables = rows[name], found["cables"][name]
        worse = mine["worse_off"]["count"]
        text = f"The policy {name} costs {with_interval(mine['cost_over_best'])} times the best baseline"
        text += f", with an effort of {with_interval(mine['effort_over_doffed'])} times doffed; "
        text += f"{worse} of {mine['wearers']} wearers cost more than doffed."
        leads = [_percent(cables["lead"])]
        leads += [f"{_percent(cables[kind]['lead'])} {words}" for kind, words in _CABLES.items() if cables[kind]]
        lines.append(f"{text} Its lead is {', and '.join(leads)}.")
    return lines


def headroom_table(found: Content) -> Table:
    """Return the headroom per suite and loop."""
    first = ("best constant / doffed", "two assistances / constant", "two levels / constant")
    head = ("suite", "loop", *first, "clairvoyant / constant", "two levels / two assistances", "clairvoyant / doffed")
    rows = []
    for cell in found["headroom"]:
        ratios = [cell["over_doffed"]["constant"], *cell["over_constant"].values()]
        ratios += [cell["two_levels_over_two_assistances"], cell["over_doffed"]["clairvoyant"]]
        rows.append([cell["suite"], cell["control"], *(with_interval(ratio) for ratio in ratios)])
    plan = found["description"]["headroom"]
    note = (
        f"Ratios of costs on {plan['held_out']} held-out wearers (clairvoyant: the first "
        f"{plan['clairvoyant']['scenarios']}), with 95 % intervals over wearers. Constant and levels are tuned "
        f"with their admittance on {plan['episodes']} training wearers, {plan['population']} candidates in each of "
        f"{plan['iterations']} iterations. Two levels: co-contraction and assistance by the wearer's true intention, "
        "moving or not; two assistances: at one co-contraction. Clairvoyant: both in each phase of the intention, "
        "searched for each scenario."
    )
    return Table("Headroom", head, rows, note, left=(0, 1))


def baselines_table(found: Content) -> Table:
    """Return the tuned parameters."""
    rows = []
    for kind, each in found["baselines"].items():
        values = ", ".join(f"{_SHORT.get(key, key)} {number(value)}" for key, value in each["values"].items())
        searches = ", ".join(number(search["validation"]) for search in each["searches"])
        rows.append([kind, each["control"], values, number(each["searches"][0]["train"]), searches])
    plan = found["description"]["tuning"]
    episodes = plan["starts"] * plan["population"] * plan["iterations"] * plan["episodes"]
    note = (
        f"Mean costs; each baseline has the same budget, {episodes:,} episodes, and its own admittance. Units: N, deg, "
        "deg/s, N m, s. Validation: of each search; the first is chosen."
    )
    head = ("baseline", "loop", "tuned parameters", "training", "validation")
    return Table("Tuned baselines", head, rows, note, left=(0, 1, 2))


def comparison_table(found: Content) -> Table:
    """Return the comparison on held-out wearers."""
    shares = ("cost / doffed", "cost / best baseline", "effort / doffed")
    peaks = ("cuff torque moving [N m]", "mean peak [N m]", "largest peak [N m]")
    head = ("contender", *shares, *peaks, "tracking rms [deg]", "ISAV [deg2/s]", "failed")
    rows = []
    for name, row in found["comparison"].items():
        ratios = [with_interval(row[key]) for key in ("cost_over_doffed", "cost_over_best", "effort_over_doffed")]
        keys = ("moving_cuff_rms", "cuff_peak", "largest_cuff_peak", "tracking_rms", "isav")
        rows.append([_label(found, name), *ratios, *(number(row[key]) for key in keys), str(row["failed"])])
    description = found["description"]
    note = (
        f"{description['held_out']} held-out wearers of the suite {description['suite']} in the loop "
        f"{description['control']} (a policy: in its own), from seed {description['seed']}. Doffed: the same wearers "
        "without the device; it has no cuff and no drives, so that its cost is that of muscles and tracking alone. "
        "Two-assistances and two-level know the true intention, which no device does."
    )
    return Table("Held-out wearers", head, rows, note)


def wearers_table(found: Content) -> Table:
    """Return how many wearers are worse off than without the device."""
    head = ("contender", "worse off by cost", "median ratio", "worst ratio", "worse off by effort", "worst ratio")
    rows = []
    for name, row in found["comparison"].items():
        if name != DOFFED:
            cost, effort, of = row["worse_off"], row["worse_off_by_effort"], row["wearers"]
            cells = [_share(cost["count"], of), number(cost["median"]), number(cost["worst"])]
            rows.append([_label(found, name), *cells, _share(effort["count"], of), number(effort["worst"])])
    note = "Ratios of each wearer's cost and muscle effort to those of the same wearer, doffed, in the same scenario."
    return Table("Wearers who are worse off", head, rows, note)


def guards_table(found: Content) -> Table:
    """Return what a slack arm and a held wearer cost."""
    head = ("behaviour", "what it is", "cost / doffed", "cost / best baseline", "muscle", "tracking", "cuff", "drives")
    rows = []
    for name, row in found["guards"].items():
        terms = [number(row["terms"][key]) for key in ("muscle", "tracking", "cuff", "drives")]
        ratios = [with_interval(row["cost_over_doffed"]), with_interval(row["cost_over_best"])]
        rows.append([name, GUARDS[name], *ratios, *terms])
    note = "With the admittance of the best constant; the terms of the cost show which of them prevents it."
    return Table("Behaviour that must not be rewarded", head, rows, note, left=(0, 1))


def cables_table(found: Content, kind: str = "pairs") -> Table:
    """Return the costs with Bowden cables: of fixed pairs of friction and bend, or drawn for each wearer."""
    description = found["description"]
    costs = [cable_name(cable) for cable in description["cables"]] if kind == "pairs" else ["drawn"]
    over = f"{'all' if kind == 'pairs' else kind} / best baseline"
    head = ("contender", *costs, over, "lead without", "lead with cables", "worse off")
    rows = []
    for name, row in found["cables"].items():
        own, device = row[kind], name != DOFFED
        lead = [_percent(row["lead"]), _percent(own["lead"])] if device else ["-", "-"]
        worse = _share(own["worse_off"]["count"], own["worse_off"]["of"]) if device else "-"
        means = [number(row["costs"][cable]) for cable in costs]
        rows.append([_label(found, name), *means, with_interval(own["cost_over_best"]), *lead, worse])
    which = "friction mu and total bend of each sheath"
    if kind == "drawn":
        (least, most), (low, high) = (description["drawn_cables"][key] for key in ("friction", "bend_deg"))
        which = f"each wearer's are drawn, mu from {least:g} to {most:g} and a bend from {low:g} to {high:g} deg"
    note = (
        f"Mean costs of the same wearers and laws, nothing tuned again, with Bowden cables of both strings at the "
        f"{description['side']} side: {which}. Lead: gain over the best baseline with the same cables. Worse off: "
        "episodes that cost more than doffed."
    )
    return Table("Bowden cables" if kind == "pairs" else "Bowden cables of each wearer's own", head, rows, note)


def cable_name(cable: Mapping[str, Any]) -> str:
    """Return a cable's name."""
    return f"mu {cable['friction']:g}, {cable['bend_deg']:g} deg"


def _label(found: Content, name: str) -> str:
    marks = [" (best baseline)"] if name == found["best_baseline"] else []
    return f"{name}{''.join(marks)}"


def _share(count: int, of: int) -> str:
    return f"{count} of {of}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
