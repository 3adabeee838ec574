"""The benchmark's numbers as tables: for the terminal, the page and the document, and as CSV for everything else."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.contenders import CONSTANT
from amulett_gym.reporting.table import Table, csv_text
from amulett_gym.reporting.words import interval, number, with_interval
from amulett_gym.storage.writing import write_text
from amulett_gym.studies.benchmark.claims import Claim
from amulett_gym.studies.benchmark.description import PAPER_STEP
from amulett_gym.studies.benchmark.results import POSITION_ONLY, SEARCHED, TUNED_LAW, Content

FOLDER = "tables"

HOLDS = {True: "yes", False: "NO", None: "-"}
"""Whether a claim holds, in words."""

Estimate = Mapping[str, float | None]


def tables(found: Content, claims: Sequence[Claim]) -> dict[str, Table]:
    """Return all tables by name; those that nothing was measured for are left out."""
    makers: dict[str, Callable[[Content], Table | None]] = {
        "ranking": ranking,
        "suites": by_suite,
        "scores": scores,
        "metrics": physical,
        "paper_step": paper_step,
        "constants": constants,
        "seeds": by_seed,
        "ablations": ablations,
        "references": references,
        "budgets": budgets,
        "worst": worst,
    }
    made = {"claims": claims_table(claims)} if claims else {}
    for name, make in makers.items():
        table = make(found)
        if table is not None:
            made[name] = table
    return made


def claims_table(claims: Sequence[Claim]) -> Table:
    """Return what is claimed, what was measured, and whether it holds."""
    rows = [
        [
            claim.about,
            claim.claim,
            number(claim.measured, 3),
            interval(claim.low, claim.high),
            HOLDS[claim.holds],
            claim.note,
        ]
        for claim in claims
    ]
    held, judged = sum(claim.holds is True for claim in claims), sum(claim.holds is not None for claim in claims)
    note = f"{held} of {judged} claims hold. A dash: not measured here, or reported without a claim."
    head = ("on", "claim", "measured", "95 %", "holds", "of what")
    return Table("What the learned policy is to show", head, rows, note, left=(0, 1, 5))


def ranking(found: Content) -> Table:
    """Return all contenders on the headline suite, held-out, the cheapest first."""
    place = f"{found['description']['headline']}/held-out"
    results, overall = found["results"][place], found["constants"]["overall"]
    names = sorted(_told(found, results), key=lambda name: results[name]["cost"]["mean"])
    rows = [
        [
            label(found, name),
            number(results[name]["cost"]["mean"]),
            *(with_interval(results[name]["ratio"].get(other)) for other in (YARDSTICK, overall, TUNED_LAW)),
            number(results[name]["iqm"]["mean"]),
            number(results[name]["worst_decile"]["mean"]),
            share(results[name]["better_than"].get(TUNED_LAW)),
            f"{results[name]['failures']['count']} of {results[name]['failures']['total']}",
            number(results[name]["metrics"]["resting_stiffness"]["mean"]),
        ]
        for name in names
    ]
    head = (
        *("", "cost", "to eq. 6", "to the best constant", "to the tuned richer law", "IQM", "worst decile"),
        *("P(better than it)", "failed", "rest [N m/rad]"),
    )
    note = (
        "Ratios of costs in the same scenarios, with 95 % intervals over training seeds and scenarios. IQM: mean of "
        "the middle half; worst decile: CVaR; P: probability to cost less than the tuned richer law in a scenario. "
        + _position_only(found)
    )
    return Table(f"{place.replace('/', ', ')}: all contenders", head, rows, note)


def by_suite(found: Content) -> Table:
    """Return each entry's cost as a share of eq. 6's on every suite and split."""
    places = list(found["results"])
    names = [name for name in found["entries"] if _is_main(found, name) and name != YARDSTICK]
    rows = []
    for place in places:
        results, best = found["results"][place], found["constants"]["best"][place.split("/")[0]]
        rows.append(
            [
                place.replace("/", ", "),
                f"{best.removeprefix(CONSTANT)} N: {number(results[best]['ratio'][YARDSTICK]['mean'])}",
                *(with_interval(results[name]["ratio"].get(YARDSTICK)) for name in names),
            ]
        )
    head = ("", "best constant there", *(label(found, name) for name in names))
    note = "Cost over that of eq. 6 (text) in the same scenarios. A suite's best constant is chosen on its split train."
    return Table("Cost as a share of eq. 6's, by suite and split", head, rows, note)


def scores(found: Content) -> Table | None:
    """Return scores: 0 is the best constant overall, 1 the clairvoyant reference."""
    clairvoyant = found["references"]["clairvoyant"]
    if not clairvoyant:
        return None
    names = [name for name in found["entries"] if _is_main(found, name)]
    rows = [
        [f"{suite} ({goal['scenarios']})", *(with_interval(goal["score"].get(name)) for name in names)]
        for suite, goal in clairvoyant.items()
    ]
    note = (
        "On the suite's first held-out scenarios, whose number is in brackets. 0: the best constant overall; 1: each "
        "scenario's best schedule with the future known. " + _position_only(found)
    )
    return Table("Score", ("", *(label(found, name) for name in names)), rows, note)


def physical(found: Content) -> Table:
    """Return physical metrics on the headline suite, held-out, and their ratios to eq. 6's."""
    keys = (
        *("position_ise", "isav_biceps", "isav_triceps", "effort", "contact_ise", "contact_peak", "push_deflection"),
        "resting_stiffness",
    )
    place = f"{found['description']['headline']}/held-out"
    note = (
        "Means over all episodes; in brackets the ratio to eq. 6's. Effort is the ISAV of both drives without the "
        "setpoint's jump. Stiffness is not better or worse by itself."
    )
    return _of_metrics(found, place, {key: METRICS[key].name for key in keys}, "physical metrics", note)


def paper_step(found: Content) -> Table | None:
    """Return the metrics of the paper's Tables 2-5 on its step, or None if it was not played."""
    place = f"{PAPER_STEP}/held-out"
    if place not in found["results"]:
        return None
    keys = (*("rise_time", "settling_time", "position_ise", "tension_ise", "isav_biceps", "isav_triceps", "overshoot"),)
    names = {key: METRICS[key].paper_name or METRICS[key].name for key in keys}
    note = "In brackets the ratio to eq. 6's. Episodes differ by sensor noise."
    return _of_metrics(found, place, names, "", note)


def constants(found: Content) -> Table:
    """Return what constants cost on each suite's split train."""
    tried = found["constants"]["tried"]
    names = list(next(iter(tried.values())))
    rows = [
        [
            suite,
            *(number(costs[name]) for name in names),
            f"{found['constants']['best'][suite].removeprefix(CONSTANT)} N",
        ]
        for suite, costs in tried.items()
    ]
    head = ("", *(f"{name.removeprefix(CONSTANT)} N" for name in names), "best")
    overall = found["constants"]["overall"].removeprefix(CONSTANT)
    note = f"Mean cost on the split train, by which constants are chosen: overall, that is on the mix, {overall} N."
    return Table("How the best constant differs between suites", head, rows, note)


def by_seed(found: Content) -> Table | None:
    """Return what each training seed came to on the headline suite, held-out."""
    results = found["results"][f"{found['description']['headline']}/held-out"]
    rows = []
    for name, entry in found["entries"].items():
        if entry["kind"] in ("learned", "reference"):
            runs = found["training"][name]["runs"]
            for k, seed in enumerate(entry["seeds"]):
                run, ratios = runs[str(seed)], results[name]["seed_ratios"]
                rows.append(
                    [
                        f"{name}, seed {seed}",
                        number(results[name]["seeds"][k], 4),
                        number(ratios[YARDSTICK][k], 4),
                        number(ratios[TUNED_LAW][k], 4) if TUNED_LAW in ratios else "-",
                        number(run["best_cost"], 4),
                        f"{run['best_steps']:,}",
                        f"{run['steps']:,}",
                        f"{run['seconds']:.0f}",
                    ]
                )
    head = (
        *("", "cost", "to eq. 6", "to the tuned richer law", "training cost, validation", "steps of the best policy"),
        *("steps", "seconds"),
    )
    return Table("Training seeds, one by one", head, rows) if rows else None


def ablations(found: Content) -> Table | None:
    """Return what the learned entry becomes without each reward term, or None if none was taken away."""
    place = f"{found['description']['headline']}/held-out"
    results = found["results"][place]
    names = [name for name, entry in found["entries"].items() if entry["kind"] == "ablation"]
    if not names:
        return None
    metrics = ("position_ise", "effort", "contact_ise")
    rows = [
        [label(found, name), with_interval(results[name]["ratio"][YARDSTICK]), *_metric_cells(results[name], metrics)]
        for name in (found["best_learned"], *names)
    ]
    note = "Trained again with one weight at zero, one seed each; judged by the same cost as all."
    return Table("Without a reward term", ("", "cost to eq. 6", *(METRICS[key].heading for key in metrics)), rows, note)


def references(found: Content) -> Table | None:
    """Return how far each reference lies below the best law by hand, and what speaks for the search."""
    best, rows = found["best_learned"], []
    for kind in SEARCHED:
        for suite, goal in found["references"][kind].items():
            second = goal.get("second_search")
            rows.append(
                [
                    f"{kind}, {suite} ({goal['scenarios']})",
                    number(goal["cost"], 4),
                    with_interval(goal["ratio_to_eq6"]),
                    "-" if best is None else with_interval(goal["share_from_hand"][best]),
                    number(goal["with_other_noise"], 4),
                    f"{goal['last_quarter']:.2%}",
                    " and ".join(number(cost, 4) for cost in goal["searches_alone"]),
                    "-" if second is None else f"{second['either'] - 1:+.2%} ({second['scenarios']})",
                    f"{goal['cost_more_than_an_entry']} of {goal['scenarios']}",
                ]
            )
    for name, goal in found["references"]["causal"].items():
        shares = with_interval(goal["ratio_to_eq6"]), with_interval(goal["share_from_hand"].get(best))
        rows.append([f"causal ({name})", number(goal["cost"], 4), *shares, *"-----"])
    head = (
        *(
            "",
            "cost",
            "to eq. 6",
            "share of the way" if best is None else f"share of the way, {best}",
            "with other noise",
        ),
        "found in the last quarter",
        *("searches alone", "second search finds", "beaten by an entry"),
    )
    note = (
        f"The way is that from the best law by hand, {found['references']['from']}, to the reference. Searches are "
        "independent of what was learned. Clairvoyant: the best schedule of each scenario with all known; foresight: "
        "with all known but chance, judged during the search by other draws of the noise than the scenario's own. With "
        "other noise: what the schedules cost when chance is drawn anew. Found in the last quarter: by how much the "
        "search's mean cost fell then. Searches "
        "alone: what each start came to without the other, in the noise that it was searched in. The second search has "
        "another seed and twice as many "
        "rounds; what counts is the better of both. Beaten: scenarios in which some entry costs less: one that "
        "acts in the loop plays by other rules, another one shows that the search fell short, or that to answer "
        "the noise is worth more than to foresee."
    )
    return Table("References", head, rows, note) if rows else None


def budgets(found: Content) -> Table | None:
    """Return how many episodes were simulated for what was tuned and what was learned."""
    rows = []
    for name, entry in found["training"].items():
        if "runs" in entry:
            runs = entry["runs"].values()
            episodes = sorted(run["episodes"] for run in runs)
            times = sorted(run["seconds"] for run in runs)
            rows.append([name, f"{episodes[-1]:,}", f"{len(times)}", f"{times[0]:.0f} to {times[-1]:.0f}"])
        else:
            rows.append([name, f"{entry['tuned_episodes']:,}", f"{len(entry['recipe']['seeds'])} starts together", "-"])
    head = ("", "simulated episodes", "runs", "seconds")
    return Table("What learning and tuning took", head, rows, "Episodes of one run, of all starts.") if rows else None


def worst(found: Content) -> Table | None:
    """Return the scenarios in which the learned policy loses most."""
    rows = [
        [
            f"{item['family']}, seed {item['seed']}",
            *(number(item[key]) for key in ("learned", "by_hand", "eq6")),
            "yes" if item["loses"] else "no",
            item["file"],
        ]
        for item in found["worst"]
    ]
    head = ("", "learned", f"hand-tuned ({found['best_by_hand']})", "eq. 6", "loses", "scenario")
    note = "Costs, of the learned entry the mean over its seeds. Replay: `amulett simulate --scenario FILE --law ...`."
    return Table("Where the learned policy loses most", head, rows, note) if rows else None


def write_csv(found: Content, claims: Sequence[Claim], folder: Path) -> list[Path]:
    """Write the numbers as CSV: ``results``, ``seeds``, ``constants``, ``claims``, ``families``; return the paths."""
    files = {
        "results": (("suite", "split", "entry", "kind", "quantity", "against", "mean", "low", "high"), _long(found)),
        "seeds": (("suite", "split", "entry", "seed", "cost"), _seeds(found)),
        "constants": (
            ("suite", "constant", "train_cost"),
            (
                (suite, name, cost)
                for suite, costs in found["constants"]["tried"].items()
                for name, cost in costs.items()
            ),
        ),
        "claims": (
            ("about", "claim", "measured", "low", "high", "holds", "note"),
            ((c.about, c.claim, c.measured, c.low, c.high, c.holds, c.note) for c in claims),
        ),
        "families": (
            ("family", "scenarios", "entry", "ratio_to_eq6", "low", "high"),
            (
                (family, entry["scenarios"], name, *_three(estimate))
                for family, entry in found["families"].items()
                for name, estimate in entry["ratio_to_eq6"].items()
            ),
        ),
    }
    paths = [folder / f"{name}.csv" for name in files]
    for path, (head, rows) in zip(paths, files.values(), strict=True):
        write_text(path, csv_text(head, rows))
    return paths


def _long(found: Content) -> Iterable[Sequence[Any]]:
    for place, results in found["results"].items():
        suite, split = place.split("/")
        for name, numbers in results.items():
            about = suite, split, name, found["entries"][name]["kind"]
            for quantity in ("cost", "iqm", "worst_decile"):
                if quantity in numbers:
                    yield (*about, quantity, "", *_three(numbers[quantity]))
            for quantity in ("ratio", "better_than"):
                for other, estimate in numbers.get(quantity, {}).items():
                    yield (*about, quantity, other, *_three(estimate))
            failures = numbers["failures"]
            yield (*about, "failed", "", failures["count"] / failures["total"], failures["low"], failures["high"])
            for metric, estimate in numbers["metrics"].items():
                yield (*about, metric, "", *_three(estimate))
                if "ratio_to_eq6" in estimate:
                    yield (*about, f"ratio of {metric}", YARDSTICK, *_three(estimate["ratio_to_eq6"]))


def _seeds(found: Content) -> Iterable[Sequence[Any]]:
    for place, results in found["results"].items():
        suite, split = place.split("/")
        for name, entry in found["entries"].items():
            for seed, cost in zip(entry["seeds"], results[name]["seeds"], strict=False):
                yield suite, split, name, seed, cost


def _three(estimate: Estimate) -> tuple[float | None, float | None, float | None]:
    return estimate["mean"], estimate["low"], estimate["high"]


def _of_metrics(found: Content, place: str, names: Mapping[str, str], title: str, note: str) -> Table:
    """Return metrics of all entries on a suite and split, under the names that are given."""
    results = found["results"][place]
    rows = [[label(found, name), *_metric_cells(results[name], names)] for name in _told(found, results)]
    head = ("", *(f"{name} [{found['units'][key]}]" for key, name in names.items()))
    return Table(f"{place.replace('/', ', ')}: {title}" if title else "The paper's step", head, rows, note)


def _metric_cells(numbers: Content, metrics: Iterable[str]) -> list[str]:
    cells = []
    for metric in metrics:
        estimate = numbers["metrics"][metric]
        over = estimate["ratio_to_eq6"]["mean"]
        cells.append(number(estimate["mean"]) + ("" if over is None else f" ({number(over)})"))
    return cells


def _told(found: Content, results: Content) -> list[str]:
    return [name for name in results if "iqm" in results[name] and found["entries"][name]["kind"] != "ablation"]


def _is_main(found: Content, name: str) -> bool:
    kind = found["entries"][name]["kind"]
    return kind not in ("constant", "ablation") or name == found["constants"]["overall"]


def label(found: Content, name: str) -> str:
    """Return what a table calls an entry: constants by their tension, what was learned with its number of seeds."""
    if name.startswith(CONSTANT):
        return f"constant {name.removeprefix(CONSTANT)} N"
    count = len(found["entries"][name]["seeds"])
    return f"{name} ({count} seeds)" if count > 1 else name


def share(estimate: Estimate | None) -> str:
    """Return a probability in percent."""
    return "-" if estimate is None or estimate["mean"] is None else f"{estimate['mean']:.0%}"


def _position_only(found: Content) -> str:
    if POSITION_ONLY not in found["entries"]:
        return ""
    return "Position control alone has other gains and no tension loop: no schedule, and no reference bounds it."
